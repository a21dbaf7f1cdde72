"""z_touch/templates.py: text as a parameter of the user's G-code."""

from __future__ import annotations

import shlex

import pytest
from hypothesis import given
from hypothesis import strategies as st

from z_touch.errors import CalibrationError
from z_touch.templates import as_param


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ("", ""),
        ("  two\n lines\t ", "two lines"),
        ('Unknown command:"X"', "Unknown command:'X'"),
        ("first; second", "first, second"),
        ("extruder #1", "extruder 1"),
        ("it's 5.5 mm (100%)", "it's 5.5 mm (100%)"),
        (CalibrationError("no probe; look"), "no probe, look"),
        (0.25, "0.25"),
    ],
)
def test_text_for_a_macro(value, text):
    assert as_param(value) == text


@given(
    st.lists(
        st.characters(codec="ascii", exclude_categories=["Cc"])
        | st.sampled_from(";#\"'\\\n\r\t ")
    ).map("".join)
)
def test_text_for_a_macro_can_stand_in_a_quoted_string(value):
    # As hosts take a line apart: a comment, then the parameters
    text = as_param(value)
    lexer = shlex.shlex(f'MSG="{text}"'.split(";")[0], posix=True)
    lexer.whitespace_split = True
    lexer.commenters = "#;"
    assert list(lexer) == [f"MSG={text}"]
    assert not set("\n\r") & set(text)
