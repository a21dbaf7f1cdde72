"""z_touch/dialog.py: whatever is shown is in the grammar of the interfaces."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from tools.kit.dialogs import dialogs_of
from z_touch.dialog import Button, lines

words = st.text(st.characters(exclude_categories=["Cs"]), max_size=30)
FOOTER = [Button("Continue", "GO_ON", "primary"), Button("Abort", "END")]


def test_buttons_are_shown_as_given():
    (shown,) = dialogs_of(lines("One", ["A.", "", "B."], FOOTER, [FOOTER[:1]]))
    assert (shown.headline, shown.texts) == ("One", ["A.", "B."])
    assert shown.footer_buttons == [
        ("Continue", "GO_ON", "primary"),
        ("Abort", "END", "secondary"),
    ]
    assert shown.groups == [[("Continue", "GO_ON", "primary")]]


@given(words, st.lists(words, min_size=1, max_size=3))
def test_texts_stay_in_their_lines(headline, sentences):
    shown = list(lines("H" + headline, ["S", *sentences], FOOTER))
    assert all("\n" not in line and "\r" not in line for line in shown)
    assert all("|" not in line for line in shown if "_button" not in line)
    (dialog,) = dialogs_of(shown)
    assert dialog.headline.startswith("H")
    assert len(dialog.footer_buttons) == 2
