"""docs/dockable_probe.md says what dockable_probe.py does."""

from __future__ import annotations

import re

from tests.docs.documents import DOCS, link_problems, part, text_of
from tests.quick.runs import ours, started
from tests.quick.test_dockable_probe_quick import GUARDED, WITHOUT_TWIST
from tools.kit.dockable_probe import GANTRY
from tools.kit.product import OLD_POSITIONS, OPTIONS

TEXT = text_of("dockable_probe")
# Of the host's own probe, which it stands for
OF_PROBE = {
    "PROBE_ACCURACY",
    "PROBE_CALIBRATE",
    "QUERY_PROBE",
    "Z_OFFSET_APPLY_PROBE",
}


def old_names() -> set[str]:
    """All options of other releases that the module reads."""
    return {row.name for row in OLD_POSITIONS} | {
        name for row in OPTIONS["dockable_probe"] for name in row.old
    }


def test_old_names_are_all_there():
    assert len(old_names()) > 3
    missing = {name for name in old_names() if f"`{name}`" not in TEXT}
    assert missing == set()


def test_commands_are_all_there(start):
    table = part(TEXT, "Which commands are there?")
    told = set(re.findall(r"`([A-Z]+(?:_[A-Z]+)+)[ `]", table))
    own = ours(started(start, GANTRY, WITHOUT_TWIST)) - GUARDED
    assert told - OF_PROBE == own


def test_links():
    assert link_problems(TEXT, DOCS / "dockable_probe.md") == []
