"""docs/reliability.md says what is judged, with the numbers of the sources."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.campaign import breaking, gaps, jobs, judging
from tools.campaign.drawn.machines import BASES

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.fixture(scope="module")
def document():
    return (DOCS / "reliability.md").read_text(encoding="utf-8")


def test_document_says_what_is_judged(document):
    text = " ".join(document.split())
    for words in (
        f"{jobs.FLOOR_MARGIN:g} mm below where a trigger is expected",
        f"within {judging.GAP_ERROR:.3f} mm of that of a run without",
        f"strikes {breaking.INTO_A_MOVE * 1e3:g} ms into it",
        f"within {gaps.GAP_ERROR:g} mm, what is told and what has grown",
        f"{len(BASES)} machines",
        f"pressed up to {judging.BLIND_BODY:g} mm deeper",
    ):
        assert words in text, words
