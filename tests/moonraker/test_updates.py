"""A new version of the modules comes and goes by Moonraker."""

from __future__ import annotations

import pytest

from simprinter.hosts.moonraker import MoonrakerError
from tests.moonraker.updates import (
    calibrated,
    refreshed,
    restarted,
    status_of,
)
from tools.kit.cases import slow


def help_text(lab):
    """What the console says of CALIBRATE_Z: klippy's own answer."""
    return lab.moonraker.get("/printer/gcode/help")["CALIBRATE_Z"]


def update(lab):
    """Let Moonraker install what there is."""
    lab.moonraker.post("/machine/update/client", name="z_calibration")


@pytest.fixture
def current(lab):
    """The lab with the latest release on it."""
    if refreshed(lab)["commits_behind_count"]:
        update(lab)
        lab.obey()
    return lab


def test_update_restarts_klippy_onto_the_new_commit(current):
    lab = current
    before = help_text(lab)
    assert status_of(lab)["commits_behind_count"] == 0
    expected = lab.release()
    status = refreshed(lab)
    assert status["commits_behind_count"] == 1
    assert status["is_valid"] and status["pristine"]
    offered = status["remote_version"]
    assert offered != status["version"]
    assert help_text(lab) == before
    update(lab)
    assert lab.obey() == ["klipper"]
    assert help_text(lab) == expected
    status = status_of(lab)
    assert status["version"] == offered
    assert status["commits_behind_count"] == 0
    assert status["is_valid"] and status["pristine"]
    assert lab.git(lab.klipper, "status", "--porcelain") == ""


@pytest.mark.slow
@pytest.mark.parametrize("command", ["RESTART", slow("FIRMWARE_RESTART")])
def test_klippy_that_is_not_restarted_works_with_the_old_module(
    current, command
):
    """Whatever of the new files it has not read before."""
    lab = current
    before, expected = help_text(lab), lab.release()
    refreshed(lab)
    update(lab)
    restarted(lab, command)
    assert help_text(lab) == before
    calibrated(lab)
    lab.obey()
    assert help_text(lab) == expected
    calibrated(lab)


@pytest.mark.slow
def test_rollback_restarts_klippy_onto_the_old_commit(current):
    lab = current
    before, version = help_text(lab), status_of(lab)["version"]
    expected = lab.release()
    refreshed(lab)
    update(lab)
    lab.obey()
    assert help_text(lab) == expected
    lab.moonraker.post("/machine/update/rollback", name="z_calibration")
    assert lab.obey() == ["klipper"]
    assert help_text(lab) == before
    status = refreshed(lab)
    assert status["version"] == version
    assert status["commits_behind_count"] == 1
    assert status["is_valid"] and status["pristine"]


def test_changed_checkout_is_not_updated(current):
    lab = current
    before = help_text(lab)
    lab.release()
    script = lab.checkout / "install.sh"
    script.chmod(0o644)
    try:
        refreshed(lab)
        with pytest.raises(MoonrakerError, match="not valid") as caught:
            update(lab)
        assert caught.value.status == 400
    finally:
        script.chmod(0o755)
    assert lab.obey() == []
    assert help_text(lab) == before
