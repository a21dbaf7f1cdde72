# What a picture is made of: text, plots and their curves, as SVG.
# Its texts are no messages: they are drawn.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# Colours stand in the elements themselves, as many viewers know no style sheets,
# or no variables in them.  The style sheet only changes them on dark pages.

import collections
import math

# Of the picture and of its plots, in its own units
WIDTH = 720
LEFT, RIGHT = 66, 18
EDGE = 18
PLOT = 104
TITLE, BELOW, GAP = 24, 18, 20
LINE = 18
SIZE = 13

# Letters in a line of text: none is wider than 7.2 on an average
LETTERS = 94

# By name: on a light and on a dark page
COLOURS = (
    ("page", "#ffffff", "#0d1117"),
    ("ink", "#1f2328", "#e6edf3"),
    ("soft", "#59636e", "#9198a1"),
    ("grid", "#d8dee4", "#30363d"),
    ("a", "#0969da", "#58a6ff"),
    ("b", "#bc4c00", "#f0883e"),
    ("c", "#8250df", "#bc8cff"),
    ("good", "#1a7f37", "#3fb950"),
    ("watch", "#9a6700", "#d29922"),
    ("act", "#cf222e", "#ff7b72"),
)
LIGHT = dict((name, light) for name, light, _ in COLOURS)


def dark_rules():
    rules = [
        ".f-%s{fill:%s}.s-%s{stroke:%s}" % (name, dark, name, dark)
        for name, _, dark in COLOURS
    ]
    return "".join(rules)


STYLE = (
    "svg{max-width:100%%;height:auto;display:block;margin:auto}"
    "@media(prefers-color-scheme:dark){svg{background:#0d1117}%s}"
    % (dark_rules(),)
)

# One curve: its name, colour, and a value of each run or None.  'band': pairs
# of low and high, or None.  'line': whether the points are joined.
Curve = collections.namedtuple("Curve", "name colour values band line")


# Attributes of an element
def fill(colour):
    return 'class="f-%s" fill="%s"' % (colour, LIGHT[colour])


def stroke(colour, width=1.0, dashes=""):
    text = 'class="s-%s" stroke="%s" fill="none"' % (colour, LIGHT[colour])
    if width != 1.0:
        text += ' stroke-width="%g"' % (width,)
    if dashes:
        text += ' stroke-dasharray="%s"' % (dashes,)
    return text


# In XML, without what it cannot hold
def escaped(text):
    letters = []
    for c in "%s" % (text,):
        code = ord(c)
        if c in '&<>"' or 0xA0 <= code < 0xD800:
            letters.append("&#%d;" % (code,))
        else:
            letters.append(str(c) if 0x20 <= code < 0x7F else "?")
    return "".join(letters)


# In lines of whole words, of which the last one is cut where there are more
def wrapped(text, most, letters=LETTERS):
    lines = [""]
    for word in ("%s" % (text,)).split():
        word = word[: letters - 1]
        if len(lines[-1]) + len(word) >= letters:
            lines.append("")
        lines[-1] += (" " if lines[-1] else "") + word
    if len(lines) > most:
        lines = lines[:most]
        lines[-1] = lines[-1][: letters - 3] + "..."
    return lines


# Round numbers between low and high, three or four
def ticks(low, high):
    rough = (high - low) / 3.0
    power = 10.0 ** math.floor(math.log10(rough))
    step = min((f * power for f in (1, 2, 5, 10)), key=lambda s: abs(s - rough))
    first = math.ceil(low / step - 1e-9)
    count = int(math.floor(high / step + 1e-9) - first)
    digits = max(0, -int(math.floor(math.log10(step) + 1e-9)))
    return [((first + i) * step, digits) for i in range(count + 1)]


# So much (of a plot's unit) at least between low and high, with room around
def spanned(low, high, least):
    lack = max(0.0, least - (high - low)) / 2.0
    low, high = low - lack, high + lack
    room = max((high - low) * 0.08, 1e-6 * abs(high))
    return low - room, high + room


# From 0 to so much (of a plot's unit) at least, with room above
def from_zero(high, least):
    return 0.0, max(high, least) * 1.08


# A drawing that grows downwards
class Page:
    def __init__(self, pause):
        self.parts = []
        self.y = 0.0
        self.pause = pause

    def add(self, text, *values):
        self.parts.append(text % values if values else text)

    # 'more': attributes
    def text(self, x, y, text, colour="ink", more=""):
        self.add(
            '<text x="%.1f" y="%.1f" %s%s>%s</text>',
            x,
            y,
            fill(colour),
            more and " " + more,
            escaped(text),
        )

    # Text of several lines at the edge
    def line(self, text, colour="ink", more="", most=1, x=EDGE):
        letters = LETTERS - int((x - EDGE) / 7.0)
        for line in wrapped(text, most, letters):
            self.y += LINE
            self.text(x, self.y, line, colour, more)

    def title(self, text):
        self.y += GAP
        self.line(text, more=BOLD)

    def done(self):
        height = self.y + GAP
        head = (
            '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 %d %d"'
            ' width="%d" height="%d" font-family="system-ui,-apple-system,'
            'Segoe UI,Roboto,DejaVu Sans,sans-serif" font-size="%d">'
            '<style>%s</style><rect width="%d" height="%d" %s/>\n'
        )
        size = (WIDTH, height)
        head %= size + size + (SIZE, STYLE) + size + (fill("page"),)
        return head + "\n".join(self.parts) + "</svg>\n"


BOLD = 'font-weight="600"'
END = 'text-anchor="end"'
MIDDLE = 'text-anchor="middle"'


# One plot.  'xs': where each run is, from 0 to 1; 'box': its left and right end.
class Plot:
    def __init__(self, page, xs, low, high, box=(LEFT, WIDTH - RIGHT)):
        self.page = page
        self.xs = xs
        self.low, self.high = low, high
        self.left, self.right = box
        self.top = page.y + TITLE
        self.bottom = self.top + PLOT

    # So far from the ends that a point stays inside
    def x(self, number):
        return self.at(self.xs[number])

    def at(self, part):
        return self.left + 7 + part * (self.right - self.left - 14)

    def y(self, value):
        part = (value - self.low) / (self.high - self.low)
        return self.top + PLOT * (1.0 - part)

    # Title, what it is in softer words, horizontal lines with their values
    def frame(self, title, words=""):
        page = self.page
        x = EDGE if self.left == LEFT else self.left
        page.text(x, page.y + 12, title, more=BOLD)
        if words:
            page.text(x + 7.7 * len(title) + 10, page.y + 12, words, "soft")
        lines = []
        for value, digits in ticks(self.low, self.high):
            y, text = self.y(value), "%.*f" % (digits, value + 0.0)
            lines.append("M%.1f %.1fH%.1f" % (self.left, y, self.right))
            page.text(self.left - 6, y + 4, text, "soft", END)
        page.add('<path d="%s" %s/>', "".join(lines), stroke("grid"))

    # Below it: pairs of a place from 0 to 1 and a text
    def scale(self, marks):
        page = self.page
        for part, text in marks:
            x, more = self.at(part), MIDDLE
            page.add(
                '<path d="M%.1f %.1fv4" %s/>', x, self.bottom, stroke("soft")
            )
            if x - 3.6 * len(text) < self.left:
                x, more = self.left, ""
            elif x + 3.6 * len(text) > self.right:
                x, more = self.right, END
            page.text(x, self.bottom + 16, text, "soft", more)

    # A text below it
    def below(self, text):
        x = (self.left + self.right) / 2.0
        self.page.text(x, self.bottom + 16, text, "soft", MIDDLE)

    # All of it between two heights
    def strip(self, low, high, colour):
        self.page.add(
            '<rect x="%.1f" y="%.1f" width="%.1f" height="%.1f" %s'
            ' fill-opacity="0.15"/>',
            self.left,
            self.y(high),
            self.right - self.left,
            self.y(low) - self.y(high),
            fill(colour),
        )

    # Names of the curves, from the right
    def legend(self, curves):
        x = self.right
        for curve in reversed(curves):
            more = BOLD + " " + END
            self.page.text(
                x, self.top - TITLE + 12, curve.name, curve.colour, more
            )
            x -= 8.0 * len(curve.name) + 14

    def curve(self, curve):
        points = [(i, v) for i, v in enumerate(curve.values) if v is not None]
        if curve.band:
            self.band(curve)
        if curve.line:
            self.page.add(
                '<polyline points="%s" %s/>',
                self.path(points),
                stroke(curve.colour, 1.6),
            )
        if len(self.xs) <= 120:
            corners = [(self.x(i), self.y(v)) for i, v in points]
            self.dots(corners, curve.colour, 2.2 if curve.line else 1.5)

    def dots(self, points, colour, radius=2.2):
        circles = [
            '<circle cx="%.1f" cy="%.1f" r="%.1f"/>' % (x, y, radius)
            for x, y in points
        ]
        self.page.add("<g %s>%s</g>", fill(colour), "".join(circles))

    # Of what does not count
    def rings(self, points, colour):
        for x, y in points:
            self.page.add(
                '<circle cx="%.1f" cy="%.1f" r="4" %s/>',
                x,
                y,
                stroke(colour, 1.5),
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
        self.page.add(
            '<polygon points="%s" %s fill-opacity="0.2"/>',
            self.path(points),
            fill(curve.colour),
        )

    # A dashed line through it, at one run
    def mark(self, number, colour):
        self.page.add(
            '<path d="M%.1f %.1fV%.1f" %s/>',
            self.x(number),
            self.top,
            self.bottom,
            stroke(colour, dashes="4 3"),
        )

    # A flag with a text at the top of such a line
    def flag(self, number, text, colour):
        x, wide = self.x(number), 7.4 * len(text) + 6
        self.page.add(
            '<rect x="%.1f" y="%.1f" width="%.1f" height="14" rx="3" %s/>',
            x - wide / 2.0,
            self.top - 7,
            wide,
            fill(colour),
        )
        self.page.text(x, self.top + 4, text, "page", MIDDLE + " " + SMALL)

    # At the bottom: an X, or a triangle
    def signs(self, numbers, shape, colour):
        y = self.bottom - 5
        if not numbers:
            return
        if shape == "x":
            form, more = "M%.1f %.1fl7 7m0 -7l-7 7", stroke(colour, 1.6)
        else:
            form, more = "M%.1f %.1fh7l-3.5 7z", fill(colour)
        paths = [form % (self.x(i) - 3.5, y - 3.5) for i in numbers]
        self.page.add('<path d="%s" %s/>', "".join(paths), more)


SMALL = 'font-size="11" font-weight="600"'


# A plan of the bed from above, as high as it is wide.  'points': X and Y (mm);
# 'box': its left and right end.
class Plan:
    def __init__(self, page, points, box):
        self.page = page
        self.left, self.right = box
        self.top, self.side = page.y, box[1] - box[0]
        ends = [(min(part), max(part)) for part in zip(*points)]
        self.middle = [(low + high) / 2.0 for low, high in ends]
        self.span = max([high - low for low, high in ends] + [1.0]) * 1.25

    # In units of the picture; Y of the bed goes up
    def place(self, point):
        x, y = [
            (xy - middle) / self.span + 0.5
            for xy, middle in zip(point, self.middle)
        ]
        return self.left + x * self.side, self.top + (1.0 - y) * self.side

    # With the ends of X and Y
    def frame(self):
        page, half, bottom = self.page, self.span / 2.0, self.top + self.side
        (x, y), digits = self.middle, 1
        box = (self.left, self.top, self.side, self.side, stroke("grid"))
        rect = '<rect x="%.1f" y="%.1f" width="%.1f" height="%.1f" %s/>'
        page.add(rect % box)
        for end, value, more in (
            (self.left, x - half, ""),
            (self.right, x + half, END),
        ):
            text = "X %.*f" % (digits, value)
            page.text(end, bottom + 16, text, "soft", more)
        for end, value in ((bottom, y - half), (self.top + 12, y + half)):
            text = "Y %.*f" % (digits, value)
            page.text(self.left - 6, end, text, "soft", END)

    # Circles around points, full or not
    def circles(self, points, radii, attributes):
        for point, radius in zip(points, radii):
            circle = self.place(point) + (radius, attributes)
            self.page.add('<circle cx="%.1f" cy="%.1f" r="%.1f" %s/>' % circle)
