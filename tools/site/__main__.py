"""The documents as a site, by mkdocs.

    python -m tools.site [--folder FOLDER]

The pages are written for a forge, which shows them as they are.  Here they are
copied as they stand beside each other, with what mkdocs wants otherwise: lists
that are indented by four, a page for each folder of examples.  A dead link, or a
page that nobody is led to, is an error.
"""

from __future__ import annotations

import argparse
import csv
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from simprinter.hosts.environment import build_dir

ROOT = Path(__file__).resolve().parents[2]
CONFIG = Path(__file__).with_name("mkdocs.yml")
COPIED = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "LICENSE")
COPIED += ("docs", "examples", "simprinter/LIMITS.md")
ITEM = re.compile(r"( *)((?:[-*]|\d+\.) +)")
INDENT = 4
STYLE = Path(__file__).with_name("site.css")
# Data files that are pages here, and what these are called
TABLES = {
    "options": "All options",
    "old_names": "Old names of options",
    "numbers": "Built-in numbers",
    "installer": "Options and messages of install.sh",
    "all_messages": "All messages",
    "report_texts": "Texts of the report",
}
# They have every word, or more than an owner wants, and come behind the pages that
# explain it
BEHIND = (
    *(f"docs/{name}.md" for name in TABLES),
    "docs/z_calibration_inside.md",
    "docs/auto_z_offset_inside.md",
    "CHANGELOG.md",
    "simprinter/LIMITS.md",
    "simprinter/TUTORIAL.md",
)
BOOST = "---\nsearch:\n  boost: {}\n---\n\n"
# The theme knows one language for all pages. By that of the page a browser chooses the
# shapes of Chinese characters, and a screen reader its voice
LANGUAGE = '<html lang="en"', '<html lang="zh-Hans"'
# As mkdocs.yml calls the folder of what was staged
PAGES = "pages"


def indented(text: str) -> Iterator[str]:
    """The lines, with what belongs to an item of a list indented by four."""
    # Of each list that is open: where its text begins, here and there
    open_lists: list[tuple[int, int]] = []
    for line in text.splitlines():
        spaces = len(line) - len(line.lstrip(" "))
        if line.strip():
            while open_lists and spaces < open_lists[-1][0]:
                open_lists.pop()
        old, new = open_lists[-1] if open_lists else (0, 0)
        item = ITEM.match(line)
        if item and spaces == old:
            open_lists.append((len(item[0]), new + INDENT))
            line = line[spaces:]
            yield " " * new + line
        else:
            yield " " * new + line[old:] if line.strip() else ""


def with_targets(
    text: str, page: Path, source: Path, folders: set[Path]
) -> str:
    """Links to folders lead to the pages of these; other files are there."""

    def changed(link: re.Match[str]) -> str:
        target = (page.parent / link[1]).resolve()
        if target.is_dir():
            folders.add(target)
            return f"]({link[1].rstrip('/')}/README.md"
        if not target.exists() and source in target.parents:
            original = ROOT / target.relative_to(source)
            if original.is_file():
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(original, target)
        return link[0]

    return re.sub(r"\]\(([\w./-]+)", changed, text)


def page_of_table(path: Path) -> str:
    """A data file as a page: a table for each section."""
    with path.open(encoding="utf-8", newline="") as lines:
        heads, *rows = csv.reader(lines)
    text = [f"# {TABLES[path.stem]}", "", f"[Download]({path.name})"]
    section = None
    for row in rows:
        if row[0] != section:
            section = row[0]
            text += ["", f"## {section}", "", f"| {' | '.join(heads[1:])} |"]
            text += ["|---" * len(heads[1:]) + "|"]
        text.append(f"| {' | '.join(row[1:])} |")
    # What belongs together stands below each other
    return "\n".join([*text, ""]).replace("` `", "`<br>`")


def page_of(folder: Path) -> str:
    """What there is in a folder of examples, all of it."""
    lines = [f"# examples/{folder.name}", ""]
    for path in sorted(folder.iterdir()):
        lines += [f"## {path.name}", "", f"[Download]({path.name})", ""]
        if path.suffix in (".cfg", ".conf", ".yml"):
            lines += ["```ini", path.read_text("utf-8").rstrip(), "```", ""]
    return "\n".join(lines)


def stage(source: Path) -> None:
    """Copies what the site is made of."""
    shutil.rmtree(source, ignore_errors=True)
    for name in COPIED:
        target = source / name
        target.parent.mkdir(parents=True, exist_ok=True)
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, target)
    for name in TABLES:
        path = source / "docs" / f"{name}.csv"
        path.with_suffix(".md").write_text(page_of_table(path), "utf-8")
    folders: set[Path] = set()
    for page in sorted(source.rglob("*.md")):
        text = "\n".join(indented(page.read_text(encoding="utf-8"))) + "\n"
        for name in TABLES if page.stem not in TABLES else ():
            text = text.replace(f"]({name}.csv)", f"]({name}.md)")
        text = with_targets(text, page, source.resolve(), folders)
        page.write_text(text, encoding="utf-8")
    # A word in a title counts a thousandfold
    boosts = {source / name: 0.0005 for name in BEHIND}
    # A word that both languages have is looked for in English more often
    boosts.update((page, 0.5) for page in source.glob("docs/zh/*.md"))
    for page, boost in boosts.items():
        text = BOOST.format(boost) + page.read_text(encoding="utf-8")
        page.write_text(text, encoding="utf-8")
    shutil.copy(STYLE, source / STYLE.name)
    for folder in folders:
        (folder / "README.md").write_text(page_of(folder), encoding="utf-8")


def build(source: Path, site: Path, python: str = sys.executable) -> int:
    """Make a site of what was staged; the exit code of mkdocs."""
    config = shutil.copy(CONFIG, source.parent / CONFIG.name)
    command = [python, "-m", "mkdocs", "build", "--strict"]
    command += ["--config-file", str(config), "--site-dir", str(site)]
    # What it has to say of versions to come
    env = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    code = subprocess.call(command, env=env)
    for page in (site / "docs" / "zh").rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        page.write_text(text.replace(*LANGUAGE), encoding="utf-8")
    return code


def main() -> int:
    """Make the site; the exit code is that of mkdocs."""
    parser = argparse.ArgumentParser(prog="python -m tools.site")
    parser.add_argument("--folder", type=Path, help="default: build/site")
    options = parser.parse_args()
    source = build_dir() / "site-source" / PAGES
    stage(source)
    return build(source, (options.folder or build_dir() / "site").resolve())


if __name__ == "__main__":
    sys.exit(main())
