"""Draw the chart of the benchmark.

    python draw.py CONTENT.json CHART.svg

Needs matplotlib and nothing of this repository. The file is the same each time
and follows the reader's light or dark theme.
"""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.patches import Patch

PAGE, INK, GRID, BOUND = "#ffffff", "#1f2328", "#d1d9e0", "#8c959f"
HOSTS = ("#0969da", "#bc4c00", "#1a7f37", "#8250df", "#9a6700", "#bf3989")

# The same for a dark page
DARK = {
    PAGE: "#0d1117",
    INK: "#e6edf3",
    GRID: "#30363d",
    BOUND: "#6e7681",
    HOSTS[0]: "#58a6ff",
    HOSTS[1]: "#f0883e",
    HOSTS[2]: "#3fb950",
    HOSTS[3]: "#bc8cff",
    HOSTS[4]: "#d29922",
    HOSTS[5]: "#f778ba",
}

SETTINGS = {
    "svg.fonttype": "none",
    "svg.hashsalt": "performance",
    "font.family": "sans-serif",
    "font.size": 9,
    "figure.facecolor": PAGE,
    "axes.facecolor": PAGE,
    "axes.edgecolor": GRID,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": GRID,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
}

Rows = Sequence[dict[str, Any]]


def distinct(rows: Rows, name: str) -> list[str]:
    """The values of a column, each once."""
    return list(dict.fromkeys(row[name] for row in rows))


def draw_times(axes: Any, bars: Rows, colours: dict[str, str]) -> None:
    """A bar for each command and host, and on it the lower bound."""
    places, names = [], []
    place = 0.0
    for command in distinct(bars, "command"):
        group = [bar for bar in bars if bar["command"] == command]
        names.append(command)
        places.append(place + (len(group) - 1) / 2.0)
        for bar in group:
            colour = colours[bar["host"]]
            axes.barh(place, bar["seconds"], 0.8, color=colour)
            axes.barh(place, bar["bound"], 0.4, color=BOUND)
            axes.text(bar["seconds"] + 0.2, place, bar["label"], va="center")
            place += 1.0
        place += 0.7
    axes.set_yticks(places, names)
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.margins(x=0.15)
    axes.set_xlabel("printer seconds, right after G28; grey: the lower bound")


def draw_errors(
    axes: Any, points: Rows, noises: Sequence[str], colours: dict[str, str]
) -> None:
    """Mean with sigma, and the worst, for each noise and host."""
    hosts = distinct(points, "host")
    for point in points:
        shift = (hosts.index(point["host"]) - (len(hosts) - 1) / 2.0) * 0.2
        x = noises.index(point["noise"]) + shift
        colour = colours[point["host"]]
        axes.errorbar(
            x, point["mean"], point["sigma"], fmt="o", ms=4, color=colour
        )
        axes.plot(x, point["worst"], "x", ms=5, color=colour)
    labels = [noise.replace(", ", "\n") for noise in noises]
    axes.set_xticks(range(len(noises)), labels)
    axes.tick_params(axis="x", labelsize=7)
    axes.set_xlim(-0.6, len(noises) - 0.4)
    axes.grid(visible=False, axis="x")


def draw_all(content: dict[str, Any]) -> Figure:
    """Times above, errors below."""
    bars, points = content["bars"], content["points"]
    hosts = distinct([*bars, *points], "host")
    colours = {h: HOSTS[i % len(HOSTS)] for i, h in enumerate(hosts)}
    commands = distinct(points, "command")
    figure = Figure(figsize=(9.6, 7.6), layout="constrained")
    shape = figure.add_gridspec(2 if commands else 1, max(1, len(commands)))
    draw_times(figure.add_subplot(shape[0, :]), bars, colours)
    noises = distinct(points, "noise")
    first = None
    for column, command in enumerate(commands):
        axes = figure.add_subplot(shape[1, column], sharey=first)
        group = [point for point in points if point["command"] == command]
        draw_errors(axes, group, noises, colours)
        axes.set_title(command.replace(", ", ",\n"), fontsize=9)
        axes.tick_params(labelleft=first is None)
        if first is None:
            first = axes
            axes.set_ylabel(
                f"error, um, {content['seeds']} printers:\n"
                "mean, sigma (bar), worst (x)"
            )
    add_legend(figure, colours)
    return figure


def add_legend(figure: Figure, colours: dict[str, str]) -> None:
    """The colours of the hosts, above all."""
    handles = [
        Patch(color=colour, label=host) for host, colour in colours.items()
    ]
    figure.legend(
        handles=handles, loc="outside upper center", ncols=len(handles)
    )


def dark_style() -> str:
    """Rules that exchange the colours of matplotlib's style attributes."""
    rules = "".join(
        f'[style*="{what}: {light}"]{{{what}:{dark} !important}}\n'
        for light, dark in DARK.items()
        for what in ("fill", "stroke")
    )
    return f"@media (prefers-color-scheme: dark) {{\n{rules}}}\n"


def main(source: str, target: str) -> None:
    """Read what is to be drawn, write the chart."""
    with open(source, encoding="utf-8") as file:
        content = json.load(file)
    mpl.rcParams.update(SETTINGS)
    output = io.StringIO()
    metadata = {
        "Date": None,
        "Title": "Calibrations: time and error",
        "Description": f"figures {content['digest']}",
    }
    draw_all(content).savefig(output, format="svg", metadata=metadata)
    svg = output.getvalue().replace("</style>", dark_style() + "</style>", 1)
    lines = [line.rstrip() for line in svg.splitlines()]
    with open(target, "w", encoding="utf-8") as file:
        file.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
