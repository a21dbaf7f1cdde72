"""What Moonraker and klippy say of an installation by install.sh."""

from __future__ import annotations

import pytest

from simprinter.hosts.trees import FOLDER_PARENT
from tests.moonraker.updates import calibrated, refreshed, restarted
from tools.kit.printer import FOLDER, MODULES


def test_klippy_has_the_modules_of_the_checkout(lab):
    # Where the host has a dockable_probe of its own, it stays
    kept = lab.klipper / "klippy" / "extras" / "dockable_probe.py"
    own = {kept.stem} if kept.exists() and not kept.is_symlink() else set()
    names = set(MODULES) - own
    links = [lab.module_dir / f"{name}.py" for name in names]
    for link in (*links, lab.klipper / FOLDER_PARENT / FOLDER):
        assert link.is_symlink()
        assert link.resolve() == (lab.checkout / link.name).resolve()
    objects = lab.moonraker.get("/printer/objects/list")["objects"]
    assert "z_calibration" in objects
    assert lab.moonraker.status("z_calibration")["phase"] == "idle"


def test_moonraker_has_nothing_to_complain_of(lab):
    info = lab.moonraker.get("/server/info")
    assert info["klippy_state"] == "ready"
    assert info["warnings"] == []
    assert info["failed_components"] == []
    assert info["missing_klippy_requirements"] == []
    assert "update_manager" in info["components"]


@pytest.mark.slow
def test_checkout_is_valid_and_pristine(lab):
    status = refreshed(lab)
    assert status["remote_url"] == f"file://{lab.directory}/origin.git"
    assert status["branch"] == "main"
    assert status["is_valid"] and status["pristine"]
    assert not status["is_dirty"] and not status["corrupt"]
    assert status["anomalies"] == status["warnings"] == []


def test_checkout_of_klipper_stays_clean(lab):
    assert lab.git(lab.klipper, "status", "--porcelain") == ""
    status = refreshed(lab, "klipper")
    assert status["is_valid"] and status["pristine"]
    # Only because it is not where Klipper comes from
    (anomaly,) = status["anomalies"]
    assert anomaly.startswith("Unofficial remote url")


def test_bytecode_in_the_checkout_is_nothing_new(lab):
    command = [str(lab.host.python), "-m", "compileall", "-q", "."]
    lab.run(command, lab.checkout)
    assert list(lab.checkout.glob("__pycache__/*.pyc"))
    assert refreshed(lab)["pristine"]


@pytest.mark.slow
def test_copy_of_one_module_and_the_folder_works(copied_lab):
    lab = copied_lab
    assert not list(lab.klipper.glob("klippy/*/auto_z_offset.py"))
    calibrated(lab)
    for command in ("RESTART", "FIRMWARE_RESTART"):
        restarted(lab, command)
        calibrated(lab)
