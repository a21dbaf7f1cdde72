"""Runs of commands, one that goes well and one that does not of each."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple, Optional

from tools.kit import load_errors
from tools.kit.printer import Printer, module_files

EXTRA = Path(load_errors.__file__).with_name("extras") / "commands.py"


class Run(NamedTuple):
    """A script that ends with a command, and words of what comes of it.

    before: what is done to the printer first. is_error: whether a bad run fails;
    what only tells something has bad news to tell. check: of a good run, whether
    it has done what it should.
    """

    script: str
    words: str
    before: Optional[Callable[[Printer], Any]] = None
    is_error: bool = True
    check: Optional[Callable[[Printer], bool]] = None

    @property
    def command(self) -> str:
        """The command that it is about."""
        return self.script.splitlines()[-1].split()[0]


def started(
    start: Callable[..., Printer], scene: Any, changes: dict[str, Any]
) -> Printer:
    """A homed printer that tells which commands are ours."""
    modules = {**module_files(), "commands": EXTRA}
    return start(scene, {**changes, "commands": {}}, modules=modules).homed()


def ours(printer: Printer) -> set[str]:
    """All commands that our modules have registered on a printer."""
    return set(printer.status("commands")["names"])


def go_well(printer: Printer, runs: Iterable[Run]) -> set[str]:
    """Do all of them; their commands."""
    done = set()
    for run in runs:
        if run.before is not None:
            run.before(printer)
        text = "\n".join(printer.run(run.script))
        assert run.words in text, (run.script, text)
        assert run.check is None or run.check(printer), run.script
        done.add(run.command)
    return done


def go_wrong(printer: Printer, runs: Iterable[Run]) -> set[str]:
    """Do all of them, after each of which the printer goes on; their commands."""
    done = set()
    for run in runs:
        if run.before is not None:
            run.before(printer)
        text = (
            printer.fail(run.script)
            if run.is_error
            else "\n".join(printer.run(run.script))
        )
        assert run.words in text, (run.script, text)
        assert printer.session.state()[0] == "ready", run.script
        done.add(run.command)
    return done
