"""Z_CALIBRATION_SETUP through Moonraker, by buttons only."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import pytest

from simprinter.hosts.moonraker import MoonrakerError
from tests.moonraker.updates import restarted
from tools.kit.lab import Lab
from tools.kit.scenes import SCENES
from tools.kit.setup_user import EMPTY, SETUP, User, open_dialog
from tools.kit.z_calibration import MICROSTEP

BEGIN = "action:prompt_begin"
PRESS = ": press it now"
# Real seconds that a hand needs
HAND = 0.25


@pytest.fixture(scope="module")
def lab(request, moonraker_python, tmp_path_factory):
    """A printer that knows start_gcode and end_gcode only."""
    scene = SCENES["cartesian"]
    own = {**scene.sections["z_calibration"], **EMPTY}
    scene = replace(scene, sections={**scene.sections, "z_calibration": own})
    directory = tmp_path_factory.mktemp("lab")
    with Lab(request.param, moonraker_python, directory, scene) as lab:
        lab.install()
        lab.obey()
        yield lab


class WebUser(User):
    """Sees and sends what a web interface does."""

    def __init__(self, lab: Lab):
        super().__init__(lab.printer)
        self.lab = lab

    def dialog(self):
        store = self.lab.moonraker.get("/server/gcode_store")["gcode_store"]
        said = [e["message"] for e in store if e["type"] == "response"]
        # It keeps a thousand lines: the first dialog may have lost its head
        heads = [i for i, line in enumerate(said) if BEGIN in line]
        return open_dialog(said[heads[0] :] if heads else [])

    def begin(self):
        self.lab.moonraker.run(SETUP)

    def _send(self, label):
        return self.lab.moonraker.run(self.dialog().gcode(label))

    def position(self):
        return self.lab.moonraker.status("toolhead")["position"]

    def hold(self, signal, level):
        with self.lab.standing() as printer:
            printer.machine.hold(signal, level)

    def gap(self):
        with self.lab.standing():
            return super().gap()

    def by_hand(self, signal, *, after=None, others=()):
        watching = threading.Thread(target=self.press, args=["Watch"])
        watching.start()
        while (shown := self.dialog()) is None or not (
            shown.headline.endswith(PRESS)
        ):
            time.sleep(0.02)
        for level in (True, after):
            time.sleep(HAND)
            self.hold(signal, level)
        watching.join()


@pytest.mark.slow
def test_console_says_how_to_begin_after_each_start(lab):
    words = "no place for the switch; run Z_CALIBRATION_SETUP"
    for _ in range(3):
        # What the klippy of before has told last is none of this start
        gone = restarted(lab, "RESTART")
        # Moonraker listens only after klippy is ready
        until = time.monotonic() + 10.0
        while not lines_since(lab, gone, words):
            assert time.monotonic() < until
            time.sleep(0.1)
        time.sleep(3.0)
        assert len(lines_since(lab, gone, words)) == 1
        status = lab.moonraker.status("z_calibration")
        assert sum(words in note for note in status["notes"]) == 1


def lines_since(lab, began, words):
    """What Moonraker has stored of the console since then, with the words."""
    store = lab.moonraker.get("/server/gcode_store")["gcode_store"]
    return [
        e["message"]
        for e in store
        if e["type"] == "response" and e["time"] >= began
        if words in e["message"]
    ]


@pytest.mark.slow
def test_empty_section_to_the_true_gap(lab):
    user = WebUser(lab)
    user.begin()
    user.test_switches()
    user.set_places((226.0, 20.0), (254.0, 18.0))
    user.touch()
    assert user.step() == "GAP"
    user.press("SSG 0.2 mm")
    assert "switch_offset: 0.200" in user.dialog().text
    save = user.dialog().gcode("Save")
    with lab.moonraker.listen() as listener:
        user.press("Save")
        listener.collect("notify_klippy_disconnected", lambda _: True)
        listener.collect("notify_klippy_ready", lambda _: True)
    # Of a page that was loaded before
    assert user.dialog() is None
    with pytest.raises(MoonrakerError) as caught:
        lab.moonraker.run(save)
    assert "no set-up is under way" in caught.value.text
    lab.moonraker.run("G28\nCALIBRATE_Z")
    settings = lab.moonraker.status("configfile")["settings"]
    point = tuple(settings["z_calibration"]["bed_xy_position"])
    with lab.standing() as printer:
        gap = printer.gap(point)
    # Of an SSG the least that it may have, for one that has 0.7
    assert gap == pytest.approx(0.5, abs=2 * MICROSTEP)
