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


DAMAGES = {
    "missing": shutil.rmtree,
    "half copied": lambda folder: (folder / "core" / "errors.py").unlink(),
    "of another version": other_version,
}


@pytest.mark.spread
@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
@pytest.mark.parametrize(
    ("module", "scene"), [("z_calibration", "voron"), ("auto_z_offset", "qidi")]
)
def test_one_sentence_says_what_to_do(host, tmp_path, module, scene, damage):
    tree = tmp_path / "tree"
    link_tree(host.install(module_files()).cwd, tree)
    damage(tree / FOLDER_PARENT / FOLDER)
    with Machine(SCENES[scene], app=firmware_of(host)) as machine:
        config = machine.scene.config(machine.serials)
        with LiveSession(host.at(tree), machine, config) as session:
            state, message = session.start()
    assert state == "error"
    assert message.startswith(
        f"Section '{module}': the folder z_touch that belongs to this module"
        " is not in klippy/extras, or not of version "
    )
    assert "run install.sh again, or copy z_touch there, too" in message
