"""The numbers that the documents' pictures show."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

DOCS = Path(__file__).resolve().parents[2] / "docs"
SVG = "{http://www.w3.org/2000/svg}"
MINUS = "\N{MINUS SIGN}"
PICTURES = sorted(DOCS.glob("*.svg"))


def numbers(name: str) -> dict[str, float]:
    """What the description of a picture names, mm; spaces in names are _."""
    text = (DOCS / f"{name}.svg").read_text(encoding="utf-8")
    words = ET.fromstring(text).find(f"{SVG}desc").text.replace(MINUS, "-")
    found = re.findall(r"[:,;] ([a-z_ ]+) (-?\d+\.\d{3})\b", words)
    return {name.replace(" ", "_"): float(number) for name, number in found}
