"""What README.md and the pages behind it tell a new owner, done literally."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from simprinter.hosts.environment import build_dir
from simprinter.hosts.hosts import all_hosts, missing_hosts
from tests.docs.documents import blocks, link_problems, nodes, part
from tests.docs.pictures import numbers
from tests.modules.example_owners import OWNERS
from tests.modules.test_z_calibration_examples import (
    assert_ready_to_print,
    assert_soft_and_clean,
    print_start,
)
from tools.kit.cases import all_slow_but
from tools.kit.lab import copy_own_files

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
CHINESE = ROOT / "docs" / "zh"
DOCUMENTS = sorted(
    [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *CHINESE.glob("*.md")]
)
SETUP = [
    ROOT / "docs" / "quickstart_voron_klicky.md",
    ROOT / "docs" / "setup.md",
]


def settings(document: Path) -> str:
    """What a document gives for printer.cfg: its first section, its macro."""
    text = document.read_text(encoding="utf-8")
    if document == SETUP[0]:
        # What the set-up has found, and the macro
        titles = (
            "3. Let the dialogs find the rest (seven minutes)",
            "4. Use it in PRINT_START (one minute)",
        )
    else:
        titles = ("printer.cfg", "PRINT_START")
    return "\n".join(blocks(part(text, t), "ini")[0] for t in titles)


@pytest.mark.parametrize("document", SETUP, ids=lambda path: path.name)
def test_shortest_way_ends_at_the_right_height(start, tmp_path, document):
    owner = OWNERS["voron24_klicky"]
    file = tmp_path / "mine.cfg"
    file.write_text(settings(document))
    changes = {f"include {file}": {}}
    if document != SETUP[0]:
        # The mesh of an earlier day
        owner = owner.__class__(owner.scene, owner.bed)
    printer = start(owner.scene, changes=changes)
    lines = print_start(printer)
    assert_soft_and_clean(lines)
    assert_ready_to_print(printer, owner)


def test_section_of_the_quick_start_is_enough_to_begin(start, tmp_path):
    text = SETUP[0].read_text(encoding="utf-8")
    file = tmp_path / "mine.cfg"
    file.write_text(
        blocks(part(text, "2. Write a section (one minute)"), "ini")[0]
    )
    owner = OWNERS["voron24_klicky"]
    printer = start(owner.scene, changes={f"include {file}": {}})
    printer.session.require_ready()
    lines = printer.run("Z_CALIBRATION_SETUP")
    assert "// action:prompt_show" in lines
    assert "nothing was saved" in "\n".join(
        printer.run("Z_CALIBRATION_SETUP STEP=ABORT")
    )


def typed(title: str) -> list[str]:
    """What docs/setup.md has typed below a heading, a list each."""
    text = SETUP[1].read_text(encoding="utf-8")
    return [code.strip() for code in blocks(part(text, title), "")]


@pytest.mark.slow
def test_first_run_and_a_position_found_by_hand(start, tmp_path):
    owner = OWNERS["voron24_klicky"]
    document = SETUP[1]
    file = tmp_path / "mine.cfg"
    file.write_text(settings(document))
    printer = start(owner.scene, changes={f"include {file}": {}})
    truth = printer.machine.truth
    printer.session.require_ready()
    by_hand = typed("switch_xy_position by hand")
    assert len(by_hand) == 6
    printer.run(by_hand[0])
    before = len(truth.touches)
    for lines in by_hand[1:]:
        printer.run(lines)
        if lines == "GET_POSITION":
            probe = printer.scene.world.mag_probe
            free = 12.0 - probe.body_drop - printer.scene.world.pin.z
            assert 2.0 < free < 4.5
    assert len(truth.touches) == before, "something was touched"
    offsets = []
    for lines in typed("The first run"):
        text = "\n".join(printer.run(lines))
        offsets += map(float, re.findall(r"new offset=([-\d.]+)\n", text))
    assert len(offsets) == 2
    assert abs(offsets[0] - offsets[1]) < 0.01
    assert truth.min_gap > 0.0
    assert printer.status("toolhead")["position"][:2] == [150.0, 150.0]


def test_numbers_of_the_readme_are_those_of_the_picture():
    """README, picture and document show one run."""
    line = re.search(r"Z-CALIBRATION: .*", README.read_text())[0]
    document = (ROOT / "docs" / "z_calibration.md").read_text(encoding="utf-8")
    assert f"// {line}\n" in document
    heights = {k: float(v) for k, v in re.findall(r"(\w+)=([\d.]+)", line)}
    assert heights == pytest.approx(numbers("z_calibration"))


def test_readme_is_short_and_begins_with_what_one_can_try():
    text = README.read_text(encoding="utf-8")
    lines = text.splitlines()
    assert {"make demo", "make printer", "make test"} <= {
        line.partition("#")[0].strip() for line in lines[:24]
    }


def test_the_address_stands_in_readme_alone():
    """At its top and where it is installed, in both languages; whoever publishes it
    looks nowhere else."""
    paths = [*DOCUMENTS, *ROOT.glob("examples/**/*"), ROOT / "install.sh"]
    texts = {p: p.read_text(encoding="utf-8") for p in paths if p.is_file()}
    found = re.findall(r"ADDRESS=([^\s;]+)", "".join(texts.values()))
    (address,) = set(found)
    readmes = [README, CHINESE / "README.md"]
    for path in readmes:
        top, _, rest = texts[path].partition("\n## ")
        assert f"\ngit clone {address} " in top
        assert rest.count(address) == 2
    assert len(found) == 4
    assert {path for path in texts if address in texts[path]} == {*readmes}


# Commands


TITLE = "Trying it without a printer"
DEVELOPING = ROOT / "docs" / "developing.md"
TRYING = part(DEVELOPING.read_text(encoding="utf-8"), TITLE)


def commands() -> list[str]:
    """Every line of a shell that is there to try, without comments."""
    titles = "Install", "Z offset calibration for Klipper and Kalico"
    text = README.read_text(encoding="utf-8")
    first = part(text, titles[1]).partition("\n## ")[0]
    shown = "".join(
        code
        for body in (first, part(text, titles[0]), TRYING)
        for code in blocks(body, "")
    )
    lines = [line.partition("#")[0].strip() for line in shown.splitlines()]
    inline = re.findall(r"`((?:make |build/venv)[^`]*)`", TRYING)
    inline = [" ".join(line.split()) for line in inline]
    return list(dict.fromkeys([*filter(None, lines), *inline]))


INSTALLING = {
    # Typed by tests/install/test_installation_doc.py
    "ADDRESS=https://example.com/OWNER/NAME.git",
    'git clone "$ADDRESS" ~/klipper_z_calibration &&'
    " ~/klipper_z_calibration/install.sh",
    # The same way as in developing.md, whose clone test_the_way_to_the_demo types
    "git clone https://example.com/OWNER/NAME.git z_calibration"
    " && cd z_calibration",
}
# By test_the_way_to_the_demo
DEMO = {
    "git clone ADDRESS ~/klipper_z_calibration",
    "cd ~/klipper_z_calibration",
    "make demo",
}
# What follows the command, so that it does not run this test again
ADDED = {
    # By tools/playground
    "make printer": " --dry-run",
    # The same with more hosts is below
    "make test": " --dry-run",
    "make test-rest": " --dry-run",
    "KLIPPER_PATH=~/klipper:~/kalico make test": " PYTEST_ARGS=--version",
    "make demo DEMO_ARGS=--help": "",
}
# What collects no tests
SHORT = [
    name for name in ADDED if name.startswith("make ") and "demo" not in name
]
EXPECTED = {
    "make printer": r"-m tools\.playground",
    "make test": r"-m pytest --cases test -n \d",
    "make test-rest": r"-m pytest --cases rest -n \d",
    "KLIPPER_PATH=~/klipper:~/kalico make test": r"klipper@klipper.*\nkalico@",
    "make demo DEMO_ARGS=--help": r"--scene",
}


def test_every_command_is_known():
    assert set(commands()) == {*INSTALLING, *DEMO, *ADDED}


@pytest.fixture
def home(tmp_path):
    """A home with a Kalico, and one without plugins, as Klipper has none."""
    found = [h.directory / "base" for h in all_hosts() if h.name == "kalico"]
    if not found:
        reason = missing_hosts().get("kalico", "Kalico is not the one host")
        pytest.skip(f"NOT TESTED: {reason}")
    (base,) = found
    (tmp_path / "kalico").symlink_to(base)
    shutil.copytree(base / "klippy", tmp_path / "klipper" / "klippy")
    shutil.rmtree(tmp_path / "klipper" / "klippy" / "plugins")
    return tmp_path


@pytest.mark.timeout(300)
@pytest.mark.parametrize("command", all_slow_but(SHORT, ADDED))
def test_command_works(home, command):
    env = {**os.environ, "HOME": str(home), "KLIPPER_PATH": ""}
    # build/ is where the running tests have it
    env["BUILD_DIR"] = os.path.relpath(build_dir(), ROOT)
    line = command.replace("build/venv", f"{env['BUILD_DIR']}/venv")
    done = subprocess.run(
        ["bash", "-c", line + ADDED[command]],
        cwd=ROOT,
        env=env,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(EXPECTED[command], done.stdout), done.stdout


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_the_way_to_the_demo(home):
    """From the clone to the true gap; make test is above."""
    origin = home / "origin"
    copy_own_files(origin)
    begin = (
        "git init -q && git add -A && git -c user.name=n"
        " -c user.email=e@example.com commit -q -m all"
    )
    subprocess.run(begin, shell=True, cwd=origin, check=True)
    lines = blocks(TRYING, "")[0]
    lines = lines.replace("ADDRESS", str(origin)).replace("make test", "true")
    env = {**os.environ, "HOME": str(home), "KLIPPER_PATH": ""}
    env["BUILD_DIR"] = str(build_dir())
    done = subprocess.run(
        ["bash", "-ec", lines], env=env, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "new offset=" in done.stdout


# Words of Klipper, of web interfaces and of others' macros
FOREIGN = """
expected_bed_probe_z bed_probe_max_deviation
QUERY_ENDSTOPS QUERY_PROBE RESTORE_GCODE_STATE Internal klippy base
smart_effector qdprobe extra_probe rename_existing client macros CHAMBER
KAMP_Settings variable_probe_dock_enable SHAPER_CALIBRATE"""
KNOWN_TEXTS = [
    ROOT / "docs" / "setup.md",
    ROOT / "docs" / "accuracy.md",
    ROOT / "docs" / "z_calibration.md",
    ROOT / "docs" / "auto_z_offset.md",
    ROOT / "docs" / "extra_probe.md",
    ROOT / "docs" / "messages.md",
    ROOT / "docs" / "all_messages.csv",
    ROOT / "docs" / "old_names.csv",
    ROOT / "docs" / "installation.md",
    ROOT / "examples" / "moonraker.conf",
    ROOT / "examples" / "z_calibration" / "calibrate_macros.cfg",
    ROOT / "examples" / "z_calibration" / "plates.cfg",
    ROOT / "examples" / "z_calibration" / "voron24_klicky.cfg",
    ROOT / "examples" / "auto_z_offset" / "q1_pro.cfg",
]


@pytest.mark.parametrize("name", ["troubleshooting", "migration", "faq"])
def test_words_exist(name):
    """What these documents call by its name is described elsewhere."""
    known = "\n".join(path.read_text() for path in KNOWN_TEXTS)
    text = (ROOT / "docs" / f"{name}.md").read_text()
    text = re.sub(r"(?ms)^```.*?^```", "", text)
    spans = re.findall(r"`([^`]+)`", text)
    words = set(re.findall(r"[A-Za-z_]{4,}", " ".join(spans)))
    assert len(words) >= 10
    unknown = {w for w in words if w not in known} - set(FOREIGN.split())
    assert unknown == set()


# Links


@pytest.mark.parametrize(
    "document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT))
)
def test_links(document):
    text = document.read_text(encoding="utf-8")
    assert link_problems(text, document) == []


def plain(code: str) -> list[str]:
    """The lines of a block without their comments."""
    lines = [line.partition("#")[0].rstrip() for line in code.splitlines()]
    return [line for line in lines if line]


@pytest.mark.parametrize(
    "document", sorted(CHINESE.glob("*.md")), ids=lambda path: path.name
)
def test_chinese_shows_the_same_code(document):
    """What is typed and pasted was run in the English page."""
    english = README if document.name == "README.md" else None
    english = english or ROOT / "docs" / document.name
    shown = {
        path: [
            (fence.info, plain(fence.content))
            for fence in nodes(path.read_text(encoding="utf-8"), "fence")
        ]
        for path in (document, english)
    }
    assert shown[document] == shown[english]
    commands = [
        {*re.findall(r"`([A-Z][A-Z_]{3,}[^`]*)`", path.read_text("utf-8"))}
        for path in (document, english)
    ]
    words = {word.split()[0] for word in commands[0] - commands[1]}
    known = "".join(
        path.read_text("utf-8") for path in (*ROOT.glob("docs/*.md"), README)
    )
    assert [word for word in words if word not in known] == []


def test_everything_of_the_quick_starts_is_there_in_chinese():
    wanted = {path.name for path in ROOT.glob("docs/quickstart_*.md")}
    assert {p.name for p in CHINESE.glob("*.md")} == {"README.md", *wanted}


def test_everything_is_linked_from_the_readme():
    text = README.read_text()
    for path in [*ROOT.glob("docs/*.md"), *ROOT.glob("examples/*/*.cfg")]:
        name = str(path.relative_to(ROOT))
        folder = str(path.parent.relative_to(ROOT))
        assert f"]({name}" in text or f"]({folder})" in text, name
