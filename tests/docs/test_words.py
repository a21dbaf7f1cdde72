"""One word for one thing: what users read has no words of developers."""

from __future__ import annotations

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
    "docs/installation",
    "docs/messages",
    "docs/migration",
    "docs/setup",
    "docs/troubleshooting",
    "docs/z_calibration",
)
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


def test_pins_are_told_apart():
    text = (ROOT / "docs" / "z_calibration.md").read_text(encoding="utf-8")
    head = " ".join(text.partition("\n## ")[0].split())
    assert "The *pin* is the metal pin" in head
    for name in ("auto_z_offset", "extra_probe"):
        page = (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
        bare = re.findall(r"(?<!MCU )\bpin\b(?! of the Z).*", prose(page))
        assert bare == []
