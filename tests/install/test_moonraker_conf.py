"""install.sh: the section for Moonraker's update manager."""

from __future__ import annotations

import configparser
import re
import shutil

import pytest

from tests.install.box import MODULES, ORIGIN, snapshot

pytestmark = pytest.mark.slow

HEADER = "[update_manager z_calibration]"
MARK = "# Added by install.sh of z_calibration\n"
SECTION = f"""{HEADER}
type: git_repo
path: ~/klipper_z_calibration
origin: {ORIGIN}
primary_branch: main
managed_services: klipper
"""
OTHER_PATH = SECTION.replace("~/klipper_z_calibration", "~/old")
# As of the plugin that ours follows, at the same place
OTHER_ORIGIN = SECTION.replace(ORIGIN, "https://example.com/else.git")
THERE = "... [SKIPPED, already there]\n"
PLACE = "printer_data/config"


@pytest.fixture
def conf(machine, klipper):
    """The moonraker.conf of a whole machine."""
    return machine.home / PLACE / "moonraker.conf"


@pytest.mark.parametrize("text", ["[server]", "[server]\r\n#é\xff\n"])
def test_section_is_appended(machine, conf, text):
    conf.write_bytes(text.encode("latin-1"))
    assert SECTION in machine.installed("--dry-run")
    out = machine.installed()
    assert f"Adding {HEADER} to {machine.short(conf)}... [OK]\n" in out
    written = conf.read_bytes().decode("latin-1")
    assert written == f"{text}\n{MARK}{SECTION}"
    configparser.ConfigParser().read_string(written)


def test_file_keeps_its_identity(machine, conf):
    real = machine.home / "real.conf"
    conf.rename(real)
    conf.symlink_to(real)
    real.chmod(0o640)
    before = real.stat()
    for options in ([], ["-u"]):
        machine.installed(*options)
        after = real.stat()
        assert conf.is_symlink()
        assert after.st_mode == before.st_mode
        assert [path.name for path in real.parent.glob(".real*")] == []


def test_every_configuration_is_found(box):
    box.klipper()
    places = [
        *("printer_1_data/config", "printer_2_data/config"),
        *("klipper_config", "klipper_config/printer_2"),
    ]
    confs = [box.conf(place) for place in places]
    other = box.home / "old_data/config"
    other.mkdir(parents=True)
    # One file under two names
    (other / "moonraker.conf").symlink_to(confs[0])
    box.installed()
    assert [conf.read_text().count(HEADER) for conf in confs] == [1] * 4
    box.installed("-u")
    assert [conf.read_text() for conf in confs] == ["[server]\n"] * 4


def test_no_moonraker(machine, conf):
    assert "update_manager" not in machine.installed("--no-moonraker")
    assert conf.read_text() == "[server]\n"
    assert machine.restarted() == ["klipper"]
    machine.installed()
    machine.installed("-u", "--no-moonraker")
    assert HEADER in conf.read_text()


# A section that is there


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (HEADER, "[update_manager client \t z_calibration ]  # updates"),
        (".git\nprimary_branch: main", "\r"),
        ("~/klipper_z_calibration", "HOME/klipper_z_calibration/  # here"),
    ],
)
def test_section_that_is_right_stays(machine, conf, old, new):
    text = SECTION.replace(old, new).replace("HOME", str(machine.home))
    machine.conf(text=text)
    before = conf.read_bytes()
    assert THERE in machine.installed("--force")
    assert conf.read_bytes() == before
    assert machine.restarted() == ["klipper"]
    machine.installed("-u")
    assert conf.read_bytes() == b""


def test_what_only_looks_like_it_does_not_count(machine, conf):
    text = f"#{HEADER}\n[update_manager z_calibration_old]\npath: ~/old\n"
    # A file that includes itself
    text += "[include moonraker.conf]\n"
    conf.write_text(text)
    machine.installed()
    assert conf.read_text() == f"{text}\n{MARK}{SECTION}"
    machine.installed("-u")
    assert conf.read_text() == text


def test_included_section_counts(machine, conf):
    file = machine.write(f"{PLACE}/conf.d/a b.conf", "")
    real = machine.write("dotfiles/updates.conf", SECTION)
    file.unlink()
    file.symlink_to(real)
    pattern = f"{conf.parent}/conf.d/*.conf"
    machine.write(f"{PLACE}/a first.conf", f"[include {pattern}]\n")
    text = "[include a first.conf]\n"
    conf.write_text(text)
    assert THERE in machine.installed()
    file.write_text(OTHER_PATH)
    machine.installed("--force")
    assert real.read_text() == f"\n{MARK}{SECTION}"
    machine.installed("-u")
    assert (real.read_text(), conf.read_text()) == ("", text)
    assert file.is_symlink()


def test_last_line_without_an_end_counts(machine, conf):
    """A real moonraker.conf is a single include."""
    more = machine.write(f"{PLACE}/more.conf", OTHER_ORIGIN)
    line = "[include\tmore.conf]"
    conf.write_text(line)
    assert "updates ~/klipper_z_calibration from" in machine.installed()
    assert conf.read_text() == line
    more.write_text(SECTION)
    assert THERE in machine.installed()
    machine.installed("-u")
    assert (more.read_text(), conf.read_text()) == ("", line)


@pytest.mark.parametrize("section", [OTHER_PATH, OTHER_ORIGIN])
def test_section_of_somebody_else(machine, conf, section):
    text = f"{section}[server]\n"
    conf.write_text(text)
    out = machine.installed()
    path, origin = re.findall(r"(?:path|origin): (.*)", section)
    shown = machine.short(conf)
    assert f"Adding {HEADER} to {shown}... [SKIPPED, see below]" in out
    *_, warning, last = out.splitlines()
    assert warning == (
        f"Warning: you will not see our updates: {HEADER} in {shown} updates"
        f" {path} from {origin}, not ~/klipper_z_calibration from {ORIGIN};"
        " to replace that section run this again with --force"
    )
    assert last.startswith("Installed: ")
    assert conf.read_text() == text
    assert machine.restarted() == ["klipper"]
    if section == OTHER_PATH:
        out = machine.installed("-u")
        assert conf.read_text() == text
        assert f"updates {path}, not ~/klipper_z_calibration... [SKIP" in out
        assert "--force" not in out
    machine.restarted()
    out = machine.installed("--force", "--no-restart")
    assert conf.read_text() == f"[server]\n\n{MARK}{SECTION}"
    kept = re.search(rf"text of {shown} is kept as (.*)", out).group(1)
    assert (conf.parent / kept).read_text() == text
    before = snapshot(machine.home)
    machine.installed("-f")
    assert snapshot(machine.home) == before
    assert f"{kept} is an old text of moonraker.conf" in machine.installed("-u")


def test_section_stays_while_a_module_is_linked(machine, conf, klipper):
    machine.installed()
    text = conf.read_text()
    machine.restarted()
    for _ in range(2):  # The second time no link is removed
        out = machine.installed("-u", "--modules", MODULES[0])
        shown = machine.short(klipper.path)
        assert f"the links that are still in {shown}\n" in out
        assert conf.read_text() == text
        assert machine.restarted() == []
    machine.installed("-u", "--modules", " ".join(MODULES[1:]))
    assert (conf.read_text(), klipper.links()) == ("[server]\n", {})


def test_section_stays_while_another_klipper_has_links(machine, conf):
    other = machine.klipper("kalico")
    machine.installed("-k", str(other.path))
    machine.installed()
    out = machine.installed("-u")
    assert f"the links that are still in {machine.short(other.path)}\n" in out
    assert HEADER in conf.read_text()
    machine.installed("-u", "-k", str(other.path))
    assert conf.read_text() == "[server]\n"


@pytest.mark.parametrize(
    ("before", "after"),
    [
        # By hand
        (
            f"[server]\n\n{SECTION}\n# n\n[n]\na: 1",
            "[server]\n\n# n\n[n]\na: 1\n",
        ),
        # With more options, and what follows them
        (
            f"[s]\n\n{MARK}{SECTION}# mine\ninfo_tags:\n  a=Z\n\n#b\n\n[n]\n",
            "[s]\n\n#b\n\n[n]\n",
        ),
        (f"[s]\r\n\r\n{SECTION}[n]\r\na: é\r\n", "[s]\r\n[n]\r\na: é\r\n"),
        # Twice: Moonraker does not start with it
        (
            f"[s]\n\n{MARK}{SECTION}\n[update_manager\tz_calibration ]\n"
            f"path: ~/old\n\n[n]\na: 1\n{SECTION}",
            "[s]\n\n[n]\na: 1\n",
        ),
    ],
)
def test_uninstall_takes_our_lines_only(machine, conf, before, after):
    conf.write_bytes(before.encode())
    out = machine.installed("-u")
    assert f"Removing {HEADER} from {machine.short(conf)}... [OK]\n" in out
    assert conf.read_bytes().decode() == after
    (kept,) = conf.parent.glob("moonraker.conf.bak-*")
    assert kept.read_bytes().decode() == before


# Files that cannot be read or written


@pytest.mark.parametrize(
    ("text", "options", "is_needed"),
    [
        ("[server]\n", [], True),
        (SECTION, [], False),
        (SECTION, ["-u"], True),
    ],
)
def test_file_that_cannot_be_written(machine, conf, text, options, is_needed):
    conf.write_text(text)
    conf.chmod(0o444)
    if not is_needed:
        machine.installed(*options)
        return
    shown = machine.short(conf)
    assert f"cannot write to {shown}" in machine.refused(5, *options)
    conf.chmod(0o644)
    # The new text is written beside it
    conf.parent.chmod(0o555)
    err = machine.refused(5, *options)
    conf.parent.chmod(0o755)
    shown = machine.short(conf.parent)
    assert f"cannot write to {shown}; give it to your user: sudo" in err


def test_file_that_cannot_be_read(machine, conf, klipper):
    conf.chmod(0o000)
    outcome = machine.run()
    assert (outcome.code, outcome.out) == (5, "")
    assert f"cannot read {machine.short(conf)}" in outcome.err
    assert klipper.links() == {}
    machine.installed("--no-moonraker")


@pytest.mark.parametrize(
    ("text", "options", "program", "words"),
    [
        ("[server]\n", [], "cat", "*/new"),
        ("[server]\n", [], "mv", "*"),
        (OTHER_PATH, ["-f"], "cat", "*/new"),
        # The old text could not be kept
        (OTHER_PATH, ["-f"], "cp", "*"),
    ],
)
def test_full_disk_loses_nothing(machine, conf, text, options, program, words):
    """Written beside, then put in its place: half of it is never seen."""
    conf.write_text(text)
    machine.failing(program, words)
    outcome = machine.run(*options)
    assert outcome.code == 1
    shown = machine.short(conf)
    assert f"{shown}, which is as it was; is the disk full?" in outcome.err
    assert conf.read_text() == text
    left = {path.name for path in conf.parent.iterdir()}
    assert not any(name.startswith(".") for name in left)


# What is written


def test_checkout_that_cannot_be_updated(machine, conf, klipper):
    shutil.rmtree(machine.checkout / ".git")
    # That of a repository around it is not ours
    machine.commit(machine.home)
    machine.git(machine.home, "remote", "add", "origin", "a")
    out = machine.installed()
    assert "Note: automatic updates not set up: git does not tell where" in out
    assert conf.read_text() == "[server]\n"
    assert klipper.place().is_symlink()


def test_token_in_the_address_stays_where_it_is(machine, conf):
    address = ORIGIN.replace("https://", "https://me:secret@")
    machine.git(machine.checkout, "remote", "set-url", "origin", address)
    out = machine.installed()
    assert conf.read_text() == f"[server]\n\n{MARK}{SECTION}"
    assert "secret" not in out
    said = "has a name or a password in it; moonraker.conf gets it without"
    assert said in out


def test_branch_of_the_checkout_is_followed(machine, conf):
    machine.git(machine.checkout, "checkout", "-q", "-b", "next")
    out = machine.installed()
    assert "is on branch next, not main: updates are those of next" in out
    assert "\nprimary_branch: next\n" in conf.read_text()
    machine.git(machine.checkout, "checkout", "-q", "main")
    out = machine.installed()
    assert "(branch next), not" in out and "run this again with --force" in out
    machine.git(machine.checkout, "checkout", "-q", "--detach")
    out = machine.installed("--force")
    assert "at a commit of no branch; Moonraker is told branch main" in out
