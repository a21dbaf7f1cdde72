"""Charts of bars, for light and dark pages."""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path

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


def draw_bars(
    title: str,
    labels: Sequence[str],
    series: Mapping[str, Sequence[float]],
    file: Path,
) -> None:
    """Write bars from the top down: for each label one of each series."""
    chart = pygal.HorizontalBar(
        style=_LIGHT,
        css=["file://style.css", "file://graph.css", _DARK],
        js=[],
        title=title,
        width=860,
        height=170 + 16 * len(labels) * len(series),
        legend_at_bottom=True,
        value_formatter=_shown,
        print_values=len(series) == 1,
    )
    chart.uuid = _NAME
    chart.add_xml_filter(_drawing_only)
    # The first one is at the bottom
    chart.x_labels = labels[::-1]
    for name, values in series.items():
        chart.add(name, values[::-1])
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
