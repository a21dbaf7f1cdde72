"""What of the documents is generated is what its figures make of it."""

from __future__ import annotations

import pytest
from cogapp import Cog

from tests.docs.pictures import DOCS

PAGES = [
    page
    for page in sorted(DOCS.glob("*.md"))
    if "[[[cog" in page.read_text(encoding="utf-8")
]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_generated_parts_are_up_to_date(page, monkeypatch, capsys):
    monkeypatch.chdir(DOCS.parent)
    differs = Cog().main(["cog", "--check", "--diff", str(page)])
    assert not differs, capsys.readouterr().out
