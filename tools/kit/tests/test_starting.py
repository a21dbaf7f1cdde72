"""A klippy that is forked is one that was started."""

from __future__ import annotations

import json
import os
from contextlib import ExitStack

import pytest

from simprinter.hosts import session, starting
from tools.kit.printer import Printer, module_files

# What a module finds of the process that it is in
LOOK = """
import gc, json, os, random, signal, sys, threading

def load_config(config):
    main = sys.modules["__main__"]
    with open(config.get("file"), "w") as out:
        json.dump({
            "main": (main.__file__, main.__package__ or "", main.__name__),
            "cwd": os.getcwd(),
            "path": [os.path.abspath(entry) for entry in sys.path],
            "environment": dict(os.environ),
            "threads": [type(t).__name__ for t in threading.enumerate()],
            "argv": sys.argv[:1],
            "stdin": os.fstat(0).st_rdev,
            "output": os.readlink("/proc/self/fd/1").split("/")[-1],
            "errors": os.readlink("/proc/self/fd/2").split("/")[-1],
            "child": signal.getsignal(signal.SIGCHLD),
            "collects": gc.isenabled(),
            "pid": os.getpid(),
            "parent": os.getppid(),
            "random": random.random(),
        }, out)
    return object()
"""
# Differs from one start to the next
OWN = ("pid", "parent", "random")


@pytest.fixture
def started(monkeypatch):
    """After a call klippies are started as on a printer."""

    def begin(installed, options, clock, output, config):
        return starting.start(installed, options, clock, output)

    return lambda: monkeypatch.setattr(session, "fork", begin)


@pytest.fixture
def look(tmp_path, host):
    """look(): what a module sees of its process."""
    source, found = tmp_path / "look.py", tmp_path / "found.json"
    source.write_text(LOOK)
    modules = {**module_files(), "look": source}

    def look():
        changes = {"look": {"file": str(found)}}
        with Printer(host, changes=changes, modules=modules) as printer:
            printer.session.require_ready()
            text = found.read_text()
            data = str(printer.session.data)
            page = printer.machine.simulation.clock.page
        return json.loads(text.replace(data, "DATA").replace(page, "PAGE"))

    return look


def test_forked_klippy_finds_itself_as_if_started(look, started):
    forked, again = look(), look()
    started()
    plain = look()
    assert plain["parent"] == os.getpid()
    assert forked["parent"] == again["parent"] != os.getpid()
    assert forked["pid"] != again["pid"]
    assert forked["random"] != again["random"]
    for name in OWN:
        del plain[name], forked[name]
    assert forked == plain


@pytest.mark.every_host("each host imports its modules in a way of its own")
def test_forked_klippy_does_the_same(host, started):
    def heights(printer):
        printer.homed().run("CALIBRATE_Z")
        touches = printer.machine.truth.touches
        return [(t.site, t.x, t.y, t.trigger_z) for t in touches]

    with Printer(host) as printer:
        forked = heights(printer)
    started()
    with Printer(host) as printer:
        assert heights(printer) == forked


def test_numbers_of_descriptors_may_be_high(host):
    """As those of one printer are where seven others live."""
    with ExitStack() as stack:
        while stack.enter_context(open(os.devnull)).fileno() < 530:
            pass
        printer = stack.enter_context(Printer(host))
        printer.session.require_ready()
