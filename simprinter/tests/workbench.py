"""A board on a workbench: its clock is turned by hand, no line, no world."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any, Optional

from simprinter.mcu.board import (
    USUAL_CRYSTAL,
    USUAL_DIALECT,
    Board,
    Crystal,
    Peripheral,
)

LOW32 = 0xFFFFFFFF


class Bench:
    """Commands go in as klippy spells them, answers come out decoded.

    answers: (name, values by parameter name) in the order of sending. beside:
    another bench, with which it shares the time.
    """

    def __init__(
        self,
        *parts: Peripheral,
        crystal: Crystal = USUAL_CRYSTAL,
        beside: Optional[Bench] = None,
    ):
        self.time = beside.time if beside else SimpleNamespace(ns=5 * 10**9)
        self.board = Board(lambda: self.ns, parts, USUAL_DIALECT, crystal)
        self.board.send = self._take
        self.answers: list[tuple[str, dict[str, Any]]] = []
        dictionary = self.board.dictionary
        self._commands = {m.name: m for m in dictionary.commands.values()}
        self._responses = {m.ident: m for m in dictionary.responses.values()}

    @property
    def ns(self) -> int:
        """The time."""
        return self.time.ns

    @ns.setter
    def ns(self, ns: int) -> None:
        self.time.ns = ns

    def _take(self, content: bytes) -> None:
        message = self._responses[content[0]]
        values, end = message.decode(content, 1)
        assert end == len(content)
        named = dict(zip((name for name, _ in message.params), values))
        self.answers.append((message.name, named))

    def tell(self, *texts: str, **values: Any) -> None:
        """Send commands in one block; clocks in full width.

        values: those that are no numbers.
        """
        content = b""
        for text in texts:
            name, *words = text.split()
            for key, value in (word.split("=") for word in words):
                cut = LOW32 if key.endswith("clock") else -1
                values[key] = int(value) & cut
            content += self._commands[name].encode(values)
        self.board.receive(content)

    def ask(self, text: str, **values: Any) -> dict[str, Any]:
        """Send a command; the values of its only answer."""
        before = len(self.answers)
        self.tell(text, **values)
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
        while (due := self.board.next_event_ns()) is not None and due <= end:
            self.ns = max(self.ns, due)
            self.board.run_due()
        self.ns = max(self.ns, end)

    def shutdown(self) -> str:
        """The reason that the board gave for its only shutdown."""
        (answer,) = self.said("shutdown")
        (reason,) = self.board.journal.shutdowns
        told = json.loads(self.board.dictionary.json)["enumerations"]
        number = told["static_string_id"][reason]
        # The second time as an answer to whatever it is asked to do
        self.tell("finalize_config crc=1")
        assert self.said("is_shutdown")[-1] == {"static_string_id": number}
        assert answer["static_string_id"] == number
        return reason

    # Its steppers

    def config_stepper(self, oid: int, step_pin: int, dir_pin: int) -> None:
        """Configure one."""
        self.tell(
            f"config_stepper oid={oid} step_pin={step_pin} dir_pin={dir_pin}"
            " invert_step=0 step_pulse_ticks=100"
        )

    def reset_clock(self, oid: int, clock: int) -> None:
        """What the next interval counts from."""
        self.tell(f"reset_step_clock oid={oid} clock={clock}")

    def turn(self, oid: int, direction: int) -> None:
        """The direction of what is queued from now on."""
        self.tell(f"set_next_step_dir oid={oid} dir={direction}")

    def queue(
        self, oid: int, interval: int, count: int = 1, add: int = 0
    ) -> None:
        """Queue steps."""
        self.tell(
            f"queue_step oid={oid} interval={interval} count={count} add={add}"
        )

    def move(
        self, oid: int, start: int, interval: int, count: int, direction=1
    ) -> None:
        """Queue steps that count from a clock."""
        self.reset_clock(oid, start)
        self.turn(oid, direction)
        self.queue(oid, interval, count)

    def position(self, oid: int) -> int:
        """As the host is told, steps."""
        return self.ask(f"stepper_get_position oid={oid}")["pos"]
