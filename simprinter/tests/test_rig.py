"""Between the board's pins and the world."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simprinter.mcu.board import TICK_NS, Crystal
from simprinter.mcu.steppers import Steppers
from simprinter.mcu.sync import Endstops, TrsyncTable
from simprinter.rig import Port, Rig
from simprinter.tests.workbench import Bench
from simprinter.tests.world_machines import OUTPUT, PIEZO
from simprinter.wiring import (
    BoardSpec,
    Heater,
    Motor,
    Wiring,
    pin_number,
)
from simprinter.world import HotendSpec, Pose, World, make_kinematics

STEP = 0.0125
MOTORS = {
    "x": Motor("PA0", "PA1", STEP),
    "y": Motor("PA2", "!PA3", STEP),
    "z": Motor("PA4", "PA5", 0.0025),
}
INPUTS = {"x_endstop": "PB0", "y_endstop": "^!PB1", "z_endstop": "PB2"}
MILLISECOND = 1_000_000


class RigBench(Bench):
    """A board wired to a cartesian machine with three axis switches.

    The x endstop is at 300 mm, z at 0.
    """

    def __init__(self, spec=PIEZO, inputs=INPUTS, **wired) -> None:
        wiring = Wiring(MOTORS, inputs, **wired)
        self.world = World(spec, 1)
        kinematics = make_kinematics("cartesian", [("z", 150.0, 150.0)])
        begin = kinematics.motors(Pose(290.0, 100.0, 20.0))
        # The rig wants the time before there is a board
        self.time = Bench().time
        self.rig = Rig(self.world, kinematics, wiring, begin, lambda: self.ns)
        self.port = Port(self.rig)
        super().__init__(Steppers(self.port), beside=self)
        self.port.board = self.board
        for oid, motor in enumerate(MOTORS.values()):
            pins = pin_number(motor.step_pin), pin_number(motor.dir_pin)
            self.config_stepper(oid, *pins)

    def step(
        self, name: str, interval: int, count: int, direction: int = 1
    ) -> int:
        """Queue steps from 1000 ticks ahead on; the clock they count from."""
        start = self.now() + 1000
        self.move("xyz".index(name), start, interval, count, direction)
        return start


def test_poses_follow_the_steps():
    bench = RigBench()
    assert bench.rig.pose(bench.ns) == Pose(290.0, 100.0, 20.0)
    start = bench.step("x", 1000, 80)
    bench.step("y", 1000, 80)
    bench.step("z", 1000, 80, direction=0)
    end = bench.board.ns(start + 80_000)
    # The y motor is wired the other way round
    assert bench.rig.pose(end) == pytest.approx((291.0, 99.0, 19.8))
    half = bench.board.ns(start + 40_000)
    assert bench.rig.pose(half) == pytest.approx((290.5, 99.5, 19.9))
    just_before = bench.rig.pose(half - 1)
    assert just_before.x == pytest.approx(290.5 - STEP)
    # A motor that is not wired moves nothing
    track = bench.port.track(pin_number("PG0"), pin_number("PG1"))
    track.append(10, 100, 0, 1, bench.now())
    assert bench.rig.pose(end) == pytest.approx((291.0, 99.0, 19.8))


def test_world_is_told_every_few_milliseconds_of_a_moving_head():
    bench = RigBench()
    told = []
    observe = bench.world.observe
    bench.rig.world = SimpleNamespace(
        observe=lambda t, pose: (told.append((t, pose)), observe(t, pose))
    )
    bench.step("x", 50_000, 100)  # 100 ms
    bench.ns += 60 * MILLISECOND
    bench.rig.settle(bench.ns)
    bench.rig.settle(bench.ns)
    assert [t for t, _ in told] == pytest.approx(
        [0.01 * n for n in range(1, 7)]
    )
    for t, pose in told:
        assert pose == bench.rig.pose(round(t * 1e9) + 5_000_000_000)
    # Standing still is told in one go
    bench.ns += 40 * MILLISECOND
    bench.rig.settle(bench.ns)
    told.clear()
    bench.ns += 100 * 1000 * MILLISECOND
    bench.rig.settle(bench.ns)
    assert len(told) <= 2


@given(st.integers(1000, 60_000), st.integers(0, 400))
def test_edge_is_found_to_the_nanosecond(interval, ahead):
    bench = RigBench()
    # 10 mm are 800 steps to the switch
    start = bench.step("x", interval, 1000)
    reached = bench.board.ns(start + 800 * interval)
    first = reached - ahead * MILLISECOND
    pin = pin_number("PB0")
    last = reached + 20 * MILLISECOND
    found = bench.port.edge(pin, True, max(first, bench.ns), last)
    if first >= reached:  # asserted already
        assert found == first + 1
    else:
        assert found == reached
    assert bench.port.edge(pin, True, bench.ns, reached - 1) is None


def test_levels_and_inversion():
    bench = RigBench()
    x, y, unwired = (pin_number(pin) for pin in ("PB0", "PB1", "PF7"))
    # Nothing is asserted; the y switch pulls its pin low when it is
    assert not bench.port.level(x, bench.ns)
    assert bench.port.level(y, bench.ns)
    assert not bench.port.level(unwired, bench.ns)
    later = bench.ns + 10 * MILLISECOND
    assert bench.port.edge(x, False, bench.ns, later) == bench.ns + 1
    assert bench.port.edge(y, False, bench.ns, later) is None
    assert bench.port.edge(unwired, True, bench.ns, later) is None
    # y: 105 mm down to its switch, 8400 steps
    start = bench.step("y", 1000, 8500, direction=1)
    bench.run_to(start + 8_500_000)
    assert not bench.port.level(y, bench.ns)
    assert bench.port.level(y, bench.board.ns(start + 8_399_999))


def test_latency_delays_the_level():
    class Late:
        """A world whose only signal is late."""

        observe = staticmethod(lambda t, pose: None)
        latency = staticmethod(lambda signal: 0.002)
        level = staticmethod(lambda signal, t, pose: pose.x >= 300.0)

    bench = RigBench()
    bench.rig.world = Late()
    start = bench.step("x", 10_000, 1000)
    reached = bench.board.ns(start + 800 * 10_000)
    bench.ns = reached
    pin = pin_number("PB0")
    assert (
        bench.port.edge(pin, True, reached, reached + 5 * MILLISECOND)
        == reached + 2 * MILLISECOND
    )


def test_outputs_reach_the_world():
    wired = {"outputs": {"probe_attach": "!PC0"}}
    bench = RigBench(OUTPUT, {"z_endstop": "PB2"}, **wired)
    pin = pin_number("PC0")
    for expected, duty in (("docked", 1.0), ("attached", 0.0)):
        bench.ns += 1000 * MILLISECOND
        bench.port.set_output(pin, bench.ns, duty)
        at = bench.rig.seconds(bench.ns) + 0.5
        assert bench.world.probe_state(at) == expected
    # An unknown pin is nobody's
    bench.port.set_output(pin_number("PF7"), bench.ns, 1.0)


def test_arming_reaches_the_signal():
    armed, told = [], []
    bench = RigBench()
    bench.rig.world = SimpleNamespace(
        observe=lambda t, pose: None,
        touch_armed=lambda signal, t: armed.append((signal, t)),
    )
    bench.rig.on_operation.append(lambda *what: told.append(what))
    bench.ns += 250 * MILLISECOND
    for pin in ("PB2", "PF7"):
        bench.port.armed(pin_number(pin), bench.ns)
        bench.port.queried(pin_number(pin), bench.ns)
    assert armed == [("z_endstop", pytest.approx(0.25))]
    assert told == [
        ("touch", "z_endstop", bench.ns),
        ("query", "z_endstop", bench.ns),
    ]


def test_old_steps_are_forgotten_and_new_ones_kept():
    bench = RigBench()
    for _ in range(20):
        start = bench.step("x", 100_000, 80)  # 0.16 s
        bench.run_to(start + 8_000_000)
        bench.rig.settle(bench.ns)
        start = bench.step("x", 100_000, 80, direction=0)
        bench.run_to(start + 8_000_000)
        bench.rig.settle(bench.ns)
    now = bench.ns
    # A second back everything is still known, to the step
    start = now - 8_000_000 * TICK_NS
    assert bench.rig.pose(now).x == pytest.approx(290.0)
    assert bench.rig.pose(start).x == pytest.approx(291.0)
    assert bench.rig.pose(now - 1_000_000_000).x < 291.0


class TwoBoards(RigBench):
    """Motors on the one board; the x endstop on another, with 40 MHz.

    The other board reads PB0; nothing is wired there on the main one.
    """

    def __init__(self) -> None:
        crystal = Crystal(tick_ns=25, first_wrap=3)
        super().__init__(
            inputs={**INPUTS, "x_endstop": "^zboard:PB0"},
            heaters={"bed": Heater("zboard:PH1", "zboard:PI1")},
            boards={"zboard": BoardSpec(crystal)},
        )
        self.far_port = Port(self.rig, "zboard")
        trsyncs = TrsyncTable(Steppers(self.far_port))
        self.endstops = Endstops(self.far_port, trsyncs)
        parts = trsyncs, self.endstops
        self.far = Bench(*parts, crystal=crystal, beside=self)
        self.far_port.board = self.far.board
        self.rig.on_steps.append(self.endstops.steps_queued)


def test_pins_of_two_boards_do_not_meet():
    bench = TwoBoards()
    pin = pin_number("PB0")
    start = bench.step("x", 1000, 1000)
    reached = bench.board.ns(start + 800 * 1000)
    last = reached + MILLISECOND
    assert bench.port.edge(pin, True, bench.ns, last) is None
    assert bench.far_port.edge(pin, True, bench.ns, last) == reached
    heater, sensor = pin_number("PH1"), pin_number("PI1")
    assert bench.port.voltage(sensor, bench.ns) == 0.5
    bench.port.set_output(heater, bench.ns, 1.0)
    bench.far_port.set_output(heater, bench.ns, 0.25)
    bench.far_port.voltage(sensor, bench.ns + 10**9)
    assert bench.rig.heaters["bed"].celsius == pytest.approx(26.0, abs=0.05)
    # No motor is on the far board
    far_track = bench.far_port.track(pin_number("PA0"), pin_number("PA1"))
    assert far_track is not bench.rig.axes["x"].track


def test_endstop_sees_steps_that_another_board_makes():
    bench = TwoBoards()
    far, now = bench.far, bench.far.now()
    far.tell("config_trsync oid=0", "config_endstop oid=1 pin=16 pull_up=1")
    far.tell(
        f"trsync_start oid=0 report_clock={now} report_ticks=0 expire_reason=2"
    )
    # 4 samples 600 ticks apart, every 1200 ticks
    far.tell(
        f"endstop_home oid=1 clock={now} sample_ticks=600 sample_count=4"
        " rest_ticks=1200 pin_value=1 trsync_oid=0 trigger_reason=1"
    )
    # It has looked ahead 20 ms, at motors that stand still, when they start
    far.run_to(now + MILLISECOND // 25)
    start = bench.step("x", 1000, 1000)
    reached = bench.board.ns(start + 800 * 1000)
    far.run_to(far.board.clock_at(reached + 3 * MILLISECOND))
    endstop = bench.endstops.by_oid[1]
    first_match = far.board.ns(endstop.next_clock - 1200)
    # Sampled every 30 us
    assert 0 <= first_match - reached < 30_000
    # It stops nothing: the motor's own board must be told
    assert bench.rig.axes["x"].track.position == 1000


def test_nozzle_grows_with_the_heater_of_its_name():
    world = World(replace(OUTPUT, hotend=HotendSpec(0.05)), 0)
    heaters = {
        "extruder": Heater("PH0", "PI0"),
        "bed": Heater("PH1", "PI1"),
    }
    rig = Rig(
        world,
        make_kinematics("cartesian"),
        Wiring(MOTORS, INPUTS, heaters=heaters),
        dict.fromkeys("xyz", 10.0),
        lambda: 0,
    )
    port = Port(rig, "mcu")
    point = (150.0, 150.0, 5.0)

    def grown(heater: str, sensor: str, ns: int) -> float:
        port.voltage(pin_number(sensor), ns)
        before = world.truth.true_gap(*point, ns * 1e-9)
        port.set_output(pin_number(heater), ns, 1.0)
        port.voltage(pin_number(sensor), ns + 10**9)
        return before - world.truth.true_gap(*point, ns * 1e-9 + 1.0)

    assert grown("PH1", "PI1", 0) == 0.0
    longer = grown("PH0", "PI0", 2 * 10**9)
    assert longer == pytest.approx(0.05 * 4.0 / 100.0, rel=0.01)
