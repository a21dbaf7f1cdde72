"""What a playground tells and does as typed, on a clock that waits for it."""

from __future__ import annotations

import re
from contextlib import ExitStack

import pytest

from tools.kit.printer import Printer
from tools.playground import commands, watcher
from tools.playground.playground import SHOWN, dressed, point_of
from tools.playground.watcher import Watcher


class Played:
    """A printer of a playground; said: what the terminal would show."""

    def __init__(self, printer: Printer, said: list[str]):
        self.printer, self._said = printer, said
        socket = printer.session.data / "comms" / "klippy.sock"
        point = point_of(printer.scene)
        self._watcher = Watcher(printer.machine, socket, point, said.append)
        printer.machine.simulation.peers.append(self._watcher)

    def type(self, line: str) -> str:
        """What is answered to a line at once."""
        try:
            return commands.run(line, self._watcher, self.printer.scene)
        except commands.CommandError as error:
            return f"!! {error}"

    def shown(self, wanted: str = "") -> str:
        """What was said since the last time, once all has come to rest."""
        session = self.printer.session
        session.wait(4.0)
        for _ in range(100):
            if any(wanted in text for text in self._said) or not wanted:
                break
            # Klippy gets its time to hear of it
            session.state()
            session.wait(0.5)
        text = "\n".join(self._said)
        self._said.clear()
        return text

    def run(self, script: str, wanted: str = "true gap") -> str:
        self.printer.run(script)
        return self.shown(wanted)

    def gap(self, shown: str) -> float:
        """The true gap that was told last, mm."""
        found = re.findall(r"true gap: Z=0 is (\S+) mm (above|IN)", shown)
        assert found, shown
        return float(found[-1][0]) * (1 if found[-1][1] == "above" else -1)

    def close(self) -> None:
        self._watcher.close()


@pytest.fixture
def play(host, tmp_path, monkeypatch):
    """play(name of a scene): a Played, ready."""
    # Never waits for the time of day
    monkeypatch.setattr(watcher, "_ASK_EVERY", 0.0)
    files = {"virtual_sdcard": {"path": str(tmp_path)}, "pause_resume": {}}
    with ExitStack() as stack:

        def begin(name: str) -> Played:
            scene = dressed(SHOWN[name])
            printer = stack.enter_context(Printer(host, scene, files))
            played = Played(printer, [])
            stack.callback(played.close)
            printer.session.require_ready()
            return played

        yield begin


def test_calibration_is_seen_touch_by_touch_with_all_faults(play):
    played = play("z_calibration")
    scene, fail = played.printer.scene, played.printer.fail
    # Where the owner believes the pin is
    assert played.gap(played.run("G28")) == pytest.approx(-0.1, abs=2e-3)
    shown = played.run("CALIBRATE_Z")
    assert played.gap(shown) == pytest.approx(scene.formula_gap(), abs=3e-3)
    for place in ("nozzle on the pin", "probe body on the pin"):
        touches = re.findall(
            rf"{place} +X20\S+ Y\S+, tip (\S+) mm .* (\S+) mm deep", shown
        )
        assert len(touches) == 3
        drop = scene.world.mag_probe.body_drop if "body" in place else 0.0
        height = scene.world.pin.z + drop - scene.world.bed.z0
        for tip, deep in touches:
            assert float(tip) == pytest.approx(height, abs=1e-3)
            assert 0.0 <= float(deep) < 0.02
    assert len(re.findall(r"probe on the bed +X152\.0 Y125\.", shown)) == 3

    answer = played.type("break probe")
    assert answer == "the wire of probe is broken: always triggered"
    assert "the probe reads triggered" in fail("CALIBRATE_Z")
    assert played.type("repair") == "all is as good as new"
    # A wire that touches ground never triggers; the floor ends the touch
    assert played.type("short z_endstop").endswith("ground: never triggered")
    played.printer.machine.tolerate("nozzle_pin", 1.1)
    assert "No trigger" in fail("CALIBRATE_Z")
    played.type("repair")
    played.shown()
    assert played.type("late z_endstop 0.3").startswith("z_endstop triggers")
    deep = re.search(
        r"nozzle on the pin .* (\S+) mm deep", played.run("G28", "pin")
    )
    assert float(deep[1]) == pytest.approx(0.3, abs=0.02)
    played.type("repair")

    assert played.type("drop").startswith("the probe has fallen off")
    assert "probe: lost" in played.shown()
    assert "the probe" in fail("CALIBRATE_Z")
    assert played.type("drop") == "!! the head does not carry the probe now"
    played.type("repair")
    shown = played.run("G28\nCALIBRATE_Z")
    assert played.gap(shown) == pytest.approx(scene.formula_gap(), abs=3e-3)


def test_hand_presses_a_switch_and_puts_the_probe_on(play):
    played = play("z_calibration")
    query = played.printer.homed().run
    played.type("drop")
    played.shown("lost")
    assert "TRIGGERED" in query("QUERY_PROBE")[-1]
    assert played.type("attach") == "the probe is on the head"
    assert "open" in query("QUERY_PROBE")[-1]
    assert played.type("press probe") == "a hand presses probe for 2 s"
    assert "TRIGGERED" in query("QUERY_PROBE")[-1]
    # It lets go
    played.shown()
    assert "open" in query("QUERY_PROBE")[-1]
    assert played.type("press nothing").startswith("!! no wire nothing, only")


def test_gap_that_is_asked_for_waits_until_klippy_is_done(play):
    played = play("z_calibration")
    session = played.printer.session
    played.type("gap")
    assert "true gap: not known before Z is homed" in played.shown("gap:")
    told = played.gap(played.run("G28"))
    # The head stands, but klippy is not done with what was sent
    pause = session.begin("G4 P4000")
    session.wait(1.0)
    played.type("gap")
    session.finish(pause, 60.0)
    assert played.gap(played.shown("gap:")) == told


@pytest.mark.parametrize("name", ["auto_z_offset", "dockable_probe"])
def test_module_sets_its_gap_in_a_scene_of_its_own(play, name):
    played = play(name)
    scene = played.printer.scene
    played.run("G28")
    if name == "auto_z_offset":
        shown, wanted = played.run("AUTO_Z_CALIBRATE"), scene.piezo_gap()
        assert shown.count("probe senses the bed") == 6
    else:
        shown, wanted = played.run("CALIBRATE_Z"), scene.formula_gap()
        assert shown.count("probe: ") == 2, shown
    assert played.gap(shown) == pytest.approx(wanted, abs=6e-3), shown


def test_membrane_is_laid_and_taken_as_typed(play):
    played = play("extra_probe")
    played.run("G28\nEXTRA_PROBE_CALIBRATE PROBE=membrane", "endstop")
    assert played.type("lay") == "the membrane lies on the bed"
    touched = "nozzle on the membrane"
    shown = played.run("EXTRA_PROBE_CONTINUE PROBE=membrane", touched)
    assert touched in shown
    assert played.type("take") == "the bed is free"
    shown = played.run("EXTRA_PROBE_CONTINUE PROBE=membrane")
    assert played.gap(shown) == pytest.approx(0.0, abs=3e-3)
    assert played.type("drop").startswith("!! this printer has no probe")


def test_what_cannot_be_done_is_told(play):
    played = play("z_calibration")
    for line, answer in (
        ("fly", "!! fly: unknown, 'help' lists the commands"),
        ("break nothing", "!! no wire nothing, only x_endstop"),
        ("break", "!! usage: break WIRE"),
        ("late probe x", "!! late: could not convert"),
        ("lay", "!! this printer has no membrane"),
        ("speed 21", "!! speed: 21 is not from 1 to 20"),
        ("speed 2", "2 times as fast as a real printer"),
    ):
        assert played.type(line).startswith(answer)
    simulation = played.printer.machine.simulation
    # A printer second takes half a real one now
    ahead = simulation.clock.now() + 1000 * 10**9
    assert simulation.pace.seconds_until(ahead) == pytest.approx(500, abs=60)
    simulation.pace = None
    assert all(name in played.type("help") for name in commands.COMMANDS)
    # A mistake in printer.cfg is no end
    state, _ = played.printer.session.reload("[printer]\nkinematics: none\n")
    assert state == "error"
    played.type("gap")
    assert "true gap: not known before Z is homed" in played.shown("gap:")
