"""Look whether this commit may become a release, and print the commands that tag it.

    python3 -m tools.release

It needs a clean tree on main, one version everywhere, an entry for it in CHANGELOG.md
with the date of today, no tag of that name, and the whole suite: .ci/run notes the
commit that has passed it.  Nothing is tagged or pushed.
"""

from __future__ import annotations

import datetime
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MODULES = (
    "z_calibration.py",
    "auto_z_offset.py",
    "dockable_probe.py",
    "extra_probe.py",
    "z_touch/__init__.py",
)
VERSION = re.compile(r'(?m)^__version__ = "(\d+\.\d+\.\d+)"$')
ENTRY = re.compile(r"(?m)^## \[(\S+)\](?: - (\d{4}-\d\d-\d\d))?$")
# Below the folder of the build: the commit for which .ci/run has passed
PASSED = "suite-passed"


def git(root: Path, *words: str) -> str:
    """What git says, without the end of its last line; empty if it fails."""
    command = ["git", "-C", str(root), *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.stdout.strip()


def versions(root: Path) -> set[str]:
    """The versions that the modules and their folder have; "" where one has none."""
    found = set()
    for name in MODULES:
        match = VERSION.search((root / name).read_text(encoding="utf-8"))
        found.add(match[1] if match else "")
    return found


def reasons(root: Path, build: Path, today: datetime.date) -> Iterator[str]:
    """Why this commit may not be tagged, each as a sentence."""
    if changed := git(root, "status", "--porcelain"):
        yield f"The tree is not clean; commit or remove: {changed}"
    if (branch := git(root, "rev-parse", "--abbrev-ref", "HEAD")) != "main":
        yield f"This is branch {branch}; releases are made of main."
    found = versions(root)
    if len(found) != 1 or "" in found:
        yield f"The modules have several versions: {sorted(found)}."
        return
    (version,) = found
    text = (root / "CHANGELOG.md").read_text(encoding="utf-8")
    entry = ENTRY.search(text)
    if entry is None or entry[1] != version:
        newest = entry[1] if entry else "nothing"
        yield (
            f"CHANGELOG.md begins with {newest}, the modules have {version};"
            " write the entry of this version on top."
        )
    elif entry[2] != today.isoformat():
        yield f"CHANGELOG.md dates {version} {entry[2]}; today is {today}."
    if git(root, "tag", "--list", f"v{version}"):
        yield f"The tag v{version} is there already; raise the version."
    passed = build / PASSED
    commit = git(root, "rev-parse", "HEAD")
    if not passed.exists() or passed.read_text().strip() != commit:
        yield "The suite has not passed for this commit: run .ci/run."


def main(root: Path = ROOT) -> int:
    """Print the reasons, or the commands; 1 if there are reasons."""
    build = root / os.environ.get("BUILD_DIR", "build")
    found = list(reasons(root, build, datetime.date.today()))
    if found:
        sys.stderr.write("Not yet:\n" + "".join(f"  {r}\n" for r in found))
        return 1
    (version,) = versions(root)
    sys.stdout.write(
        f"git tag -a v{version} -m 'Version {version}'\n"
        f"git push origin main v{version}\n"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
