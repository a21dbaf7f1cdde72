# The text that an owner attaches where he asks somebody: versions, his options, what
# was measured and told.  Nothing in it names a person, a computer, a folder, a serial
# number or an address; of G-code it has the names of the commands only.
# Its texts are no messages: they are written into a file.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import json
import os
import re
import sys

from .file import as_text, replace

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
# Options whose values are nobody's business, in whatever section they stand
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


# A text without paths, addresses and 'names' (of the computer and its user)
def without_names(text, names=()):
    text = as_text(text)
    for pattern, instead in HIDDEN:
        text = pattern.sub(instead, text)
    for name in names:
        text = re.sub(r"(?i)\b%s\b" % (re.escape(name),), "<name>", text)
    return text


# Of this computer and its user; a short one is a word that texts have anyway
def names_here():
    names = [os.uname()[1].partition(".")[0]]
    names.append(os.path.basename(os.path.expanduser("~")))
    return [name for name in names if len(name) > 3]


# The names of the commands and macros that a template runs
def commands_of(template):
    # What stands behind one of them on its line is no command: a value leaves a mark.
    lines = NO_COMMAND.sub(
        lambda found: "." if found.group(1) else " ", template
    )
    return " ".join(COMMAND.findall(lines))


# An option as a line has it
def value_of(option, value, names):
    if PRIVATE.search(option):
        return "(left out)"
    text = as_text(value)
    if GCODE.search(option):
        return "runs " + commands_of(text) if text.strip() else ""
    if isinstance(value, (list, tuple)):
        text = ", ".join(map(as_text, value))
    return " ".join(without_names(text, names).split())


def is_told(section, asked_section):
    return section in (asked_section,) + SECTIONS or section.startswith(
        BEGINNINGS
    )


# The sections that count, the own one first.  'settings': of configfile's status
def sections_of(settings, asked_section, names):
    for section in sorted(
        settings, key=lambda name: (name != asked_section, name)
    ):
        if not is_told(section, asked_section):
            continue
        yield "[%s]" % (section,)
        options = settings[section]
        for option in sorted(options):
            value = value_of(option, options[option], names)
            yield ("%s: %s" % (option, value)).rstrip()
        yield ""


# A value of a record, or of a status, with all of its texts made harmless
def harmless(value, names):
    if isinstance(value, dict):
        return dict(
            (key, harmless(inner, names)) for key, inner in value.items()
        )
    if isinstance(value, (list, tuple)):
        return [harmless(inner, names) for inner in value]
    if isinstance(value, (bool, int, float)) or value is None:
        return value
    return without_names(value, names)


def as_json(value, names):
    return json.dumps(harmless(value, names), sort_keys=True)


# The last runs, as the history has them, but for whose they are
def runs_of(runs, names):
    for run in runs[-RUNS:]:
        told = dict((k, v) for k, v in run.items() if k != "printer")
        yield as_json(told, names)


def last_error(runs):
    errors = [run.get("reason") for run in runs if not run.get("ok")]
    return errors[-1] if errors else "none is kept"


# All of it.  'versions': (name, text); 'status': of the section; 'runs': its records
def compose(asked_section, versions, settings, status, runs):
    names = names_here()
    lines = ["What to attach when you ask about [%s]" % (asked_section,), ""]
    python = sys.version.split()[0]
    for name, version in list(versions) + [("Python", python)]:
        lines.append("%s: %s" % (name, without_names(version, names)))
    lines += ["", "Last error: " + without_names(last_error(runs), names), ""]
    lines.append("Notes of the start:")
    notes = [without_names(note, names) for note in status.get("notes", [])]
    lines += notes or ["none"]
    shown = dict(
        (k, v) for k, v in status.items() if k not in ("history", "notes")
    )
    lines += ["", "Status:", as_json(shown, names), "", "Last runs:"]
    lines += list(runs_of(runs, names)) or ["none"]
    lines += [""] + list(sections_of(settings, asked_section, names))
    return "\n".join(lines)


# Beside the picture of that path; returns its own
def write(picture, text):
    path = os.path.splitext(picture)[0] + ".txt"
    replace(path, text.encode("utf-8"))
    return path
