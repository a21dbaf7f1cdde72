"""Hosts on Python 2.7."""

from __future__ import annotations

import os

import pytest

from simprinter.hosts import python2
from simprinter.hosts.hosts import HostError, named_checkouts, named_host
from simprinter.plugin_printer import start
from simprinter.running import SAMPLE


def test_checkout_may_name_its_python(tmp_path):
    assert python2.named(str(tmp_path)) == (tmp_path, None)
    given = python2.named(f"{tmp_path}@python2.7")
    assert given == (tmp_path, "python2.7")
    # A folder may have such a name
    odd = tmp_path / "klipper@home"
    odd.mkdir()
    assert python2.named(str(odd)) == (odd, None)


@pytest.mark.parametrize(
    ("source", "wanted"),
    [("import os, Queue as queue", True), ("import queue", False)],
)
def test_one_that_runs_on_nothing_else_gets_it(tmp_path, source, wanted):
    (tmp_path / "klippy").mkdir()
    (tmp_path / "klippy" / "reactor.py").write_text(source)
    assert python2.is_wanted(python2.Named(tmp_path, None)) is wanted
    assert python2.is_wanted(python2.Named(tmp_path, "/opt/python2.7"))


def test_other_interpreters_are_refused(tmp_path):
    with pytest.raises(HostError, match="give python2.7 or its path"):
        python2.is_wanted(python2.Named(tmp_path, "python3.9"))
    with pytest.raises(HostError, match="/no/python2.7 is none: install it"):
        python2.interpreter(python2.Named(tmp_path, "/no/python2.7"))


def test_shim_that_starts_nothing_is_passed_over(tmp_path, monkeypatch):
    """As pyenv has one for each Python that is not chosen."""
    home = tmp_path / "home"
    versions = home / ".pyenv" / "versions" / "2.7.18" / "bin"
    for folder, program in (
        (tmp_path, "exit 127"),
        (versions, "echo 2.7"),
    ):
        folder.mkdir(parents=True, exist_ok=True)
        file = folder / "python2.7"
        file.write_text(f"#!/bin/sh\n{program}\n")
        file.chmod(0o755)
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    found = python2.interpreter(python2.Named(tmp_path, None))
    assert found == versions / "python2.7"


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("checkout", named_checkouts(), ids=str)
def test_klippy_homes_on_python_2(checkout):
    try:
        python2.interpreter(checkout)
    except HostError as error:
        pytest.skip(str(error))
    host = named_host(f"{checkout.folder}@python2.7")
    assert host.name.endswith("-python2")
    files = (SAMPLE / "printer.cfg", SAMPLE / "world.toml")
    with start(host, *files) as printer:
        printer.run("G28")
        assert printer.status("toolhead")["homed_axes"] == "xyz"
        assert "Python: '2.7" in printer.session.log()
