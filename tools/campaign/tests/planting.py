"""Modules that do something wrong, for a campaign to find.

What is wrong is put around a command of the module, behind its source: it
names nothing of what the module is made of.
"""

from __future__ import annotations

from pathlib import Path
from textwrap import indent

from tools.campaign.jobs import JOBS
from tools.kit.printer import given_module, module_files

_AROUND = """

def _planted(config, load=load_config):
    printer = config.get_printer()
    gcode = printer.lookup_object("gcode")
    run = gcode.run_script_from_command
{before}
    module = load(config)
    command = gcode.register_command("{command}", None)

    def planted(gcmd):
        try:
            command(gcmd)
        except Exception as error:
{failed}
            raise
{done}

    gcode.register_command("{command}", planted)
    return module


load_config = _planted
"""


def planted(
    folder: Path,
    command: str,
    before: str = "",
    failed: str = "",
    done: str = "",
) -> dict[str, Path]:
    """The module of a command with lines of Python around it.

    before: the module is loaded; failed, done: when the command has ended.
    """
    name = JOBS[command].module
    lines = _AROUND.format(
        command=command,
        before=indent(before, " " * 4),
        failed=indent(failed, " " * 12),
        done=indent(done, " " * 8),
    )
    file = folder / f"{name}.py"
    file.write_text(module_files()[name].read_text() + lines)
    return given_module(name, file)
