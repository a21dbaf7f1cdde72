"""The chart of the benchmark: each command on each host beside its bound."""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pygal
from pygal.style import Style

# It leaves a finder of modules there that has no find_spec(), which Python 3.12
# passes over, but pytest calls
sys.meta_path[:] = [f for f in sys.meta_path if hasattr(f, "find_spec")]

_LIGHT = Style(
    background="#ffffff",
    plot_background="#ffffff",
    foreground="#1f2328",
    foreground_strong="#1f2328",
    foreground_subtle="#d1d9e0",
    opacity="1",
    colors=("#0969da", "#8c959f", "#bc4c00"),
    font_family="sans-serif",
    label_font_size=11,
    value_font_size=11,
    major_label_font_size=11,
)
# In place of one drawn by lot
_NAME = "bars"
_DARK = """inline:@media (prefers-color-scheme: dark) {
#chart-bars{background-color:#0d1117}
#chart-bars .graph > .background,#chart-bars .plot > .background{fill:#0d1117}
#chart-bars .graph,#chart-bars .title,#chart-bars .axis text,
#chart-bars .axis text.major,#chart-bars .series text,
#chart-bars .legends .legend text{fill:#e6edf3}
#chart-bars .axis .line{stroke:#e6edf3}
#chart-bars .axis .guide.line{stroke:#30363d}}"""


def draw(figures: Mapping[str, Any], file: Path) -> None:
    """Write it: printer seconds right after G28, and the lower bound."""
    # The first one is at the bottom
    done = figures["timings"][::-1]
    chart = pygal.HorizontalBar(
        style=_LIGHT,
        css=["file://style.css", "file://graph.css", _DARK],
        js=[],
        title="Printer seconds right after G28, and the lower bound",
        width=860,
        height=170 + 32 * len(done),
        legend_at_bottom=True,
        value_formatter=_shown,
        print_values=False,
    )
    chart.uuid = _NAME
    chart.add_xml_filter(_drawing_only)
    chart.x_labels = [f"{t['command']}, {t['host']}" for t in done]
    for name, key in (("printer seconds", "seconds"), ("lower bound", "bound")):
        chart.add(name, [timing["runs"][0][key] for timing in done])
    file.write_bytes(chart.render() + b"\n")


def _shown(value: float) -> str:
    """A value to three digits; those of the axis are whole."""
    return f"{value:.0f}" if value == round(value) else f"{value:.3f}"


def _drawing_only(root: ET.Element) -> ET.Element:
    """Without the script for pointers, and without the date of today."""
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag is ET.Comment or str(child.tag).endswith("script"):
                parent.remove(child)
    return root
