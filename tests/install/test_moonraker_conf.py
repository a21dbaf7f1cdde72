"""install.sh: the section for Moonraker's update manager."""

from __future__ import annotations

import configparser
import os
import re
import shutil
from pathlib import Path

import pytest

from tests.install.box import ORIGIN, REPO, new_box, snapshot

HEADER = "[update_manager z_calibration]"
MARK = "# Added by install.sh of z_calibration\n"
SECTION = f"""{HEADER}
type: git_repo
path: ~/klipper_z_calibration
origin: {ORIGIN}
primary_branch: main
managed_services: klipper
"""
OTHER = f"""{HEADER}
type: git_repo
path: ~/old
origin: {ORIGIN}
primary_branch: main
managed_services: klipper
"""
SKIPPED = "[SKIPPED, already there]"


def test_section_is_appended(machine):
    conf = machine.home / "printer_data/config/moonraker.conf"
    out = machine.installed()
    assert conf.read_text() == f"[server]\n\n{MARK}{SECTION}"
    assert f"Adding {HEADER} to {conf}... [OK]" in out


@pytest.mark.parametrize(
    ("text", "appended"),
    [
        ("", MARK + SECTION),
        (
            "[server]",
            "\n\n"
            + MARK.replace("\n", " (the line before had no end)\n")
            + SECTION,
        ),
        ("[server]\r\n", "\n" + MARK + SECTION),
    ],
)
def test_end_of_the_file(box, text, appended):
    box.klipper()
    conf = box.conf(text=text)
    box.installed()
    assert conf.read_bytes().decode() == text + appended
    configparser.ConfigParser().read_string(conf.read_text())


def test_file_keeps_its_identity(machine):
    conf = machine.home / "printer_data/config/moonraker.conf"
    real = machine.home / "real.conf"
    conf.rename(real)
    conf.symlink_to(real)
    real.chmod(0o640)
    before = real.stat()
    machine.installed()
    machine.installed("-u")
    after = real.stat()
    assert conf.is_symlink()
    assert (after.st_ino, after.st_mode) == (before.st_ino, before.st_mode)


@pytest.mark.parametrize(
    "places",
    [
        ["printer_data/config"],
        ["printer_data/config", "printer_big_data/config"],
        ["printer_1_data/config", "printer_2_data/config"],
        ["klipper_config"],
        ["klipper_config/printer_1", "klipper_config/printer_2"],
    ],
)
def test_every_configuration_is_found(box, places):
    box.klipper()
    confs = [box.conf(place) for place in places]
    box.installed()
    for conf in confs:
        assert conf.read_text().count(HEADER) == 1
    box.installed("-u")
    for conf in confs:
        assert conf.read_text() == "[server]\n"


def test_one_file_under_two_names_gets_one_section(box):
    box.klipper()
    conf = box.conf("printer_data/config")
    other = box.home / "old_data/config"
    other.mkdir(parents=True)
    (other / "moonraker.conf").symlink_to(conf)
    out = box.installed()
    assert conf.read_text().count(HEADER) == 1
    assert out.count(f"{HEADER} to ") == 1


def test_named_files_only(box):
    box.klipper()
    found = box.conf()
    named = [box.conf("a b"), box.conf("elsewhere")]
    box.installed("-m", str(named[0]), f"--moonraker-conf={named[1]}")
    assert found.read_text() == "[server]\n"
    for conf in named:
        assert conf.read_text().count(HEADER) == 1


def test_no_moonraker(machine):
    conf = machine.home / "printer_data/config/moonraker.conf"
    out = machine.installed("--no-moonraker")
    assert conf.read_text() == "[server]\n"
    assert "update_manager" not in out
    assert machine.restarted() == ["klipper"]
    machine.installed()
    machine.installed("-u", "--no-moonraker")
    assert HEADER in conf.read_text()


@pytest.mark.parametrize(
    "header",
    [
        HEADER,
        "[update_manager  z_calibration]  # updates",
        "[update_manager client z_calibration]",
        HEADER + "\r",
    ],
)
def test_section_that_is_there_stays(machine, header):
    text = SECTION.replace(HEADER, header)
    conf = machine.conf(text=text)
    out = machine.installed()
    assert conf.read_bytes().decode() == text
    assert SKIPPED in out
    assert machine.restarted() == ["klipper"]


@pytest.mark.parametrize(
    "line",
    [
        "#" + HEADER,
        "# " + HEADER,
        "[update_manager z_calibration_old]",
        "[update_manager my z_calibration]",
        "[z_calibration]",
    ],
)
def test_what_only_looks_like_it_does_not_count(machine, line):
    conf = machine.conf(text=f"{line}\n")
    machine.installed()
    assert conf.read_text().endswith(f"\n\n{MARK}{SECTION}")


@pytest.mark.parametrize(
    "include",
    [
        "more.conf",
        "conf.d/*.conf",
        "ABSOLUTE/conf.d/updates.conf",
        "first.conf",
    ],
)
def test_included_section_counts(machine, include):
    folder = machine.home / "printer_data/config"
    include = include.replace("ABSOLUTE", str(folder))
    (folder / "conf.d").mkdir()
    name = "more.conf" if "conf.d" not in include else "conf.d/updates.conf"
    (folder / name).write_text(SECTION)
    (folder / "first.conf").write_text("[include more.conf]\n")
    text = f"[server]\n[include {include}]\n"
    conf = machine.conf(text=text)
    out = machine.installed()
    assert SKIPPED in out
    assert conf.read_text() == text
    machine.installed("-u")
    assert (folder / name).read_text() == ""
    assert conf.read_text() == text


def test_file_that_includes_itself_ends(machine):
    text = "[include moonraker.conf]\n"
    conf = machine.conf(text=text)
    machine.installed()
    assert conf.read_text() == f"{text}\n{MARK}{SECTION}"


@pytest.mark.parametrize(
    ("section", "words"),
    [
        (OTHER, "updates '~/old', not this checkout"),
        (
            SECTION.replace(ORIGIN, "https://example.com/else.git"),
            "has another origin, branch or channel",
        ),
        # Moonraker wants exactly that address
        (
            SECTION.replace(ORIGIN, ORIGIN + "/"),
            "has another origin, branch or channel",
        ),
        (
            SECTION.replace("primary_branch: main\n", ""),
            "has another origin, branch or channel",
        ),
    ],
)
def test_section_of_somebody_else(machine, section, words):
    conf = machine.conf(text=f"{section}[server]\n")
    out = machine.installed()
    assert f"Note: the section in {conf} {words}; use --force" in out
    assert conf.read_text() == f"{section}[server]\n"
    assert machine.restarted() == ["klipper"]
    machine.forget_calls()
    out = machine.installed("--force")
    assert conf.read_text() == f"[server]\n\n{MARK}{SECTION}"
    kept = re.search(r"\[OK, old file kept as (.*)\]", out).group(1)
    assert (conf.parent / kept).read_text() == f"{section}[server]\n"
    assert re.fullmatch(r"moonraker\.conf\.bak-\d{14}", kept)
    assert machine.restarted() == ["moonraker"]
    machine.forget_calls()
    before = snapshot(machine.home)
    machine.installed("-f")
    assert snapshot(machine.home) == before
    assert machine.restarted() == []


@pytest.mark.parametrize(
    ("path", "origin"),
    [
        ("~/klipper_z_calibration/", ORIGIN),
        ("HOME/klipper_z_calibration  # here", ORIGIN[:-4]),
        ("~/link", ORIGIN.upper()),
    ],
)
def test_other_words_for_the_same(machine, path, origin):
    (machine.home / "link").symlink_to(machine.checkout)
    path = path.replace("HOME", str(machine.home))
    text = SECTION.replace("~/klipper_z_calibration", path)
    conf = machine.conf(text=text.replace(ORIGIN, origin))
    before = conf.read_text()
    assert SKIPPED in machine.installed("--force")
    assert conf.read_text() == before


def test_replaced_where_it_stands(machine):
    folder = machine.home / "printer_data/config"
    (folder / "more.conf").write_text(OTHER)
    conf = machine.conf(text="[include more.conf]\n")
    machine.installed("--force")
    assert conf.read_text() == "[include more.conf]\n"
    assert (folder / "more.conf").read_text() == MARK + SECTION


@pytest.mark.parametrize("channel", ["dev", "beta", "stable"])
def test_channel(machine, channel):
    conf = machine.home / "printer_data/config/moonraker.conf"
    machine.installed("--channel", channel)
    line = f"channel: {channel}\n"
    assert conf.read_text() == f"[server]\n\n{MARK}{SECTION}{line}"
    # Without the option any channel is right, with it only that one
    assert SKIPPED in machine.installed()
    assert SKIPPED in machine.installed(f"--channel={channel}")
    other = "beta" if channel != "beta" else "stable"
    out = machine.installed("--channel", other)
    assert "has another origin, branch or channel" in out
    machine.installed("--channel", other, "--force")
    assert f"channel: {other}\n" in conf.read_text()
    assert conf.read_text().count(HEADER) == 1


def test_checkout_outside_of_home(machine):
    checkout = machine.clone(machine.directory / "opt" / "z")
    conf = machine.home / "printer_data/config/moonraker.conf"
    outcome = machine.run(script=checkout / "install.sh")
    assert outcome.code == 0, outcome
    assert f"path: {checkout}\n" in conf.read_text()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["rm", "-rf", ".git"], " is not a git clone"),
        (
            ["git", "remote", "rename", "origin", "upstream"],
            "git does not tell where",
        ),
    ],
)
def test_checkout_that_cannot_be_updated(machine, words, message):
    conf = machine.home / "printer_data/config/moonraker.conf"
    machine.run("--help")  # gives all to the user
    command = f"cd '{machine.checkout}' && {' '.join(words)}"
    assert machine.command(["bash", "-c", command]).code == 0
    out = machine.installed()
    assert "Note: automatic updates not set up: " in out
    assert message in out
    assert conf.read_text() == "[server]\n"
    assert os.path.lexists(
        machine.home / "klipper/klippy/extras/z_calibration.py"
    )


def test_file_that_cannot_be_written(machine):
    conf = machine.home / "printer_data/config/moonraker.conf"
    conf.chmod(0o444)
    err = machine.refused(5)
    assert f"cannot write to {conf}" in err
    machine.installed("--no-moonraker")
    conf.chmod(0o644)
    machine.installed()
    conf.chmod(0o444)
    # Nothing to write
    machine.installed()
    machine.forget_calls()
    assert "cannot write" in machine.refused(5, "-u")


@pytest.mark.parametrize("option", [[], ["-u"]])
def test_folder_that_cannot_be_written(machine, option):
    """The old text would have no place while the new one is written."""
    conf = machine.home / "printer_data/config/moonraker.conf"
    if option:
        machine.installed()
        machine.forget_calls()
    conf.parent.chmod(0o555)
    err = machine.refused(5, *option)
    conf.parent.chmod(0o755)
    assert f"cannot write to {conf}, or not beside it" in err


def test_folder_of_the_exclude_file_that_cannot_be_written(machine):
    machine.installed()
    folder = machine.home / "klipper/.git/info"
    text = (folder / "exclude").read_text()
    folder.chmod(0o555)
    out = machine.installed("-u")
    folder.chmod(0o755)
    assert "the lines for the links stay there" in out
    assert (folder / "exclude").read_text() == text
    conf = machine.home / "printer_data/config/moonraker.conf"
    assert conf.read_text() == "[server]\n"


def test_file_without_a_section_need_not_be_writable(machine):
    conf = machine.home / "printer_data/config/moonraker.conf"
    conf.chmod(0o444)
    machine.installed("-u")
    assert conf.read_text() == "[server]\n"


def test_other_peoples_file_need_not_be_writable(machine):
    conf = machine.conf(text=OTHER)
    conf.chmod(0o444)
    machine.installed()
    machine.forget_calls()
    assert "cannot write" in machine.refused(5, "--force")
    machine.installed("-u")
    assert conf.read_text() == OTHER


def test_uninstall_leaves_somebody_elses_section(machine):
    machine.installed()
    conf = machine.conf(text=OTHER)
    out = machine.installed("-u")
    assert conf.read_text() == OTHER
    assert "[SKIPPED, updates ~/old]" in out


def test_uninstall_takes_a_section_written_by_hand(machine):
    conf = machine.conf(text=f"[server]\n\n{SECTION}\n# next\n[next]\n")
    machine.installed("-u")
    assert conf.read_text() == "[server]\n\n# next\n[next]\n"


def test_uninstall_takes_our_options_only(machine):
    section = SECTION.replace(
        "origin", "# mine\ninfo_tags:\n    desc=Z\n\norigin"
    )
    conf = machine.conf(text=f"[server]\n\n{MARK}{section}\n# b\n\n[next]\n")
    machine.installed("-u")
    assert conf.read_text() == "[server]\n\n# b\n\n[next]\n"


def failing(program, when):
    """A stand-in for a program that fails when its last word fits."""
    real = shutil.which(program)
    return f'#!/usr/bin/env bash\n[[ "$*" != {when} ]] || exit 1\nexec {real} "$@"\n'


@pytest.mark.parametrize("option", [[], ["-u"]])
def test_full_disk_loses_nothing(machine, option):
    conf = machine.home / "printer_data/config/moonraker.conf"
    if option:
        machine.installed()
    text = conf.read_text()
    # What is written over the file ends too early
    machine.fake("cmp", failing("cmp", f"*{conf}"))
    outcome = machine.run(*option)
    assert outcome.code == 1
    kept = re.search(r"its old text is in (.*)", outcome.err).group(1)
    assert Path(kept).read_text() == text
    assert Path(kept).parent == conf.parent


def test_no_room_for_a_copy(machine):
    conf = machine.home / "printer_data/config/moonraker.conf"
    machine.fake("cp", failing("cp", f"*{conf}.bak-*"))
    outcome = machine.run()
    assert outcome.code == 1
    assert f"could not keep a copy of {conf}, so it was left" in outcome.err
    assert conf.read_text() == "[server]\n"


@pytest.mark.parametrize("name", ["moonraker.conf", "more.conf"])
@pytest.mark.parametrize("option", [[], ["-u"]])
def test_file_that_cannot_be_read(machine, name, option):
    conf = machine.conf(text="[include more.conf]\n")
    conf.with_name("more.conf").write_text("[server]\n")
    file = conf.with_name(name)
    machine.installed("--help")
    file.chmod(0o000)
    outcome = machine.run(*option)
    file.chmod(0o644)
    assert outcome.code == 5
    assert f"cannot read {file}" in outcome.err
    assert conf.read_text() == "[include more.conf]\n"


@pytest.mark.parametrize("name", ["-x.conf", "a=b.conf", "a b.conf"])
def test_name_that_is_no_option(machine, name):
    conf = machine.directory / name
    conf.write_text("[server]\nport: 1\n" + OTHER)
    machine.installed("-m", name, "--force")
    assert conf.read_text() == f"[server]\nport: 1\n\n{MARK}{SECTION}"
    machine.installed("-u", "-m", name)
    assert conf.read_text() == "[server]\nport: 1\n"


def test_home_with_brackets():
    box = new_box("home[1]")
    box.klipper()
    conf = box.conf(text="[include conf.d/*.conf]\n")
    (conf.parent / "conf.d").mkdir()
    (conf.parent / "conf.d" / "a.conf").write_text(SECTION)
    assert SKIPPED in box.installed()
    shutil.rmtree(box.directory)


def test_clone_on_no_branch(machine):
    machine.installed("--help")
    machine.git(machine.checkout, "checkout", "-q", "--detach")
    out = machine.installed()
    assert "is on no branch, and Moonraker will not update it" in out
    assert f"git -C '{machine.checkout}' checkout main" in out


AWKS = {
    "mawk": ["mawk"],
    "gawk": ["gawk"],
    "original-awk": ["original-awk"],
    "busybox": ["busybox", "awk"],
}
FOUND = [name for name in AWKS if shutil.which(AWKS[name][0])]


def test_there_is_an_awk():
    assert FOUND


@pytest.mark.parametrize("name", FOUND)
def test_every_awk_does_the_same(machine, name):
    program, *applet = AWKS[name]
    words = " ".join([shutil.which(program), *applet])
    machine.fake("awk", f'#!/usr/bin/env bash\nexec {words} "$@"\n')
    conf = machine.conf(text=f"[server]\nport: 1\n\n{OTHER}\n[next]\n")
    exclude = machine.home / "klipper/.git/info/exclude"
    exclude.write_text("*.bak")
    machine.installed("--help")
    out = machine.installed("--force")
    assert conf.read_text() == (
        f"[server]\nport: 1\n\n[next]\n\n{MARK}{SECTION}"
    )
    assert SKIPPED in machine.installed()
    assert "http://127.0.0.1:1/" in "".join(machine.calls())
    machine.installed("-u")
    assert conf.read_text() == "[server]\nport: 1\n\n[next]\n"
    assert exclude.read_text() == "*.bak"
    assert "warning" not in out


def test_awk_gets_no_backslash_in_a_variable():
    """Only some take it away: `awk -v x='\\['` is not portable."""
    script = (REPO / "install.sh").read_text()
    values = re.findall(r'-v \w+=("[^"]*"|\S+)', script)
    assert len(values) >= 10
    assert [v for v in values if "\\" in v.replace("\\$", "")] == []
    pattern = re.search(r"header_pattern\(\) \{\n(.*)\n", script).group(1)
    assert "\\" not in pattern


def test_it_is_told_after_it_was_done(machine):
    machine.fake("ln", "#!/usr/bin/env bash\nexit 1\n")
    outcome = machine.run()
    assert outcome.code == 1
    assert "Linking" not in outcome.out
    assert outcome.err.count("unexpected failure") == 1
