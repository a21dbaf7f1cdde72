"""docs/options.csv and the whole sections of the pages are what the rows say."""

from __future__ import annotations

import pytest

from simprinter.hosts.hosts import Host
from tests.docs import options as written
from tests.docs.documents import data_of, spans
from tools.kit.dockable_probe import SENSED
from tools.kit.printer import Printer

RUN = "run build/venv/bin/python -m tests.docs.options"
FILES = written.generated()


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_options_are_those_of_the_rows(path):
    if path.read_text(encoding="utf-8") != FILES[path]:
        text = f"docs/{path.name} is not what the rows of options say: {RUN}"
        pytest.fail(text, pytrace=False)


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
