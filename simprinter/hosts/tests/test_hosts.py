"""The hosts are what they are taken for, and checkouts stay as they are."""

from __future__ import annotations

import subprocess

import pytest

from simprinter.hosts import hosts as hostkit

HELPER_STAND_IN = """\
import os
path = os.path.join(os.path.dirname(os.path.realpath(__file__)), "c_helper.so")
if not os.path.exists(path):
    open(path, "w").close()
"""


@pytest.fixture
def build(tmp_path, monkeypatch):
    """An empty build directory, but for the Python environments."""
    shared = hostkit.build_dir() / "envs"
    directory = tmp_path / "build"
    directory.mkdir()
    monkeypatch.setenv("BUILD_DIR", str(directory))
    hostkit.build_dir()
    (directory / "envs").symlink_to(shared.resolve())
    monkeypatch.setenv("KLIPPER_PATH", "")
    monkeypatch.delenv("ALLOW_MISSING_HOSTS", raising=False)
    return directory


@pytest.fixture
def named(build, monkeypatch):
    """named(*checkouts): the hosts that they are."""

    def named(*checkouts):
        monkeypatch.setenv("KLIPPER_PATH", ":".join(map(str, checkouts)))
        return hostkit.checkout_hosts()

    return named


def make_checkout(path, tag="v1.2.3", mark="1", kalico=False):
    """A checkout in small, with files in it that git ignores."""
    files = {
        "klippy/klippy.py": f"print('started', {mark})\n",
        "klippy/chelper/__init__.py": HELPER_STAND_IN,
        "klippy/extras/__init__.py": "",
        "klippy/extras/probe.py": "ORIGIN = 'host'\n",
        ".gitignore": "*.so\n*.pyc\n__pycache__\n.version\n",
    }
    if kalico:
        files["klippy/plugins/__init__.py"] = ""
    write_files(path, files)
    if tag is not None:
        git(path, "init", "--quiet")
        git(path, "add", ".")
        git(path, "commit", "--quiet", "-m", "all")
        git(path, "tag", tag)
    write_files(path, {"klippy/chelper/c_helper.so": "old"})
    return path


def write_files(root, files):
    for name, text in files.items():
        file = root / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)


def git(path, *words):
    options = ["-c", "user.name=a", "-c", "user.email=a@b.invalid"]
    return subprocess.run(
        ["git", "-C", str(path), *options, *words],
        env=hostkit.clean_environment({"GIT_OPTIONAL_LOCKS": "0"}),
        check=True,
        capture_output=True,
        text=True,
    ).stdout


def snapshot(root):
    """Each file and folder below `root`, ignored or not, and git's view."""
    entries = {
        path: (stat.st_mode, stat.st_size, stat.st_mtime_ns)
        for path in root.rglob("*")
        for stat in [path.lstat()]
    }
    return entries, git(root, "status", "--porcelain", "--ignored")


def run(installed):
    """What klippy prints."""
    return subprocess.run(
        installed.argv,
        cwd=installed.cwd,
        env=installed.environment(),
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    ).stdout


def test_preparing_does_not_modify_a_checkout(named, tmp_path):
    checkout = make_checkout(tmp_path / "klipper")
    module = tmp_path / "mine.py"
    module.touch()
    (checkout / "klippy/extras/linked.py").symlink_to(module)
    (checkout / "klippy/extras/loop").symlink_to(checkout / "klippy")
    before = snapshot(checkout)
    (host,) = named(checkout)
    other = tmp_path / "other.py"
    other.write_text("A = 1\n")
    installed = host.install({"probe": other, "linked": other})
    assert run(installed) == "started 1\n"
    assert snapshot(checkout) == before
    assert module.read_text() == ""
    # Its helper was not built for this Python, and is not taken over
    helper = installed.cwd / "klippy/chelper/c_helper.so"
    assert helper.read_text() == ""


@pytest.mark.parametrize(
    ("kalico", "folder"),
    [(False, "klippy/extras"), (True, "klippy/plugins")],
)
def test_modules_go_where_the_host_expects_them(
    named, tmp_path, kalico, folder
):
    (host,) = named(make_checkout(tmp_path / "checkout", kalico=kalico))
    assert host.name == ("kalico@v1.2.3" if kalico else "klipper@v1.2.3")
    rooms = tmp_path / "rooms"
    (rooms / "room").mkdir(parents=True)
    module = rooms / "room" / "module.py"
    module.touch()
    installed = host.install({"door": module, "rooms": rooms})
    assert installed.module_dir == installed.cwd / folder
    assert (installed.module_dir / "door.py").exists()
    assert ("allow_plugin_override: True" in installed.config) is kalico
    assert (installed.cwd / "klippy/extras/rooms/room/module.py").exists()


def test_edited_checkout_is_prepared_anew(named, tmp_path):
    checkout = make_checkout(tmp_path / "klipper")
    (first,) = named(checkout)
    assert named(checkout) == [first]
    (checkout / "klippy/klippy.py").write_text("print('edited')\n")
    (second,) = named(checkout)
    assert second.name == first.name
    assert run(second.install({})) == "edited\n"
    assert run(first.install({})) == "started 1\n"


def test_edited_module_is_installed_anew(named, tmp_path):
    (host,) = named(make_checkout(tmp_path / "klipper"))
    module = tmp_path / "one.py"
    module.write_text("A = 1\n")
    first = host.install({"probe": module})
    assert host.install({"probe": module}) == first
    module.write_text("A = 2\n")
    second = host.install({"probe": module})
    # Files are shared between installations; replaced ones must not be.
    assert (first.module_dir / "probe.py").read_text() == "A = 1\n"
    assert (second.module_dir / "probe.py").read_text() == "A = 2\n"
    untouched = host.install({}).module_dir / "probe.py"
    assert untouched.read_text() == "ORIGIN = 'host'\n"


def test_klipper_of_python_2_is_refused(named, tmp_path):
    checkout = make_checkout(tmp_path / "klipper")
    write_files(checkout, {"klippy/reactor.py": "import Queue as queue\n"})
    with pytest.raises(hostkit.HostError, match="runs on Python 2.7 only"):
        named(checkout)
