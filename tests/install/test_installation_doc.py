"""docs/installation.md says what install.sh does."""

from __future__ import annotations

import csv
import re

import pytest

from tests.docs.documents import link_problems, part, spans
from tests.install.box import MODULES, ORIGIN, OVERRIDE, REPO, Box, options_in

pytestmark = pytest.mark.slow

DOCUMENT = REPO / "docs" / "installation.md"
README = REPO / "README.md"
EXAMPLE = REPO / "examples" / "moonraker.conf"
TEXT = DOCUMENT.read_text()
with DOCUMENT.with_name("installer.csv").open(encoding="utf-8") as lines:
    # Options, exit codes and messages of the script
    _, *TABLE = csv.reader(lines)
SCRIPT = "".join(
    path.read_text()
    for path in (REPO / "install.sh", *sorted(REPO.glob("installer/*.sh")))
)


def commands(text, title, language="sh"):
    """The lines to type below a heading."""
    blocks = re.findall(rf"```{language}\n(.*?)```", part(text, title), re.S)
    return "\n".join(blocks)


def typed(box: Box, lines):
    """Type lines into a shell in the box; ADDRESS is that of a clone."""
    source = box.directory / "source"
    if not source.exists():
        box.clone(source)
    lines = re.sub(r"ADDRESS=[^\s;]+", f"ADDRESS='{source}'", lines)
    lines = re.sub(r"(?<!\$)\bADDRESS\b(?!=)", str(source), lines)
    script = f"set -e\n{lines}"
    outcome = box.command(["bash", "-c", script])
    assert (outcome.code, outcome.err) == (0, ""), outcome
    return outcome.out


@pytest.fixture
def home(machine):
    """A machine on which our checkout has not been cloned yet."""
    machine.checkout.rename(machine.directory / "source")
    quiet = "[advice]\n    detachedHead = false\n"
    machine.write(".gitconfig", quiet)
    return machine


def cloned(text):
    return text.replace("git clone", "git clone -q")


@pytest.mark.parametrize(
    ("file", "title"), [(DOCUMENT, "With the script"), (README, "Install")]
)
def test_with_the_script(home, klipper, file, title):
    language = "sh" if file is DOCUMENT else ""
    typed(home, cloned(commands(file.read_text(), title, language)))
    assert home.restarted() == ["klipper", "moonraker"]
    assert klipper.links() == klipper.expected(*MODULES)
    conf = home.home / "printer_data/config/moonraker.conf"
    assert "path: ~/klipper_z_calibration\n" in conf.read_text()


def test_by_hand_is_what_the_script_does(home, klipper):
    typed(home, cloned(commands(TEXT, "By hand")))
    assert klipper.links() == klipper.expected("z_calibration")
    assert klipper.status() == ""
    source = str(home.directory / "source")
    home.conf(
        text="[server]\n" + EXAMPLE.read_text().replace("ADDRESS", source)
    )
    out = home.installed("--modules", "z_calibration")
    assert out.count("[OK, already linked]") == 2
    assert "[SKIPPED, already there]" in out
    assert "Nothing changed" in out


def test_example_is_the_section_of_the_script(machine, klipper):
    machine.installed()
    conf = machine.home / "printer_data/config/moonraker.conf"
    section = conf.read_text().partition("z_calibration\n")[2]
    lines = EXAMPLE.read_text().replace("ADDRESS", ORIGIN).splitlines()
    kept = [line for line in lines if line and not line.startswith("#")]
    assert "\n".join(kept) + "\n" == section


def test_kalico(home):
    kalico = home.kalico("kalico")
    lines = cloned(commands(TEXT, "On Kalico"))
    by_hand, _, alone = lines.partition("\n\n")
    typed(home, by_hand)
    assert kalico.links() == kalico.expected("z_calibration")
    assert kalico.status() == ""
    typed(home, alone)
    assert kalico.links() == kalico.expected("auto_z_offset", "z_calibration")
    assert commands(TEXT, "On Kalico", "ini") == OVERRIDE


CHANGING = "You have klipper_z_calibration already"


def test_lines_for_owners_of_the_original_never_run_its_installer(home):
    """The address is a placeholder: typed word for word, line by line."""
    old = home.home / "klipper_z_calibration"
    old.mkdir()
    script = old / "install.sh"
    script.write_text(f'#!/bin/sh\necho "$@" >{old}/ran\n')
    script.chmod(0o755)
    there = commands(README.read_text(), CHANGING, "").partition("\n\n")[0]
    for lines in (there, there.partition("\n")[2]):
        # Also where the first line was forgotten
        outcome = home.command(["bash", "-c", lines])
        assert outcome.code != 0
        assert "fatal:" in outcome.err
        assert [p.name for p in old.iterdir()] == ["install.sh"]
        assert not (home.home / "klipper_z_calibration.old").exists()


def test_from_the_original_plugin_and_back(home, klipper):
    old = home.clone(home.home / "klipper_z_calibration")
    (old / "theirs").write_text("")
    klipper.place().symlink_to(old / "z_calibration.py")
    theirs = (
        "[update_manager client z_calibration]\ntype: git_repo\n"
        "path: ~/klipper_z_calibration\norigin: https://example.com/\n"
        "install_script: install.sh\nmanaged_services: klipper\n"
    )
    conf = home.conf(text=theirs)
    lines = commands(README.read_text(), CHANGING, "")
    there, _, back = cloned(lines).partition("\n\n")
    for part_of_them in (there, back):
        assert len(part_of_them.strip().splitlines()) == 3
    typed(home, there)
    assert "install_script" not in conf.read_text()
    assert "origin: https" not in conf.read_text()
    assert klipper.links() == klipper.expected(*MODULES)
    (kept,) = conf.parent.glob("moonraker.conf.bak-*")
    assert kept.read_text() == theirs
    typed(home, back)
    assert set(klipper.links()) == {"extras/z_calibration.py"}
    assert (klipper.place().resolve().parent / "theirs").exists()
    assert "z_calibration" not in conf.read_text()
    assert theirs in [path.read_text() for path in conf.parent.glob("*.bak-*")]


def test_update_and_uninstall(home, klipper):
    typed(home, cloned(commands(TEXT, "With the script")))
    typed(home, commands(TEXT, "Updating"))
    status = commands(TEXT, "What does -dirty mean?")
    assert typed(home, status) == ""
    klipper.place("probe.py").write_text("new = 1\n")
    assert typed(home, status) == " M klippy/extras/probe.py\n"
    typed(home, commands(TEXT, "Uninstalling"))
    assert klipper.links() == {}
    assert not home.checkout.exists()


def test_options_are_those_of_the_script(machine, klipper):
    table, codes = [], []
    for row in TABLE:
        if row[0] != "message":
            (codes if row[0] == "exit code" else table).append(row[1:])
    documented = {span.split()[0] for row in table for span in spans(row[0])}
    shown = machine.installed("--help")
    assert documented == options_in(shown)
    parser = SCRIPT.partition("parse() {")[2].partition("\n}\n")[0]
    cases = re.findall(r"^ {12}(-.*?)\)", parser, re.M)
    assert documented == {word for case in cases for word in case.split(" | ")}
    numbers = re.findall(r"[A-Z_]+=(\d)", SCRIPT.partition("# Options")[0])
    assert [row[0] for row in codes] == ["0", *numbers]


JOINED = re.sub(r'"\s*\\\n\s*"', " ", SCRIPT)


def with_dots(text):
    """A text of the script with ... for what varies."""
    return re.sub(r"\$\{[^}]*\}|\$\w+|\$\([^)]*\)", "...", text)


def documented_pieces():
    """The messages of the document, cut where something varies."""
    shown = [
        s for kind, what, _ in TABLE for s in spans(what) if kind == "message"
    ]
    pieces = [piece.strip(" ';") for s in shown for piece in s.split("...")]
    return [piece for piece in pieces if piece]


def test_messages_are_those_of_the_script():
    """Every message of the document is in the script, in these words."""
    pieces = documented_pieces()
    assert len(pieces) >= 20
    for piece in pieces:
        assert piece in with_dots(JOINED), piece


def test_refusals_are_all_in_the_document():
    codes = "ENVIRONMENT|CONFLICT|NOT_WRITABLE|RESTART"
    pattern = rf'(?:fail|problem) "\$(?:{codes})"\s*\\?\s*"([^"]*)"'
    found = [with_dots(text) for text in re.findall(pattern, JOINED)]
    assert len(found) >= 14
    for text in found:
        assert any(piece in text for piece in documented_pieces()), text


def test_links():
    assert link_problems(TEXT, DOCUMENT) == []
