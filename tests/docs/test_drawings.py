"""The drawings of the Chinese pages are the English ones, in Chinese."""

from __future__ import annotations

import pytest

from tests.docs.drawings import FOLDER, drawings, english, texts, translated


@pytest.mark.parametrize("name", drawings())
def test_drawing_is_the_english_one_with_the_texts_of_the_table(name):
    drawn = (FOLDER / name).read_text(encoding="utf-8")
    assert drawn == translated(name)
    assert any(letter >= "\u4e00" for letter in drawn)


def test_table_has_the_texts_of_the_drawings_and_no_others():
    assert len(drawings()) >= 6
    assert set(texts()) == {t for name in drawings() for t in english(name)}
