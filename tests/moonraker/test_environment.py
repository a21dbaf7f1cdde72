"""The environment of Moonraker: with no root, no libsodium, no network."""

from __future__ import annotations

from pathlib import Path

import pytest

from simprinter.hosts import moonraker_package
from simprinter.hosts.environment import HostError, UnavailableError, run
from simprinter.hosts.hosts import missing_hosts

# A machine that has no libsodium, neither by that name nor elsewhere
WITHOUT_LIBSODIUM = """
import ctypes, ctypes.util, os
load = ctypes.cdll.LoadLibrary
def load_own(name):
    if not os.path.dirname(name) or name.startswith("/usr"):
        raise OSError("there is no " + name)
    return load(name)
ctypes.util.find_library = lambda name: None
ctypes.cdll.LoadLibrary = load_own
import libnacl
assert libnacl.crypto_sign_seed_keypair(bytes(32))
print(libnacl.nacl._name)
"""


def test_libsodium_of_the_environment_is_enough(moonraker_python):
    program = [moonraker_python, "-c", WITHOUT_LIBSODIUM]
    library = Path(run(program, "libnacl").strip())
    assert library.parent.name == "libnacl"
    assert "pyzmq.libs" in library.resolve().parts


@pytest.fixture
def no_network(tmp_path, monkeypatch):
    """An empty build directory, and no package index."""

    def refuse(*_arguments):
        raise UnavailableError("no network")

    monkeypatch.setenv("BUILD_DIR", str(tmp_path))
    monkeypatch.delenv("ALLOW_MISSING_HOSTS", raising=False)
    monkeypatch.setattr(moonraker_package, "ensure", refuse)


def test_missing_moonraker_is_an_error(no_network):
    with pytest.raises(UnavailableError, match="^moonraker cannot be had: no"):
        moonraker_package.find_moonraker()


def test_missing_moonraker_may_be_left_out(no_network, monkeypatch, capsys):
    monkeypatch.setenv("ALLOW_MISSING_HOSTS", "1")
    assert moonraker_package.find_moonraker() is None
    reason = "moonraker cannot be had: no network"
    assert f"NOT TESTED: {reason}" in capsys.readouterr().err
    assert missing_hosts() == {"moonraker": reason}


def test_moonraker_without_libsodium_is_missing(no_network, monkeypatch):
    python = Path("python")
    monkeypatch.setattr(moonraker_package, "ensure", lambda *_arguments: python)
    monkeypatch.setattr(
        moonraker_package, "lend_libsodium", lambda _python: None
    )

    def run_in_vain(*_arguments):
        raise HostError("Could not locate nacl lib")

    monkeypatch.setattr(moonraker_package, "run", run_in_vain)
    with pytest.raises(UnavailableError, match="libsodium23\\)\nCould not"):
        moonraker_package.find_moonraker()
