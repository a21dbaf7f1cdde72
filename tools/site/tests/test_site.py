"""make docs: every page is there, no link is dead, nothing comes from elsewhere."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from simprinter.hosts.environment import REPO_ROOT, build_dir
from tools.site.__main__ import BEHIND, CONFIG, PAGES, build, indented, stage

PAGES_OF_DOCS = sorted(path.stem for path in REPO_ROOT.glob("docs/*.md"))
# What a reader's browser loads by itself
LOADED = re.compile(
    r"<(?:script|img|iframe|source)\b[^>]*\ssrc=[\"']?([^\"'\s>]+)"
    r"|<link\b(?![^>]*rel=[\"']?(?:canonical|next|prev))[^>]*"
    r"\shref=[\"']?([^\"'\s>]+)"
    r"|url\(([^)]+)\)"
)


def test_lists_are_indented_by_four():
    text = "1. a\n   b\n\n   ```\n   G28\n     x\n   ```\n- c\n  - d\n    e\nf"
    wanted = "1. a\n    b\n\n    ```\n    G28\n      x\n    ```\n- c\n    - d\n        e\nf"
    assert "\n".join(indented(text)) == wanted


@pytest.fixture(scope="module")
def python() -> str:
    """The Python with mkdocs, which the package index has."""
    directory = build_dir() / "docs-venv"
    module = "simprinter.hosts.environment"
    done = subprocess.run(
        [sys.executable, "-m", module, str(directory), "docs"],
        cwd=REPO_ROOT,
        capture_output=True,
        text=True,
    )
    if done.returncode:
        pytest.skip(f"NOT TESTED: {(done.stdout + done.stderr).strip()}")
    return str(directory / "bin" / "python")


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """What the site is made of."""
    stage(tmp_path / PAGES)
    return tmp_path / PAGES


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_site_has_every_page_and_loads_nothing_from_elsewhere(
    python, source, tmp_path
):
    site = tmp_path / "site"
    assert build(source, site, python) == 0
    for name in PAGES_OF_DOCS:
        assert (site / "docs" / name / "index.html").exists(), name
    index = json.loads((site / "search" / "search_index.json").read_text())
    found = {entry["location"].partition("#")[0] for entry in index["docs"]}
    assert found >= {f"docs/{name}/" for name in PAGES_OF_DOCS}
    for path in [*site.rglob("*.html"), *site.rglob("*.css")]:
        for places in LOADED.findall(path.read_text(encoding="utf-8")):
            place = "".join(places).strip("\"'")
            assert not re.match(r"(?:https?:)?//", place), (path, place)
    home = (site / "index.html").read_text(encoding="utf-8")
    assert "Quick starts" in home
    # Both themes, and both languages
    for scheme in ("default", "slate"):
        assert f'data-md-color-scheme="{scheme}"' in home
    assert '<html lang="en"' in home
    for page in ("zh", "zh/quickstart_qidi"):
        text = (site / "docs" / page / "index.html").read_text(encoding="utf-8")
        assert '<html lang="zh-Hans"' in text
    for page in ("index.html", "docs/setup/index.html"):
        text = (site / page).read_text(encoding="utf-8")
        assert text.count('hreflang="zh"') == 2


def test_titles_fit_and_say_what_a_page_is():
    text = CONFIG.read_text(encoding="utf-8").partition("\nnav:")[2]
    titles = re.findall(r"- ([^:\n]+): \S+\.md", text)
    assert len(titles) == len(re.findall(r"\.md\b", text))
    assert max(map(len, titles)) <= 24


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_tables_come_behind_the_pages_in_search(python, source, tmp_path):
    assert build(source, tmp_path / "site", python) == 0
    index = tmp_path / "site" / "search" / "search_index.json"
    for entry in json.loads(index.read_text())["docs"]:
        page = entry["location"].partition("#")[0].strip("/")
        wanted = 0.0005 if f"{page}.md" in BEHIND else 1.0
        if page.startswith("docs/zh"):
            wanted = 0.5
        assert entry.get("boost", 1.0) == wanted, page


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("what", ["file", "heading", "orphan"])
def test_dead_links_and_orphans_are_errors(python, source, tmp_path, what):
    page = source / "docs" / "setup.md"
    if what == "orphan":
        page = page.with_name("nowhere.md")
        page.write_text("# Nobody is led here\n")
    else:
        link = {"file": "gone.md", "heading": "accuracy.md#gone"}[what]
        page.write_text(f"{page.read_text()}\n[gone]({link})\n")
    assert build(source, tmp_path / "site", python) != 0
