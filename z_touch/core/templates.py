# The user's G-code.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import

import collections
import re

from .errors import CalibrationError
from .options import Kind, config_error

# What attaches a probe besides macros
ATTACHING = ("SET_SERVO", "SET_PIN", "ATTACH_PROBE")


def load_template(config, name, default=None):
    printer = config.get_printer()
    gcode_macro = printer.load_object(config, "gcode_macro")
    try:
        if default is None:
            return gcode_macro.load_template(config, name)
        return gcode_macro.load_template(config, name, default)
    except printer.command_error as e:
        # What newer hosts raise would come out as an internal error.
        raise config_error(config, name, "cannot be read: %s" % (e,))


# A template; where the default is None, a blank one is None, too.
def _read_gcode(config, name, row):
    if row.default is None and not config.get(name, "").strip():
        return None
    return load_template(config, name, row.default)


GCODE = Kind("G-code", _read_gcode, ("{", "{% if %}"))


# In a template as '"{params.NAME}"': nothing in the text may end that string
# or begin a comment or a command.
def as_param(value):
    text = " ".join(str(value).split())
    for found, instead in ((";", ","), ("#", ""), ('"', "'"), ("\\", "/")):
        text = text.replace(found, instead)
    return text


# As a macro gets its parameters: params.NAME
def run_with_params(template, **params):
    params = {name: as_param(value) for name, value in params.items()}
    context = template.create_template_context()
    context["params"] = params
    context["rawparams"] = " ".join("%s=%s" % item for item in params.items())
    template.run_gcode_from_command(context)


# Runs a template of the user; its error says which it was.  'params' as a macro
# gets them.
def run_template(host, name, template, **params):
    try:
        if params:
            run_with_params(template, **params)
        else:
            template.run_gcode_from_command()
    except host.printer.command_error as e:
        if host.printer.is_shutdown():
            raise
        raise CalibrationError("%s: %s" % (name, e))


# The texts of the user's macros by their names
def read_macros(config):
    return {
        section.get_name().upper().split()[-1]: section.get(
            "gcode", "", note_valid=False
        ).upper()
        for section in config.get_prefix_sections("gcode_macro ")
    }


# Not so: what start_gcode has done already
def attaches_probe(before_switch_gcode, start_gcode, macros):
    code = before_switch_gcode.upper()
    if code.split() == start_gcode.upper().split():
        return False
    code = re.sub(r"(?s)\{%.*?%\}", "\n", code)
    words = re.findall(r"(?m)^\s*([^\s;]+)", code)
    return any(word in ATTACHING or word in macros for word in words)


# Whether some G28 stands in the G-code, or in macros that it calls
def homes(gcode, macros):
    todo, seen = [gcode.upper()], set()
    while todo:
        words = set(re.findall(r"[A-Z0-9_]+", todo.pop())) - seen
        if "G28" in words:
            return True
        seen |= words
        todo += [macros[word] for word in words if word in macros]
    return False


# A probe that fetches and docks itself is told to, unless the user does
def probe_gcode(config):
    given = [config.get(p + "_gcode", "").strip() for p in ("start", "end")]
    if any(given) or not config.has_section("dockable_probe"):
        return {}
    if config.get("before_switch_gcode", "").strip():
        return {"end": "DETACH_PROBE"}
    return {"start": "ATTACH_PROBE", "end": "DETACH_PROBE"}


# The templates of z_calibration; those of OPTIONAL are None where they are not
# given.
Templates = collections.namedtuple(
    "Templates", "start clean before_switch end offset error start_homes"
)
OPTIONAL = ("clean", "offset", "error")


def load_templates(config):
    loaded, own = [], probe_gcode(config)
    for part in Templates._fields[:-1]:
        name = part + "_gcode"
        template = load_template(config, name, own.get(part, ""))
        if part in OPTIONAL and not config.get(name, "").strip():
            template = None
        loaded.append(template)
    start_gcode = config.get("start_gcode", "")
    return Templates(*loaded + [homes(start_gcode, read_macros(config))])
