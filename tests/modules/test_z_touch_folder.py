"""A module beside which the folder z_touch is missing, or is another one."""

from __future__ import annotations

import shutil

import pytest

from simprinter import SCENES, Machine
from simprinter.hosts.session import LiveSession
from simprinter.hosts.trees import FOLDER_PARENT, link_tree
from tools.kit.printer import FOLDER, firmware_of, module_files


def other_version(folder):
    file = folder / "__init__.py"
    # Shared with other trees
    file.unlink()
    file.write_text('__version__ = "0.0.1"\n')


# What is broken, and what is told of it
DAMAGES = {
    "missing": (shutil.rmtree, "is not in klippy/extras; run install.sh again"),
    "half copied": (
        lambda folder: (folder / "core" / "errors.py").unlink(),
        "cannot be loaded (cannot import name 'errors'",
    ),
    "of another version": (
        other_version,
        "this module is of version 1.0.0, the folder z_touch in klippy/extras"
        " of version 0.0.1; run install.sh again",
    ),
}


@pytest.mark.parametrize(("damage", "told"), DAMAGES.values(), ids=DAMAGES)
@pytest.mark.parametrize(
    ("module", "scene"), [("z_calibration", "voron"), ("auto_z_offset", "qidi")]
)
def test_one_sentence_says_what_to_do(
    host, tmp_path, module, scene, damage, told
):
    tree = tmp_path / "tree"
    link_tree(host.install(module_files()).cwd, tree)
    damage(tree / FOLDER_PARENT / FOLDER)
    with Machine(SCENES[scene], app=firmware_of(host)) as machine:
        config = machine.scene.config(machine.serials)
        with LiveSession(host.at(tree), machine, config) as session:
            state, message = session.start()
    assert state == "error"
    assert message.startswith(f"Section '{module}': ")
    assert told in message
    assert "restart the Klipper service" in message
