"""docs/installation.md says what install.sh does."""

from __future__ import annotations

import os
import re

import pytest

from tests.docs.documents import link_problems, part, rows, spans
from tests.install.box import ORIGIN, REPO, Box

DOCUMENT = REPO / "docs" / "installation.md"
README = REPO / "README.md"
EXAMPLE = REPO / "examples" / "moonraker.conf"
TEXT = DOCUMENT.read_text()
SCRIPT = (REPO / "install.sh").read_text()
LINK = "klippy/extras/z_calibration.py"


def commands(text, title, language="sh"):
    """The lines to type below a heading."""
    blocks = re.findall(rf"```{language}\n(.*?)```", part(text, title), re.S)
    return "\n".join(blocks)


def typed(box: Box, lines):
    """Type lines into a shell in the box; ADDRESS is that of a clone."""
    source = box.directory / "source"
    if not source.exists():
        box.clone(source)
    script = "set -e\n" + lines.replace("ADDRESS", str(source))
    outcome = box.command(["bash", "-c", script])
    assert (outcome.code, outcome.err) == (0, ""), outcome
    return outcome.out


@pytest.fixture
def home(machine):
    """A machine on which our checkout has not been cloned yet."""
    machine.checkout.rename(machine.directory / "source")
    quiet = "[advice]\n    detachedHead = false\n"
    (machine.home / ".gitconfig").write_text(quiet)
    return machine


def cloned(text):
    return text.replace("git clone", "git clone -q")


@pytest.mark.parametrize(
    ("file", "title"), [(DOCUMENT, "With the script"), (README, "Install")]
)
def test_with_the_script(home, file, title):
    language = "sh" if file is DOCUMENT else ""
    typed(home, cloned(commands(file.read_text(), title, language)))
    assert home.restarted() == ["klipper", "moonraker"]
    link = home.home / "klipper" / LINK
    assert os.readlink(link) == str(home.checkout / "z_calibration.py")
    conf = home.home / "printer_data/config/moonraker.conf"
    assert "path: ~/klipper_z_calibration\n" in conf.read_text()


def test_by_hand_is_what_the_script_does(home):
    typed(home, cloned(commands(TEXT, "By hand")))
    klipper = home.home / "klipper"
    link = klipper / LINK
    assert os.readlink(link) == str(home.checkout / "z_calibration.py")
    assert home.git(klipper, "status", "--porcelain") == ""
    conf = home.conf(text="[server]\n" + EXAMPLE.read_text())
    source = str(home.directory / "source")
    conf.write_text(conf.read_text().replace("ADDRESS", source))
    out = home.installed("--modules", "z_calibration", "--force")
    assert "[OK, already linked]" in out
    assert "[SKIPPED, already there]" in out
    assert "Nothing changed" in out


def test_example_is_the_section_of_the_script(machine):
    machine.installed()
    conf = machine.home / "printer_data/config/moonraker.conf"
    section = conf.read_text().partition("z_calibration\n")[2]
    lines = EXAMPLE.read_text().replace("ADDRESS", ORIGIN).splitlines()
    kept = [line for line in lines if line and not line.startswith("#")]
    assert "\n".join(kept) + "\n" == section


def test_kalico(box):
    box.kalico("kalico")
    box.checkout.rename(box.directory / "source")
    override = re.findall(r"```ini\n(.*?)```", part(TEXT, "On Kalico"), re.S)
    config = box.conf().parent / "printer.cfg"
    lines = cloned(commands(TEXT, "On Kalico"))
    by_hand, _, alone = lines.partition("\n\n")
    typed(box, by_hand)
    plugins = box.home / "kalico/klippy/plugins"
    assert (plugins / "z_calibration.py").is_symlink()
    typed(box, alone)
    assert (plugins / "auto_z_offset.py").is_symlink()
    assert box.git(box.home / "kalico", "status", "--porcelain") == ""
    (plugins / "z_calibration.py").unlink()
    assert box.run().code == 4
    config.write_text("".join(override))
    box.installed()


def test_change_from_the_original_plugin(home):
    old = home.clone(home.home / "klipper_z_calibration")
    (home.home / "klipper" / LINK).symlink_to(old / "z_calibration.py")
    conf = home.conf(
        text="[update_manager client z_calibration]\ntype: git_repo\n"
        "path: /home/pi/klipper_z_calibration\norigin: https://example.com/\n"
        "install_script: install.sh\nmanaged_services: klipper\n"
    )
    typed(home, cloned(commands(TEXT, "Coming from another version")))
    assert "install_script" not in conf.read_text()
    assert "path: ~/klipper_z_calibration\n" in conf.read_text()
    (home.home / "klipper_z_calibration.old").rename(home.home / "gone")
    text = (home.home / "klipper" / LINK).read_bytes()
    assert text == (REPO / "z_calibration.py").read_bytes()


def test_update_and_uninstall(home):
    typed(home, cloned(commands(TEXT, "With the script")))
    typed(home, commands(TEXT, "Updating"))
    status = commands(TEXT, "What does -dirty mean?")
    assert typed(home, status) == ""
    (home.home / "klipper/klippy/extras/probe.py").write_text("new = 1\n")
    assert typed(home, status) == " M klippy/extras/probe.py\n"
    typed(home, commands(TEXT, "Uninstalling"))
    assert not os.path.lexists(home.home / "klipper" / LINK)
    assert not home.checkout.exists()


def test_options_are_those_of_the_script(machine):
    table, codes = [], []
    for row in rows(part(TEXT, "Options of the script")):
        (codes if row[0].isdigit() else table).append(row)
    documented = {span.split()[0] for row in table for span in spans(row[0])}
    shown = machine.installed("--help")
    lines = "\n".join(re.findall(r"^  ..(?=-)?.*", shown, re.M))
    assert documented == set(re.findall(r"(?<!\S)--?[a-z][a-z-]*", lines))
    numbers = re.findall(r"[A-Z_]+=(\d)", SCRIPT.partition("# Options")[0])
    assert [row[0] for row in codes] == ["0", *numbers]


JOINED = re.sub(r'"\s*\\\n\s*"', " ", SCRIPT)


def with_dots(text):
    """A text of the script with ... for what varies."""
    return re.sub(r"\$\{[^}]*\}|\$\w+|\$\([^)]*\)", "...", text)


def documented_pieces():
    """The messages of the document, cut where something varies."""
    table = rows(part(TEXT, "What does this message mean?"))
    shown = [span for row in table for span in spans(row[0])]
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
    assert len(found) >= 15
    for text in found:
        assert any(piece in text for piece in documented_pieces()), text


def test_links():
    assert link_problems(TEXT, DOCUMENT) == []
