"""install.sh: links, git's exclude file, and what is refused."""

from __future__ import annotations

import os
import re
import shlex
import shutil

import pytest

from tests.install.box import (
    KALICO_SHIPS,
    MODULES,
    OVERRIDE,
    REPO,
    snapshot,
)

pytestmark = pytest.mark.slow

NAME = "auto_z_offset"  # which no host ships
PLACE = f"klippy/extras/{NAME}.py"
FREEDI = "FreeDi/klipper_module/auto_z_offset.py"


# Good runs


def test_modules_and_their_folder_are_linked_once(machine, either):
    out = machine.installed()
    links = either.expected(*MODULES)
    assert either.links() == links
    for place in links:
        folder, name = place.split("/")
        assert f"Linking {name} into klippy/{folder}... [OK]\n" in out
    assert (either.place("z_touch") / "__init__.py").is_file()
    assert either.status() == ""
    last = out.splitlines()[-1]
    assert last.startswith("Installed: z_calibration, auto_z_offset, ")
    assert last.endswith(
        ". Next: the quick start of your printer, see"
        " ~/klipper_z_calibration/README.md"
    )
    machine.restarted()
    before = snapshot(machine.home)
    out = machine.installed()
    assert snapshot(machine.home) == before
    assert machine.restarted() == []
    assert out.count("... [OK, already linked]\n") == len(links)
    assert "Nothing changed; nothing to restart" in out


def test_which_klipper_is_taken(box):
    klipper, kalico = box.klipper(), box.kalico("kalico")
    out = box.installed()
    assert klipper.links() == klipper.expected(*MODULES)
    assert kalico.links() == {}
    told = f"using ~/klipper; for the other one: -k '{kalico.path}'\n"
    assert f"Note: {told}" in out
    other = box.klipper("k2")
    script = "home/klipper_z_calibration/install.sh"
    command = f"ln -s {script} z && ./z -k home/k2"
    assert box.command(["bash", "-c", command]).code == 0
    assert other.links() == other.expected(*MODULES)
    assert kalico.links() == {}


def test_spaces_in_home(new_box):
    box = new_box("the home of [me]")
    klipper, conf = box.klipper(), box.conf()
    folder = klipper.path / "klippy/extras"
    folder.chmod(0o555)
    (advice,) = re.findall("sudo chown (.*)", box.refused(5))
    assert shlex.split(advice)[1:] == [str(folder)]
    folder.chmod(0o755)
    out = box.installed()
    assert klipper.links() == klipper.expected(*MODULES)
    assert "Moonraker updates no path with a space, such as" in out
    assert conf.read_text() == "[server]\n"
    box.installed("-u")
    assert klipper.links() == {}


def test_neither_moonraker_nor_services_are_needed(box):
    klipper = box.klipper()
    out = box.installed()
    assert klipper.links() == klipper.expected(*MODULES)
    assert "No moonraker.conf found: automatic updates not set up" in out
    command = "there is systemd: sudo systemctl restart klipper\n"
    assert "Restart Klipper yourself." in out and command in out


# What belongs to somebody else


def test_link_of_somebody_else_stays(machine, klipper):
    file = klipper.place(f"{NAME}.py")
    file.symlink_to(machine.write(FREEDI, "theirs = 1\n"))
    target = os.readlink(file)
    err = machine.refused(4)
    shown = machine.short(file)
    assert f"{shown} belongs to somebody else: it is a link to" in err
    assert f"~/{FREEDI}" in err
    assert "z_offset of [auto_z_offset] has the opposite sign" in err
    assert "name the others with --modules" in err
    assert f"or rm -r '{file}' and run this again\n" in err
    assert err.endswith("Error: nothing was changed\n")
    out = machine.installed("--force")
    assert f"[OK, pointed to {machine.short(target)} before]" in out
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


def test_link_that_leads_to_nothing_of_use_is_replaced(machine, klipper):
    klipper.place().symlink_to("/nowhere/z_calibration.py")
    klipper.place(f"{NAME}.py").symlink_to(machine.checkout / "install.sh")
    theirs = klipper.place("theirs.py")
    theirs.symlink_to("/nowhere/theirs.py")
    out = machine.installed()
    assert "[OK, pointed to /nowhere/z_calibration.py before]" in out
    assert machine.restarted() == ["klipper", "moonraker"]
    theirs.unlink()
    assert klipper.links() == klipper.expected(*MODULES)


def test_copies_by_hand_are_kept(machine, klipper):
    file, folder = klipper.place(), klipper.place("z_touch")
    file.write_text("mine = 1\n")
    folder.mkdir()
    (folder / "mine.py").write_text("mine = 2\n")
    err = machine.refused(4)
    for place in (file, folder):
        shown = machine.short(place)
        assert f"{shown} is no link, so this script has not made it" in err
    out = machine.installed("--force")
    assert klipper.links() == klipper.expected(*MODULES)
    kept = re.findall(r"\[OK, old one kept as (.*\.bak-\d{14}-\d+)\]", out)
    assert (file.parent / kept[0]).read_text() == "mine = 1\n"
    assert (file.parent / kept[1] / "mine.py").read_text() == "mine = 2\n"
    out = machine.installed("-u")
    for name in kept:
        shown = machine.short(file.parent / name)
        assert f"{shown} was kept when ours came" in out


@pytest.mark.parametrize(
    ("path", "is_linked", "options"),
    [
        (PLACE, True, ["--force"]),
        (f"klippy/extras/{NAME}/__init__.py", False, []),
    ],
)
def test_part_of_klipper_is_never_replaced(
    machine, klipper, path, is_linked, options
):
    file = machine.write(f"klipper/{path}", "vendor = 1\n")
    machine.commit(klipper.path)
    if is_linked:
        file.unlink()
        file.symlink_to("/somewhere/auto_z_offset.py")
    # Whatever repository a caller works in
    err = machine.refused(4, *options, GIT_DIR=f"{machine.checkout}/.git")
    assert f"{PLACE} is part of this Klipper, and replacing it would" in err
    machine.installed("--modules", "z_calibration")
    assert klipper.expected("z_calibration").items() <= klipper.links().items()


# What git knows


def test_klipper_without_git(box):
    klipper = box.klipper()
    shutil.rmtree(klipper.path / ".git")
    assert "git" not in box.installed("--no-moonraker")
    assert klipper.links() == klipper.expected(*MODULES)
    box.installed("-u")
    assert klipper.links() == {}


def test_git_that_refuses_to_look(machine, klipper):
    (klipper.path / ".git" / "HEAD").write_text("nonsense")
    err = machine.refused(3)
    shown = machine.short(klipper.path)
    assert f"git does not tell what is part of {shown}: fatal: " in err


def test_lines_of_others_in_the_exclude_file_stay(machine, klipper):
    klipper.exclude.write_text("# mine\n*.bak")
    machine.installed()
    (klipper.path / "a.bak").write_text("")
    assert klipper.status() == ""
    machine.installed("-u", "--modules", NAME)
    left = klipper.exclude.read_text()
    assert f"{NAME}.py" not in left and "/klippy/extras/z_touch" in left
    machine.installed("-u")
    assert klipper.exclude.read_text() == "# mine\n*.bak\n"


def test_exclude_file_that_cannot_be_written(machine, klipper):
    klipper.exclude.chmod(0o444)
    klipper.exclude.parent.chmod(0o555)
    out = machine.installed()
    assert klipper.links() == klipper.expected(*MODULES)
    shown = machine.short(klipper.exclude)
    assert f"Note: cannot write to {shown}; git will list" in out
    assert "Excluding" not in out
    machine.installed("-u")
    klipper.exclude.parent.chmod(0o755)
    assert klipper.links() == {}


# Kalico


def test_kalico_needs_the_override_of_each_printer(box):
    kalico = box.kalico()
    first = box.conf("printer_1_data/config").with_name("printer.cfg")
    second = box.conf("printer_2_data/config").with_name("printer.cfg")
    first.write_text(OVERRIDE)
    second.write_text("[printer]\n")
    err = box.refused(4)
    assert "Kalico ships its own z_calibration, and will" in err
    assert f"first add to {box.short(second)}:" in err
    assert f"\n{OVERRIDE}\n" in err
    assert "with -m if one of these is of another Klipper" in err
    others = re.search(r'--modules "(.*)"', err).group(1)
    assert set(others.split()) == set(MODULES) - set(KALICO_SHIPS)
    box.installed("--modules", others)
    box.installed("-m", str(first.with_name("moonraker.conf")))
    box.installed("-u")
    assert "before [danger_options]" in box.installed("--force")
    box.installed("-u")
    second.write_text(OVERRIDE)
    box.installed()
    assert kalico.links() == kalico.expected(*MODULES)


@pytest.mark.parametrize(
    ("name", "line"),
    [
        (
            "printer.cfg",
            "allow_plugin_override: False\n#allow_plugin_override: True",
        ),
        # In none that the printer includes
        ("unused.cfg", "allow_plugin_override: True"),
    ],
)
def test_override_that_the_printer_does_not_read(box, name, line):
    kalico = box.kalico()
    folder = "printer_data/config"
    cfg = box.write(f"{folder}/printer.cfg", "[include more/*.cfg]\n")
    box.write(f"{folder}/{name}", f"[danger_options]\n{line}\n")
    assert f"first add to {box.short(cfg)}:" in box.refused(4)
    cfg.write_text("[include more/*.cfg]\n")
    line = "allow_plugin_override = yes  # for us\r"
    box.write(f"{folder}/more/z.cfg", f"[danger_options]\n{line}\n")
    box.installed()
    assert kalico.links() == kalico.expected(*MODULES)


def test_kalico_keeps_its_own_dockable_probe_unless_asked(box):
    kalico = box.kalico()
    box.conf().with_name("printer.cfg").write_text(OVERRIDE)
    out = box.installed()
    assert "Kalico's own dockable_probe stays; --modules takes ours" in out
    assert "dockable_probe.py" not in str(kalico.links())
    box.installed("--modules", "dockable_probe")
    assert "dockable_probe.py" in str(kalico.links())
    box.installed("-u")
    assert kalico.links() == {}


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


def test_links_of_klipper_are_none_of_kalico(machine):
    """As after a change of the branch of ~/klipper."""
    machine.write("printer_data/config/printer.cfg", OVERRIDE)
    kalico = machine.kalico()
    marker = kalico.path / "klippy/plugins/__init__.py"
    marker.rename(marker.with_suffix(".away"))
    machine.installed("--modules", NAME)
    marker.with_suffix(".away").rename(marker)
    out = machine.installed("--modules", NAME)
    assert f"Removing {NAME}.py from klippy/extras... [OK]" in out
    assert kalico.links() == kalico.expected(NAME)


# What the environment has to offer


def test_root_is_refused(machine, klipper):
    machine.fake("id", "#!/usr/bin/env bash\necho 0\n")
    assert "this runs as root or with sudo" in machine.refused(3)
    machine.installed("--allow-root")
    # Root needs no sudo
    assert machine.calls("sudo") == []
    assert machine.restarted() == ["klipper", "moonraker"]


def test_what_is_named_has_to_be_there(box):
    err = box.refused(3)
    assert "no Klipper in ~/klipper or ~/kalico; give its path with -k" in err
    err = box.refused(3, "-k", "klipper_z_calibration")
    assert "no klippy/extras in klipper_z" in err
    box.klipper()
    err = box.refused(3, "-m", "/nowhere/m.conf")
    assert "there is no /nowhere/m.conf; give a" in err


def test_not_from_a_pipe(machine, klipper):
    text = (REPO / "install.sh").read_bytes()
    outcome = machine.command(["bash", "-s", "--", "--dry-run"], stdin=text)
    assert outcome.code == 3
    assert "the script is no file of a clone" in outcome.err


@pytest.mark.parametrize("missing", ["z_touch", "modules", "installer"])
def test_not_from_an_incomplete_clone(machine, klipper, missing):
    said = "has no installer/; run the script from a complete clone"
    if missing == "modules":
        for name in MODULES:
            (machine.checkout / f"{name}.py").unlink()
    else:
        shutil.rmtree(machine.checkout / missing)
    if missing == "z_touch":
        # What git leaves behind when its files go
        (machine.checkout / "z_touch/core/__pycache__").mkdir(parents=True)
    if missing != "installer":
        said = "has no module or no z_touch; run"
    assert f"~/klipper_z_calibration {said}" in machine.refused(3)


def test_extras_that_cannot_be_written(machine, klipper):
    folder = klipper.path / "klippy/extras"
    klipper.place().mkdir()
    folder.chmod(0o555)
    shown = f"cannot write to {machine.short(folder)}; give it to your user"
    # All that is in the way is named at once
    err = machine.refused(4)
    assert err.count(shown) == 1 and "z_calibration.py is no link" in err
    folder.chmod(0o755)
    klipper.place().rmdir()
    machine.installed()
    folder.chmod(0o555)
    assert shown in machine.refused(5, "-u")
    # Nothing to write
    machine.installed()
    folder.chmod(0o755)


def test_usage(machine, klipper):
    (machine.checkout / "extra_probe.py").unlink()
    for options, message in (
        (["--what"], "unknown option --what"),
        (["-k", ""], "-k needs a value"),
        (["--modules"], "--modules needs a value"),
        (["--modules", "z_calibration *"], "no module *; choose from: z_c"),
        # Ours, but not in this checkout
        (["--modules", "extra_probe"], "no module extra_probe; choose from"),
    ):
        assert message in machine.refused(2, *options)


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


def test_folder_goes_with_the_last_module(machine, klipper):
    machine.installed("--modules", NAME)
    assert klipper.links() == klipper.expected(NAME)
    machine.installed()
    assert klipper.links() == klipper.expected(*MODULES)
    machine.installed("-u", "--modules", "z_calibration")
    rest = [name for name in MODULES if name != "z_calibration"]
    assert klipper.links() == klipper.expected(*rest)
    # A link to what the checkout has no more goes, too
    (machine.checkout / f"{NAME}.py").unlink()
    machine.installed("-u", "--modules", f" {'  '.join(rest)}")
    assert klipper.links() == {}


def test_uninstall_leaves_what_is_not_ours(machine, klipper):
    klipper.place().symlink_to(machine.write("theirs.py", "theirs = 1\n"))
    klipper.place(f"{NAME}.py").write_text("mine = 1\n")
    klipper.place("z_touch").mkdir()
    klipper.place("other.py").symlink_to(machine.home / "gone.py")
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


@pytest.mark.parametrize("options", [["-u"], ["--force"]])
def test_dry_run_changes_nothing(machine, klipper, options):
    if options == ["-u"]:
        machine.installed()
    else:
        klipper.place().write_text("mine = 1\n")
        machine.conf(text="[update_manager z_calibration]\npath: ~/old\n")
    machine.restarted()
    before = snapshot(machine.home)
    out = machine.installed("--dry-run", *options)
    assert snapshot(machine.home) == before
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


# A clone that was moved, and two of them


@pytest.mark.parametrize("options", [[], ["--uninstall"]])
def test_links_of_a_clone_that_was_moved(machine, klipper, options):
    machine.installed()
    machine.checkout = machine.checkout.rename(machine.home / "moved")
    out = machine.installed(*options)
    conf = machine.home / "printer_data/config/moonraker.conf"
    assert ("path: ~/moved\n" in conf.read_text()) is not bool(options)
    assert "klipper_z_calibration\n" not in conf.read_text()
    if options:
        assert conf.read_text() == "[server]\n"
        assert klipper.links() == {}
        assert "Removing z_touch from klippy/extras... [OK, which led to" in out
        assert klipper.status() == ""
    else:
        assert klipper.links() == klipper.expected(*MODULES)


def test_modules_of_two_checkouts_are_not_mixed(machine, klipper):
    machine.installed()
    first, second = machine.checkout, machine.clone(machine.home / "second")
    script = second / "install.sh"
    err = machine.refused(4, script=script)
    shown = machine.short(klipper.place())
    assert (
        f"Error: {shown} is a link to another checkout of this project,"
        " ~/klipper_z_calibration; its version and this one cannot be mixed"
    ) in err
    assert "opposite sign" not in err
    err = machine.refused(4, "--modules", NAME, "--force", script=script)
    advice = "all of them to this checkout: --force, without --modules\n"
    assert err.count(advice) == 1
    outcome = machine.run("--force", script=script)
    assert (outcome.code, outcome.err) == (0, "")
    assert f"[OK, pointed to {machine.short(first)}/{NAME}.py" in outcome.out
    machine.checkout = second
    assert klipper.links() == klipper.expected(*MODULES)


# The script as such


def test_any_shell_may_be_named(machine, klipper):
    script = str(machine.checkout / "install.sh")
    outcome = machine.command([shutil.which("sh"), script])
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


def test_unexpected_failure_is_told(machine, klipper):
    machine.failing("ln")
    outcome = machine.run()
    assert outcome.code == 1
    assert re.findall(
        r"Error: unexpected failure in (\S+), line \d+", outcome.err
    )
    assert "Linking" not in outcome.out
