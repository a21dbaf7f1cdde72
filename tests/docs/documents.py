"""Reading the documents in docs/: headings, tables, code, links."""

from __future__ import annotations

import configparser
import csv
import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote

from markdown_it import MarkdownIt
from markdown_it.tree import SyntaxTreeNode

DOCS = Path(__file__).resolve().parents[2] / "docs"
# Section -> the pages of it, where it has more than one
PAGES = {
    "z_calibration": (
        "z_calibration",
        "setup",
        "accuracy",
        "z_calibration_inside",
    ),
    "auto_z_offset": ("auto_z_offset", "auto_z_offset_inside"),
}
NUMBERS = "Built-in numbers"
OPTIONS = "Which options are there?"
OLD_NAMES = "Old names"
COMMANDS = "Which commands are there?"
STATUS = "What can macros read?"
_MARKDOWN = MarkdownIt("commonmark").enable("table")


def data_of(file: str, section: str) -> list[dict[str, str]]:
    """The lines of a section in one of the data files beside the pages."""
    with (DOCS / file).open(encoding="utf-8", newline="") as lines:
        return [r for r in csv.DictReader(lines) if r["section"] == section]


def text_of(name: str) -> str:
    """All that the documents say of a section: its pages, its options, its numbers."""
    text = "\n".join(
        (DOCS / f"{page}.md").read_text(encoding="utf-8")
        for page in PAGES.get(name, (name,))
    )
    options = [f"\n## {OPTIONS}\n", "| option | default | unit, range | more |"]
    options += ["|---|---|---|---|"]
    options += [
        f"| `{r['option']}` | {r['default']} | {r['unit, range']} | {r['more']} |"
        for r in data_of("options.csv", name)
    ]
    text = text.replace(f"\n## {OPTIONS}\n", "\n".join([*options, ""]))
    old = [f"\n### {OLD_NAMES}\n", "| option | now | unit, range |"]
    old += ["|---|---|---|"]
    old += [
        f"| {r['option']} | {r['now']} | {r['unit, range']} |"
        for r in data_of("old_names.csv", name)
    ]
    text = text.replace(f"\n### {OLD_NAMES}\n", "\n".join([*old, ""]))
    numbers = [
        f"## {NUMBERS}",
        "",
        "| name | value | meaning |",
        "|---|---|---|",
    ]
    numbers += [
        f"| `{r['name']}` | {r['value']} | {r['meaning']} |"
        for r in data_of("numbers.csv", name)
    ]
    return "\n".join([text, *numbers, ""])


@lru_cache
def nodes(text: str, kind: str) -> list[SyntaxTreeNode]:
    """Its parts of a kind, such as links, in their order."""
    tree = SyntaxTreeNode(_MARKDOWN.parse(text))
    return [node for node in tree.walk() if node.type == kind]


def blocks(text: str, language: str) -> list[str]:
    """Its blocks of code in a language."""
    fences = nodes(text, "fence")
    return [fence.content for fence in fences if fence.info == language]


def headings(text: str) -> list[tuple[int, str, str]]:
    """(level, title, what stands below it up to a heading as high)."""
    lines, found = text.splitlines(), nodes(text, "heading")
    result = []
    for number, node in enumerate(found):
        after = (n for n in found[number + 1 :] if n.tag <= node.tag)
        end = next((n.map[0] for n in after), len(lines))
        below = "\n".join(lines[node.map[1] : end])
        result.append((int(node.tag[1:]), node.children[0].content, below))
    return result


def part(text: str, title: str) -> str:
    """What stands below a heading."""
    (body,) = [body for _, name, body in headings(text) if name == title]
    return body


def rows(text: str) -> Iterator[list[str]]:
    """The cells of every row of every table, without the table's heading."""
    for body in nodes(text, "tbody"):
        for row in body.children:
            yield [cell.children[0].content for cell in row.children]


def spans(text: str) -> list[str]:
    """What is written as code."""
    return [node.content for node in nodes(text, "code_inline")]


def names(text: str) -> set[str]:
    """What the first column of the tables has as code."""
    return {spans(row[0])[0] for row in rows(text)}


def normal(text: str) -> str:
    """One space for all that is white."""
    return " ".join(text.split())


# Options


class Option(NamedTuple):
    """A row of a table of options."""

    name: str
    default: str
    range: str


def options_of(text: str) -> list[Option]:
    """The rows of all tables of options in a text."""
    return [Option(*spans(row[0]), *row[1:3]) for row in rows(text)]


def samples_of(words: str) -> tuple[list[str], list[str]]:
    """Range -> (texts that are taken, texts that are not)."""
    number = r"(-?[\d.]+)"
    if match := re.match(
        rf"(?:mm/s²|mm/s|mm|°C|count), ([>≥]) {number}", words
    ):
        limit = float(match[2])
        if words.startswith("count"):
            return (
                [f"{limit:g}", f"{limit + 1:g}"],
                [f"{limit - 1:g}", "2.5"],
            )
        below = [f"{limit - 0.001:g}", "x", "nan"]
        if match[1] == "≥":
            return [f"{limit:g}", f"{limit + 0.5:g}"], below
        return [f"{limit + 0.5:g}"], [f"{limit:g}", f"{limit - 1:g}", *below]
    if match := re.match(rf"count, {number} to {number}", words):
        low, high = int(match[1]), int(match[2])
        return [f"{low}", f"{high}"], [f"{low - 1}", f"{high + 1}", "2.5"]
    if match := re.fullmatch(rf"(?:mm, )?{number} to {number}", words):
        low, high = float(match[1]), float(match[2])
        beyond = [f"{low - 0.001:g}", f"{high + 0.001:g}"]
        return [f"{low:g}", f"{high:g}"], [*beyond, "x", "nan"]
    if words == "X, Y in mm":
        return ["50, 40"], ["5", "5, x", "1, 2, 3"]
    if words in ("X in mm", "Y in mm"):
        return ["160"], ["x", "inf"]
    if words == "low, high in mm":
        taken = ["-0.5, 0.7", "0.5", "-0.5", "0, 1", "0.1, 1"]
        return taken, ["0, 0", "0", "1, -1"]
    if words == "mm":
        return ["-1"], ["x", "inf"]
    choices = spans(words)
    return choices, ["x"] if choices else []


# Links, code


def anchors(text: str) -> set[str]:
    """What GitHub makes of the headings."""
    return {
        re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")
        for _, title, _ in headings(text)
    }


def link_problems(text: str, document: Path) -> list[str]:
    """Links to files and headings that are not there."""
    found = []
    targets = [str(link.attrs["href"]) for link in nodes(text, "link")]
    targets += [str(image.attrs["src"]) for image in nodes(text, "image")]
    for target in targets:
        path, _, anchor = unquote(target).partition("#")
        if target.startswith("http"):
            continue
        if path and not (document.parent / path).exists():
            found.append(f"no file: {target}")
        elif anchor:
            other = text
            if path:
                other = (document.parent / path).read_text(encoding="utf-8")
            if anchor not in anchors(other):
                found.append(f"no heading: {target}")
    return found


def ini_blocks(text: str) -> dict[str, dict[str, str]]:
    """Every section that the document shows."""
    parser = configparser.ConfigParser(delimiters=":", interpolation=None)
    # Values keep their indentation; in a template it does not matter
    for block in blocks(text, "ini"):
        parser.read_string(block)
    return {
        name: {
            option: value.replace("\n", "\n  ")
            for option, value in parser[name].items()
        }
        for name in parser.sections()
    }


def shown_answers(text: str) -> dict[str, list[str]]:
    """What the console answers to the commands of each block of code."""
    found: dict[str, list[str]] = {}
    for block in blocks(text, ""):
        lines = block.splitlines()
        commands = [line[2:] for line in lines if line.startswith("> ")]
        if commands:
            answers = [line for line in lines if not line.startswith("> ")]
            found["\n".join(commands)] = answers
    return found
