"""What refusals, status and console say of the printer, and whether it is so.

A claim is judged by what was so at any moment of its step, as nobody knows at
which of them it was made.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Optional

from tools.campaign.drawn import values

# What the message of a command has to say, by fault (and subject); a switch
# that is dead or triggers in the wrong place looks like one that is not met
_DEAD = r"No trigger|did not answer|did not trigger"
_TRIGGERED = r"reads triggered|prior to movement|still triggered"
_HEIGHTS = (
    r"above the expected|differ|No trigger|did not answer|is above z=|sees the bed"
    r" at"
)
# What a dockable probe says where its pins are not as they have to be
_PROBE = r"the probe (was not fetched|was not docked|is not ready|was lost)"
CAUSES = {
    # Before before_switch_gcode a probe has to read triggered
    "stuck_open": _DEAD
    + r"|is attached already|look at its switch and wire where nothing does|"
    + _PROBE,
    "stuck_closed": _TRIGGERED + r"|before the toolhead moved|" + _PROBE,
    # In mid air; at the last touch it is a height like others
    "sticks": _TRIGGERED
    + r"|before the toolhead moved|check the probe with QUERY_PROBE|samples differ"
    + r"|if a hand has pressed it",
    "trigger_never": _DEAD,
    "trigger_early": _HEIGHTS,
    "trigger_late": _HEIGHTS,
    "probe_falls": r"has come off|not attached|No trigger|did not answer|before the"
    r" toolhead moved|" + _PROBE,
    "probe_put_on": r"the probe is on the toolhead",
    "attach_fails": r"the probe was not fetched|it is not attached",
    "dock_fails": r"the probe was not docked",
    "template raises": r"template \d+ fails",
    "template leaves": r"Move out of range|out of range",
    "tmc_change_lost": r"Unable to write tmc uart '\w+' register",
    "tmc_write_error": r"Unable to write tmc uart '\w+' register",
    "tmc_read_error": r"Unable to read tmc uart '\w+' register",
    "mcu_silent": r"shutdown|Unable to obtain|Timeout on wait|Lost communic",
    # A host may be about to plan one more move, and says that it cannot
    "cancel": r"shutdown|webhooks request|Unable to obtain|Timeout on wait"
    r"|Internal error in (MCU '\w+' )?stepcompress",
}
SHUT_DOWN_CAUSES = {
    # A host may stumble over its own moves before it misses the board, or miss an
    # answer of its motor drivers
    "mcu_silent": r"Lost communication with MCU|Internal error on command"
    r"|Exception in flush_handler|Timeout on wait for 'tmcuart_response'",
    "cancel": r"webhooks request",
}
# After these a sensor tells of nothing any more
BLINDING = ("stuck_open", "trigger_never", "probe_falls")
# Reasons that status and console give
HOMED_OR_SET = "Z was homed again or set"
MOTORS_OFF = "the motors were turned off"


@dataclass(frozen=True)
class Facts:
    """Of one step.

    before, after: status of the printer's objects. probes: where the world had
    the probe; membrane: whether it lies there; touched: the sites touched.
    is_asked: somebody is asked something, or was by a dialog.
    """

    before: Mapping[str, Any]
    after: Mapping[str, Any]
    probes: frozenset[str]
    membrane: bool
    touched: frozenset[str]
    is_asked: bool

    def any(self, section: str, field: str, test: Callable[[Any], Any]) -> bool:
        """Whether a field was so, before or after."""
        return any(
            test(status.get(section, {}).get(field))
            for status in (self.before, self.after)
        )


def _not_homed(facts: Facts, axes: str = "xyz") -> bool:
    wanted = set(re.findall("[xyz]", axes.lower()) or "xyz")
    return facts.any("toolhead", "homed_axes", lambda had: wanted - set(had))


def _is_manual(facts: Facts, *unused: str) -> bool:
    return facts.any("manual_probe", "is_active", bool)


def _is_at(facts: Facts, state: str) -> bool:
    """The pins cannot tell a lost probe from one in its dock."""
    wanted = {
        "ATTACHED": {"attached"},
        "DOCKED": {"docked", "lost"},
        "UNKNOWN": {"attached", "docked", "lost"},
    }
    return bool(wanted[state.upper()] & facts.probes)


def _is_off_head(facts: Facts, *unused: str) -> bool:
    return bool({"docked", "lost"} & facts.probes)


def _is_on_head(facts: Facts, *unused: str) -> bool:
    """Already when it began."""
    return "attached" in facts.probes


def _waits(facts: Facts, *unused: str) -> bool:
    return facts.is_asked


def _waits_not(facts: Facts, *unused: str) -> bool:
    return facts.any("extra_probe membrane", "waits_for", lambda v: not v)


def _not_calibrated(facts: Facts, *unused: str) -> bool:
    return facts.any("z_calibration", "last_result", lambda last: not last)


def _holds_no_more(facts: Facts, reason: str) -> bool:
    """As the status says by itself; motors that are off hide what was before."""
    return facts.any(
        "z_calibration", "reason", lambda now: now in (reason, MOTORS_OFF)
    )


def _no_membrane(facts: Facts, *unused: str) -> bool:
    """Nothing lies where the nozzle looks for it."""
    return not facts.membrane or "nozzle_membrane" not in facts.touched


def _is_true(facts: Facts, *unused: str) -> bool:
    """Of what its owner has asked for: only the words tell what is wrong."""
    return True


def _has_offset(facts: Facts, *unused: str) -> bool:
    return facts.any(
        "gcode_move", "homing_origin", lambda now: now and now[2] < 0.0
    )


def _is_reset(facts: Facts, *unused: str) -> bool:
    return facts.any("gcode_move", "homing_origin", lambda now: not now[2])


def _wants_no_trips(facts: Facts, *unused: str) -> bool:
    return facts.any(
        "dockable_probe", "auto_attach_detach", lambda now: now is False
    )


def _has_g92(facts: Facts, *unused: str) -> bool:
    """Z=0 is elsewhere than homing and the G-code offset have it."""
    moves = facts.before["gcode_move"], facts.after["gcode_move"]
    return any(
        abs(z["position"][2] - z["gcode_position"][2] - z["homing_origin"][2])
        > 0.0004
        for z in moves
    )


def _has_no_correction(facts: Facts, *unused: str) -> bool:
    return facts.any("auto_z_offset", "probe_z_correction", lambda z: not z)


def _is_paused(facts: Facts, *unused: str) -> bool:
    return facts.any("print_stats", "state", lambda now: now == "paused")


def _is_never(facts: Facts, *unused: str) -> bool:
    """Of what nobody has asked for."""
    return False


# A refusal begins to tell with the first of them that it has. Nothing here is of
# a healthy printer that does what its owner has ordered.
CLAIMS: tuple[tuple[re.Pattern, Callable[..., bool]], ...] = tuple(
    (re.compile(pattern), test)
    for pattern, test in (
        (r"Must home", _not_homed),
        (r"not homed(?: any more after \w+)?: ([XYZ, ]+)", _not_homed),
        (r"manual probe is under way|end the manual probe", _is_manual),
        (r"lready in a manual Z probe", _is_manual),
        (r"waits for an answer", _waits),
        (r"nothing was asked", _waits_not),
        (r"not calibrated yet", _not_calibrated),
        (
            r"^z_calibration: (.*); (?:run CALIBRATE_Z first|baby steps count)",
            _holds_no_more,
        ),
        (r"switch_offset=\S+, which cannot be negative", _is_true),
        (r"probe is attached already", _is_on_head),
        (r"probe is (ATTACHED|DOCKED|UNKNOWN)", _is_at),
        (r"not (?:attached|docked|fetched), it is (\w+)", _is_at),
        (r"probe reads triggered", _is_off_head),
        (r"needs the probe on the toolhead all the time", _is_off_head),
        (r"^extra_probe .*(?:No trigger on|did not answer)", _no_membrane),
        (r"^extra_probe .*(?:was not pressed|press it once)", _is_true),
        (r"no set-up is under way|did not change; check", _is_true),
        (r"is not what is asked now|since the calibration began", _is_true),
        (r"reach of the axis|Z was set by AUTO_Z_HOME_Z", _is_true),
        # Only the motors know, and whoever has levelled or set them
        (r"since G28,|Z was not homed with G28", _is_true),
        (r"a print is paused \(PAUSE\)", _is_true),
        (r"a print is paused, and the toolhead", _is_paused),
        (r"with the G-code Z offset of \S+ in force", _has_offset),
        (r"G-code (?:Z )?offset is 0, not th", _is_reset),
        (r"holds no correction, and none was saved", _has_no_correction),
        (r"auto_attach_detach is off, and", _wants_no_trips),
        (r"G92 has moved Z=0 by", _has_g92),
        # What only the owner's own file and the drawn printer know
        (r"end_gcode has left a G-code Z offset", _is_true),
        (r"section 'axis_twist_compensation' is missing", _is_true),
        (r"the pin still moves|the nozzle would be \S+ mm longer", _is_true),
        (r"no extruder, so it is not known how hot", _is_true),
        (r"is none of baby steps", _is_true),
        # A retraction of Klipper's that fails leaves G91 to its owner's templates
        (r"^z_calibration: \w+_gcode: .*Move out of range", _is_true),
        # Our calibrations are asked to go nowhere else
        (r"^(?:z_calibration|auto_z_offset): .*Move out of range", _is_never),
        (values.NOT_READY, _is_true),
        (r"Unknown profile|Unknown g-code state|Move out of range", _is_true),
        (r"Extrude when no|Extrude below min|max_temperature is", _is_true),
    )
)
_SEEN = re.compile(r"Probe Status: (\w+)")


def verdict(refusal: str, facts: Facts) -> Optional[bool]:
    """Whether a refusal is true; None: the world knows no reason for it."""
    for pattern, test in CLAIMS:
        found = pattern.search(refusal)
        if found:
            return test(facts, *(group or "" for group in found.groups()))
    return None


def untrue(
    command: str, refusal: str, lines: Sequence[str], facts: Facts
) -> Iterator[str]:
    """What status and console say, and is not so."""
    for line in lines:
        found = _SEEN.search(line)
        if found and not _is_at(facts, found.group(1)):
            yield f"{line!r}, and the probe is {sorted(facts.probes)}"
    wanted = {"ATTACH_PROBE": "attached", "DETACH_PROBE": "docked"}.get(command)
    if wanted and not refusal and wanted not in facts.probes:
        yield f"after {command} the probe is {sorted(facts.probes)}"
    dock = facts.after.get("dockable_probe") or {}
    state = dock.get("last_status_name", dock.get("last_status"))
    is_told = wanted and not refusal and isinstance(state, str)
    if is_told and not _is_at(facts, state):
        yield f"last_status is {state}, the probe {sorted(facts.probes)}"
    yield from _reasons(facts)
    yield from untrue_query(command, refusal, facts)


def untrue_query(command: str, refusal: str, facts: Facts) -> Iterator[str]:
    """Whether the last run was good is not what the status says."""
    good = (facts.after.get("z_calibration") or {}).get("last_query")
    if command == "CALIBRATE_Z" and good is bool(refusal):
        yield f"last_query is {good} after {refusal or 'a good run'}"


def _reasons(facts: Facts) -> Iterator[str]:
    """Why a result is not valid, where that is another reason than before."""
    before, after = (
        (status.get("z_calibration") or {}).get("reason") or ""
        for status in (facts.before, facts.after)
    )
    if after == before:
        return
    # To hop, [safe_z_home] sets a Z that is not homed, and touches nothing
    was_homed = "z" in facts.before["toolhead"]["homed_axes"]
    is_set = after == HOMED_OR_SET and not was_homed
    is_homed = re.search("Z was homed|levelled", after) and not is_set
    if is_homed and not facts.touched:
        yield f"reason is {after!r}, and nothing was touched"
    found = re.match(r"the G-code Z offset is (-?[\d.]+)", after)
    z = facts.after["gcode_move"]["homing_origin"][2] if found else 0.0
    if found and abs(float(found.group(1)) - z) > 0.0006:
        yield f"reason is {after!r}, and it is {z:.6f}"
