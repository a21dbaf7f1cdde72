"""z_touch/dialog.py: whatever is asked is in the grammar of the interfaces."""

from __future__ import annotations

from types import SimpleNamespace
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tools.kit.dialogs import dialogs_of
from z_touch.attached import Attached
from z_touch.dialog import Dialog


class Question(NamedTuple):
    """What somebody wants to know again."""

    asks: str


class Wrong(Exception):
    """A command that ends with an error."""


def command(**params):
    """A command of a host with its parameters."""
    return SimpleNamespace(get=params.get, error=Wrong)


words = st.text(st.characters(exclude_categories=["Cs"]), max_size=30)


def dialog(lines, said):
    """One that writes its lines, and what it says, into lists."""
    gcode = SimpleNamespace(respond_raw=lines.append)
    carrying = Attached()
    printer = SimpleNamespace(lookup_object=lambda name, default: carrying)
    host = SimpleNamespace(
        gcode=gcode, section="it", printer=printer, say=said.append
    )
    return Dialog(host, "DO_%s PROBE=a")


def test_question_is_asked_and_answered():
    lines, said = [], []
    asked = dialog(lines, said)
    assert (asked.question, asked.waits_for()) == (None, "")
    question = Question("depth")
    asked.ask(question, "Lay it down", ["One.", "Two."])
    assert asked.question is question
    assert asked.waits_for() == "depth"
    assert said == [
        "Lay it down. One. Two.",
        "then DO_CONTINUE PROBE=a, or DO_ABORT PROBE=a",
    ]
    (shown,) = dialogs_of(lines)
    assert (shown.headline, shown.texts) == (
        "Lay it down",
        ["One.", "Two."],
    )
    assert shown.footer_buttons == [
        ("Continue", "DO_CONTINUE PROBE=a QUESTION=depth", "primary"),
        ("Abort", "DO_ABORT PROBE=a", "error"),
    ]
    assert asked.answered(command()) is question
    assert (asked.question, asked.waits_for()) == (None, "")
    (shown,) = dialogs_of(lines)
    assert not shown.is_open
    for answer in (asked.answered, asked.continued):
        with pytest.raises(Wrong, match="begin with DO_CALIBRATE PROBE=a"):
            answer(command(QUESTION="depth"))
        # Whatever an interface still shows is closed
        assert lines[-1] == "// action:prompt_end"
        lines.append("more")


def test_button_of_a_question_before_answers_nothing():
    lines = []
    asked = dialog(lines, [])
    question = Question("removal")
    asked.ask(question, "Take it away", ["One."])
    told = "it: QUESTION=depth is not what is asked now, which is removal"
    with pytest.raises(Wrong, match=told):
        asked.continued(command(QUESTION="depth"))
    assert asked.question is question
    (shown,) = dialogs_of(lines)
    assert shown.is_open
    assert asked.continued(command(QUESTION="removal ")) is question


def test_answer_need_not_say_to_what():
    for params in ({}, {"QUESTION": ""}):
        asked = dialog([], [])
        question = Question("depth")
        asked.ask(question, "Lay it down", ["One."])
        assert asked.continued(command(**params)) is question


@given(words, st.lists(words, min_size=1, max_size=3))
def test_texts_stay_in_their_lines(headline, sentences):
    lines = []
    asked = dialog(lines, [])
    asked.ask(Question("depth"), "H" + headline, ["S", *sentences])
    assert all("\n" not in line and "\r" not in line for line in lines)
    assert all("|" not in line for line in lines if "_button" not in line)
    (shown,) = dialogs_of(lines)
    assert shown.headline.startswith("H")
    assert len(shown.footer_buttons) == 2
