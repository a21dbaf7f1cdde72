"""docs/zh/*.svg: the drawings of the English pages with the texts of docs/zh/drawings.csv.

    build/venv/bin/python -m tests.docs.drawings

writes them anew.
"""

from __future__ import annotations

import csv
import re
from html import escape, unescape

from tests.docs.documents import DOCS

FOLDER = DOCS / "zh"
TEXTS = FOLDER / "drawings.csv"
TEXT = re.compile(r"(?<=>)[^<>\n]+(?=</(?:text|title|desc)>)")


def texts() -> dict[str, str]:
    """The Chinese text of each English one."""
    with TEXTS.open(newline="", encoding="utf-8") as f:
        return dict(list(csv.reader(f))[1:])


def drawings() -> list[str]:
    """The names of all that the Chinese pages show of their own."""
    pages = [page.read_text(encoding="utf-8") for page in FOLDER.glob("*.md")]
    return sorted(
        {name for page in pages for name in re.findall(r"\((\w+\.svg)\)", page)}
    )


def english(name: str) -> list[str]:
    """The texts of an English drawing."""
    drawing = (DOCS / name).read_text(encoding="utf-8")
    return [unescape(text) for text in TEXT.findall(drawing)]


def translated(name: str) -> str:
    """An English drawing with Chinese texts; KeyError: one is not in the table."""
    known = texts()
    drawing = (DOCS / name).read_text(encoding="utf-8")
    return TEXT.sub(
        lambda m: escape(known[unescape(m[0])], quote=False), drawing
    )


if __name__ == "__main__":
    for one in drawings():
        (FOLDER / one).write_text(translated(one), encoding="utf-8")
