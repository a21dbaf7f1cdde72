"""Processes that klippy starts, and what the virtual clock does meanwhile."""

from __future__ import annotations

import os
import re
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from simprinter import simulation as simulation_module
from simprinter.hosts.hosts import Host
from simprinter.hosts.session import SessionError
from simprinter.plugin_printer import PluginPrinter
from simprinter.plugin_printer import start as start_printer
from simprinter.running import SAMPLE
from simprinter.simulation import SimulationError
from simprinter.tests.programs import Program, python, run_python

SECOND = 10**9
# A second thread that waits for time again and again, as klippy's do
TICK = """
def tick():
    while True:
        time.sleep(0.01)
threading.Thread(target=tick, daemon=True).start()
"""


def never() -> bool:
    """What is waited for in vain."""
    return False


def has_ended(pid: int) -> bool:
    """Whether there is no such process, or nothing of it but its status."""
    try:
        with open(f"/proc/{pid}/stat", encoding="ascii") as file:
            return file.read().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


def processes_with(text: str) -> list[int]:
    """Those that were started with such an argument."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            if text.encode() in (entry / "cmdline").read_bytes():
                found.append(int(entry.name))
        except OSError:
            continue
    return found


def wait_for_end(pid: int) -> None:
    """Of a process that has been killed."""
    end = time.monotonic() + 20.0
    while not has_ended(pid):
        assert time.monotonic() < end, f"process {pid} is still there"
        time.sleep(0.01)


# Python starts a child by fork or by posix_spawn, depending on close_fds
WAYS = [
    "subprocess.run(command, stdout=PIPE, close_fds=True).stdout",
    "subprocess.run(command, stdout=PIPE, close_fds=False).stdout",
    "subprocess.run(command, stdout=PIPE, stderr=PIPE).stdout",
    "subprocess.run(command, stdout=PIPE, timeout=100).stdout",
    "polled(subprocess.Popen(command, stdout=PIPE))",
    "waited(subprocess.Popen(command, stdout=PIPE))",
    "read_by_thread(subprocess.Popen(command, stdout=PIPE))",
    "forked()",
    "by_multiprocessing()",
]
WAITING = """
import multiprocessing
from subprocess import PIPE
def polled(child):
    while child.poll() is None:
        time.sleep(0.1)
    return child.stdout.read()
def waited(child):
    child.wait()
    return child.stdout.read()
def read_by_thread(child):
    said = []
    thread = threading.Thread(target=lambda: said.append(child.stdout.read()))
    thread.start()
    while child.poll() is None:
        time.sleep(0.1)
    thread.join(3600)
    return said[0]
def life():
    # Without exec there is the real clock, too
    began = time.monotonic()
    time.sleep(0.8)
    is_real = time.time() > 1_767_300_000
    return f"{is_real} {0.8 <= time.monotonic() - began < 60.0}".encode()
def forked():
    reader, writer = os.pipe()
    pid = os.fork()
    if not pid:
        os.write(writer, life())
        os._exit(0)
    said = os.read(reader, 100)
    os.waitpid(pid, 0)
    return said
def by_multiprocessing():
    parent, child = multiprocessing.Pipe()
    process = multiprocessing.Process(target=lambda: child.send(life()))
    process.daemon = True
    process.start()
    while process.is_alive():
        time.sleep(0.1)
    process.join()
    return parent.recv()
"""


@pytest.mark.parametrize(
    "way",
    # Each lives for two real seconds
    [WAYS[0], *(pytest.param(w, marks=pytest.mark.slow) for w in WAYS[1:])],
)
def test_clock_keeps_pace_with_a_child_and_is_free_afterwards(way):
    source = f"""
child = (
    "import time; began = time.monotonic(); time.sleep(0.8);"
    " print(time.time() > 1_767_300_000,"
    " 0.8 <= time.monotonic() - began < 60.0)"
)
command = [sys.executable, "-c", child]
for _ in range(2):
    begin = now()
    print({way}.decode().strip())
    end = now()
    print((end - begin) / 1e9)
    time.sleep(100)
    print(now() - end)
"""
    began = time.monotonic()
    lines = run_python(WAITING + TICK + source)
    took = time.monotonic() - began
    assert took < 60.0
    # The child's clock is the real one
    assert lines[::3] == ["True True"] * 2
    assert lines[2::3] == [str(100 * SECOND)] * 2
    # The simulator may see a child late where it gets no processor, and those
    # who poll wait for up to 0.1 s more
    lives = [float(line) for line in lines[1::3]]
    assert min(lives) > 0.0
    assert sum(lives) <= took + 0.5


def test_clock_stands_still_for_who_waits_for_a_child_and_for_no_time():
    # So klippy asks git which version it is, before it has threads that wait
    source = """
child = [sys.executable, "-c", "import time; time.sleep(0.2); print('v1')"]
for stderr in (subprocess.PIPE, None):
    done = subprocess.run(child, stdout=subprocess.PIPE, stderr=stderr)
    print(done.stdout.decode().strip(), now())
"""
    assert run_python(source) == ["v1 0", "v1 0"]


def test_child_that_is_never_waited_for_does_not_hold_the_clock():
    source = """
children = [subprocess.Popen(["true"]) for _ in range(3)]
time.sleep(3600)
print(now() - 3600 * 10**9, [child.returncode for child in children])
"""
    began = time.monotonic()
    assert run_python(source) == ["0 [None, None, None]"]
    assert time.monotonic() - began < 60.0


def test_what_a_child_said_last_is_heard_before_time_passes():
    source = """
late = []
for n in range(300):
    child = subprocess.Popen(["true"], stdout=subprocess.PIPE)
    begin = now()
    ready, _, _ = select.select([child.stdout], [], [], 3600)
    if not ready or now() - begin > 60 * 10**9:
        late.append((n, now() - begin))
    child.stdout.close()
    child.wait()
print(late)
"""
    assert run_python(source) == ["[]"]


def test_child_that_hangs_is_killed_by_time():
    source = """
child = subprocess.Popen(["sleep", "1000"])
begin = now()
while child.poll() is None:
    time.sleep(0.1)
    if now() - begin >= 10**9:
        child.kill()
print(child.returncode, (now() - begin) / 1e9)
begin = now()
time.sleep(3600)
print(now() - begin)
"""
    began = time.monotonic()
    ended, after = run_python(source)
    assert 1.0 <= time.monotonic() - began < 60.0
    status, seconds = ended.split()
    assert int(status) == -signal.SIGKILL
    assert 1.0 <= float(seconds) < 1.35
    assert after == str(3600 * SECOND)


def test_time_may_go_by_faster_than_a_child_lives():
    source = """
child = subprocess.Popen(["sleep", "1000"])
time.sleep(60)
child.kill()
print(child.wait(), now() >= 60 * 10**9)
"""

    def prepare(simulation):
        simulation.children_speed = 100.0

    began = time.monotonic()
    with Program(python(source), prepare) as program:
        assert program.finish() == ["-9 True"]
    assert 0.6 <= time.monotonic() - began < 30.0


def test_hanging_child_for_which_klippy_waits_without_end(monkeypatch):
    monkeypatch.setattr(simulation_module, "_STALL_LIMIT", 3.0)
    source = "subprocess.run(['sleep', '1000'])"
    failure = pytest.raises(
        SimulationError, match="^tea: klippy waits for a child for 3 s of real"
    )
    with Program(python(source)) as program, failure:
        program.simulation.run_until(never, 5.0, "tea")
    assert program.simulation.virtual_ns == 0


@pytest.mark.parametrize("options", ["", ", start_new_session=True"])
def test_nothing_is_left_of_a_child_that_outlives_its_parent(options):
    source = f"print(subprocess.Popen(['sleep', '1000']{options}).pid)"
    with Program(python(source)) as program:
        pid = int(program.finish()[0])
        assert not has_ended(pid)
    wait_for_end(pid)


def test_places_of_ended_children_are_used_again_until_there_are_too_many():
    seconds = f"1000.{os.getpid()}"  # nobody else's
    source = f"""
for _ in range(100):
    # Nobody waits for it
    os.posix_spawn("/bin/true", ["true"], {{}})
    time.sleep(1)
print(now() >= 100 * 10**9, flush=True)
for _ in range(70):
    subprocess.Popen(["sleep", "{seconds}"])
    time.sleep(0.001)
"""
    failure = pytest.raises(AssertionError, match="more than 64 children")
    with Program(python(source)) as program, failure as caught:
        program.finish()
    assert "True" in str(caught.value)
    # Neither the 64 nor the one that was too many
    for pid in processes_with(seconds):
        wait_for_end(pid)


# Under klippy

PLUGIN = """
import os
import subprocess
import sys


class Starter:
    def __init__(self, config):
        self.printer = config.get_printer()
        self.reactor = self.printer.get_reactor()
        self.gcode = self.printer.lookup_object("gcode")
        self.child = None
        for name in ("WATCH_CHILD", "FORGET_CHILD", "WAIT_FOR_CHILD", "END"):
            self.gcode.register_command(name, getattr(self, "cmd_" + name))
        self.printer.register_event_handler("klippy:disconnect", self.kill)

    def start(self, gcmd):
        program = "import time; time.sleep(%f)" % gcmd.get_float("SECONDS")
        command = ["nice", sys.executable, "-c", program]
        self.child = subprocess.Popen(command)
        gcmd.respond_info("Child is %d" % self.child.pid)

    def kill(self):
        if self.child is not None:
            self.child.kill()

    def cmd_WATCH_CHILD(self, gcmd):
        self.start(gcmd)
        self.began = self.reactor.monotonic()
        self.reactor.register_timer(self.look, self.reactor.NOW)

    def look(self, eventtime):
        status, lived = self.child.poll(), eventtime - self.began
        if status is None:
            return eventtime + 0.25
        text = "Child ended with %d after %.2f s" % (status, lived)
        self.gcode.respond_info(text)
        return self.reactor.NEVER

    def cmd_FORGET_CHILD(self, gcmd):
        self.start(gcmd)
        # Nobody kills it, nor what it has started
        self.child = None
        subprocess.Popen(["sh", "-c", "sleep 1000 & echo $! >&2; sleep 1000"])

    def cmd_WAIT_FOR_CHILD(self, gcmd):
        self.start(gcmd)
        self.child.wait()

    def cmd_END(self, gcmd):
        os._exit(0)


def load_config(config):
    return Starter(config)
"""


@pytest.fixture
def start(host: Host, tmp_path: Path) -> Iterator[Callable[..., PluginPrinter]]:
    """start(): the sample's printer with the plugin."""
    plugin = tmp_path / "starter.py"
    plugin.write_text(PLUGIN)

    with ExitStack() as stack:
        yield lambda: stack.enter_context(
            start_printer(
                host,
                SAMPLE / "printer.cfg",
                SAMPLE / "world.toml",
                [plugin],
                {"starter": {}},
            )
        )


def told(printer: PluginPrinter, pattern: str) -> re.Match:
    """What the console's last line of that kind says."""
    found = [re.search(pattern, line) for line in printer.console]
    return [match for match in found if match][-1]


def wait_until_told(printer: PluginPrinter) -> tuple[int, float]:
    """How a child that is watched has ended, and after how many s."""
    session = printer.session
    for _ in range(1000):
        if any("Child ended" in line for line in printer.console):
            match = told(printer, r"Child ended with (-?\d+) after (\S+) s$")
            return int(match[1]), float(match[2])
        session.wait(0.25)
    raise AssertionError(f"{printer.console}\n{session.log()[-2000:]}")


def touched(printer: PluginPrinter) -> list[tuple]:
    """All touches but their times, to the digit."""
    return [
        (touch.site, touch.x, touch.y, touch.z, touch.trigger_z)
        for touch in printer.touches
    ]


def test_child_that_a_timer_polls_ends_while_klippy_goes_on(start):
    printer = start()
    simulation = printer.machine.simulation
    before, began = simulation.virtual_ns, time.monotonic()
    printer.run("WATCH_CHILD SECONDS=2")
    assert simulation.virtual_ns - before < SECOND
    # Klippy works meanwhile, at the machine's pace
    printer.run("SET_KINEMATIC_POSITION X=20 Y=20 Z=20\nG4 P500")
    assert not any("Child ended" in line for line in printer.console)
    status, lived = wait_until_told(printer)
    assert status == 0
    assert 1.0 < lived <= time.monotonic() - began + 0.5


def test_homing_after_children_is_as_ever(start):
    plain, printer = start(), start()
    printer.run("WATCH_CHILD SECONDS=0.5")
    wait_until_told(printer)
    printer.run("WAIT_FOR_CHILD SECONDS=0.5")
    plain.run("G28\nG1 Z20 F900\nG28")
    printer.run("G28\nG1 Z20 F900")
    printer.run("WATCH_CHILD SECONDS=0.5\nG28")
    assert len(touched(plain)) == 12
    assert touched(printer) == touched(plain)
    assert printer.session.position() == plain.session.position()


def test_time_passes_for_the_machine_while_klippy_waits_for_a_child(start):
    printer = start()
    simulation = printer.machine.simulation
    before = simulation.virtual_ns
    printer.run("WAIT_FOR_CHILD SECONDS=1")
    assert 0.5 * SECOND < simulation.virtual_ns - before < 60 * SECOND


@pytest.mark.parametrize("way", ["stopped", "killed", "by itself"])
def test_no_process_is_left_behind_when_klippy_ends(start, way):
    printer = start()
    printer.run("FORGET_CHILD SECONDS=1000")
    printer.session.wait(0.5)
    log = printer.session.log()
    pids = [int(told(printer, r"Child is (\d+)$")[1])]
    pids += [int(line) for line in log.splitlines() if line.isdigit()]
    assert len(pids) == 2
    assert not any(map(has_ended, pids))
    if way == "killed":
        printer.session.kill()
    if way == "by itself":
        with pytest.raises(SessionError, match="klippy has ended"):
            printer.run("END")
    printer.__exit__(None, None, None)
    for pid in pids:
        wait_for_end(pid)


def test_restart_ends_a_child_where_the_plugin_does(start):
    printer = start()
    printer.run("WATCH_CHILD SECONDS=1000")
    printer.session.restart("RESTART")
    wait_for_end(int(told(printer, r"Child is (\d+)$")[1]))
    printer.run("G28")
    assert printer.touches
