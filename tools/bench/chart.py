"""What the chart shows; it is drawn by matplotlib, in a Python of its own."""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from simprinter.hosts.environment import cached_environment, run
from tools.bench.timing import OURS

# Also for the oldest Python that the tests run on
REQUIREMENTS = ("matplotlib==3.9.4",)
_DRAW = Path(__file__).with_name("draw.py")

Figures = Mapping[str, Any]


def bars(figures: Figures) -> list[dict[str, Any]]:
    """Of each command on each host: seconds, lower bound, label."""
    found = []
    for timing in figures["timings"]:
        if timing["module"] == OURS and not timing["failure"]:
            first = timing["runs"][0]
            bar = {name: timing[name] for name in ("command", "host")}
            bar.update({name: first[name] for name in ("seconds", "bound")})
            bar["label"] = f"{first['seconds']:.1f} s, {first['ratio']:.2f}x"
            found.append(bar)
    return found


def points(figures: Figures) -> list[dict[str, Any]]:
    """Mean, sigma and worst (um) of each command, host and noise."""
    names = ("command", "host", "noise", "mean", "sigma", "worst")
    return [
        {name: error[name] for name in names}
        for error in figures["errors"]
        if error["module"] == OURS and error["sigma"] is not None
    ]


def content(figures: Figures) -> dict[str, Any]:
    """All that is drawn, with a digest of it for the file's description."""
    drawn = {"bars": bars(figures), "points": points(figures)}
    text = json.dumps(drawn, sort_keys=True)
    digest = hashlib.sha256(text.encode()).hexdigest()[:16]
    seeds = max((error["seeds"] for error in figures["errors"]), default=0)
    return {**drawn, "seeds": seeds, "digest": digest}


def draw(figures: Figures, files: Sequence[Path]) -> None:
    """Write the chart. Raises HostError if matplotlib cannot be had."""
    python = cached_environment(REQUIREMENTS)
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "content.json"
        data.write_text(json.dumps(content(figures)), encoding="utf-8")
        for file in files:
            run([python, _DRAW, data, file], f"drawing {file}")
