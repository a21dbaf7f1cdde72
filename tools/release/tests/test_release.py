"""python3 -m tools.release, on repositories of a few files."""

from __future__ import annotations

import datetime
import shutil
import subprocess
from pathlib import Path

import pytest

from tools.release.__main__ import MODULES, PASSED, main

TODAY = datetime.date.today().isoformat()
CHANGELOG = f"# Changelog\n\n## [1.2.3] - {TODAY}\n\nWhat it is.\n"


def git(root: Path, *words: str) -> str:
    """Run git there."""
    who = ("-c", "user.name=n", "-c", "user.email=e@example.com")
    command = ["git", "-C", str(root), *who, *words]
    return subprocess.run(
        command, check=True, capture_output=True, text=True
    ).stdout.strip()


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository that may be released."""
    monkeypatch.setenv("BUILD_DIR", "build")
    for name in MODULES:
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text('__version__ = "1.2.3"\n')
    (tmp_path / "CHANGELOG.md").write_text(CHANGELOG)
    (tmp_path / ".gitignore").write_text("build\n")
    git(tmp_path, "init", "-q", "-b", "main")
    commit(tmp_path)
    return tmp_path


def commit(root: Path) -> None:
    """All that is there, as the commit for which the suite has passed."""
    git(root, "add", "-A")
    git(root, "commit", "-q", "--allow-empty", "-m", "all")
    (root / "build").mkdir(exist_ok=True)
    (root / "build" / PASSED).write_text(git(root, "rev-parse", "HEAD") + "\n")


def test_commands_are_printed(root, capsys):
    assert main(root) == 0
    assert capsys.readouterr().out == (
        "git tag -a v1.2.3 -m 'Version 1.2.3'\ngit push origin main v1.2.3\n"
    )
    assert git(root, "tag") == ""


def broken(root: Path, what: str) -> None:
    """Make one thing wrong."""
    changelog = root / "CHANGELOG.md"
    if what == "tree":
        (root / "new").write_text("")
    elif what == "branch":
        git(root, "checkout", "-q", "-b", "other")
    elif what == "versions":
        (root / MODULES[0]).write_text('__version__ = "1.2.4"\n')
        commit(root)
    elif what == "entry":
        changelog.write_text("# C\n\n## [Unreleased]\n" + CHANGELOG)
        commit(root)
    elif what == "date":
        changelog.write_text(CHANGELOG.replace(TODAY, "2020-02-29"))
        commit(root)
    elif what == "tag":
        git(root, "tag", "v1.2.3")
    elif what == "suite":
        git(root, "commit", "-q", "--allow-empty", "-m", "later")
    elif what == "no suite":
        shutil.rmtree(root / "build")


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("tree", "The tree is not clean; commit or remove: ?? new"),
        ("branch", "This is branch other; releases are made of main."),
        ("versions", "several versions: ['1.2.3', '1.2.4']."),
        ("entry", "begins with Unreleased, the modules have 1.2.3;"),
        ("date", "dates 1.2.3 2020-02-29; today is"),
        ("tag", "The tag v1.2.3 is there already;"),
        ("suite", "The suite has not passed for this commit:"),
        ("no suite", "The suite has not passed for this commit:"),
    ],
)
def test_what_is_missing_is_told(root, capsys, what, words):
    broken(root, what)
    assert main(root) == 1
    said = capsys.readouterr()
    assert words in said.err
    assert said.err.count("\n") == 2, "one reason"
    assert said.out == ""


def test_the_suite_leaves_what_is_looked_for():
    repository = Path(__file__).resolve().parents[3]
    text = (repository / ".ci" / "run").read_text(encoding="utf-8")
    assert text.index("make test-rest") < text.index(PASSED)
