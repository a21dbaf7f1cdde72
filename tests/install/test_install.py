"""install.sh: links, git's exclude file, and what is refused."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.documents import part, rows, spans
from tests.install.box import (
    KALICO_SHIPS,
    MODULES,
    OVERRIDE,
    REPO,
    Box,
    options_in,
    snapshot,
)

pytestmark = pytest.mark.slow

NAME = "auto_z_offset"  # which no host ships
PLACE = f"klippy/extras/{NAME}.py"


# Good runs


def test_modules_and_their_folder_are_linked(machine, either):
    out = machine.installed()
    assert either.links() == either.expected(*MODULES)
    folder = either.modules
    for name in (
        f"{MODULES[0]}.py into {folder}",
        "z_touch into klippy/extras",
    ):
        assert f"Linking {name}... [OK]\n" in out
    assert either.place().read_text() == (REPO / "z_calibration.py").read_text()
    assert (either.place("z_touch") / "__init__.py").is_file()
    assert either.status() == ""
    names = ["z_calibration", NAME, "dockable_probe", "extra_probe"]
    ours = [name for name in names if f"Linking {name}.py" in out]
    assert len(ours) >= 3
    assert out.splitlines()[-1] == (
        f"Installed: {', '.join(ours)}. Next: the quick start of your printer,"
        " see ~/klipper_z_calibration/README.md"
    )


def test_second_run_changes_nothing(machine, either):
    machine.installed()
    machine.restarted()
    before = snapshot(machine.home)
    out = machine.installed()
    assert snapshot(machine.home) == before
    assert machine.restarted() == []
    assert out.count("... [OK, already linked]\n") == len(either.links())
    assert "Nothing changed; nothing to restart" in out
    assert out.splitlines()[-1].startswith("Installed: ")


@pytest.mark.parametrize("options", [[], ["--modules", NAME]])
def test_installation_without_the_folder_gets_it(machine, klipper, options):
    """As all had it before the modules shared one."""
    machine.installed()
    klipper.place("z_touch").unlink()
    machine.restarted()
    out = machine.installed(*options)
    assert klipper.links() == klipper.expected(*MODULES)
    assert "already linked" in out
    assert machine.restarted() == ["klipper"]


def test_every_module_of_the_checkout_is_linked(machine, either):
    later = ("dockable_probe", "extra_probe")
    for name in later:
        (machine.checkout / f"{name}.py").write_text("")
    (machine.checkout / "other.py").write_text("")
    machine.installed()
    assert either.links() == either.expected(*{*MODULES, *later})


def test_chosen_modules_only(machine, klipper):
    machine.installed("--modules", NAME)
    assert klipper.links() == klipper.expected(NAME)
    machine.installed("--modules", f" z_calibration  {NAME}")
    assert klipper.links() == klipper.expected("z_calibration", NAME)


@pytest.mark.parametrize(
    "command",
    [
        "home/klipper_z_calibration/install.sh -k home/k2",
        "cd home && klipper_z_calibration/install.sh --klipper k2",
        "ln -s home/klipper_z_calibration/install.sh z && ./z -k home/k2",
    ],
)
def test_klipper_elsewhere(machine, klipper, command):
    other = machine.klipper("k2")
    done = machine.command(["bash", "-c", command])
    assert done.code == 0, done
    assert other.links() == other.expected(*MODULES)
    assert klipper.links() == {}


def test_first_klipper_that_is_there_is_taken(box):
    kalico = box.kalico("kalico")
    box.installed("--modules", NAME)
    assert kalico.links() == kalico.expected(NAME)
    klipper = box.klipper()
    box.installed("--modules", NAME)
    assert klipper.links() == klipper.expected(NAME)


def test_spaces_in_home(new_box):
    box = new_box("the home of [me]")
    klipper, conf = box.klipper(), box.conf()
    out = box.installed()
    assert klipper.links() == klipper.expected(*MODULES)
    assert "Moonraker updates no path with a space, such as" in out
    assert conf.read_text() == "[server]\n"
    box.installed("-u")
    assert klipper.links() == {}


def test_advice_about_a_path_with_a_space_can_be_typed(new_box):
    box = new_box("the home of [me]")
    folder = box.klipper().path / "klippy/extras"
    folder.chmod(0o555)
    err = box.refused(5)
    folder.chmod(0o755)
    (advice,) = re.findall("sudo chown (.*)", err)
    assert shlex.split(advice)[1:] == [str(folder)]


def test_neither_moonraker_nor_services_are_needed(box):
    klipper = box.klipper()
    out = box.installed()
    assert klipper.links() == klipper.expected(*MODULES)
    assert "No moonraker.conf found: automatic updates not set up" in out
    command = "there is systemd: sudo systemctl restart klipper\n"
    assert "Restart Klipper yourself." in out and command in out


# What belongs to somebody else

FREEDI = "FreeDi/klipper_module/auto_z_offset.py"


def link_to(machine, target, klipper):
    """A link in the place of ours to somebody's file below HOME."""
    file = klipper.place(f"{NAME}.py")
    file.symlink_to(machine.write(target, "theirs = 1\n"))
    return file


def test_link_of_somebody_else_stays(machine, klipper):
    file = link_to(machine, FREEDI, klipper)
    err = machine.refused(4)
    assert (
        f"{machine.short(file)} belongs to somebody else: it is a link to"
        in err
    )
    assert f"~/{FREEDI}" in err
    assert "z_offset of [auto_z_offset] has the opposite sign" in err
    assert f"or rm -r '{file}' and run this again\n" in err
    assert "name the others with --modules" in err
    assert err.endswith("Error: nothing was changed\n")


def test_link_of_somebody_else_can_be_taken_over_as_told(machine, klipper):
    file = link_to(machine, FREEDI, klipper)
    command = re.search(r"rm -r '.*?'", machine.refused(4)).group(0)
    machine.command(["bash", "-c", command])
    assert not os.path.lexists(file)
    machine.installed()
    assert klipper.links() == klipper.expected(*MODULES)
    assert (machine.home / FREEDI).read_text() == "theirs = 1\n"


def test_force_replaces_the_link_of_somebody_else(machine, klipper):
    file = link_to(machine, FREEDI, klipper)
    target = os.readlink(file)
    out = machine.installed("--force")
    assert (
        f"{NAME}.py into klippy/extras... [OK, pointed to {machine.short(target)}"
        in out
    )
    assert "Note: With ours, z_offset of [auto_z_offset] has the" in out
    assert klipper.links() == klipper.expected(*MODULES)
    assert (machine.home / FREEDI).read_text() == "theirs = 1\n"


def test_link_to_a_directory_is_not_followed(machine, klipper):
    old = machine.home / "old"
    old.mkdir()
    for name in (f"{NAME}.py", "z_touch"):
        klipper.place(name).symlink_to(old)
    assert "z_touch belongs to somebody else" in machine.refused(4)
    machine.installed("-f")
    assert klipper.links() == klipper.expected(*MODULES)
    assert list(old.iterdir()) == []


def test_differences_are_those_of_the_document(machine, klipper):
    link_to(machine, FREEDI, klipper)
    told = machine.refused(4)
    text = (REPO / "docs" / "auto_z_offset.md").read_text()
    (title,) = re.findall(r"^## (How do I migrate.*)$", text, re.M)
    assert title.startswith("How do I migrate")
    ignored = [spans(row[0])[0] for row in rows(part(text, title))]
    named = re.search(r"here\); (.*) are ignored", told).group(1)
    assert set(re.findall(r"\w+_\w+", named)) <= set(ignored)


def test_dangling_link_is_replaced(machine, klipper):
    klipper.place().symlink_to("/nowhere/z_calibration.py")
    out = machine.installed()
    assert "[OK, pointed to /nowhere/z_calibration.py before]" in out
    assert klipper.links() == klipper.expected(*MODULES)


def test_other_link_into_the_checkout_is_replaced(machine, klipper):
    klipper.place().symlink_to(machine.checkout / "gone.py")
    klipper.place(f"{NAME}.py").symlink_to(machine.checkout / "install.sh")
    machine.installed()
    assert klipper.links() == klipper.expected(*MODULES)


def test_link_of_other_words_to_the_same_file_is_fine(machine, klipper):
    (machine.home / "here").symlink_to(machine.checkout)
    file = klipper.place()
    file.symlink_to(machine.home / "here" / file.name)
    before = os.readlink(file)
    assert "Linking z_calibration.py into klippy/extras... [OK, already" in (
        machine.installed()
    )
    assert os.readlink(file) == before
    machine.installed("-u")
    assert klipper.links() == {}


def test_copies_by_hand_are_kept(machine, klipper):
    file, folder = klipper.place(), klipper.place("z_touch")
    file.write_text("mine = 1\n")
    folder.mkdir()
    (folder / "mine.py").write_text("mine = 2\n")
    err = machine.refused(4)
    for place in (file, folder):
        assert (
            f"{machine.short(place)} is no link, so this script has not made it"
            in err
        )
    out = machine.installed("--force")
    assert klipper.links() == klipper.expected(*MODULES)
    names = re.findall(r"\[OK, old one kept as (.*)\]", out)
    assert all(re.search(r"\.bak-\d{14}-\d+$", name) for name in names)
    kept = [file.parent / name for name in names]
    assert kept[0].read_text() == "mine = 1\n"
    assert (kept[1] / "mine.py").read_text() == "mine = 2\n"


@pytest.mark.parametrize("options", [[], ["--force"]])
@pytest.mark.parametrize("path", [PLACE, f"klippy/extras/{NAME}/__init__.py"])
@pytest.mark.parametrize("is_linked", [False, True])
def test_part_of_klipper_is_never_replaced(
    machine, klipper, options, path, is_linked
):
    file = machine.write(f"klipper/{path}", "vendor = 1\n")
    machine.commit(klipper.path)
    if is_linked:
        file.unlink()
        file.symlink_to("/somewhere/auto_z_offset.py")
    # Whatever repository a caller works in
    err = machine.refused(4, *options, GIT_DIR=f"{machine.checkout}/.git")
    assert (
        f"{PLACE} is part of this Klipper, and replacing it would block" in err
    )
    machine.installed("--modules", "z_calibration")
    assert klipper.expected("z_calibration").items() <= klipper.links().items()


def test_all_obstacles_are_named_at_once(machine, klipper):
    for name in MODULES:
        klipper.place(f"{name}.py").mkdir()
    klipper.path.joinpath("klippy/extras").chmod(0o555)
    err = machine.refused(4)
    klipper.path.joinpath("klippy/extras").chmod(0o755)
    for name in MODULES:
        assert f"{name}.py is no link" in err
    folder = f"{klipper.path}/klippy/extras"
    assert (
        err.count(
            f"cannot write to {machine.short(folder)}; give it to your user"
        )
        == 1
    )


# What git knows


def test_klipper_without_git(box):
    klipper = box.klipper()
    shutil.rmtree(klipper.path / ".git")
    assert "git" not in box.installed("--no-moonraker")
    assert klipper.links() == klipper.expected(*MODULES)
    box.installed("-u")
    assert klipper.links() == {}


@pytest.mark.parametrize("broken", ["index", "HEAD"])
def test_git_that_refuses_to_look(machine, klipper, broken):
    (klipper.path / ".git" / broken).write_text("nonsense")
    err = machine.refused(3)
    assert (
        f"git does not tell what is part of {machine.short(klipper.path)}: "
        in err
    )
    assert "fatal: " in err or "error: " in err


def test_worktree_has_the_exclude_file_of_its_repository(box):
    main = box.klipper("main")
    box.git(main.path, "worktree", "add", "-q", str(box.home / "klipper"))
    box.installed()
    assert box.git(box.home / "klipper", "status", "--porcelain") == ""
    assert "/klippy/extras/z_touch\n" in main.exclude.read_text()


def test_klipper_in_a_bigger_repository(box):
    klipper = box.klipper("firmware/klipper")
    shutil.rmtree(klipper.path / ".git")
    box.commit(box.home / "firmware")
    before = (box.home / "firmware/.git/info/exclude").read_text()
    box.installed("-k", str(klipper.path))
    assert klipper.links() == klipper.expected(*MODULES)
    # That repository is its owner's business
    assert (box.home / "firmware/.git/info/exclude").read_text() == before
    box.installed("-k", str(klipper.path), "-u")
    assert klipper.links() == {}


@pytest.mark.parametrize("text", ["# mine\n*.bak\n", "*.bak", "", None])
def test_lines_of_others_in_the_exclude_file_stay(machine, klipper, text):
    klipper.exclude.unlink()
    if text is not None:
        klipper.exclude.write_text(text)
    machine.installed()
    (klipper.path / "a.bak").write_text("")
    assert klipper.status() == ("" if text else "?? a.bak\n")
    machine.installed("-u")
    lines = klipper.exclude.read_text().splitlines()
    assert lines == (text or "").splitlines()


def test_exclude_file_that_cannot_be_written(machine, klipper):
    klipper.exclude.chmod(0o444)
    out = machine.installed()
    assert klipper.links() == klipper.expected(*MODULES)
    assert (
        f"Note: cannot write to {machine.short(klipper.exclude)}; git will list"
        in out
    )
    assert "Excluding" not in out
    klipper.exclude.parent.chmod(0o555)
    machine.installed("-u")
    klipper.exclude.parent.chmod(0o755)
    assert klipper.links() == {}


# Kalico


def test_kalico_needs_the_override(box):
    box.kalico()
    config = box.conf().parent
    for name in KALICO_SHIPS:
        (box.checkout / f"{name}.py").write_text("")
    err = box.refused(4)
    assert "Kalico ships its own z_calibration, and will" in err
    assert f"\n{OVERRIDE}\n" in err
    others = re.search(r'--modules "(.*)"', err).group(1)
    box.installed("--modules", others)
    assert set(others.split()) == set(MODULES) - set(KALICO_SHIPS)
    (config / "printer.cfg").write_text(OVERRIDE)
    box.installed()


@pytest.mark.parametrize(
    ("name", "line", "is_allowed"),
    [
        ("printer.cfg", "allow_plugin_override: True", True),
        ("more/z.cfg", "allow_plugin_override = yes  # for us", True),
        ("printer.cfg", "allow_plugin_override: true\r", True),
        ("printer.cfg", "allow_plugin_override: False", False),
        ("printer.cfg", "#allow_plugin_override: True", False),
        ("printer.cfg", "allow_plugin_override: Trueish", False),
        ("printer.cfg", "[other]\nallow_plugin_override: True", False),
        # In none that the printer includes
        ("unused.cfg", "allow_plugin_override: True", False),
        ("printer-20261121_174500.cfg", "allow_plugin_override: True", False),
    ],
)
@pytest.mark.parametrize("folder", ["printer_data/config", "klipper_config"])
def test_override_is_read_from_what_the_printer_reads(
    box, folder, name, line, is_allowed
):
    kalico = box.kalico()
    cfg = box.write(f"{folder}/printer.cfg", "[include more/*.cfg]\n")
    box.write(f"{folder}/{name}", f"[danger_options]\n{line}\n")
    if is_allowed:
        box.installed()
        assert kalico.links() == kalico.expected(*MODULES)
    else:
        assert f"first add to {box.short(cfg)}:" in box.refused(4)


def test_each_printer_has_to_allow_it(box):
    kalico = box.kalico()
    box.conf("printer_1_data/config").with_name("printer.cfg").write_text(
        OVERRIDE
    )
    second = box.conf("printer_2_data/config").with_name("printer.cfg")
    second.write_text("[printer]\n")
    assert f"first add to {box.short(second)}:" in box.refused(4)
    second.write_text(OVERRIDE)
    box.installed()
    assert kalico.links() == kalico.expected(*MODULES)


def test_kalico_keeps_its_own_dockable_probe_unless_asked(box):
    kalico = box.kalico()
    box.conf().with_name("printer.cfg").write_text(OVERRIDE)
    out = box.installed()
    if "dockable_probe" in MODULES:
        assert "Kalico's own dockable_probe stays; --modules takes ours" in out
    assert "klippy/plugins/dockable_probe.py" not in str(kalico.links())
    (box.checkout / "dockable_probe.py").write_text("")
    box.installed("--modules", "dockable_probe")
    assert "dockable_probe.py" in str(kalico.links())
    box.installed("-u")
    assert kalico.links() == {}


def test_override_beside_a_named_moonraker_conf(box):
    box.kalico()
    conf = box.conf("elsewhere")
    box.write("elsewhere/printer.cfg", OVERRIDE)
    box.refused(4)
    box.installed("-m", str(conf))


def test_force_links_without_the_override(box):
    kalico = box.kalico()
    out = box.installed("--force")
    assert kalico.links() == kalico.expected(*MODULES)
    assert "does not start beside ours before [danger_options]" in out


def test_printer_of_another_klipper_needs_no_override(box):
    """It would not start with it."""
    box.kalico()
    conf = box.conf("kalico_data/config")
    conf.with_name("printer.cfg").write_text(OVERRIDE)
    box.conf("klipper_data/config").with_name("printer.cfg").write_text("")
    assert "with -m if one of these is of another Klipper" in box.refused(4)
    box.installed("-m", str(conf))


def test_module_of_somebody_else_in_extras_of_kalico(machine):
    kalico = machine.kalico()
    machine.write("printer_data/config/printer.cfg", OVERRIDE)
    other = kalico.path / PLACE
    other.symlink_to(machine.write(FREEDI, "theirs = 1\n"))
    err = machine.refused(4)
    assert f"{machine.short(other)} belongs to somebody else" in err
    # As it advises; beside ours Kalico would not start
    out = machine.installed("--force")
    assert not other.is_symlink() and "which led to" in out
    assert kalico.links() == kalico.expected(*MODULES)
    other.write_text("theirs = 1\n")
    machine.installed("--force")
    (kept,) = other.parent.glob(f"{other.name}.bak-*")
    assert (kept.read_text(), other.exists()) == ("theirs = 1\n", False)


@pytest.mark.parametrize("was", ["kalico", "klipper"])
def test_links_of_the_other_host_are_taken_away(machine, was):
    """As after a change of the branch of ~/klipper."""
    machine.write("printer_data/config/printer.cfg", OVERRIDE)
    either = machine.kalico()
    marker = either.path / "klippy/plugins/__init__.py"
    if was == "kalico":
        machine.installed("--modules", NAME)
        marker.unlink()
        either.modules = "klippy/extras"
    else:
        marker.rename(marker.with_suffix(".away"))
        machine.installed("--modules", NAME)
        marker.with_suffix(".away").rename(marker)
    out = machine.installed("--modules", NAME)
    assert f"Removing {NAME}.py from klippy/" in out
    assert either.links() == either.expected(NAME)


# What the environment has to offer


def test_root_is_refused(machine, klipper):
    machine.fake("id", "#!/usr/bin/env bash\necho 0\n")
    assert "this runs as root or with sudo" in machine.refused(3)
    machine.installed("--allow-root")
    # Root needs no sudo
    assert machine.calls("sudo") == []
    assert machine.restarted() == ["klipper", "moonraker"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "no Klipper in ~/klipper or ~/kalico; give its path with -k"),
        (["-u"], "no Klipper in ~/klipper or ~/kalico"),
        (["-k", "klipper_z_calibration"], "no klippy/extras in klipper_z"),
        (["-m", "/nowhere/m.conf"], "there is no /nowhere/m.conf; give a"),
    ],
)
def test_what_is_named_has_to_be_there(box, options, message):
    if "-m" in options:
        box.klipper()
    assert message in box.refused(3, *options)


def test_not_from_a_pipe(machine, klipper):
    text = (REPO / "install.sh").read_bytes()
    outcome = machine.command(["bash", "-s", "--", "--dry-run"], stdin=text)
    assert outcome.code == 3
    assert "the script is no file of a clone" in outcome.err


@pytest.mark.parametrize("missing", ["z_touch", "its files", "modules"])
def test_not_from_an_incomplete_clone(machine, klipper, missing):
    folder = machine.checkout / "z_touch"
    if missing == "modules":
        for name in MODULES:
            (machine.checkout / f"{name}.py").unlink()
    else:
        shutil.rmtree(folder)
    if missing == "its files":
        # What git leaves behind when they go
        (folder / "core" / "__pycache__").mkdir(parents=True)
    err = machine.refused(3)
    assert "~/klipper_z_calibration has no module or no z_touch; run" in err


def test_extras_that_cannot_be_written(machine, klipper):
    folder = klipper.path / "klippy/extras"
    folder.chmod(0o555)
    shown = machine.short(folder)
    assert f"cannot write to {shown}" in machine.refused(5)
    folder.chmod(0o755)
    machine.installed()
    folder.chmod(0o555)
    assert f"cannot write to {shown}" in machine.refused(5, "-u")
    # Nothing to write
    machine.installed()
    folder.chmod(0o755)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--what"], "unknown option --what"),
        (["-x"], "unknown option -x"),
        (["here"], "unknown option here"),
        (["-k"], "-k needs a value"),
        (["-k", ""], "-k needs a value"),
        (["-m"], "-m needs a value"),
        (["--modules", ""], "--modules needs a value"),
        (
            ["--modules", "z_calibration other"],
            "no module other; choose from: ",
        ),
        (["--modules", "*"], "no module *; choose from: "),
        # Ours, but not in this checkout
        (["--modules", "extra_probe"], "no module extra_probe; choose from"),
    ],
)
def test_usage(machine, klipper, options, message):
    (machine.checkout / "extra_probe.py").unlink(missing_ok=True)
    assert message in machine.refused(2, *options)


@pytest.mark.parametrize("option", ["-h", "--help"])
def test_help_has_every_option(machine, klipper, option):
    before = snapshot(machine.home)
    out = machine.installed(option)
    assert out.startswith("usage: ./install.sh [options]\n")
    text = (REPO / "install.sh").read_text()
    parser = text.partition("parse() {")[2].partition("\n}\n")[0]
    cases = re.findall(r"^ {12}(-.*?)\)", parser, re.M)
    known = {word for case in cases for word in case.split(" | ")}
    assert options_in(out) == known
    assert snapshot(machine.home) == before


# Uninstalling


def test_uninstall_takes_everything_back(machine, either):
    conf = machine.home / "printer_data/config/moonraker.conf"
    before = either.exclude.read_text().splitlines()
    machine.installed()
    assert either.exclude.read_text().splitlines() != before
    machine.restarted()
    out = machine.installed("-u")
    for name in (
        f"{NAME}.py from {either.modules}",
        "z_touch from klippy/extras",
    ):
        assert f"Removing {name}... [OK]\n" in out
    assert either.links() == {}
    after = either.exclude.read_text().splitlines()
    assert [line for line in after if line] == before
    assert conf.read_text() == "[server]\n"
    assert either.status() == ""
    # Klipper goes on as it is
    assert machine.restarted() == ["moonraker"]
    assert "Klipper is not restarted: it does not start while" in out
    before = snapshot(machine.home)
    assert "Nothing changed; nothing to restart" in machine.installed("-u")
    assert snapshot(machine.home) == before


def test_folder_goes_with_the_last_module(machine, either):
    machine.installed()
    machine.installed("-u", "--modules", "z_calibration")
    rest = [name for name in MODULES if name != "z_calibration"]
    assert either.links() == either.expected(*rest)
    assert either.status() == ""
    machine.installed("-u", "--modules", " ".join(rest))
    assert either.links() == {}


@pytest.mark.parametrize("missing", ["auto_z_offset.py", "z_touch"])
def test_link_to_what_the_checkout_has_no_more_goes(machine, klipper, missing):
    machine.installed()
    path = machine.checkout / missing
    path.rename(machine.directory / "gone")
    out = machine.installed("-u")
    assert f"Removing {missing} from klippy/extras... [OK]\n" in out
    assert klipper.links() == {}


def test_uninstall_leaves_what_is_not_ours(machine, klipper):
    klipper.place().symlink_to(machine.write("theirs.py", "theirs = 1\n"))
    klipper.place(f"{NAME}.py").write_text("mine = 1\n")
    klipper.place("z_touch").mkdir()
    before = snapshot(machine.home)
    assert "Nothing changed" in machine.installed("-u")
    assert snapshot(machine.home) == before


def test_uninstall_tells_how_to_restore_a_part_of_klipper(machine):
    klipper = machine.klipper(z_calibration="vendor = 1\n")
    file = klipper.place()
    file.unlink()
    file.symlink_to(machine.checkout / "z_calibration.py")
    out = machine.installed("-u")
    command = re.search(r"git -C .*", out).group(0)
    machine.command(["bash", "-c", command])
    assert file.read_text() == "vendor = 1\n"


# Dry run


@pytest.mark.parametrize("options", [[], ["-u"], ["--force"]])
def test_dry_run_changes_nothing(machine, klipper, options):
    if options == ["-u"]:
        machine.installed()
    elif options:
        klipper.place().write_text("mine = 1\n")
        machine.conf(text="[update_manager z_calibration]\npath: ~/old\n")
    machine.restarted()
    before = snapshot(machine.home)
    out = machine.installed("--dry-run", *options)
    after = snapshot(machine.home)
    assert {k: v[0] for k, v in after.items()} == {
        k: v[0] for k, v in before.items()
    }
    assert after == before
    assert machine.restarted() == []
    assert "[OK" not in out
    assert "Restarting moonraker... [DRY RUN]\n" in out
    if options == ["-u"]:
        assert "Removing z_touch from klippy/extras... [DRY RUN]\n" in out
        assert "Removing [update_manager z_calibration] from " in out
    else:
        assert "Linking z_touch into klippy/extras... [DRY RUN]\n" in out
        assert "type: git_repo\n" in out
        assert "Excluding the links from git status... [DRY RUN, in " in out


def test_dry_run_refuses_the_same(machine, klipper):
    klipper.place().mkdir()
    machine.refused(4, "--dry-run")


# A clone that was moved, and a module that is gone


@pytest.mark.parametrize("options", [[], ["--uninstall"]])
def test_links_of_a_clone_that_was_moved(machine, either, options):
    machine.installed()
    moved = machine.checkout.rename(machine.home / "moved")
    machine.checkout = moved
    out = machine.installed(*options)
    if options:
        assert either.links() == {}
        assert "Removing z_touch from klippy/extras... [OK, which led to" in out
        assert either.status() == ""
    else:
        assert either.links() == either.expected(*MODULES)


def test_link_of_somebody_else_that_leads_nowhere_stays(machine, klipper):
    machine.installed()
    theirs = klipper.place("theirs.py")
    theirs.symlink_to(machine.home / "gone.py")
    machine.installed()
    machine.installed("--uninstall")
    assert os.path.lexists(theirs)


def test_lines_of_git_go_with_their_links(machine, klipper):
    before = klipper.exclude.read_text()
    machine.installed()
    assert klipper.exclude.read_text() != before
    machine.installed("--uninstall", "--modules", NAME)
    text = klipper.exclude.read_text()
    assert f"{NAME}.py" not in text and "/klippy/extras/z_touch" in text
    machine.installed("--uninstall")
    assert klipper.exclude.read_text().strip() == before.strip()


# Two checkouts


def test_modules_of_two_checkouts_are_not_mixed(machine, klipper):
    machine.installed()
    other = machine.clone(machine.home / "other")
    script = other / "install.sh"
    before = klipper.links()
    outcome = machine.run("--modules", NAME, "--force", script=script)
    assert outcome.code == 4
    assert "its version and this one cannot be mixed" in outcome.err
    assert klipper.links() == before
    assert "all of them to this checkout: --force, without" in outcome.err


@pytest.fixture
def second(machine):
    """The script of a second checkout, on a machine that has the first."""
    machine.installed()
    return machine.clone(machine.home / "second") / "install.sh"


def leads_to(klipper):
    """The folders that the links of a Klipper lead to."""
    return {os.path.dirname(target) for target in klipper.links().values()}


def test_another_checkout_is_none_of_somebody_else(machine, klipper, second):
    before = klipper.links()
    err = machine.run(script=second).err
    for name in [*[f"{name}.py" for name in MODULES], "z_touch"]:
        line = (
            f"Error: {machine.short(klipper.place(name))} is a link to another checkout of"
            " this project, ~/klipper_z_calibration; "
        )
        assert err.count(line) == 1
    for words in ("somebody else", "opposite sign", "migration.md", "rm -r"):
        assert words not in err
    assert klipper.links() == before
    outcome = machine.run("--force", script=second)
    assert (outcome.code, outcome.err) == (0, "")
    assert f"[OK, pointed to ~/klipper_z_calibration/{NAME}.py" in outcome.out
    assert "opposite sign" not in outcome.out
    assert "migration.md" not in outcome.out
    assert leads_to(klipper) == {str(second.parent)}


@pytest.mark.parametrize("make", [Box.klipper, Box.kalico])
@pytest.mark.parametrize("options", [[], ["--modules", "z_calibration"]])
def test_proposal_for_another_checkout_works(machine, make, options):
    either = make(machine)
    machine.write("printer_data/config/printer.cfg", OVERRIDE)
    machine.installed("--modules", " ".join(MODULES))
    count = len(either.links())
    second = machine.clone(machine.home / "second") / "install.sh"
    err = machine.run(*options, script=second).err
    assert "--modules" not in err.replace("without --modules", "")
    assert err.count("To change all of them to this checkout: --force") == 1
    assert ("--force, without --modules\n" in err) is bool(options)
    outcome = machine.run("--force", script=second)
    assert (outcome.code, outcome.err) == (0, "")
    assert leads_to(either) == {str(second.parent)}
    assert len(either.links()) == count == len(MODULES) + 1
    assert "stays; --modules takes ours" not in outcome.out


def test_links_of_another_checkout_for_the_other_host_go(machine):
    """As after a change of the branch of ~/klipper."""
    machine.write("printer_data/config/printer.cfg", OVERRIDE)
    kalico = machine.kalico()
    marker = kalico.path / "klippy/plugins/__init__.py"
    marker.rename(marker.with_suffix(".away"))
    machine.installed("--modules", NAME)
    marker.with_suffix(".away").rename(marker)
    second = machine.clone(machine.home / "second") / "install.sh"
    assert machine.run(script=second).code == 4
    outcome = machine.run("--force", script=second)
    assert f"Removing {NAME}.py from klippy/extras... [OK, which" in outcome.out
    assert leads_to(kalico) == {str(second.parent)}


def test_file_beside_the_linked_folder_is_no_checkout(machine, klipper):
    """As of somebody who has renamed what was there."""
    machine.installed("--modules", "z_calibration")
    kept = klipper.place("kept.py")
    kept.write_text("theirs = 1\n")
    klipper.place(f"{NAME}.py").symlink_to(kept)
    err = machine.refused(4)
    assert "belongs to somebody else" in err
    assert "opposite sign" in err


def test_what_was_put_aside_is_named_at_the_end(machine, klipper):
    klipper.place().write_text("theirs = 1\n")
    machine.installed("--force")
    (kept,) = klipper.place().parent.glob("z_calibration.py.bak-*")
    assert (
        f"{machine.short(kept)} was kept when ours came"
        in machine.installed("-u")
    )


def test_which_klipper_was_taken(box):
    box.klipper(), box.kalico("kalico")
    out = box.installed()
    klipper, kalico = box.home / "klipper", box.home / "kalico"
    told = f"using ~/klipper; for the other one: -k '{kalico}'\n"
    assert f"Note: {told}" in out
    assert "the other one" not in box.installed("-k", str(klipper))


# The script as such


@pytest.mark.parametrize("shell", ["sh", "bash --posix", "dash"])
def test_any_shell_may_be_named(machine, klipper, shell):
    real = shutil.which(shell.split()[0])
    if real is None:
        pytest.skip(f"no {shell} here")
    words = [real, *shell.split()[1:], str(machine.checkout / "install.sh")]
    outcome = machine.command(words)
    assert (outcome.code, outcome.err) == (0, "")
    assert klipper.links() == klipper.expected(*MODULES)


def test_output_that_is_cut_off_stops_nothing(machine, klipper):
    script = machine.checkout / "install.sh"
    outcome = machine.command(
        ["bash", "-c", f"set -o pipefail; '{script}' | true"]
    )
    assert outcome.code == 0, outcome
    assert klipper.links() == klipper.expected(*MODULES)
    assert machine.restarted() == ["klipper", "moonraker"]


def test_shellcheck():
    shellcheck = Path(sys.executable).with_name("shellcheck")
    services = sorted((REPO / "tools" / "kit" / "services").iterdir())
    subprocess.run(
        [shellcheck, "-x", REPO / "install.sh", *services],
        cwd=REPO,
        check=True,
    )


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


def test_unexpected_failure_is_told(machine, klipper):
    machine.failing("ln")
    outcome = machine.run()
    assert outcome.code == 1
    assert re.findall(
        r"Error: unexpected failure in (\S+), line \d+", outcome.err
    )
    assert "Linking" not in outcome.out
