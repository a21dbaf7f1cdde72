"""The user's G-code.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any, Iterator, Optional

from .errors import CalibrationError
from .host import unknown_commands

if TYPE_CHECKING:
    from .host.klippy import Config, Template
    from .host.printer import Host


def load_template(
    config: Config, name: str, default: Optional[str] = None
) -> Template:
    """Return the template of an option; default None: it has to be given."""
    printer = config.get_printer()
    gcode_macro = printer.load_object(config, "gcode_macro")
    try:
        template: Template = (
            gcode_macro.load_template(config, name)
            if default is None
            else gcode_macro.load_template(config, name, default)
        )
    except printer.command_error as e:
        # The error of a command; at start it would come out as an internal one.
        raise config.error(
            f"Option '{name}' in section '{config.get_name()}' cannot be read: {e}"
        )
    script: str = config.get(name, default or "")
    unknown_commands.of(printer).add(config.get_name(), name, script)
    return template


def as_param(value: object) -> str:
    """Return a value as a parameter, for a template that has '"{params.NAME}"'.

    Nothing in the text may end that string, or begin a comment or a command.
    """
    text = " ".join(str(value).split())
    for character, instead in ((";", ","), ("#", ""), ('"', "'"), ("\\", "/")):
        text = text.replace(character, instead)
    return text


def run_with_params(template: Template, **params: object) -> None:
    """Run a template with params.NAME, as a macro gets its parameters.  May pause."""
    texts = {name: as_param(value) for name, value in params.items()}
    context = template.create_template_context()
    context["params"] = texts
    context["rawparams"] = " ".join(f"{k}={v}" for k, v in texts.items())
    template.run_gcode_from_command(context)


def run_template(
    host: Host, name: str, template: Any, **params: object
) -> None:
    """Run a template of the user; its error says which option it was.  May pause.

    Raises CalibrationError, or the host's error where the printer was shut down.
    """
    try:
        with checking_commands(host, name):
            if params:
                run_with_params(template, **params)
            else:
                template.run_gcode_from_command()
    except host.printer.command_error as e:
        if host.printer.is_shutdown():
            raise
        raise CalibrationError(f"{name}: {e}")


@contextlib.contextmanager
def checking_commands(host: Host, name: str) -> Iterator[None]:
    """Raise CalibrationError after G-code of an option that was not all run.

    A command that the host does not know is answered with a line, so what the user wants was
    not done.  One such as M300 is told only.
    """
    with unknown_commands.of(host.printer).listening() as heard:
        yield
    for command in heard:
        if unknown_commands.is_letter_and_number(command):
            host.say(
                f"{name}: {command} is no command of this printer; ignored"
            )
            continue
        raise CalibrationError(
            f"{name}: {command} is no command or macro of this printer; check how it"
            " is spelt, there and in the macros that it runs"
        )
