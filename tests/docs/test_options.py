"""docs/options.csv and the whole sections of the pages are what the rows say."""

from __future__ import annotations

import re

import pytest

from simprinter.hosts.hosts import Host
from tests.docs import options as written
from tests.docs.documents import data_of, spans
from tools.kit.dockable_probe import SENSED
from tools.kit.printer import Printer
from tools.kit.product import options

RUN = "run build/venv/bin/python -m tests.docs.options"
FILES = written.generated()
PAGES = {name: FILES[written.DOCS / f"{name}.md"] for name in written.NAMES}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_options_are_those_of_the_rows(path):
    if path.read_text(encoding="utf-8") != FILES[path]:
        text = f"docs/{path.name} is not what the rows of options say: {RUN}"
        pytest.fail(text, pytrace=False)


@pytest.mark.parametrize("name", written.NAMES)
def test_each_page_opens_with_its_whole_section(name):
    """What is given has a value, what is not says where its default comes from."""
    assert re.search(r"(?m)^## (.*)", PAGES[name])[1] == "The whole section"
    lines = written.LINE.findall(written.WHOLE.search(PAGES[name])[2])
    assert len(lines) == len(written.TABLES[name])
    for mark, option, value, comment in lines:
        if not value:
            assert mark, f"{option}: write a value of one printer"
            words = r"\bdefault|SAVE_CONFIG"
            assert re.search(words, comment), (
                f"{option}: nothing of its default"
            )


# What is changed in a page, and is put right
MISTAKES = {
    "left out": r"(?m)^#lift_speed:.*\n(#   .*\n)+",
    "comment": r"(?m)(?<=^#   )The ",
    "no comment": r"(?m)(?<=^#lift_speed:\n)(#   .*\n)+",
    "value": r"(?m)(?<=^#speed: )\d+",
}


@pytest.mark.parametrize("what", MISTAKES)
def test_mistakes_in_a_page_are_put_right(what):
    text, table = PAGES["z_calibration"], written.TABLES["z_calibration"]
    changed, count = re.subn(MISTAKES[what], "", text)
    assert count
    assert written.page(changed, table) == text


ROW = options.option(
    "new", options.COUNT, 3, "", "How many.", minval=1, maxval=9
)


def test_new_option_stands_behind_the_one_before_it():
    first, *rest = written.TABLES["extra_probe"]
    table = (first, ROW, *rest)
    old = f"\n#   {first.text}\n"
    new = old + "#new: 3\n#   How many.\n"
    text = PAGES["extra_probe"]
    assert written.page(text, table) == text.replace(old, new)
    # And goes again
    assert written.page(text.replace(old, new), (first, *rest)) == text
    names = [first.name, *(row.name for row in rest)]
    assert written.ordered(names[::-1], (ROW, first)) == ["new", first.name]


def test_data_file_keeps_what_is_written_by_hand(monkeypatch):
    first, *rest = written.TABLES["extra_probe"]
    row = first._replace(default=None, kind=options.NUMBER, unit="mm")
    monkeypatch.setitem(written.TABLES, "extra_probe", (row, ROW, *rest))
    text = FILES[written.DATA]
    (line,) = re.findall(r"(?m)^extra_probe,pin,.*$", text)
    more = line.partition("MCU pin")[2]
    new = f'extra_probe,pin,-,mm{more}\nextra_probe,new,`3`,"count, 1 to 9",'
    # Another default is that of the row, words of one that comes from elsewhere stay
    changed = text.replace("extra_probe,speed,`5`", "extra_probe,speed,`6`")
    assert written.data(changed) == text.replace(line, new)
    words = "distance of the nearest position"
    assert words in text and words in written.data(text)


def test_old_names_are_those_of_the_rows():
    told = {
        (old, spans(row["now"])[0])
        for row in data_of("old_names.csv", "z_calibration")
        for old in spans(row["option"])
    }
    known = {
        (old, row.name)
        for row in written.TABLES["z_calibration"]
        for entry in row.old
        for old in ((entry,) if isinstance(entry, str) else entry)
    }
    assert told == known


def test_dockable_probe_has_these_defaults(host: Host):
    """Those of the others are asked for in test_documents."""
    rows = {
        row.name: row
        for row in written.TABLES["dockable_probe"]
        if written.value_of(row)
    }
    assert len(rows) > 15
    changes = {"dockable_probe": dict.fromkeys(rows)}
    with Printer(host, SENSED, changes) as printer:
        printer.session.require_ready()
        settings = printer.status("configfile")["settings"]["dockable_probe"]
    for name, row in rows.items():
        assert settings[name] == row.default, name
