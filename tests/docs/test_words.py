"""One word for one thing: what users read has no words of developers."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = (
    "README",
    "docs/accuracy",
    "docs/auto_z_offset",
    "docs/dockable_probe",
    "docs/extra_probe",
    "docs/faq",
    "docs/first_real_printer",
    "docs/installation",
    "docs/messages",
    "docs/migration",
    "docs/quickstart_dock",
    "docs/quickstart_nozzle_switch",
    "docs/quickstart_qidi",
    "docs/quickstart_voron0",
    "docs/quickstart_voron_klicky",
    "docs/report",
    "docs/setup",
    "docs/slicers",
    "docs/troubleshooting",
    "docs/wiring",
    "docs/z_calibration",
)
# What is typed, and happens to be the name of a number, too
TYPED = {"BACK", "PAPER"}
# Word of developers -> what users read instead, unless it is in italics there
# and says what it is
WORDS = {
    "hosts?": "Klipper",
    "klippy": "Klipper",
    "sites?": "place",
    "floors?": "lowest point",
    "frames?": "zero, or the part of the printer",
}


def prose(text: str) -> str:
    """A text without code, targets of links and italics."""
    text = re.sub(r"```.*?```", "", text, flags=re.S)
    return re.sub(r"`[^`]*`|\]\([^)]*\)|(?<!\*)\*[^*\n]+\*(?!\*)", "", text)


@pytest.mark.parametrize("name", PAGES)
def test_users_read_words_that_they_know(name):
    text = prose((ROOT / f"{name}.md").read_text(encoding="utf-8"))
    for word, better in WORDS.items():
        found = re.findall(rf"(?i)\b{word}\b.*", text)
        assert found == [], f"write {better}"


def constants() -> set[str]:
    """Names of numbers in the sources, which no owner has to know."""
    with (ROOT / "docs" / "numbers.csv").open(encoding="utf-8") as lines:
        return {row["name"] for row in csv.DictReader(lines)}


@pytest.mark.parametrize("name", PAGES)
def test_users_read_no_names_of_the_sources(name):
    text = (ROOT / f"{name}.md").read_text(encoding="utf-8")
    names = {*re.findall(r"`([A-Z][A-Z_]+)`", text)}
    assert names & constants() - TYPED == set()


def test_pins_are_told_apart():
    text = (ROOT / "docs" / "z_calibration.md").read_text(encoding="utf-8")
    head = " ".join(text.partition("\n## ")[0].split())
    assert "The *pin* is the metal pin" in head
    for name in ("auto_z_offset", "extra_probe"):
        page = (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
        bare = re.findall(r"(?<!MCU )\bpin\b(?! of the Z).*", prose(page))
        assert bare == []
