"""What is missing is said in one sentence, before anything is downloaded."""

import os
import re
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from simprinter.hosts.environment import REPO_ROOT


def make_environment(folder, **environment):
    """What ends `make demo` where the environment cannot be had."""
    kept = {"PATH": os.environ["PATH"], "HOME": str(folder.parent)}
    return subprocess.run(
        [Path(sys.base_prefix) / "bin" / "python3", "-m"]
        + ["simprinter.hosts.environment", folder / "venv", "demo"],
        cwd=REPO_ROOT,
        env={**kept, "BUILD_DIR": str(folder), **environment},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture
def folder(tmp_path):
    """An empty one; nothing but the marks of the build may be in it after."""
    folder = tmp_path / "build"
    folder.mkdir()
    yield folder
    names = {path.name for path in folder.iterdir()}
    assert names == {"CACHEDIR.TAG", ".made-for-this-build", "venv.lock"}


@pytest.fixture
def index():
    """An address where nobody answers, and what answers by hanging up."""
    server = socket.create_server(("127.0.0.1", 0))
    yield (
        server,
        {
            "PIP_CONFIG_FILE": os.devnull,
            "PIP_FIND_LINKS": "",
            "PIP_INDEX_URL": f"http://127.0.0.1:{server.getsockname()[1]}/simple",
        },
    )
    server.close()


def test_no_compiler(folder):
    done = make_environment(folder, PATH=str(folder))
    assert done.returncode == 1
    assert done.stderr == (
        "error: the C helper of klippy needs gcc: install gcc and the headers of"
        " the C library (Debian: apt install gcc libc6-dev)\n"
    )


def test_no_network(folder, index):
    server, environment = index
    server.close()
    done = make_environment(folder, **environment)
    assert done.returncode == 1
    lines = done.stderr.splitlines()
    # On a machine with much to do, pip needs more than its second
    # Of the demo's packages the one that is asked for first
    assert re.match(
        r"error: the package index does not give [\w-]+, so", lines[-1]
    )
    assert lines[:-1] in ([], ["Waiting for the package index ..."])


@pytest.mark.slow
def test_what_takes_long_is_said(folder, index):
    server, environment = index

    def hang_up():
        while True:
            try:
                connection, _ = server.accept()
            except OSError:
                return
            time.sleep(2.0)
            connection.close()

    threading.Thread(target=hang_up, daemon=True).start()
    done = make_environment(folder, **environment)
    assert done.stderr.startswith("Waiting for the package index ...\nerror: ")
