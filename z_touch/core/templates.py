# The user's G-code.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from .errors import CalibrationError
from .options import Kind, config_error


def load_template(config, name, default=None):
    printer = config.get_printer()
    gcode_macro = printer.load_object(config, "gcode_macro")
    try:
        if default is None:
            return gcode_macro.load_template(config, name)
        return gcode_macro.load_template(config, name, default)
    except printer.command_error as e:
        # The error of a command; at start it would come out as an internal one.
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
    for character, instead in ((";", ","), ("#", ""), ('"', "'"), ("\\", "/")):
        text = text.replace(character, instead)
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
