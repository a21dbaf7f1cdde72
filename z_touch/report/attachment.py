"""The text that a user attaches where he asks somebody.

Versions, his options, what was measured and reported. Nothing in it names a person, a
computer, a folder, a serial number or an address; of G-code it has the names of the
commands only.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

# Its texts are no messages: they are written into a file.

from __future__ import annotations

import json
import os
import re
import sys
from typing import Any, Dict, Iterator, List, Mapping, Sequence

from ..z_calibration.runs import Run, line_of

# Sections that say how Z is homed, probed and levelled: whole names, and beginnings
SECTIONS = (
    "printer",
    "stepper_z",
    "probe",
    "bltouch",
    "smart_effector",
    "dockable_probe",
    "auto_z_offset",
    "safe_z_home",
    "homing_override",
    "bed_mesh",
    "bed_tilt",
    "z_tilt",
    "quad_gantry_level",
    "screws_tilt_adjust",
    "bed_screws",
    "z_thermal_adjust",
    "axis_twist_compensation",
    "skew_correction",
    "duplicate_pin_override",
)
BEGINNINGS = ("stepper_z", "carriage ", "extra_probe ")
# Options whose values are private, in whatever section they stand
PRIVATE = re.compile("serial|uuid|token|secret|passw|user|host|url|path|file")
GCODE = re.compile("gcode$")
COMMAND = re.compile(r"(?m)^[ \t]*([A-Za-z_][\w.]*)")
# Of a template: statements and remarks, values with the texts in them, and what a line
# of G-code ends with
NO_COMMAND = re.compile(
    r"""(?s)\{%.*?%\}|\{#.*?#\}"""
    r"""|(\{(?:"[^"]*"|'[^']*'|[^"'}])*\}?)|[#;][^\n]*"""
)
# Runs that it has
RUNS = 10

HIDDEN = (
    (re.compile(r"\w+://\S+"), "<address>"),
    (re.compile(r"[\w.+-]+@[\w-]+(?:\.[\w-]+)+"), "<address>"),
    (re.compile(r"\b\d{1,3}(?:\.\d{1,3}){3}(?::\d+)?\b"), "<address>"),
    (re.compile(r"(?<![\w>])~?(?:/[\w.+@~-]+)+/?"), "<path>"),
)

# A name that is no longer is a word that texts have anyway
SHORT_NAME = 3

Names = Sequence[str]
# As klippy hands it over: anything that JSON can be
Value = Any


def without_names(text: object, names: Names = ()) -> str:
    """Return a text without paths, addresses and 'names' (of computer and user)."""
    shown = str(text)
    for pattern, instead in HIDDEN:
        shown = pattern.sub(instead, shown)
    for name in names:
        shown = re.sub(rf"(?i)\b{re.escape(name)}\b", "<name>", shown)
    return shown


def names_here() -> List[str]:
    """Return the names of this computer and its user."""
    names = (
        os.uname()[1].partition(".")[0],
        os.path.basename(os.path.expanduser("~")),
    )
    return [name for name in names if len(name) > SHORT_NAME]


def commands_of(template: str) -> str:
    """Return the names of the commands and macros that a template runs."""
    # What stands behind one of them on its line is no command: a value leaves a mark.
    lines = NO_COMMAND.sub(
        lambda found: "." if found.group(1) else " ", template
    )
    return " ".join(COMMAND.findall(lines))


def value_of(option: str, value: Value, names: Names) -> str:
    """Return an option's value as its line has it."""
    if PRIVATE.search(option):
        return "(left out)"
    text = str(value)
    if GCODE.search(option):
        return "runs " + commands_of(text) if text.strip() else ""
    if isinstance(value, (list, tuple)):
        text = ", ".join(map(str, value))
    return " ".join(without_names(text, names).split())


def is_shown(section: str, asked: str) -> bool:
    """Tell whether a section is of use, where 'asked' is asked about."""
    if section == asked or section in SECTIONS:
        return True
    return section.startswith(BEGINNINGS)


def sections_of(
    settings: Mapping[str, Mapping[str, Value]], asked: str, names: Names
) -> Iterator[str]:
    """Yield the lines of the sections that are of use, the one asked about first.

    settings: as the status of configfile has them.
    """
    for section in sorted(settings, key=lambda name: (name != asked, name)):
        if not is_shown(section, asked):
            continue
        yield f"[{section}]"
        options = settings[section]
        for option in sorted(options):
            value = value_of(option, options[option], names)
            yield f"{option}: {value}".rstrip()
        yield ""


def harmless(value: Value, names: Names) -> Value:
    """Return a value with all of its texts without names."""
    if isinstance(value, dict):
        return {key: harmless(inner, names) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [harmless(inner, names) for inner in value]
    if isinstance(value, (bool, int, float)) or value is None:
        return value
    return without_names(value, names)


def as_json(value: Value, names: Names) -> str:
    """Return a value as one line, without names."""
    return json.dumps(harmless(value, names), sort_keys=True)


def last_error(runs: Sequence[Run]) -> str:
    """Return why the last run was refused that was."""
    errors = [run.reason for run in runs if not run.ok]
    return errors[-1] if errors else "none is kept"


def compose(facts: Dict[str, Value], runs: Sequence[Run]) -> str:
    """Return the text.

    facts: of klippy: 'section' that is asked about, its 'status', 'versions' by name,
    'settings' by section. runs: the oldest first.
    """
    names, asked = names_here(), str(facts["section"])
    lines = [f"What to attach when you ask about [{asked}]", ""]
    versions = {**facts["versions"], "Python": sys.version.split()[0]}
    for name, version in versions.items():
        lines.append(f"{name}: {without_names(version, names)}")
    lines += ["", f"Last error: {without_names(last_error(runs), names)}", ""]
    status = dict(facts["status"])
    # Its runs come below
    status.pop("history", None)
    notes = [without_names(note, names) for note in status.pop("notes", [])]
    lines += ["Notes of the start:", *(notes or ["none"])]
    lines += ["", "Status:", as_json(status, names), "", "Last runs:"]
    kept = [as_json(json.loads(line_of(run)), names) for run in runs[-RUNS:]]
    lines += [*(kept or ["none"]), ""]
    lines += sections_of(facts["settings"], asked, names)
    return "\n".join(lines)
