"""Only a folder that the build has made is removed by `make clean`."""

import subprocess

import pytest

from simprinter.hosts import environment
from simprinter.hosts.environment import HostError

STAMP = environment.STAMP


def take(folder, monkeypatch):
    monkeypatch.setenv("BUILD_DIR", str(folder))
    return environment.build_dir()


def make_clean(folder):
    return subprocess.run(
        ["make", "--no-print-directory", "clean", f"BUILD_DIR={folder}"],
        cwd=environment.REPO_ROOT,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "folder"


@pytest.mark.parametrize("is_there", [False, True])
def test_new_or_empty_folder_comes_and_goes(folder, monkeypatch, is_there):
    if is_there:
        folder.mkdir()
    assert take(folder, monkeypatch) == folder
    (folder / "venv").mkdir()
    assert take(folder, monkeypatch) == folder
    assert make_clean(folder).returncode == 0
    assert not folder.exists()


def test_caches_of_tools_are_no_obstacle(folder, monkeypatch):
    (folder / "ruff_cache").mkdir(parents=True)
    take(folder, monkeypatch)
    assert (folder / STAMP).exists()


# The tag says that a folder may be left out of a backup, not whose it is
@pytest.mark.parametrize("name", ["photo.jpg", "CACHEDIR.TAG"])
def test_folder_of_somebody_else_stays(folder, monkeypatch, name):
    folder.mkdir()
    (folder / name).write_text("mine")
    (folder / "letter.txt").write_text("mine")
    with pytest.raises(HostError, match="Name a new or empty one"):
        take(folder, monkeypatch)
    done = make_clean(folder)
    assert done.returncode != 0
    assert "remove what you want to be gone by hand" in done.stderr
    assert (folder / "letter.txt").read_text() == "mine"
    assert not (folder / STAMP).exists()
