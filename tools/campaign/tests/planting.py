"""Modules that do something wrong, for a campaign to find.

What is wrong is put around a command, as any module of Klipper may do: it names
nothing of what our modules are made of.
"""

from __future__ import annotations

from pathlib import Path
from textwrap import indent

from tools.kit.printer import given_module, module_files

# Behind the source of a module that Klipper loads, for one section or several
_AROUND = """

import functools


def _planted(load, config):
    printer = config.get_printer()
    reactor = printer.get_reactor()
    gcode = printer.lookup_object("gcode")
    run = gcode.run_script_from_command
{before}
    module = load(config)
    command = gcode.register_command("{command}", None)

    def planted(gcmd):
{first}
        try:
            command(gcmd)
        except Exception:
{failed}
            raise
{done}

    gcode.register_command("{command}", planted)
    return module


for _name in ("load_config", "load_config_prefix"):
    if _name in globals():
        globals()[_name] = functools.partial(_planted, globals()[_name])
"""


def planted(
    folder: Path,
    module: str,
    command: str,
    before: str = "",
    first: str = "",
    failed: str = "",
    done: str = "",
) -> dict[str, Path]:
    """The module of a command with lines of Python around it.

    before: the module is loaded; first: the command begins; failed, done: when
    it has ended.
    """
    lines = _AROUND.format(
        command=command,
        before=indent(before, " " * 4),
        first=indent(first, " " * 8),
        failed=indent(failed, " " * 12),
        done=indent(done, " " * 8),
    )
    file = folder / f"{module}.py"
    file.write_text(module_files()[module].read_text() + lines)
    return given_module(module, file)
