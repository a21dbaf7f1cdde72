"""A running klippy: started, spoken to, and looked at."""

from __future__ import annotations

import os
import shutil
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as NotYetError
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, Optional

from simprinter import Machine, VirtualClock, build_directory
from simprinter.clock import RealClock
from simprinter.hosts.api import ApiClient, ApiError
from simprinter.hosts.hosts import Host, Installed
from simprinter.hosts.starting import Klippy, fork, start
from simprinter.simulation import Pace, Simulation, SimulationError

_START_LIMIT = 120.0  # printer seconds
_ASK_STATE_EVERY = 5.0
_BATCH_LIMIT = 3600.0
_LIFETIME = 1e6
# Real seconds in which a printer that lives by itself comes to rest; klippy
# alone may compute for a minute
_REST_LIMIT = 90.0


class GcodeError(Exception):
    """A command ended in an error; the text is what the user sees."""


class SessionError(Exception):
    """Klippy is not where the test needs it; carries the log's tail."""


class Command(NamedTuple):
    """G-code that was sent; lines: on the console before."""

    script: str
    number: int
    lines: int


class _Process:
    """Klippy's process with its files, laid out as installers do it."""

    def __init__(
        self,
        installed: Installed,
        simulation: Simulation,
        config: str,
        data: Optional[Path] = None,
    ) -> None:
        """data: where the files are and stay (default: they do not stay)."""
        self._is_kept = data is not None
        self.directory = data or Path(tempfile.mkdtemp(prefix="klippy-"))
        self.config = self.directory / "config" / "printer.cfg"
        self.log = self.directory / "logs" / "klippy.log"
        self.socket = self.directory / "comms" / "klippy.sock"
        for path in (self.config, self.log, self.socket):
            path.parent.mkdir(exist_ok=True)
        self._installed = installed
        self.write_config(config)
        self._simulation = simulation
        self._klippy: Optional[Klippy] = None

    def write_config(self, config: str) -> None:
        """Make printer.cfg anew."""
        self.config.write_text(self._installed.config + config)

    def start(self, options: list[str], as_service: bool = False) -> None:
        """Start klippy on the simulation's clock.

        as_service: from its program file, not forked; slower.
        """
        clock = self._simulation.clock
        # The terminal has a fixed name in /tmp otherwise
        terminal = self.socket.with_name("klippy.serial")
        command = [str(self.config), "-l", str(self.log), "-I", str(terminal)]
        command += options
        output = self.log.with_name("output.txt")
        # Where files stay, an update may have changed the modules
        is_real = isinstance(clock, RealClock)
        if as_service or self._is_kept or is_real:
            self._klippy = start(self._installed, command, clock, output)
        else:
            config = self.config.read_text()
            self._klippy = fork(self._installed, command, clock, output, config)
        self._simulation.process_fd = os.dup(self._klippy.pidfd)

    def log_text(self) -> str:
        """The log and whatever else klippy has printed."""
        texts = []
        for path in (self.log, self.log.with_name("output.txt")):
            if path.exists():
                texts.append(path.read_text(errors="replace"))
        return "\n".join(texts)

    def end(self) -> Optional[int]:
        """End klippy if it still runs; its exit status where it is known."""
        assert self._klippy is not None
        return self._klippy.end()

    def remove(self) -> None:
        """Forget it, and delete its files unless they are to stay."""
        if self._klippy is not None:
            self._klippy.close()
        if not self._is_kept:
            shutil.rmtree(self.directory, ignore_errors=True)


class LiveSession:
    """Klippy with its API socket open, as a web interface would use it.

    Use as a context manager; klippy is ended and its files are removed on
    leaving.
    """

    def __init__(
        self,
        installed: Installed,
        machine: Machine,
        config: str,
        data: Optional[Path] = None,
    ):
        """config: printer.cfg without what the host itself needs.

        data: directory for klippy's files (default: a new one, removed at the
        end).
        """
        self.machine = machine
        self._process = _Process(installed, machine.simulation, config, data)
        self._api = ApiClient(self._process.socket)
        self._is_living = False
        # G-code that was sent so far
        self.scripts: list[str] = []
        self._process.start(["-a", str(self._process.socket)])
        machine.simulation.peers.append(self._api)

    def __enter__(self) -> LiveSession:
        return self

    def __exit__(self, *unused: object) -> None:
        self.close()

    def close(self) -> None:
        """End klippy."""
        self._process.end()
        self._api.close()
        self._process.remove()

    @contextmanager
    def living(self, speed: float) -> Iterator[Future]:
        """Let the printer live by itself, in real time but so much faster.

        For those who talk to klippy over its socket. Until this is left, a
        thread runs the simulation, and neither the session nor the machine is
        for others, but peers of the simulation live in it. Raises SessionError
        on leaving if the printer could not live that long; what it gives is
        done as soon as that is so.
        """
        simulation = self._simulation
        simulation.pace = Pace(simulation.clock, speed)
        leaving = threading.Event()
        with ThreadPoolExecutor(1) as pool:
            try:
                life = pool.submit(
                    simulation.run_until, leaving.is_set, _LIFETIME, "living"
                )
                self._is_living = True
                yield life
            finally:
                leaving.set()
                failure = self._end_of(life)
                self._is_living = False
                simulation.pace = None
                self._require_well(failure)

    def _end_of(self, life: Future) -> Optional[BaseException]:
        """Wait for it; why it has failed. Klippy has to go if it lasts."""
        try:
            return life.exception(_REST_LIMIT)
        except NotYetError:
            self.kill()
            life.exception(_REST_LIMIT)
            return SessionError(
                f"living: no rest within {_REST_LIMIT:.0f} s, klippy was"
                f" ended\n{self._tail()}"
            )

    @property
    def _simulation(self) -> Simulation:
        """The simulation, for the one who runs it."""
        if self._is_living:
            raise SessionError("the printer lives by itself: end that first")
        return self.machine.simulation

    @property
    def socket(self) -> Path:
        """Of klippy's API: for others that talk to it."""
        return self._process.socket

    @property
    def data(self) -> Path:
        """Klippy's files: config/printer.cfg, logs/, comms/klippy.sock."""
        return self._process.directory

    def kill(self) -> None:
        """End klippy as a power cut would; the rest goes on."""
        self._process.end()

    @property
    def console(self) -> list[str]:
        """All lines the console has shown so far."""
        return self._api.console

    def log(self) -> str:
        """The log so far."""
        return self._process.log_text()

    def config_text(self) -> str:
        """printer.cfg as it is now (SAVE_CONFIG rewrites it)."""
        return self._process.config.read_text()

    def start(self) -> tuple[str, str]:
        """Wait until klippy is ready or has given up: (state, message)."""
        while True:
            info = self.call("info", {})
            if info["state"] != "startup":
                return info["state"], info["state_message"]
            self.wait(0.1)

    def require_ready(self) -> None:
        """Wait for klippy. Raises SessionError if it does not get ready."""
        state, message = self.start()
        if state != "ready":
            raise SessionError(f"{state}: {message}\n{self._tail()}")

    def state(self) -> tuple[str, str]:
        """(state, message), as web interfaces show it."""
        info = self.call("info", {})
        return info["state"], info["state_message"]

    def restart(self, command: str) -> None:
        """RESTART or FIRMWARE_RESTART, then wait until klippy is ready.

        Raises SessionError if it does not get there.
        """
        self._begin_anew(command)
        self.require_ready()

    def reload(
        self, config: str, command: str = "FIRMWARE_RESTART"
    ) -> tuple[str, str]:
        """Give klippy and its boards another printer.cfg; (state, message)."""
        self._process.write_config(config)
        self._begin_anew(command)
        return self.start()

    def _begin_anew(self, command: str) -> None:
        api, simulation = self._api, self._simulation
        api.request("gcode/script", {"script": command})
        before = api.connections
        try:
            simulation.run_until(
                lambda: api.connections > before, _START_LIMIT, command
            )
        except SimulationError as error:
            raise SessionError(f"{error}\n{self._tail()}") from error

    def wait(self, seconds: float) -> None:
        """Let printer seconds pass."""
        simulation = self._simulation
        end = simulation.clock.now() + round(seconds * 1e9)
        simulation.run_until(
            lambda: simulation.clock.now() >= end, seconds + 1.0, "waiting"
        )

    def call(self, method: str, params: dict[str, Any]) -> Any:
        """One API request. Raises ApiError with klippy's words."""
        try:
            number = self._ask(method, params)
            while not self._api.answered(number):
                # Klippy restarted before it could answer
                number = self._ask(method, params)
        except SimulationError as error:
            raise SessionError(f"{error}\n{self._tail()}") from error
        return self._api.answer(number)

    def _ask(self, method: str, params: dict[str, Any]) -> int:
        """Send a request and wait until it is answered or the line drops."""
        api, simulation = self._api, self._simulation
        simulation.run_until(api.connected, _START_LIMIT, "connecting")
        number = api.request(method, params)
        before = api.connections
        simulation.run_until(
            lambda: api.answered(number) or api.connections > before,
            _START_LIMIT,
            method,
        )
        return number

    def run(self, script: str, limit: float = 600.0) -> list[str]:
        """Run G-code to its end; the console lines it has printed.

        limit: printer seconds. Raises GcodeError with the text the user
        sees, also when the printer shut down meanwhile.
        """
        return self.finish(self.begin(script), limit)

    def begin(self, script: str) -> Command:
        """Send G-code; it has not begun to run.

        Faults that are about its command are counted from now on.
        """
        self.machine.faults.script_begins(script)
        self.scripts.append(script)
        number = self._api.request("gcode/script", {"script": script})
        return Command(script, number, len(self.console))

    def run_until(self, command: Command, done: Callable[[], bool]) -> None:
        """Let a command run until done() or to its end."""
        simulation, number = self._simulation, command.number
        simulation.run_until(
            lambda: self._api.answered(number) or done(),
            _START_LIMIT * 10,
            command.script,
        )

    def stop(self) -> None:
        """What the emergency stop button of an interface does."""
        self._api.request("emergency_stop", {})

    def finish(self, command: Command, limit: float = 600.0) -> list[str]:
        """Let a command run to its end, as run() does."""
        try:
            return self._finish(command, limit)
        finally:
            self.machine.faults.script_ends(command.script)

    def _finish(self, command: Command, limit: float) -> list[str]:
        script, number, before = command
        simulation = self._simulation
        end = simulation.clock.now() + round(limit * 1e9)
        while not self._api.answered(number):
            self._live_until_answered(number, script)
            if simulation.clock.now() >= end:
                raise SessionError(f"{script!r} takes over {limit} s")
            # A request that a shutdown overtakes is never answered
            if not self._api.answered(number):
                state, message = self.state()
                if state != "ready" and not self._api.answered(number):
                    raise GcodeError(message)
        try:
            self._api.answer(number)
        except ApiError as error:
            raise GcodeError(str(error)) from error
        return self.console[before:]

    def _live_until_answered(self, number: int, script: str) -> None:
        simulation = self._simulation
        end = simulation.clock.now() + round(_ASK_STATE_EVERY * 1e9)
        try:
            simulation.run_until(
                lambda: (
                    self._api.answered(number) or simulation.clock.now() >= end
                ),
                _ASK_STATE_EVERY + 1.0,
                script,
            )
        except SimulationError as error:
            raise SessionError(f"{error}\n{self._tail()}") from error

    def status(self, name: str) -> dict[str, Any]:
        """All status fields of one printer object."""
        return self.statuses({name: None}).get(name, {})

    def statuses(
        self, fields: Mapping[str, Optional[Sequence[str]]]
    ) -> dict[str, dict[str, Any]]:
        """Of several printer objects at one moment; None: all fields.

        Klippy answers four questions a second, so several cost printer time.
        """
        reply = self.call("objects/query", {"objects": dict(fields)})
        return reply["status"]

    def position(self) -> tuple[float, float, float]:
        """Where klippy believes the toolhead is, mm."""
        x, y, z = self.status("toolhead")["position"][:3]
        return x, y, z

    def _require_well(self, failure: Optional[BaseException]) -> None:
        if isinstance(failure, SimulationError):
            raise SessionError(f"{failure}\n{self._tail()}") from failure
        if failure is not None:
            raise failure

    def _tail(self, lines: int = 40) -> str:
        return "\n".join(self.log().splitlines()[-lines:])


class BatchResult(NamedTuple):
    """How a batch run ended: exit status, and the log, which also holds what
    a console would have shown (klippy writes it nowhere else in this mode).
    """

    status: int
    log: str

    def tail(self, lines: int = 40) -> str:
        """The end of the log."""
        return "\n".join(self.log.splitlines()[-lines:])


def run_batch(
    installed: Installed, machine: Machine, config: str, gcode: str
) -> BatchResult:
    """Run a G-code file to its end on the simulated machine (klippy -i)."""
    process = _Process(installed, machine.simulation, config)
    try:
        return _run_to_end(process, machine.simulation, gcode, [])
    finally:
        process.remove()


def run_file_output(
    host: Host,
    modules: Mapping[str, Path],
    dictionary: bytes,
    config: str,
    gcode: str,
) -> BatchResult:
    """Run a G-code file in klippy's own file-output mode, without a machine."""
    simulation = Simulation(VirtualClock(build_directory()))
    process = _Process(host.install(modules), simulation, config)
    known = process.directory / "mcu.dict"
    known.write_bytes(dictionary)
    options = ["-o", str(known.with_name("sent.bin")), "-d", str(known)]
    try:
        return _run_to_end(process, simulation, gcode, options)
    finally:
        simulation.close()
        process.remove()


def _run_to_end(
    process: _Process, simulation: Simulation, gcode: str, options: list[str]
) -> BatchResult:
    """Start klippy on a G-code file and wait until it has ended."""
    file = process.directory / "input.gcode"
    file.write_text(gcode)
    process.start(["-i", str(file), "-v", *options], as_service=True)
    try:
        simulation.run_until(
            simulation.process_ended, _BATCH_LIMIT, "batch run"
        )
    finally:
        status = process.end()
    assert status is not None
    return BatchResult(status, process.log_text())
