"""pip install ./simplay in a new environment: it brings all that it needs."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

import simplay
from simplay.tests.terminals import Terminal
from simprinter.hosts.environment import clean_environment
from simprinter.hosts.moonraker import free_port
from simprinter.places import build_root

PACKAGE = Path(simplay.__file__).parent

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


def test_it_serves_its_page_and_homes(tmp_path):
    """With the simulated printer beside it, and nothing else of this repository."""
    venv = tmp_path / "venv"
    subprocess.run([sys.executable, "-m", "venv", venv], check=True)
    pip = [venv / "bin/pip", "install", "--quiet", PACKAGE]
    subprocess.run(pip, cwd="/", env=clean_environment({}), check=True)
    # The hosts that are prepared already
    env = clean_environment(
        {
            "SIMPRINTER_CACHE": str(build_root()),
            "KLIPPER_PATH": os.environ.get("KLIPPER_PATH", ""),
        }
    )
    ports = ("--port", str(free_port()), "--page", str(free_port()))
    words = [str(venv / "bin/simplay"), "--speed", "20", *ports]
    python = str(venv / "bin/python")
    with closing(Terminal(words, python, cwd=tmp_path, env=env)) as shown:
        shown.until_begun()
        for path in (PACKAGE / "page").iterdir():
            served = shown.get_page(f"/{path.name}")
            assert served.content == path.read_bytes()
        shown.until_ready()
        assert shown.run("G28").ok
        shown.until("true gap: Z=0 is")
        shown.assert_ends(signal.SIGINT)
