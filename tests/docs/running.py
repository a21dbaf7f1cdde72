"""A module on a running klippy, asked for what its document says of it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple, Optional

from simprinter.hosts.hosts import Host
from simprinter.hosts.session import GcodeError
from tests.docs.documents import ini_blocks
from tests.docs.records import Module
from tools.kit.auto_z_offset import with_extras
from tools.kit.printer import Printer
from tools.kit.scenes import SCENES, Sections

Options = Mapping[str, Optional[str]]


class Load(NamedTuple):
    """What became of a configuration.

    error: why klippy gave up. said: on the console. kept: the numbers and
    words that the module keeps. file: what macros see of printer.cfg.
    """

    error: str
    said: list[str]
    kept: dict[str, Any]
    file: dict[str, Any]


class Step(NamedTuple):
    """What G-code has answered, and where its probing moves could end.

    floors: mm, by the module's phase; the lowest of a site is its floor.
    status: of the module, afterwards.
    """

    answer: list[str]
    floors: dict[str, list[float]]
    status: dict[str, Any]


class Running:
    """A module on its scene's printer; leaving it checks for crashes."""

    def __init__(self, host: Host, module: Module):
        self.module = module
        scene = SCENES[module.scene]
        own = dict.fromkeys({*scene.sections[module.name]} - {*module.given})
        # No option that has a default
        self.plain = {**module.sources, module.name: own}
        listener = {"listener": {"module": module.name}}
        scene = replace(scene, sections={**listener, **scene.sections})
        modules = with_extras("listener")
        self.printer = Printer(host, scene, modules=modules)
        self._loads: dict[frozenset, Load] = {}
        self._steps: dict[str, list[Step]] = {}
        self._gaps: dict[str, float] = {}
        # Names of options, and by command those of its parameters
        self.asked: dict[str, set[str]] = {}
        self.phases: set[str] = set()

    def __enter__(self) -> Running:
        return self

    def __exit__(self, *error: Any) -> Optional[bool]:
        return self.printer.__exit__(*error)

    # Configurations

    def config(self, *changes: Sections) -> str:
        """printer.cfg of the scene with changes, later ones first."""
        merged: dict[str, Any] = {}
        for sections in changes:
            for name, options in sections.items():
                known = merged.get(name) or {}
                merged[name] = None if options is None else {**known, **options}
        serials = self.printer.machine.serials
        return self.printer.scene.config(serials, merged)

    def load(self, **own: Optional[str]) -> Load:
        """The module with what is required and these options."""
        key = frozenset(own.items())
        if key not in self._loads:
            config = self.config(self.plain, {self.module.name: own})
            session = self.printer.session
            before = len(session.console)
            state, message = session.reload(config)
            is_ready = state == "ready"
            assert is_ready or own, message
            listener = self._listen() if is_ready else {}
            self._loads[key] = Load(
                "" if is_ready else message,
                session.console[before:],
                listener.get("kept", {}),
                self.printer.status("configfile"),
            )
        return self._loads[key]

    def _listen(self) -> dict[str, Any]:
        status = self.printer.status("listener")
        for who, names in status["asked"].items():
            self.asked.setdefault(who, set()).update(names)
        self.phases.update(filter(None, status["phases"]))
        return status

    @cached_property
    def commands(self) -> set[str]:
        """Those that there are with the module only."""
        session, found = self.printer.session, []
        for own in ({}, None):
            session.reload(self.config(self.plain, {self.module.name: own}))
            found.append(set(session.call("gcode/help", {})))
        return found[0] - found[1]

    # G-code

    def run(self, *scripts: str, changes: Sections) -> list[Step]:
        """G-code in turn, homed before; what fails answers with the error."""
        config = self.config(changes)
        key = "\n".join((config, *scripts))
        if key not in self._steps:
            state, message = self.printer.session.reload(config)
            assert state == "ready", message
            self.printer.run("G28")
            self._steps[key] = [self._step(script) for script in scripts]
            self._listen()
        return self._steps[key]

    def _step(self, script: str) -> Step:
        before = len(self.printer.status("listener")["floors"])
        try:
            answer = self.printer.run(script)
        except GcodeError as error:
            answer = [str(error)]
        # Without what the host's own probing says, as that differs
        # The pages show no dialogs
        hidden = "// (probe(:| at) |action:)"
        own = [a for a in answer if not re.match(hidden, a)]
        floors: dict[str, list[float]] = {}
        for phase, z in self.printer.status("listener")["floors"][before:]:
            floors.setdefault(phase, []).append(z)
        status = self.printer.status(self.module.name)
        return Step(list(filter(None, own)), floors, status)

    def example(self, text: str) -> list[Step]:
        """The steps of the record, with the sections of the document."""
        changes = dict(ini_blocks(text))
        for name, options in self.module.surroundings.items():
            changes[name] = {**changes.get(name, {}), **options}
        return self.run(*self.module.steps, changes=changes)

    def status(self, text: str) -> dict[str, Any]:
        """What macros read after these steps."""
        return self.example(text)[-1].status

    def result(self, text: str) -> dict[str, Any]:
        """Of the first run of these steps: later ones may correct it."""
        results = [s.status.get("last_result") for s in self.example(text)]
        return next(filter(None, results), {})

    def gap(self, script: str, xy: tuple[float, float]) -> float:
        """True gap at Z=0 over a point that G-code leaves, mm."""
        if script not in self._gaps:
            surroundings = self.module.surroundings
            config = self.config(self.plain, surroundings)
            self.printer.session.reload(config)
            self.printer.run("G28\n" + script)
            self._gaps[script] = self.printer.gap(xy)
        return self._gaps[script]


def differ(first: Load, second: Load) -> set[str]:
    """Where a module does not keep the same in two configurations.

    Words count, sentences do not: they may say where a number comes from.
    """
    found = set()
    for place in {*first.kept, *second.kept}:
        values = first.kept.get(place), second.kept.get(place)
        are_words = all(isinstance(v, str) and " " not in v for v in values)
        is_number = any(isinstance(v, (int, float)) for v in values)
        if values[0] != values[1] and (are_words or is_number):
            found.add(place)
    return found
