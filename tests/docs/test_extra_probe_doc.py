"""docs/extra_probe.md says what the module does, no more, no less.

Its section has a name of its own, and it has no run in one command: so it has
a record here, and of the common checks those that ask for neither.
"""

from __future__ import annotations

import re
from types import SimpleNamespace

import pytest

from tests.docs.documents import (
    STATUS,
    ini_blocks,
    part,
    rows,
    spans,
    text_of,
)
from tests.docs.pictures import numbers
from tests.docs.records import SHOWN, Module
from tests.docs.running import Running
from tests.docs.test_documents import (
    unlike,
    wrong_answers,
    wrong_commands,
    wrong_constants,
    wrong_defaults,
    wrong_links,
    wrong_options,
    wrong_ranges,
)
from tools.kit.extra_probe import (
    ABORT,
    CALIBRATE,
    CONTINUE,
    NAME,
    fixed_switch,
    press,
)

TEXT = text_of("extra_probe")
ABOVE = "G90\nG1 Z5 F900\nG1 X30 Y20 F6000"

# What a hand does at these steps
HANDS = {
    "LAY": lambda printer: printer.machine.lay_membrane(),
    "PRESS": press,
}

RECORD = Module(
    name=NAME,
    scene="membrane",
    surroundings={"respond": {}},
    steps={
        ABOVE: None,
        "QUERY_EXTRA_PROBE PROBE=membrane": SHOWN,
        "LAY": None,
        "EXTRA_PROBE PROBE=membrane": SHOWN,
        ABOVE + " ": None,
        "EXTRA_PROBE_ACCURACY PROBE=membrane SAMPLES=3": SHOWN,
        f"{CALIBRATE} SAVE=1": SHOWN,
        "PRESS": None,
        CONTINUE: SHOWN,
        CONTINUE.replace(" ", "  "): SHOWN,
        ABORT: None,
    },
    # No options of other releases
    old="Limits",
    given=("pin",),
    sources={},
    late={"lift_speed": "`speed`"},
)
SOURCES = SimpleNamespace(module=SimpleNamespace(name="extra_probe"))


def wrong_ranges_here(running, text):
    """Of options that a printer with a membrane may have.

    Those of a switch beside the bed are given by tests/modules/test_extra_probe_fixed.
    """
    own = ("{'fixed'", "fixed:", "{'switch_height'", "switch_height:")
    found = wrong_ranges(running, text)
    yield from (line for line in found if not line.startswith(own))


LIVE = (
    wrong_options,
    wrong_defaults,
    wrong_commands,
    wrong_answers,
    wrong_ranges_here,
)
OF_SOURCES = (wrong_constants, wrong_links)


class Hand(Running):
    """A klippy with somebody who lays and presses the membrane."""

    def example(self, text):
        # Those are for printers with another [probe], and with a switch beside the bed,
        # which is tried below
        others = ("extra_probe probe", "extra_probe nozzle_switch")
        own = {**dict.fromkeys(others), **self.module.surroundings}
        changes = {**ini_blocks(text), **own}
        return self.run(*self.module.steps, changes=changes)

    def _step(self, script):
        if script in HANDS:
            HANDS[script](self.printer)
            script = ""
        return super()._step(script)


def wrong_status(running, text):
    status = running.status(text)
    table = {spans(r[0])[0] for r in rows(part(text, STATUS))}
    yield from unlike("field", table, set(status))


def wrong_terms(text):
    """The table and the formula are the picture."""
    shown = numbers("extra_probe")
    table = rows(part(text, "What is measured?"))
    terms = {row[0]: row[1] for row in table if re.match(r"[\d.]+$", row[1])}
    for name in ("trigger", "z_offset", "offset"):
        if terms.get(name) != f"{shown[name]:.3f}":
            yield f"{name} is {shown[name]}"
    if (
        "{offset:.3f}  = {trigger:.3f} - {z_offset:.3f}".format(**shown)
        not in text
    ):
        yield "formula"


def problems(running, text):
    """All that is wrong in the document."""
    for check in LIVE:
        yield from check(running, text)
    for check in OF_SOURCES:
        yield from check(SOURCES, text)
    yield from wrong_status(running, text)
    yield from wrong_terms(text)


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_document_is_right(host):
    with Hand(host, RECORD) as running:
        assert list(problems(running, TEXT)) == []


def test_switch_beside_the_bed(start):
    over = (191.0, 165.0)
    own = ini_blocks(TEXT)["extra_probe nozzle_switch"]
    changes = {NAME: None, "extra_probe nozzle_switch": own}
    scene = fixed_switch(at=(289.0, 361.0), over=over, size=370.0)
    printer = start(scene, changes=changes).homed()
    printer.run("EXTRA_PROBE_CALIBRATE PROBE=nozzle_switch")
    assert printer.gap(over) == pytest.approx(0.0, abs=0.006)
