"""The four doors: what an old Python makes of them, and that they are alike.

What they find behind them, whole or broken, real klippies show in
tests/modules/test_z_touch_folder.py.
"""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
from pathlib import Path

import pytest

DOORS = sorted(Path(__file__).resolve().parents[2].glob("*.py"))


def python2() -> str:
    """A Python 2.7, or a skipped test."""
    found = sorted(Path.home().glob(".pyenv/versions/2.7*/bin/python2.7"))
    # A version manager's own may only say that it is not installed
    for python in (*found, shutil.which("python2.7")):
        if python and not subprocess.run([python, "-c", ""]).returncode:
            return str(python)
    pytest.skip("no Python 2.7 on the PATH or in ~/.pyenv/versions")


@pytest.mark.parametrize("path", DOORS, ids=lambda path: path.stem)
def test_old_python_is_told_in_one_sentence(path, tmp_path):
    """As klippy imports it, of a package that has the name of Klipper's."""
    extras = tmp_path / "extras"
    extras.mkdir()
    (extras / "__init__.py").touch()
    shutil.copy(path, extras)
    script = f"from extras import {path.stem}; print({path.stem}.FAULT)"
    done = subprocess.run(
        [python2(), "-c", script],
        cwd=tmp_path,
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    assert done.stderr == ""
    assert done.stdout == (
        "this module needs Python 3.8 or newer, and this Klipper runs on 2.7;"
        " install Klipper anew, as KIAUH does, on a system that has it\n"
    )


@pytest.mark.parametrize("path", DOORS, ids=lambda path: path.stem)
def test_doors_stay_readable_for_an_old_python(path):
    """Also where there is none to try: what it does not know is in no door."""
    text = path.read_text(encoding="ascii")
    ast.parse(text, feature_version=(3, 4))
    assert not re.search(
        r"\bf[\"']|print\(|nonlocal|\bfrom __future__|\) ->", text
    )


def test_doors_differ_in_their_rooms_only():
    """Four times the same lines, as none of them may be needed by another."""
    shared = set()
    for path in DOORS:
        text = path.read_text(encoding="utf-8")
        machinery = text.partition("import logging\n")[2]
        machinery = machinery.partition("\ndef load_config")[0]
        room = r"(?m)^ +from \.[.a-z]*z_touch\.\w+ import \w+\n"
        assert len(re.findall(room, machinery)) >= 2
        shared.add(re.sub(room, "", machinery))
    assert len(shared) == 1
