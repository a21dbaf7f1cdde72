# What a picture is made of: text, plots and their curves, as SVG.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import, division

import collections
import math
import time

# Of the picture and of its plots, in its own units
WIDTH = 560
LEFT, RIGHT = 62, 14
PLOT = 112
TITLE, BELOW, GAP = 26, 16, 16
LINE = 17

# Letters in a line of text
LETTERS = 76

STYLE = """
svg{max-width:860px;background:#fff;--ink:#1f2328;--soft:#59636e;--grid:#d1d9e0;
--a:#0969da;--b:#bc4c00;--c:#1a7f37;--bad:#cf222e;display:block;margin:auto}
@media(prefers-color-scheme:dark){svg{background:#0d1117;--ink:#e6edf3;
--soft:#9198a1;--grid:#3d444d;--a:#58a6ff;--b:#f0883e;--c:#3fb950;--bad:#ff7b72}}
text{font:12.5px system-ui,sans-serif;fill:var(--ink)}
.h{font-weight:600}.t{font-size:17px;font-weight:600}.s{fill:var(--soft)}
.e{text-anchor:end}.m{text-anchor:middle}
.g{stroke:var(--grid);fill:none}.x{stroke:var(--bad);fill:none}
.l{fill:none;stroke-width:1.5}
.a{stroke:var(--a)}.b{stroke:var(--b)}.c{stroke:var(--c)}
.fa{fill:var(--a)}.fb{fill:var(--b)}.fc{fill:var(--c)}
.band{stroke:none;opacity:.25}
"""

# One curve: its name, colour, and a value of each run or None.  'band': pairs
# of low and high, or None
Curve = collections.namedtuple("Curve", "name colour values band")


# In XML, without what it cannot hold
def escaped(text):
    letters = []
    for c in "%s" % (text,):
        code = ord(c)
        if c in "&<>" or 0xA0 <= code < 0xD800:
            letters.append("&#%d;" % (code,))
        else:
            letters.append(str(c) if 0x20 <= code < 0x7F else "?")
    return "".join(letters)


# In lines of whole words, of which the last one is cut where there are more
def wrapped(text, most):
    lines = [""]
    for word in ("%s" % (text,)).split():
        word = word[:LETTERS]
        if len(lines[-1]) + len(word) >= LETTERS:
            lines.append("")
        lines[-1] += (" " if lines[-1] else "") + word
    if len(lines) > most:
        lines = lines[:most]
        lines[-1] = lines[-1][: LETTERS - 3] + "..."
    return lines


def day(seconds):
    try:
        return time.strftime("%Y-%m-%d", time.localtime(seconds))
    except (OverflowError, ValueError, OSError):
        return "?"


# Round numbers between low and high, three or four
def ticks(low, high):
    rough = (high - low) / 3.0
    power = 10.0 ** math.floor(math.log10(rough))
    step = min((f * power for f in (1, 2, 5, 10)), key=lambda s: abs(s - rough))
    first = math.ceil(low / step - 1e-9)
    count = int(math.floor(high / step + 1e-9) - first)
    digits = max(0, -int(math.floor(math.log10(step) + 1e-9)))
    return [((first + i) * step, digits) for i in range(count + 1)]


# A drawing that grows downwards
class Page(object):
    def __init__(self, pause):
        self.parts = []
        self.y = 0.0
        self.pause = pause

    def add(self, text, *values):
        self.parts.append(text % values)

    def text(self, x, y, css, text):
        self.add(
            '<text x="%.1f" y="%.1f" class="%s">%s</text>',
            x,
            y,
            css,
            escaped(text),
        )

    def line(self, css, text, most=1):
        for line in wrapped(text, most):
            self.y += LINE
            self.text(LEFT - 48, self.y, css, line)

    def done(self):
        height = self.y + GAP
        head = (
            '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 %d %d"'
            ' width="100%%" preserveAspectRatio="xMidYMin"><style>%s</style>'
        )
        head %= (WIDTH, height, STYLE.replace("\n", ""))
        return head + "\n".join(self.parts) + "</svg>\n"


# One plot: curves over the runs.  'marks': numbers of runs to cross out,
# 'unit' and 'dates' (below it) are texts.
class Plot(object):
    def __init__(self, page, count, low, high):
        self.page = page
        self.count = count
        # Room above and below, also where all is the same
        margin = max((high - low) * 0.08, 0.0005, 1e-6 * abs(high))
        self.low, self.high = low - margin, high + margin
        self.top = page.y + TITLE

    def apart(self):
        return (WIDTH - LEFT - RIGHT) / max(self.count, 1)

    def x(self, number):
        return LEFT + self.apart() * (number + 0.5)

    def y(self, value):
        part = (value - self.low) / (self.high - self.low)
        return self.top + PLOT * (1.0 - part)

    def frame(self, title, dates):
        page, bottom = self.page, self.top + PLOT
        page.text(LEFT - 48, page.y + 12, "h", title)
        for value, digits in ticks(self.low, self.high):
            y, text = self.y(value), "%.*f" % (digits, value + 0.0)
            page.add(
                '<path d="M%d %.1fH%d" class="g"/>', LEFT, y, WIDTH - RIGHT
            )
            page.text(LEFT - 6, y + 4, "s e", text)
        for part, css, text in zip((0, 0.5, 1), ("s", "s m", "s e"), dates):
            x = LEFT + part * (WIDTH - LEFT - RIGHT)
            page.text(x, bottom + 14, css, text)
        page.y = bottom + BELOW + GAP

    # Names of the curves, from the right
    def legend(self, curves):
        x = WIDTH - RIGHT
        for curve in reversed(curves):
            self.page.text(
                x, self.top - TITLE + 12, "e f" + curve.colour, curve.name
            )
            x -= 8.0 * len(curve.name) + 14

    def curve(self, curve):
        points = [(i, v) for i, v in enumerate(curve.values) if v is not None]
        if curve.band:
            self.band(curve)
        path = self.path(points)
        self.page.add(
            '<polyline points="%s" class="l %s"/>', path, curve.colour
        )
        if self.count <= 60:
            for i, v in points:
                self.dot(self.x(i), self.y(v), curve.colour)

    def dot(self, x, y, colour):
        self.page.add(
            '<circle cx="%.1f" cy="%.1f" r="2.2" class="f%s"/>', x, y, colour
        )

    def path(self, points):
        corners = []
        for number, (i, v) in enumerate(points):
            if number % 200 == 0:
                self.page.pause()
            corners.append("%.1f,%.1f" % (self.x(i), self.y(v)))
        return " ".join(corners)

    def band(self, curve):
        there = [(i, b) for i, b in enumerate(curve.band) if b is not None]
        points = [(i, b[0]) for i, b in there]
        points += [(i, b[1]) for i, b in reversed(there)]
        path = self.path(points)
        self.page.add(
            '<polygon points="%s" class="band f%s"/>', path, curve.colour
        )

    def cross(self, number):
        x, y = self.x(number), self.top + PLOT - 5
        self.page.add(
            '<path d="M%.1f %.1fl8 8m0 -8l-8 8" class="x"/>', x - 4, y - 4
        )
