"""What klippy says and hears has one format, on our board and on programs."""

from __future__ import annotations

import pytest

from simprinter import Machine
from tests.firmware.programs import dictionary, given, program_for, why_not
from tools.kit.scenes import SCENES

# What differs from board to board
_OWN_CONSTANTS = {"MCU", "PWM_MAX"}
# What programs may have instead. A Linux process is reset otherwise; reports of
# several samples are of 2026, and klippy of that time speaks both
_INSTEAD = {
    "reset": None,
    "query_analog_in": "query_analog_in oid=%c clock=%u sample_ticks=%u"
    " sample_count=%c rest_ticks=%u bytes_per_report=%c min_value=%hu"
    " max_value=%hu range_check_count=%c",
    "analog_in_state": "analog_in_state oid=%c next_clock=%u values=%*s",
}


@pytest.fixture(scope="module")
def ours():
    """A board with everything: all peripherals are plugged in on each."""
    with Machine(SCENES["voron"]) as machine:
        return machine.board.dictionary


def by_name(messages):
    return {message.name: message.text for message in messages}


@pytest.fixture(params=given(), ids=lambda path: path.parents[1].name)
def program(request):
    return dictionary(request.param)


@pytest.mark.every_host("each host needs a program of its own version")
def test_host_speaks_with_a_program(host):
    if program_for(host) is None:
        reasons = "; ".join(f"{p}: {why_not(host, p)}" for p in given())
        pytest.skip(f"{host.name} speaks with no program given: {reasons}")


@pytest.mark.parametrize("part", ["commands", "responses"])
def test_every_message_has_its_format(ours, program, part):
    declared = by_name(getattr(program, part).values())
    own = by_name(getattr(ours, part).values())
    assert own
    found = {name: declared.get(name) for name in own}
    other = {name for name in own if found[name] != own[name]}
    expected = {name: _INSTEAD.get(name, own[name]) for name in other}
    assert {name: found[name] for name in other} == expected


def test_every_constant_has_its_value(ours, program):
    own = {
        name: value
        for name, value in ours.constants.items()
        if name not in _OWN_CONSTANTS
    }
    assert {name: program.constants.get(name) for name in own} == own
