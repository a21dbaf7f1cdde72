"""What the commands show that touch a place each minute until it stands still."""

from __future__ import annotations

import re
from typing import NamedTuple, Optional

SEEN = re.compile(r"(\d+) min: z=(\S+?)(?:, moved by (\S+) mm a minute)?$")
# Its default of LIMIT twice in a row, on a printer that is warm
STILL = (
    "it stands still after 2 minutes: it moves by 0.0000 mm a minute, less than"
    " 0.003 twice in a row"
)


class Seen(NamedTuple):
    """One line: minute, height (mm) and movement (mm a minute, None: the first)."""

    minute: int
    z: float
    movement: Optional[float]


def seen(lines: list[str]) -> list[Seen]:
    """Each time that the place was touched."""
    return [
        Seen(int(m[1]), float(m[2]), float(m[3]) if m[3] else None)
        for m in map(SEEN.search, lines)
        if m
    ]
