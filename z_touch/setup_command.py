"""What the command of each set-up by dialogs does: begin, show again, answer.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import contextlib
from typing import Iterator, List

from . import attached, options
from .errors import CalibrationError
from .host.klippy import GCodeCommand
from .host.printer import Host
from .wizard import Wizard


class SetupCommand:
    """The command of a set-up; a subclass knows its steps and does what they say."""

    def __init__(self, host: Host, name: str) -> None:
        """Begin with no set-up under way; name: of the command."""
        self.host = host
        self.wizard = Wizard(host, name)

    def run(self, gcmd: GCodeCommand) -> None:
        """Begin, show again what is asked, or do what the answer says.  May pause."""
        name = options.param_word(gcmd, "STEP").lower()
        if name:
            self.wizard.check_asked(gcmd, name)
        if name == "abort":
            self.abort(gcmd)
        elif name and self.wizard.turns_page(gcmd):
            self.ask()
        else:
            self.wizard.check_no_print(gcmd)
            if name:
                self._answer(gcmd)
            else:
                self._begin(gcmd)

    def _begin(self, gcmd: GCodeCommand) -> None:
        """Ask the first step, or again what a set-up that is under way asks."""
        is_new = self.wizard.step is None
        if is_new:
            self.begin(gcmd)
        # Later a hand is near
        attached.of(self.host.printer).settle(self.host)
        self.ask()
        if is_new:
            self.wizard.tell()
        else:
            self.wizard.tell_all(self.sentences())

    def _answer(self, gcmd: GCodeCommand) -> None:
        """Jog, or do what the answer says; ask what comes next, or again.

        For longer work the dialog closes: it would cover the emergency stop of a web
        interface.  After an error it says why.
        """
        is_jog = self.wizard.is_jog(gcmd)
        if not (is_jog or self.wizard.asked().name == "save"):
            self.wizard.hide()
        try:
            with self.running(gcmd):
                if is_jog:
                    self.jog(gcmd)
                else:
                    self.go_on(gcmd)
        except self.host.printer.command_error as e:
            if not self.host.printer.is_shutdown() and self.wizard.step:
                self.ask(str(e))
                if not is_jog:
                    # It may be another step than before
                    self.wizard.tell()
            raise
        if self.wizard.step:
            self.ask()
            if not is_jog:
                self.wizard.tell()

    ##################################################################
    # What a set-up does
    ##################################################################

    def begin(self, gcmd: GCodeCommand) -> None:
        """Have the wizard ask the first step; raise the command's error where it must not."""
        raise NotImplementedError

    def go_on(self, gcmd: GCodeCommand) -> None:
        """Do what the step has announced for this answer, and ask the next one."""
        raise NotImplementedError

    def jog(self, gcmd: GCodeCommand) -> None:
        """Move by the X, Y and Z of the command (mm).  Pauses."""
        raise NotImplementedError

    def ask(self, problem: str = "") -> None:
        """Show the dialog of the step; problem: why the last answer was not done."""
        raise NotImplementedError

    def sentences(self, problem: str = "") -> List[str]:
        """Return what the dialog says."""
        raise NotImplementedError

    @contextlib.contextmanager
    def running(self, gcmd: GCodeCommand) -> Iterator[None]:
        """Run a step: what a CalibrationError says becomes the command's error."""
        try:
            yield
        except CalibrationError as e:
            raise self.host.error(e)

    def abort(self, gcmd: GCodeCommand) -> None:
        """End the set-up, saving nothing."""
        self.wizard.close()
        self.wizard.tell_end()
