"""The commands that are put to the test, each on a machine that suits it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Optional

from simprinter import Scene, heated
from tools.campaign.breaking import PUT_ON, TEMPLATE, TEMPLATE_MACRO
from tools.campaign.drawn.printers import Owned
from tools.kit import auto_z_offset, carrying, dockable_probe, extra_probe
from tools.kit.docks import DOCK_SCENES
from tools.kit.printer import Printer
from tools.kit.scenes import SCENES, Sections

# The floor of a touch is so far (mm) below where a trigger is expected
FLOOR_MARGIN = 1.0
# A gap that tests of the modules judge: here it is that of a good run
ANY = float("nan")
OFFSET = 0.123


@dataclass(frozen=True)
class Job:
    """One command; as good as it gets, and what a failure may do.

    before: G-code after G28, such as an earlier run; again: before the next
    run, when the fault is gone. signals: the sensors it uses. margins: by
    site, mm that a touch may be deeper than in a good run. ideal: true gap at
    G-code Z=0 afterwards, None: it does not change, ANY: that of a good run. only: these faults, if it
    is there for some. point: of the bed where the gap is looked at. lift:
    toolhead Z after a failure, at least. is_homing: after a failure nobody
    knows where the toolhead is. told: what it may leave behind: status fields that
    tell what was seen last; "what is saved", where the host has a result already;
    "gap", where that is a mesh in force.
    is_long: of the operations of a kind only the first, the middle and the last.
    is_left_on: macros bring the probe, which its owner may have left on the toolhead.
    samples: as many touches, or rounds of them, are compared with each other.
    """

    name: str
    module: str
    script: str
    scene: Scene
    signals: tuple[str, ...]
    point: tuple[float, float]
    margins: Mapping[str, float]
    lift: float
    ideal: Optional[float] = None
    changes: Sections = field(default_factory=dict)
    before: str = ""
    again: str = ""
    only: tuple[str, ...] = ()
    is_homing: bool = False
    told: tuple[str, ...] = ()
    is_long: bool = False
    is_left_on: bool = False
    samples: int = 3

    def state(self, printer: Printer) -> dict[str, Any]:
        """What a failure must leave as it was, beside what any command of ours does."""
        status = printer.status(self.module)
        return {
            "homed axes": printer.status("toolhead")["homed_axes"],
            "status": {k: v for k, v in status.items() if k not in self.told},
            "printer.cfg": printer.session.config_text(),
        }

    def gap(self, printer: Printer) -> float:
        """True gap (mm) that G-code Z=0 stands for; the toolhead stands."""
        z = printer.status("gcode_move")["gcode_position"][2]
        return printer.machine.gap_at_zero(z, self.point)


def _with_templates(module: str, **templates: str) -> dict[str, Any]:
    """Changes that let every template of a scene be counted.

    templates: option of the module, and what it does already.
    """
    return {
        "respond": {},
        f"gcode_macro {TEMPLATE}": {
            "variable_n": "0",
            "variable_fail_at": "{}",
            "gcode": TEMPLATE_MACRO,
        },
        module: {
            option: "".join(
                f"\n  {line}" for line in (TEMPLATE, *text.strip().splitlines())
            )
            for option, text in templates.items()
        },
    }


def _z_calibration_jobs() -> list[Job]:
    scene, cartesian = SCENES["voron"], SCENES["cartesian"]
    plain = Job(
        name="CALIBRATE_Z",
        module="z_calibration",
        script="CALIBRATE_Z",
        scene=scene,
        signals=("z_endstop", "probe"),
        point=(150.0, 150.0),
        # A refusal is a line of it, and the last run
        told=("history", "last_query"),
        margins={
            "nozzle_pin": FLOOR_MARGIN,
            "body_pin": FLOOR_MARGIN,
            "body_bed": FLOOR_MARGIN,
            # Its trigger is expected from z_offset, which may be a bit off
            "probe_bed": FLOOR_MARGIN + 0.2,
        },
        lift=13.7,
        ideal=scene.formula_gap(),
    )
    attaching = replace(
        plain,
        name="CALIBRATE_Z, attaching",
        scene=cartesian,
        samples=2,
        point=(110.0, 110.0),
        lift=3.9,
        again="DOCK_PROBE",
        ideal=cartesian.formula_gap(),
        changes=_with_templates(
            plain.module,
            start_gcode="",
            before_switch_gcode="ATTACH_PROBE",
            end_gcode="DOCK_PROBE",
            offset_gcode="SET_GCODE_OFFSET Z={params.Z} MOVE=0",
        ),
    )
    accuracy = replace(
        plain,
        name="PROBE_Z_ACCURACY",
        script="PROBE_Z_ACCURACY SAMPLES=3",
        ideal=None,
    )
    switch_offset = replace(
        attaching,
        name="CALCULATE_SWITCH_OFFSET",
        script="CALCULATE_SWITCH_OFFSET",
        before="CALIBRATE_Z\nG90\nG1 X110 Y110 F9000\nG1 Z0.3 F600",
        lift=0.2,
        ideal=None,
    )
    # It would meet the bed long before the nozzle meets the pin, and only a switch that
    # is normally open reads attached while Z is homed without it
    probe = replace(cartesian.world.mag_probe, body_drop=6.0)
    left_on = replace(
        attaching,
        name="CALIBRATE_Z, the probe left on",
        scene=cartesian.with_world(mag_probe=probe),
        changes={**attaching.changes, "probe": {"z_offset": "6.7"}},
        is_left_on=True,
        only=(PUT_ON,),
    )
    inputs = {**cartesian.wiring.inputs, "probe": "^!PC3"}
    wired = replace(
        cartesian, wiring=replace(cartesian.wiring, inputs=inputs)
    ).with_world(mag_probe=replace(probe, normally_open=True))
    normally_open = replace(
        left_on,
        name="CALIBRATE_Z, the probe left on, normally open",
        scene=wired,
        changes={
            **attaching.changes,
            "probe": {"z_offset": "6.7", "pin": "^!PC3"},
        },
    )
    return [plain, attaching, left_on, normally_open, accuracy, switch_offset]


# Where AUTO_Z_TWIST measures
TWISTED = {
    "calibrate_start_x": "25",
    "calibrate_end_x": "220",
    "calibrate_y": f"{auto_z_offset.POINT[1]:g}",
}


def _auto_z_offset_jobs() -> list[Job]:
    scene = SCENES["qidi"]
    own = scene.sections["auto_z_offset"] or {}
    changes = _with_templates(
        "auto_z_offset", prepare_gcode=own["prepare_gcode"] or ""
    )
    changes["auto_z_offset"]["offset_samples"] = "2"
    # A single touch that sets Z has nothing to be compared with
    twice = {**changes["auto_z_offset"], "samples": "2"}
    position_min = float((scene.sections["stepper_z"] or {})["position_min"])
    probe = Job(
        name="AUTO_Z_PROBE",
        module="auto_z_offset",
        script="AUTO_Z_PROBE",
        scene=scene,
        signals=("bed_sensor", "probe"),
        samples=2,
        point=auto_z_offset.POINT,
        margins={"nozzle_bed": FLOOR_MARGIN},
        lift=3.6,
        changes=changes,
        before="AUTO_Z_PROBE",
    )
    calibrate = replace(
        probe,
        name="AUTO_Z_CALIBRATE",
        script="AUTO_Z_CALIBRATE",
        ideal=scene.piezo_gap(),
    )
    return [
        probe,
        replace(
            probe,
            name="AUTO_Z_HOME_Z",
            script="AUTO_Z_HOME_Z",
            # Z=0 is z_offset below where the sensor has triggered
            ideal=OFFSET - auto_z_offset.DEPTH - auto_z_offset.AIR_GAP,
            changes={**changes, "auto_z_offset": twice},
        ),
        replace(
            probe, name="AUTO_Z_MEASURE_OFFSET", script="AUTO_Z_MEASURE_OFFSET"
        ),
        calibrate,
        # What differs from the other one is the dead sensor: the first touch
        # of all has no floor but the axis's
        replace(
            calibrate,
            name="AUTO_Z_CALIBRATE, first of all",
            before="",
            margins={"nozzle_bed": auto_z_offset.SENSOR - position_min},
            only=("stuck_open", "trigger_never", "trigger_late"),
        ),
        replace(
            calibrate,
            name="AUTO_Z_LOAD_OFFSET",
            script="AUTO_Z_LOAD_OFFSET",
            before="AUTO_Z_CALIBRATE\nSET_GCODE_OFFSET Z=0",
        ),
        replace(
            probe,
            name="AUTO_Z_SAVE_GCODE_OFFSET",
            # The offset is that of no baby steps
            script="AUTO_Z_SAVE_GCODE_OFFSET FORCE=1",
            before="AUTO_Z_CALIBRATE\nSET_GCODE_OFFSET Z_ADJUST=0.01",
        ),
    ]


def _more_jobs() -> list[Job]:
    """The commands that wait or heat, and so take long."""
    found = {job.name: job for job in _z_calibration_jobs()}
    plain = found["CALIBRATE_Z"]
    found = {job.name: job for job in _auto_z_offset_jobs()}
    probe = found["AUTO_Z_PROBE"]
    waiting = replace(
        plain,
        name="Z_CALIBRATION_WAIT",
        script="Z_CALIBRATION_WAIT MAX=2",
        told=(*plain.told, "movement"),
        ideal=None,
    )
    growth = replace(
        waiting,
        name="Z_CALIBRATION_NOZZLE_GROWTH",
        script="Z_CALIBRATION_NOZZLE_GROWTH TEMPS=50,80,110",
        scene=heated(plain.scene),
    )
    return [
        waiting,
        growth,
        replace(
            probe,
            name="AUTO_Z_WAIT",
            script="AUTO_Z_WAIT MAX=2",
            told=("movement",),
        ),
        replace(
            probe,
            name="AUTO_Z_TWIST",
            script="AUTO_Z_TWIST SAMPLE_COUNT=2",
            changes={**probe.changes, "axis_twist_compensation": TWISTED},
            # One point of the bed is lower than another
            margins={"nozzle_bed": FLOOR_MARGIN + 0.05},
        ),
    ]


def _extra_probe_jobs() -> list[Job]:
    # It lies there all the time; what a hand does is not broken here
    scene = extra_probe.membrane(laid=True)
    first = Job(
        name="EXTRA_PROBE_CALIBRATE, first of all",
        module=extra_probe.NAME,
        script="\n".join(
            (
                # No hand is there to press it: as low as if one were
                f"{extra_probe.CALIBRATE} FLOOR=-1",
                extra_probe.CONTINUE,
                extra_probe.CONTINUE,
            )
        ),
        scene=scene,
        signals=("membrane",),
        point=extra_probe.POINT,
        # Down to 1 mm below Z=0, with the bed above it
        margins={
            "nozzle_membrane": 1.0 + extra_probe.BED + extra_probe.THICKNESS,
            "nozzle_bed": 1.0 + extra_probe.BED,
        },
        lift=9.99,
        ideal=0.0,
        before="G90\nG1 Z10 F900\nG1 X30 Y20 F6000",
        again="G90\nG1 Z10 F900",
        only=("stuck_open", "trigger_never", "trigger_late"),
    )
    # The bed is at Z=0, and that was saved
    homed = f"{-extra_probe.BED:.3f}"
    changes = _with_templates(
        extra_probe.NAME, activate_gcode="", deactivate_gcode=""
    )
    changes["stepper_z"] = {"position_endstop": homed}
    changes[extra_probe.NAME]["saved_homing_z"] = homed
    calibrate = replace(
        first,
        name="EXTRA_PROBE_CALIBRATE",
        # What was saved says how low it may go
        script=first.script.replace(" FLOOR=-1", ""),
        margins={"nozzle_membrane": 0.125, "nozzle_bed": 0.0},
        changes=changes,
        only=(),
    )
    probe = replace(
        calibrate,
        name="EXTRA_PROBE",
        script="EXTRA_PROBE PROBE=membrane SAMPLES=2",
        ideal=None,
    )
    beside = replace(
        first,
        name="EXTRA_PROBE_CALIBRATE, a switch beside the bed",
        script=extra_probe.CALIBRATE,
        scene=extra_probe.fixed_switch(),
        signals=("nozzle_endstop", "probe"),
        point=extra_probe.BED_POINT,
        # 1 mm below where the switch should trigger; the probe's touch ends where the
        # nozzle meets the bed
        margins={"nozzle_pin": 1.0, "nozzle_bed": 0.0},
        changes={
            **_with_templates(
                extra_probe.NAME, activate_gcode="", deactivate_gcode=""
            ),
            "probe": {"samples": "2"},
        },
        only=(),
    )
    return [probe, calibrate, first, beside]


# All of a dockable probe that are no touch's: those of a touch are the host's
_LOST = (
    *("stuck_open", "stuck_closed", "probe_falls", "mcu_silent", "cancel"),
    *("attach_fails", "dock_fails"),
)


def _dockable_probe_jobs() -> list[Job]:
    # A dead switch is found 5 mm below where it should have triggered
    floor = dockable_probe.HANG - dockable_probe.FLOOR
    quick = dockable_probe.QUICK
    probe = Job(
        name="PROBE, dockable",
        module="dockable_probe",
        script="PROBE",
        scene=dockable_probe.GANTRY,
        signals=("probe",),
        point=(150.0, 150.0),
        margins={"probe_bed": floor, "body_bed": floor},
        lift=dockable_probe.CLEAR - 0.01,
        changes=_with_templates(
            "dockable_probe",
            pre_attach_gcode="",
            attach_gcode="",
            post_attach_gcode="",
            activate_gcode="",
            deactivate_gcode="",
            pre_detach_gcode="",
            detach_gcode="",
            post_detach_gcode="",
        ),
        before="G90\nG1 X150 Y150 Z20 F6000",
        again="G90\nG1 X150 Y150 Z20 F6000",
        told=(*_DOCKED_STATUS, "last_probe_position"),
    )
    plain = replace(probe, changes=dockable_probe.section(**quick))
    both = dockable_probe.section(dock_retries="1", **quick)
    sensed, frame = dockable_probe.SENSED, dockable_probe.FRAME
    # The gap is looked at wherever the toolhead stands then
    level = frame.with_world(
        bed=replace(frame.world.bed, slope_x=0.0, slope_y=0.0)
    )
    signals = ("probe", "probe_sense", "dock_sense")
    mesh = "BED_MESH_CALIBRATE PROBE_COUNT=3,3\nBED_MESH_CLEAR"

    def other(script: str, **changes: Any) -> Job:
        name = f"{script.split()[0]}, dockable"
        fields = {"name": name, "script": script, "only": _LOST, **changes}
        return replace(plain, **fields)

    return [
        probe,
        other(
            "PROBE",
            name="PROBE, dockable, with sensors",
            scene=sensed,
            signals=signals,
        ),
        other("PROBE", name="PROBE, dockable, tried again", changes=both),
        # A mesh is there before the probe is docked
        other(mesh, told=(*probe.told, "what is saved"), is_long=True),
        other("QUAD_GANTRY_LEVEL", is_long=True),
        other("Z_TILT_ADJUST", scene=level, is_long=True),
        other("SCREWS_TILT_CALCULATE", is_long=True),
        other("G28", is_homing=True, again="G28"),
    ]


# Docks on which each command is tried, by what they are. The one on the gantry has
# more jobs above where Z is homed with the probe; here all home it on a pin.
DOCKS = {
    "gantry": "dock_gantry_switch",
    "servo": "dock_servo",
    "bed": "dock_bed",
    "from above": "dock_above",
}
# What each command is sent as, the probe being on the toolhead or in its dock
_OF_DOCKS = {
    "dockable_probe": {
        "PROBE": "PROBE",
        "PROBE_ACCURACY": "PROBE_ACCURACY SAMPLES=2",
        "PROBE_CALIBRATE": "PROBE_CALIBRATE\nABORT",
        "BED_MESH_CALIBRATE": "BED_MESH_CALIBRATE PROBE_COUNT=3,3\n"
        "BED_MESH_CLEAR",
        "SCREWS_TILT_CALCULATE": "SCREWS_TILT_CALCULATE",
        "ATTACH_PROBE": "ATTACH_PROBE\nDETACH_PROBE",
        "MOVE_TO_DOCK_PROBE": "MOVE_TO_DOCK_PROBE\nMOVE_TO_EXTRACT_PROBE\n"
        "MOVE_TO_DOCK_PROBE\nMOVE_TO_DETACH_PROBE",
        "G28": "ATTACH_PROBE\nG28",
    },
    "extra_probe": {
        "EXTRA_PROBE": "EXTRA_PROBE PROBE=membrane SAMPLES=2",
        "EXTRA_PROBE_ACCURACY": "EXTRA_PROBE_ACCURACY PROBE=membrane SAMPLES=2",
        "EXTRA_PROBE_CALIBRATE": "\n".join(
            (
                "EXTRA_PROBE_CALIBRATE PROBE=membrane FLOOR=-1",
                extra_probe.CONTINUE,
                extra_probe.CONTINUE,
            )
        ),
    },
    "auto_z_offset": {
        "AUTO_Z_PROBE": "AUTO_Z_PROBE",
        "AUTO_Z_HOME_Z": "AUTO_Z_HOME_Z",
        "AUTO_Z_MEASURE_OFFSET": "AUTO_Z_MEASURE_OFFSET",
        "AUTO_Z_CALIBRATE": "AUTO_Z_CALIBRATE",
    },
}


def _dock_jobs() -> list[Job]:
    """Every command on every kind of dock."""
    found = []
    for kind, name in DOCKS.items():
        scene = carrying.with_all(DOCK_SCENES[name])
        membrane = scene.world.membrane
        assert membrane is not None
        laid = scene.with_world(membrane=replace(membrane, laid=True))
        for module, scripts in _OF_DOCKS.items():
            make = _OF_MODULE[module]
            on = laid if module == "extra_probe" else scene
            for command, script in scripts.items():
                job = make(f"{command}, {kind}", script, on)
                found.append(job)
    return found


# Where the bed of these printers is: on a pin that is 0.3012 mm higher than its owner
# says
_BED = 0.0988
# The switch that is pressed may be dead: Z is homed on the pin, so a touch ends at Z=1
_BODY = {
    site: dockable_probe.HANG + _BED - 1.0 for site in ("probe_bed", "body_bed")
}
# After a failure the toolhead may stand over a dock that is entered from above, and after a
# good run on what it has touched
_AROUND = "G91\nG1 Z10 F900\nG90\nMOVE_AVOIDING_DOCK X=150 Y=150"
# A membrane that is dead, and the bed below it, are pressed down to 0.1 mm below Z=0 or,
# where a calibration looks for the bed, 1 mm
_MEMBRANE = (
    {"nozzle_membrane": FLOOR_MARGIN, "nozzle_bed": 0.3},
    {
        "nozzle_membrane": FLOOR_MARGIN + _BED + carrying.THICKNESS,
        "nozzle_bed": FLOOR_MARGIN + _BED,
    },
)
_HOMED_AGAIN = {"G28", "MOVE_TO_DOCK_PROBE"}
_DOCKED_STATUS = ("last_status", "last_status_name", "last_z_result")


def _of_dockable_probe(name: str, script: str, scene: Scene) -> Job:
    away = "G90\nG1 Z20 F900\nG1 X150 Y150 F6000"
    return Job(
        name=name,
        module="dockable_probe",
        script=script,
        scene=scene,
        signals=("probe",),
        point=(150.0, 150.0),
        margins=_BODY,
        lift=dockable_probe.CLEAR - 0.01,
        changes=dockable_probe.section(**dockable_probe.QUICK),
        before=away,
        # After a failure the toolhead may stand in the dock, or is homed no more
        again=f"G28\n{away}" if set(script.split()) & _HOMED_AGAIN else away,
        # A mesh is there, and in force, before the probe is docked
        told=(
            *_DOCKED_STATUS,
            "last_probe_position",
            *(("what is saved", "gap") if "MESH" in script else ()),
        ),
        only=_LOST,
        is_homing="G28" in script,
        is_long=True,
    )


def _of_extra_probe(name: str, script: str, scene: Scene) -> Job:
    """The probe hangs on the toolhead, and has to be docked before."""
    job = _of_dockable_probe(name, script, scene)
    begin = f"{carrying.OVER}ATTACH_PROBE"
    is_first = "CALIBRATE" in script
    return replace(
        job,
        module="extra_probe membrane",
        signals=("probe", "membrane"),
        point=carrying.POINT,
        margins={**_BODY, **_MEMBRANE[is_first]},
        before=begin,
        again=f"{_AROUND}\n{begin}",
        told=("last_z_result",),
        ideal=ANY if is_first else None,
    )


def _of_auto_z_offset(name: str, script: str, scene: Scene) -> Job:
    """The same, with a bed whose height is known."""
    job = _of_extra_probe(name, script, scene)
    begin = f"{carrying.OVER}AUTO_Z_PROBE\nATTACH_PROBE"
    return replace(
        job,
        module="auto_z_offset",
        signals=("probe", "bed_sensor"),
        margins={**_BODY, "nozzle_bed": FLOOR_MARGIN},
        lift=3.6,
        before=begin,
        again=f"{_AROUND}\n{begin}",
        told=(),
        ideal=ANY,
    )


_OF_MODULE: Mapping[str, Callable[[str, str, Scene], Job]] = {
    "dockable_probe": _of_dockable_probe,
    "extra_probe": _of_extra_probe,
    "auto_z_offset": _of_auto_z_offset,
}


JOBS = {
    job.name: job
    for job in (
        *_z_calibration_jobs(),
        *_auto_z_offset_jobs(),
        *_extra_probe_jobs(),
        *_dockable_probe_jobs(),
    )
}
DOCK_JOBS = {job.name: job for job in _dock_jobs()}
MORE_JOBS = {job.name: job for job in _more_jobs()}
ALL_JOBS = {**JOBS, **DOCK_JOBS, **MORE_JOBS}


@dataclass(frozen=True)
class OfJob(Owned):
    """The printer on which a command is broken; job: its name."""

    job: str = ""

    @cached_property
    def scene(self) -> Scene:
        """That of the job."""
        return ALL_JOBS[self.job].scene

    def changes(self, **paths: str) -> dict[str, dict[str, Optional[str]]]:
        """Those of the job."""
        return dict(ALL_JOBS[self.job].changes)

    def has(self, section: str) -> bool:
        """Whether its scene has that section."""
        return section in self.scene.sections
