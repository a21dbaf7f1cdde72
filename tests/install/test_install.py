"""install.sh: links, git's exclude file, and what is refused."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.hostkit.printer import module_files
from tests.install.box import KALICO_SHIPS, REPO, new_box, snapshot

MODULES = sorted(module_files())
# The first one shipped, for what is the same with each
NAME = "z_calibration"
FILE = f"klippy/extras/{NAME}.py"
OVERRIDE = "[danger_options]\nallow_plugin_override: True\n"
NEXT = "Next: a section for the module in printer.cfg"


def links(klipper, folder="klippy/extras"):
    """The links in a folder, with what they point to."""
    paths = sorted((klipper / folder).iterdir())
    return {p.name: os.readlink(p) for p in paths if p.is_symlink()}


def all_linked(box):
    """What links() is when everything was installed."""
    return {f"{m}.py": str(box.checkout / f"{m}.py") for m in MODULES}


def exclude(klipper):
    """Git's exclude file."""
    return klipper / ".git" / "info" / "exclude"


# Good runs


def test_all_modules_are_shipped():
    text = (REPO / "install.sh").read_text()
    shipped = re.search(r'^readonly SHIPPED="(.*)"$', text, re.M).group(1)
    assert sorted(shipped.split()) == MODULES


def test_links_all_modules(machine):
    out = machine.installed()
    klipper = machine.home / "klipper"
    assert links(klipper) == all_linked(machine)
    for name in MODULES:
        assert f"Linking {name}.py into klippy/extras... [OK]\n" in out
        assert (klipper / f"klippy/extras/{name}.py").read_bytes() == (
            REPO / f"{name}.py"
        ).read_bytes()
    assert f"{NEXT}, see {machine.checkout}/README.md" in out
    assert machine.git(klipper, "status", "--porcelain") == ""


def test_second_run_changes_nothing(machine):
    machine.installed()
    before = snapshot(machine.home)
    machine.forget_calls()
    out = machine.installed()
    assert snapshot(machine.home) == before
    assert machine.restarted() == []
    for name in MODULES:
        line = f"Linking {name}.py into klippy/extras... [OK, already linked]"
        assert line in out
    assert "Nothing changed; nothing to restart" in out
    assert "Next:" not in out


@pytest.mark.parametrize("kind", ["klipper", "kalico"])
@pytest.mark.parametrize(
    "conf",
    [
        "[server]\n",
        "[server]",
        "",
        "[server]\r\nport: 7125\r\n",
        "[server]\n\n\n",
        "[update_manager other]\npath: ~/other\n",
    ],
)
def test_uninstall_restores_every_byte(box, kind, conf):
    if kind == "klipper":
        box.klipper()
    else:
        box.kalico()
    box.conf(text=conf)
    box.run("--help")  # the box is the user's from the first run on
    before = snapshot(box.home)
    box.installed("--kalico-override")
    assert snapshot(box.home) != before
    box.installed("--uninstall")
    assert snapshot(box.home) == before


@pytest.mark.parametrize("text", ["# mine\n*.bak\n", "*.bak", "", None])
def test_uninstall_restores_the_exclude_file(machine, text):
    file = exclude(machine.home / "klipper")
    file.unlink()
    if text is not None:
        file.write_text(text)
    machine.run("--help")
    before = snapshot(machine.home)
    machine.installed()
    klipper = machine.home / "klipper"
    assert machine.git(klipper, "status", "--porcelain") == ""
    assert f"/{FILE}" in file.read_text().splitlines()
    out = machine.installed("-u")
    assert snapshot(machine.home) == before
    assert (f"Removing {file}... [OK, it was" in out) is (text is None)
    assert (f"Removing the links from {file}" in out) is (text is not None)


def test_what_was_added_later_stays(machine):
    machine.installed()
    file = exclude(machine.home / "klipper")
    conf = machine.home / "printer_data/config/moonraker.conf"
    first = file.read_text()
    file.write_text(first + "*.later")
    conf.write_text(conf.read_text() + "# later\n\n[later]\na: 1")
    machine.installed("-u")
    assert file.read_text().endswith("*.later")
    assert NAME not in file.read_text()
    assert conf.read_text() == "[server]\n# later\n\n[later]\na: 1"


def test_own_exclude_line_of_the_user_stays(machine):
    file = exclude(machine.home / "klipper")
    file.write_text(f"/{FILE}\n")
    machine.installed("--modules", NAME)
    machine.installed("-u")
    assert file.read_text() == f"/{FILE}\n"


def test_chosen_modules_only(machine):
    klipper = machine.home / "klipper"
    machine.installed("--modules", "auto_z_offset")
    assert list(links(klipper)) == ["auto_z_offset.py"]
    machine.installed(f"--modules= {NAME}  auto_z_offset")
    assert sorted(links(klipper)) == ["auto_z_offset.py", f"{NAME}.py"]
    machine.installed("-u", "--modules", NAME)
    assert list(links(klipper)) == ["auto_z_offset.py"]
    assert f"/{FILE}" not in exclude(klipper).read_text()
    assert "/klippy/extras/auto_z_offset.py" in exclude(klipper).read_text()


def test_spaces_in_home():
    box = new_box("the home of [me]")
    box.klipper()
    conf = box.conf()
    out = box.installed()
    assert links(box.home / "klipper") == all_linked(box)
    assert "contains a space; Moonraker cannot update such a checkout" in out
    assert conf.read_text() == "[server]\n"
    box.installed("-u")
    assert links(box.home / "klipper") == {}
    shutil.rmtree(box.directory)


@pytest.mark.parametrize("words", [("-k", "K"), ("--klipper=K",)])
def test_klipper_elsewhere(box, words):
    box.klipper("klipper")
    box.klipper("other/klipper")
    path = str(box.home / "other/klipper")
    box.installed(*(word.replace("K", path) for word in words))
    assert links(box.home / "other/klipper") == all_linked(box)
    assert links(box.home / "klipper") == {}


def test_relative_path(box):
    box.klipper()
    done = box.command(
        ["bash", "-c", "cd home && ./klipper_z_calibration/install.sh -k k2"],
        {},
    )
    assert done.code == 3
    box.klipper("k2")
    done = box.command(
        ["bash", "-c", "cd home && ./klipper_z_calibration/install.sh -k k2"],
        {"CDPATH": str(box.home)},
    )
    assert done.code == 0, done
    assert links(box.home / "k2") == all_linked(box)


def test_called_through_a_link(machine):
    link = machine.home / "install"
    link.symlink_to(machine.checkout / "install.sh")
    outcome = machine.run(script=link)
    assert outcome.code == 0, outcome
    assert links(machine.home / "klipper") == all_linked(machine)


def test_kalico_as_second_choice(box):
    box.kalico("kalico")
    box.installed("--modules", "auto_z_offset")
    assert list(links(box.home / "kalico", "klippy/plugins")) == [
        "auto_z_offset.py"
    ]


def test_first_klipper_is_taken(box):
    box.klipper("klipper")
    box.kalico("kalico")
    box.installed()
    assert links(box.home / "klipper") == all_linked(box)
    assert links(box.home / "kalico", "klippy/plugins") == {}


def test_no_services_are_needed(box):
    box.klipper()
    out = box.installed()
    assert links(box.home / "klipper") == all_linked(box)
    assert "No moonraker.conf found: automatic updates not set up" in out
    assert "Services not restarted. Restart Klipper yourself" in out


# What is in the way of a link


@pytest.mark.parametrize(
    "target", ["../../../old/z_calibration.py", "/nowhere/z.py", "/tmp"]
)
def test_link_elsewhere_is_replaced_and_named(machine, target):
    file = machine.home / "klipper" / FILE
    file.symlink_to(target)
    out = machine.installed()
    assert links(machine.home / "klipper") == all_linked(machine)
    line = f"Linking {NAME}.py into klippy/extras... [OK, pointed to {target}"
    assert f"{line} before]" in out


def test_link_to_a_directory_is_not_followed(machine):
    old = machine.home / "old"
    old.mkdir()
    (machine.home / "klipper" / FILE).symlink_to(old)
    machine.installed()
    assert links(machine.home / "klipper") == all_linked(machine)
    assert list(old.iterdir()) == []


def test_link_of_other_words_to_the_same_file_is_fine(machine):
    (machine.home / "here").symlink_to(machine.checkout)
    file = machine.home / "klipper" / FILE
    file.symlink_to(machine.home / "here" / f"{NAME}.py")
    out = machine.installed("--modules", NAME)
    assert "[OK, already linked]" in out
    assert os.readlink(file) == str(machine.home / "here" / f"{NAME}.py")
    machine.installed("-u")
    assert not os.path.lexists(file)


def test_different_copy_is_kept(machine):
    file = machine.home / "klipper" / FILE
    file.write_text("mine = 1\n")
    out = machine.installed()
    kept = [p for p in file.parent.iterdir() if ".bak-" in p.name]
    assert len(kept) == 1
    assert re.fullmatch(NAME + r"\.py\.bak-\d{14}", kept[0].name)
    assert kept[0].read_text() == "mine = 1\n"
    assert f"[OK, old copy kept as {kept[0].name}]" in out
    assert links(machine.home / "klipper") == all_linked(machine)


def test_second_copy_in_the_same_second_is_kept_too(machine):
    machine.fake("date", "#!/usr/bin/env bash\necho 20261121000000\n")
    file = machine.home / "klipper" / FILE
    for text in ("one", "two", "three"):
        file.unlink(missing_ok=True)
        file.write_text(text)
        machine.installed()
    kept = sorted(p for p in file.parent.iterdir() if ".bak-" in p.name)
    assert [p.read_text() for p in kept] == ["one", "two", "three"]


def test_equal_copy_is_replaced(machine):
    file = machine.home / "klipper" / FILE
    file.write_bytes((REPO / f"{NAME}.py").read_bytes())
    out = machine.installed()
    assert "[OK, replaced an equal copy]" in out
    assert links(machine.home / "klipper") == all_linked(machine)
    assert [p for p in file.parent.iterdir() if ".bak-" in p.name] == []


def test_file_of_klipper_itself_is_never_replaced(machine):
    klipper = machine.home / "klipper"
    (klipper / FILE).write_text("vendor = 1\n")
    machine.commit(klipper)
    err = machine.refused(4)
    assert f"{FILE} is part of this Klipper; replacing it would block" in err
    assert "nothing was changed" in err
    machine.installed("--modules", "auto_z_offset")
    assert list(links(klipper)) == ["auto_z_offset.py"]


def test_package_of_klipper_itself_is_never_shadowed(machine):
    klipper = machine.home / "klipper"
    (klipper / f"klippy/extras/{NAME}").mkdir()
    (klipper / f"klippy/extras/{NAME}/__init__.py").write_text("")
    machine.commit(klipper)
    assert "is part of this Klipper" in machine.refused(4)


def test_replaced_file_of_klipper_is_told_how_to_restore(machine):
    klipper = machine.home / "klipper"
    (klipper / FILE).write_text("vendor = 1\n")
    machine.commit(klipper)
    (klipper / FILE).unlink()
    (klipper / FILE).symlink_to("/somewhere/z_calibration.py")
    err = machine.refused(4)
    command = f"git -C '{klipper}' checkout -- '{FILE}'"
    assert command in err
    machine.command(["bash", "-c", command])
    assert (klipper / FILE).read_text() == "vendor = 1\n"


@pytest.mark.parametrize("name", [f"{NAME}.py", NAME])
def test_directory_is_refused(machine, name):
    (machine.home / "klipper/klippy/extras" / name).mkdir()
    err = machine.refused(4)
    assert f"has a directory {NAME} or {NAME}.py; move it away first" in err


def test_all_obstacles_are_named_at_once(machine):
    for name in MODULES:
        (machine.home / f"klipper/klippy/extras/{name}.py").mkdir()
    err = machine.refused(4)
    for name in MODULES:
        assert f"a directory {name} or" in err


def test_klipper_without_git(box):
    klipper = box.klipper()
    shutil.rmtree(klipper / ".git")
    out = box.installed()
    assert links(klipper) == all_linked(box)
    assert "exclud" not in out.lower()
    box.installed("-u")
    assert links(klipper) == {}


def test_git_that_refuses_to_look(box):
    klipper = box.klipper()
    shutil.rmtree(klipper / ".git")
    (klipper / ".git").write_text("gitdir: /nowhere\n")
    out = box.installed()
    assert links(klipper) == all_linked(box)
    assert f"Note: git does not tell about {klipper} (fatal: " in out
    assert "not added to its exclude file" in out


def test_file_that_may_be_klippers_is_left_alone(box):
    klipper = box.klipper()
    shutil.rmtree(klipper / ".git")
    (klipper / ".git").write_text("gitdir: /nowhere\n")
    (klipper / FILE).write_text("whose = 1\n")
    err = box.refused(4)
    assert f"{FILE} may be part of this Klipper, and git does not tell: " in err


def test_worktree_has_the_exclude_file_of_its_repository(box):
    main = box.klipper("main")
    tree = box.home / "klipper"
    box.git(main, "worktree", "add", "-q", str(tree))
    box.installed()
    assert links(tree) == all_linked(box)
    assert f"/{FILE}" in exclude(main).read_text().splitlines()
    assert box.git(tree, "status", "--porcelain") == ""


def test_exclude_file_that_cannot_be_written(machine):
    file = exclude(machine.home / "klipper")
    file.chmod(0o444)
    out = machine.installed()
    assert links(machine.home / "klipper") == all_linked(machine)
    assert f"Note: could not write to {file}; git and Moonraker will" in out
    assert "Excluding" not in out
    file.chmod(0o644)
    machine.installed()
    file.chmod(0o444)
    text = file.read_text()
    out = machine.installed("-u")
    assert f"Note: could not write to {file}; the lines for the links" in out
    assert file.read_text() == text
    assert links(machine.home / "klipper") == {}
    conf = machine.home / "printer_data/config/moonraker.conf"
    assert conf.read_text() == "[server]\n"


def test_index_that_git_cannot_read(machine):
    klipper = machine.home / "klipper"
    (klipper / FILE).write_text("vendor = 1\n")
    machine.commit(klipper)
    (klipper / ".git/index").write_bytes(b"nonsense")
    err = machine.refused(4)
    assert f"{FILE} may be part of this Klipper, and git does not" in err


def test_klipper_in_a_bigger_repository(box):
    klipper = box.klipper("firmware/klipper")
    shutil.rmtree(klipper / ".git")
    (klipper / FILE).write_text("vendor = 1\n")
    box.commit(box.home / "firmware")
    words = ("-k", str(klipper))
    assert "is part of this Klipper" in box.refused(4, *words)
    box.installed(*words, "--modules", "auto_z_offset")
    assert box.git(box.home / "firmware", "status", "--porcelain") == ""
    box.installed(*words, "-u")
    text = exclude(box.home / "firmware").read_text()
    assert "auto_z_offset" not in text


def test_uninstall_tells_how_to_restore(machine):
    klipper = machine.home / "klipper"
    (klipper / FILE).write_text("vendor = 1\n")
    machine.commit(klipper)
    (klipper / FILE).unlink()
    (klipper / FILE).symlink_to(machine.checkout / f"{NAME}.py")
    out = machine.installed("-u")
    assert f"git -C '{klipper}' checkout -- '{FILE}'" in out


# Kalico


def test_kalico_needs_the_override(box):
    box.kalico()
    box.conf()
    err = box.refused(4)
    assert "Kalico ships its own z_calibration. Add to printer.cfg" in err
    assert OVERRIDE in err
    assert "--kalico-override" in err


@pytest.mark.parametrize(
    ("line", "allowed"),
    [
        ("allow_plugin_override: True", True),
        ("allow_plugin_override = yes  # for us", True),
        ("allow_plugin_override: true\r", True),
        ("allow_plugin_override: False", False),
        ("#allow_plugin_override: True", False),
        ("allow_plugin_override: Trueish", False),
        ("allow_plugin_override: True", None),
    ],
)
def test_override_is_read_from_the_configuration(box, line, allowed):
    kalico = box.kalico()
    config = box.conf().parent / "more"
    config.mkdir()
    # None: in a copy that SAVE_CONFIG has left
    name = "printer-20261121_174500" if allowed is None else "danger"
    (config / f"{name}.cfg").write_text(f"[danger_options]\n{line}\n")
    if not allowed:
        box.refused(4)
        return
    box.installed()
    assert links(kalico, "klippy/plugins") == all_linked(box)
    assert box.git(kalico, "status", "--porcelain") == ""


@pytest.mark.parametrize("place", ["printer_data/config", "klipper_config/a"])
def test_override_without_moonraker(box, place):
    box.kalico()
    (box.home / place).mkdir(parents=True)
    (box.home / place / "printer.cfg").write_text(OVERRIDE)
    box.installed()


def test_printer_without_the_override_is_named(box):
    box.kalico()
    for name, text in (("printer_1", OVERRIDE), ("printer_2", "[mcu]\n")):
        config = box.conf(f"{name}_data/config").parent
        (config / "printer.cfg").write_text(text)
    out = box.installed()
    assert "does not start unless allow_plugin_override" in out
    assert "printer_2_data/config/printer.cfg" in out
    assert "printer_1_data/config/printer.cfg" not in out


def test_override_by_option(box):
    kalico = box.kalico()
    box.installed("--kalico-override")
    assert links(kalico, "klippy/plugins") == all_linked(box)


def test_what_kalico_does_not_ship_goes_without(box):
    kalico = box.kalico()
    box.conf()
    rest = [m for m in MODULES if m not in KALICO_SHIPS]
    assert rest
    box.installed("--modules", " ".join(rest))
    assert list(links(kalico, "klippy/plugins")) == [f"{m}.py" for m in rest]


def test_link_of_the_time_before_kalico_is_taken_away(box):
    kalico = box.kalico()
    old = kalico / "klippy/extras/auto_z_offset.py"
    old.symlink_to(box.checkout / "auto_z_offset.py")
    out = box.installed("--modules", "auto_z_offset")
    assert "Removing the old link klippy/extras/auto_z_offset.py... [OK]" in out
    assert not os.path.lexists(old)
    assert list(links(kalico, "klippy/plugins")) == ["auto_z_offset.py"]


def test_foreign_file_in_extras_counts_as_shipped(box):
    kalico = box.kalico()
    (kalico / "klippy/extras/auto_z_offset.py").write_text("other = 1\n")
    err = box.refused(4, "--modules", "auto_z_offset")
    assert "Kalico ships its own auto_z_offset" in err


def test_kalicos_own_file_replaced_by_a_link(box):
    kalico = box.kalico()
    own = kalico / FILE
    own.unlink()
    own.symlink_to("/somewhere/z_calibration.py")
    out = box.installed("--kalico-override")
    command = f"git -C '{kalico}' checkout -- '{FILE}'"
    assert f"{FILE} of Kalico was replaced by a link" in out
    assert command in out
    # That is the user's to restore
    assert os.readlink(own) == "/somewhere/z_calibration.py"


# What the environment has to offer


@pytest.mark.parametrize("variable", ["", "/nowhere"])
def test_home_has_to_be_there(machine, variable):
    outcome = machine.run(HOME=variable)
    assert outcome.code == 3
    assert "HOME is not set to a directory" in outcome.err


def test_root_is_refused(machine):
    machine.fake("id", "#!/usr/bin/env bash\necho 0\n")
    err = machine.refused(3)
    assert "do not run as root or with sudo" in err
    machine.installed("--allow-root")
    assert links(machine.home / "klipper") == all_linked(machine)
    # Root needs no sudo
    assert not any(call.startswith("sudo") for call in machine.calls())
    assert machine.restarted() == ["klipper", "moonraker"]


def test_no_klipper(box):
    err = box.refused(3)
    assert "no Klipper in ~/klipper or ~/kalico; give its path with -k" in err


def test_what_k_names_has_to_be_klipper(machine):
    err = machine.refused(3, "-k", str(machine.checkout))
    assert f"no klippy/extras in {machine.checkout}" in err


def test_what_m_names_has_to_be_there(machine):
    err = machine.refused(3, "-m", "/nowhere/moonraker.conf")
    assert "there is no /nowhere/moonraker.conf" in err


def test_not_from_a_pipe(machine):
    text = (REPO / "install.sh").read_bytes()
    outcome = machine.command(["bash", "-s", "--", "--dry-run"], stdin=text)
    assert outcome.code == 3
    assert "run the script from a clone" in outcome.err


def test_not_without_the_modules(machine):
    (machine.checkout / f"{NAME}.py").unlink()
    err = machine.refused(3)
    assert f"{NAME}.py is not beside" in err


def test_extras_that_cannot_be_written(machine):
    folder = machine.home / "klipper/klippy/extras"
    folder.chmod(0o555)
    err = machine.refused(5)
    assert f"cannot write to {folder}" in err
    folder.chmod(0o755)
    machine.installed()
    folder.chmod(0o555)
    machine.forget_calls()
    outcome = machine.run("-u")
    assert outcome.code == 5
    assert f"cannot write to {folder}" in outcome.err
    assert machine.restarted() == []
    folder.chmod(0o755)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--what"], "unknown option --what"),
        (["-x"], "unknown option -x"),
        (["here"], "unknown option here"),
        (["-k"], "-k needs a value"),
        (["-k", ""], "-k needs a value"),
        (["--klipper="], "--klipper needs a value"),
        (["-m"], "-m needs a value"),
        (["-s"], "-s needs a value"),
        (["-n"], "-n needs a value"),
        (["-n", "two"], "-n: two is not a number above 0"),
        (["-n", "0"], "-n: 0 is not a number above 0"),
        (["-n", "1000"], "-n: 1000 is more than anybody has"),
        (["--modules", "z_calibration other"], "no module other; there are: "),
        (["--modules", "*"], "no module *; there are: "),
        (["--modules", " "], "--modules: which?"),
        (["--channel", "daily"], "--channel: daily is not dev, beta or stable"),
    ],
)
def test_usage(machine, options, message):
    assert message in machine.refused(2, *options)


@pytest.mark.parametrize("option", ["-h", "--help"])
def test_help(machine, option):
    before = snapshot(machine.home)
    out = machine.installed(option)
    assert out.startswith("usage: ./install.sh [options]\n")
    text = (REPO / "install.sh").read_text()
    parser = text.partition("parse() {")[2].partition("\n}\n")[0]
    cases = re.findall(r"^ {12}(-.*?)\)", parser, re.M)
    known = {word for case in cases for word in case.split(" | ")} - {"--*=*"}
    lines = re.findall(r"^  ..(?=-)?.*", out, re.M)
    shown = set(re.findall(r"(?<!\S)--?[a-z][a-z-]*", "\n".join(lines)))
    assert known == shown
    assert len(known) == 20
    assert snapshot(machine.home) == before


# Uninstalling


def test_uninstall_twice(machine):
    machine.installed()
    out = machine.installed("-u")
    for name in MODULES:
        assert f"Removing {name}.py from klippy/extras... [OK]" in out
    before = snapshot(machine.home)
    machine.forget_calls()
    out = machine.installed("-u")
    assert f"Removing {NAME}.py from klippy/extras... [SKIPPED, not there]" in (
        out
    )
    assert "Nothing changed; nothing to restart" in out
    assert snapshot(machine.home) == before
    assert machine.restarted() == []


def test_uninstall_leaves_what_is_not_ours(machine):
    file = machine.home / "klipper" / FILE
    file.symlink_to("/somewhere/z_calibration.py")
    other = file.with_name("auto_z_offset.py")
    other.write_text("mine = 1\n")
    out = machine.installed("-u")
    assert "[SKIPPED, points to /somewhere/z_calibration.py]" in out
    assert "Removing auto_z_offset.py from klippy/extras... [SKIPPED, not" in (
        out
    )
    assert os.readlink(file) == "/somewhere/z_calibration.py"
    assert other.read_text() == "mine = 1\n"


def test_uninstall_takes_a_dangling_link(machine):
    machine.installed()
    link = machine.home / "klipper" / FILE
    link.unlink()
    link.symlink_to(machine.checkout / "gone" / f"{NAME}.py")
    machine.installed("-u")
    assert links(machine.home / "klipper") == {}


def test_uninstall_looks_in_both_folders(box):
    kalico = box.kalico()
    for folder in ("extras", "plugins"):
        file = kalico / "klippy" / folder / "auto_z_offset.py"
        file.symlink_to(box.checkout / "auto_z_offset.py")
    out = box.installed("-u")
    assert "Removing auto_z_offset.py from klippy/extras... [OK]" in out
    assert "Removing auto_z_offset.py from klippy/plugins... [OK]" in out
    assert links(kalico) == links(kalico, "klippy/plugins") == {}


def test_uninstall_without_klipper(box):
    conf = box.conf()
    box.klipper()
    box.installed()
    (box.home / "klipper").rename(box.home / "elsewhere")
    out = box.installed("-u")
    assert "Note: no Klipper in ~/klipper or ~/kalico" in out
    assert "Removing z_calibration.py" not in out
    assert conf.read_text() == "[server]\n"


@pytest.mark.parametrize(
    "header", ["[z_calibration]", "[auto_z_offset]  # here"]
)
def test_uninstall_with_the_section_still_there(machine, header):
    machine.installed()
    config = machine.home / "printer_data/config/include/z.cfg"
    config.parent.mkdir()
    config.write_text(f"{header}\n")
    machine.systemd()
    machine.forget_calls()
    out = machine.installed("-u")
    name = header.partition("]")[0] + "]"
    assert f"{name} is still in {config}\n" in out
    assert "Klipper will not start with it. Remove it, then restart" in out
    # Moonraker's part is done
    assert machine.restarted() == ["moonraker"]


def test_section_is_no_obstacle_to_installing(machine):
    config = machine.home / "printer_data/config/printer.cfg"
    config.write_text("[z_calibration]\n")
    out = machine.installed()
    assert "Klipper will not start" not in out
    assert machine.restarted() == ["klipper", "moonraker"]


def test_copies_of_save_config_are_no_configuration(machine):
    machine.installed()
    folder = machine.home / "printer_data/config"
    (folder / "printer-20261121_174500.cfg").write_text("[z_calibration]\n")
    machine.forget_calls()
    out = machine.installed("-u")
    assert "is still in" not in out
    assert machine.restarted() == ["klipper", "moonraker"]


def test_section_of_another_name_is_no_obstacle(machine):
    machine.installed()
    config = machine.home / "printer_data/config/printer.cfg"
    config.write_text("[z_calibration_other]\n# [z_calibration]\n")
    machine.forget_calls()
    machine.installed("-u")
    assert "klipper" in machine.restarted()


def test_section_that_kalico_knows_is_no_obstacle(box):
    box.kalico()
    config = box.conf().parent
    (config / "printer.cfg").write_text(OVERRIDE + "[z_calibration]\n")
    box.systemd()
    box.installed()
    box.forget_calls()
    out = box.installed("-u")
    assert "Klipper will not start" not in out
    assert "klipper" in box.restarted()


# Dry run


@pytest.mark.parametrize("option", [[], ["-u"]])
def test_dry_run_changes_nothing(machine, option):
    file = machine.home / "klipper" / FILE
    if option:
        machine.installed()
    else:
        file.write_text("mine = 1\n")
    machine.forget_calls()
    machine.run("--help")
    before = snapshot(machine.home)
    out = machine.installed("--dry-run", *option)
    assert snapshot(machine.home) == before
    assert machine.restarted() == []
    assert "[OK" not in out
    assert "Restarting klipper... [DRY RUN]" in out
    if option:
        assert f"Removing {NAME}.py from klippy/extras... [DRY RUN]" in out
        assert "/info/exclude... [DRY RUN]" in out
    else:
        assert "into klippy/extras... [DRY RUN, old copy kept as" in out
        assert "type: git_repo\n" in out
        assert f"Excluding {FILE} from git status... [DRY RUN]" in out


def test_dry_run_refuses_the_same(machine):
    (machine.home / "klipper" / FILE).mkdir()
    machine.refused(4, "--dry-run")


# The script as such


def test_shellcheck():
    shellcheck = Path(sys.executable).with_name("shellcheck")
    services = sorted((REPO / "tests" / "hostkit" / "services").iterdir())
    subprocess.run([shellcheck, REPO / "install.sh", *services], check=True)


def test_script_can_be_run():
    assert os.access(REPO / "install.sh", os.X_OK)
    if (REPO / ".git").exists():
        git = ["git", "-c", "safe.directory=*", "-C", str(REPO)]
        listed = subprocess.run(
            [*git, "ls-files", "-s", "install.sh"],
            capture_output=True,
            text=True,
            check=True,
        )
        assert listed.stdout.startswith("100755 ")


def test_sourced_script_does_nothing(machine):
    script = machine.checkout / "install.sh"
    outcome = machine.command(
        ["bash", "-c", f". '{script}' && declare -F main"]
    )
    assert (outcome.code, outcome.out) == (0, "main\n")
    assert links(machine.home / "klipper") == {}


def test_unexpected_failure_is_told(machine):
    machine.fake("ln", "#!/usr/bin/env bash\nexit 1\n")
    outcome = machine.run()
    assert outcome.code == 1
    assert re.search(r"Error: unexpected failure in line \d+", outcome.err)
