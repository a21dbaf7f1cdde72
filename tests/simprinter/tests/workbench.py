"""A board on a workbench: its clock is turned by hand, no line, no world."""

from __future__ import annotations

from typing import Any

from tests.simprinter.mcu.board import (
    USUAL_CRYSTAL,
    Board,
    Crystal,
    Peripheral,
)

LOW32 = 0xFFFFFFFF


class Bench:
    """Commands go in as bytes, answers come out decoded.

    answers: (name, values by parameter name) in the order of sending.
    """

    def __init__(self, *parts: Peripheral, crystal: Crystal = USUAL_CRYSTAL):
        self.ns = 5_000_000_000
        self.board = Board(lambda: self.ns, parts, "Klipper", crystal)
        self.board.send = self._take
        self.answers: list[tuple[str, dict[str, Any]]] = []
        dictionary = self.board.dictionary
        self._commands = {m.name: m for m in dictionary.commands.values()}
        self._responses = {m.ident: m for m in dictionary.responses.values()}

    def _take(self, content: bytes) -> None:
        message = self._responses[content[0]]
        values, end = message.decode(content, 1)
        assert end == len(content)
        named = dict(zip((name for name, _ in message.params), values))
        self.answers.append((message.name, named))

    def tell(self, name: str, **values: Any) -> None:
        """Send a command; clocks may be given in full width."""
        cut = {
            key: value & LOW32 if key.endswith("clock") else value
            for key, value in values.items()
        }
        self.board.receive(self._commands[name].encode(cut))

    def ask(self, name: str, **values: Any) -> dict[str, Any]:
        """Send a command; the values of its only answer."""
        before = len(self.answers)
        self.tell(name, **values)
        ((_, answer),) = self.answers[before:]
        return answer

    def said(self, name: str) -> list[dict[str, Any]]:
        """All answers of one name so far."""
        return [values for said, values in self.answers if said == name]

    def now(self) -> int:
        """The board's clock."""
        return self.board.clock()

    def run_to(self, clock: int) -> None:
        """Let the board live until a clock, event by event."""
        end = self.board.ns(clock)
        while True:
            due = self.board.next_event_ns()
            if due is None or due > end:
                break
            self.ns = max(self.ns, due)
            self.board.run_due()
        self.ns = max(self.ns, end)
