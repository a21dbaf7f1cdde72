"""z_touch/dialogs.py: whatever is asked is in the grammar of the interfaces."""

from __future__ import annotations

from types import SimpleNamespace

from hypothesis import given
from hypothesis import strategies as st

from tests.hostkit.dialogs import dialogs_of
from z_touch.dialogs import Dialog

words = st.text(st.characters(exclude_categories=["Cs"]), max_size=30)


def dialog(lines, said):
    """One that writes its lines, and what it says, into lists."""
    host = SimpleNamespace(gcode=SimpleNamespace(respond_raw=lines.append))
    return Dialog(host, said.append, "DO_%s PROBE=a")


def test_question_is_asked_and_answered():
    lines, said = [], []
    asked = dialog(lines, said)
    assert asked.question is None
    asked.ask("how deep", "Lay it down", ["One.", "Two."])
    assert asked.question == "how deep"
    assert said == [
        "Lay it down. One. Two.",
        "then DO_CONTINUE PROBE=a, or DO_ABORT PROBE=a",
    ]
    (shown,) = dialogs_of(lines)
    assert (shown.headline, shown.texts) == ("Lay it down", ["One. Two."])
    assert shown.footer_buttons == [
        ("Continue", "DO_CONTINUE PROBE=a", "primary"),
        ("Abort", "DO_ABORT PROBE=a", "error"),
    ]
    assert asked.answered() == "how deep"
    assert asked.question is None
    assert asked.answered() is None
    (shown,) = dialogs_of(lines)
    assert not shown.is_open


@given(words, st.lists(words, min_size=1, max_size=3))
def test_texts_stay_in_their_lines(headline, sentences):
    lines = []
    asked = dialog(lines, [])
    asked.ask(1, "H" + headline, ["S", *sentences])
    assert all("\n" not in line and "\r" not in line for line in lines)
    assert all("|" not in line for line in lines if "_button" not in line)
    (shown,) = dialogs_of(lines)
    assert shown.headline.startswith("H")
    assert len(shown.footer_buttons) == 2
