"""Nothing that is downloaded runs before its hash was looked at."""

import hashlib
import io
import sys
import tarfile

import pytest

from simprinter.hosts import environment, trees
from simprinter.hosts.environment import UnavailableError

PYPROJECT = """\
[build-system]
requires = ["not-to-be-had"]
build-backend = "backend"
backend-path = ["."]
[project]
name = "some-host"
version = "1.0"
"""
# What pip asks a source for, so it is code of the package that runs
BACKEND = """\
import os
open({trace!r}, "w").close()

def prepare_metadata_for_build_wheel(folder, settings=None):
    os.mkdir(os.path.join(folder, "some_host-1.0.dist-info"))
    with open(os.path.join(folder, "some_host-1.0.dist-info", "METADATA"), "w") as f:
        f.write("Metadata-Version: 2.1\\nName: some-host\\nVersion: 1.0\\n")
    return "some_host-1.0.dist-info"
"""


@pytest.fixture
def fetched(tmp_path, monkeypatch):
    """fetched(pinned): fetch a source whose hash is or is not the pinned one."""
    trace = tmp_path / "has_run"
    archive = tmp_path / "wheels" / "some_host-1.0.tar.gz"
    archive.parent.mkdir()
    files = {
        "pyproject.toml": PYPROJECT,
        "backend.py": BACKEND.format(trace=str(trace)),
        "klippy/klippy.py": "",
    }
    with tarfile.open(archive, "w:gz") as sources:
        for name, text in files.items():
            member = tarfile.TarInfo(f"some_host-1.0/{name}")
            member.size = len(text)
            sources.addfile(member, io.BytesIO(text.encode()))
    right = hashlib.sha256(archive.read_bytes()).hexdigest()
    monkeypatch.setattr(environment, "REQUIREMENTS", tmp_path)
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(archive.parent))

    def fetch(pinned=right):
        (tmp_path / "host-some.txt").write_text(
            f"some-host==1.0 --hash=sha256:{pinned}\n"
        )
        downloads = tmp_path / "downloads"
        downloads.mkdir()
        tree = tmp_path / "tree"
        trees.fetch_package(sys.executable, "some", tree, downloads)
        return tree

    fetch.has_run = trace.exists
    return fetch


@pytest.mark.slow
def test_source_of_another_hash_is_refused_unread(fetched):
    with pytest.raises(UnavailableError, match="DO NOT MATCH THE HASHES"):
        fetched("0" * 64)
    assert not fetched.has_run()


# `not-to-be-had` would have to come from the index, whatever its hash is
@pytest.mark.slow
def test_source_is_taken_without_further_downloads(fetched):
    assert (fetched() / "klippy" / "klippy.py").exists()
    assert fetched.has_run()
