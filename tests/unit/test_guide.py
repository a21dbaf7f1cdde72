"""The steps of Z_CALIBRATION_SETUP: what is asked, what follows, what is refused."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.calibrated import make_settings
from tools.kit.dialogs import dialogs_of
from z_touch.core import jogging
from z_touch.core.errors import CalibrationError
from z_touch.core.touching import Site
from z_touch.guide import steps, texts
from z_touch.guide.head import GuidedHead
from z_touch.guide.state import SITES, State
from z_touch.uncertainty.adaptive import Automatic, FixedCount
from z_touch.z_calibration.interface import Interface
from z_touch.z_calibration.settings import OPTIONS

FACTS = {
    "patience": 20.0,
    "travel_z": 17.0,
    "goal": "the head lifts to Z=17.0 and moves to X=1.0 Y=2.0",
    "back_goal": "",
    "repeats": "The nozzle repeats within 0.0025 mm.",
    "floor": -0.5,
    "touches": 5,
    "paper_z": 2.5,
    "values": "switch_offset: 0.5",
    "not_saved": "",
    "saving": "'Save' writes it.",
    "come_down": "come down",
    "of_a_list": "",
    "here": "The head is at X=1.0 Y=2.0 Z=17.00.",
    "lowest": "It stops by itself at Z=2.5.",
    "plunger": "",
    "sheet": "Lower it.",
    "look_goal": "the head looks around",
    "room": 1.9,
    "too_small": "",
    **texts.BY_GCODE,
}
every_step = pytest.mark.parametrize("name", steps.ORDER)


def dialog(name, **changes):
    shown, said = steps.ask(name, {**FACTS, **changes})
    (found,) = dialogs_of(shown)
    return found, said


@pytest.mark.parametrize("who", [texts.BY_GCODE, texts.BY_HAND])
@every_step
def test_dialog_and_console_say_the_same(name, who):
    shown, said = dialog(name, **who)
    assert shown.text in said
    assert shown.headline in said
    shown.assert_stands_alone()
    # Where the head is
    assert FACTS["here"] in shown.texts
    # One is known by what it sends
    assert len({b[1] for b in shown.footer_buttons}) == len(
        shown.footer_buttons
    )
    for label, gcode, _ in shown.footer_buttons:
        assert f"{label}: {gcode}" in said
    # On the dark page that one cannot be told from a button out of use
    assert "secondary" not in {b[2] for b in shown.footer_buttons}
    assert shown.footer_buttons[-1][1] == "Z_CALIBRATION_SETUP STEP=ABORT"
    others = [b for group in shown.groups for b in group]
    own = f"Z_CALIBRATION_SETUP STEP={name.upper()}"
    for _, gcode, _ in [*shown.footer_buttons[:-1], *others]:
        assert gcode.startswith(own)


@every_step
def test_move_that_follows_is_announced(name):
    shown, _ = dialog(name)
    follows = steps.next_asked(name)
    # By the sentence that all interfaces show
    moves = (*SITES, "look")
    assert (FACTS["goal"] in shown.last) == (follows in moves), follows
    back, _ = dialog(name, back_goal="the head flies")
    assert "'Back': the head flies." in back.texts


@every_step
def test_own_gcode_is_spoken_of_where_there_is_some(name):
    assert "own G-code" not in dialog(name, **texts.BY_HAND)[1]
    speaks = name in ("nozzle", "attach", *(f"touch_{site}" for site in SITES))
    assert ("your own G-code" in dialog(name)[1]) is speaks


def test_twelve_steps_are_asked():
    asked = [name for name in steps.ORDER if name not in steps.CHAINED]
    headlines = [dialog(name)[0].headline for name in asked]
    assert [line.split(":")[0] for line in headlines] == [
        f"Step {number} of 12" for number in range(1, 13)
    ]
    # What follows by itself is part of the step before
    for name in steps.CHAINED:
        before = steps.ORDER[steps.ORDER.index(name) - 1]
        assert steps.STEPS[name].number == steps.STEPS[before].number


@every_step
def test_sentences_name_no_options(name):
    shown, _ = dialog(name, values="", come_down="")
    for row in OPTIONS:
        assert "_" not in row.name or row.name not in shown.text
        assert f"{row.name}:" not in shown.text


@every_step
def test_a_sentence_a_line(name):
    shown, _ = dialog(name, values="", come_down="")
    for text in shown.texts:
        assert ". " not in text.rstrip("."), text


def test_problem_comes_first_and_a_late_head_is_told_of():
    shown, _ = steps.ask("switch", FACTS, "no luck.", "the head goes there")
    (found,) = dialogs_of(shown)
    assert found.texts == [
        "Not done: no luck.",
        "The head is not there yet.",
        FACTS["here"],
        "'Here': the head goes there, then this is asked again.",
    ]


def test_way_forward_leads_through_all_steps():
    name, passed = "pin", ["pin"]
    while name != "save":
        name = steps.follow(name, "")
        passed.append(name)
    assert passed == steps.ORDER
    assert steps.follow("save", "") == "save"
    assert steps.follow("off", "SKIP") == "probe"


@pytest.mark.parametrize(
    ("name", "before"),
    [
        ("probe", "off"),
        ("switch", "nozzle"),
        ("bed", "switch"),
        *((f"touch_{site}", site) for site in ("nozzle", "switch", "bed")),
        ("paper", "gap"),
        ("save", "gap"),
    ],
)
def test_way_back(name, before):
    assert steps.follow(name, "BACK") == before


def test_ways_from_the_look():
    for site in SITES:
        assert steps.follow("look", site.upper()) == site
    assert steps.follow("look", "AGAIN") == "look"
    assert steps.follow("look", "") == "touch_nozzle"
    shown, _ = dialog("look")
    label = "Switch"
    assert shown.gcode(label) == "Z_CALIBRATION_SETUP STEP=LOOK ANSWER=SWITCH"


@pytest.mark.parametrize(
    ("name", "answer"), [("pin", "BACK"), ("pin", "SKIP"), ("save", "YES")]
)
def test_answer_that_nobody_asked_for(name, answer):
    words = f"ANSWER={answer} is none of STEP={name}: none"
    with pytest.raises(CalibrationError, match=words):
        steps.follow(name, answer)


def test_jog_buttons_say_mm_and_lead_both_ways():
    shown, _ = dialog("nozzle")
    labels = [[b[0] for b in group] for group in shown.groups]
    assert labels == [
        [f"{axis}{move} mm" for move in row]
        for axis in "XYZ"
        for row in (("-10", "-1", "-0.1"), ("+0.1", "+1", "+10"))
    ]
    assert shown.gcode("Y-10 mm") == "Z_CALIBRATION_SETUP STEP=NOZZLE Y=-10"
    shown, _ = dialog("paper")
    fine = [
        "Z-0.1 mm",
        "Z+0.1 mm",
        "Z-0.05 mm",
        "Z+0.05 mm",
        "Z-0.01 mm",
        "Z+0.01 mm",
    ]
    for room, roomy in (
        (1.0, ["Z-1 mm", "Z+1 mm", "Z-0.5 mm", "Z+0.5 mm"]),
        (0.9, ["Z-0.5 mm", "Z+0.5 mm"]),
        (0.4, []),
    ):
        shown, _ = dialog("paper", room=room)
        labels = [b[0] for group in shown.groups for b in group]
        assert labels == roomy + fine
    assert not dialog("home")[0].groups
    (types,) = dialog("gap")[0].groups
    # What each of them means is on it
    assert [b[0] for b in types] == ["D2F 0.2 mm", "SSG 0.2 mm"]
    assert [b[1][-8:] for b in types] == ["TYPE=D2F", "TYPE=SSG"]
    console = dialog("gap")[1]
    assert "D2F 0.2 mm: Z_CALIBRATION_SETUP STEP=GAP TYPE=D2F" in console


def test_dialog_while_watching_cannot_watch_twice():
    (shown,) = dialogs_of(steps.while_watching("probe", "the probe"))
    assert shown.headline == "Step 3 of 12: press it now"
    assert shown.last.startswith("Press the probe by hand now")
    assert [b[0] for b in shown.footer_buttons] == ["Abort"]


NO, YES = False, True


@pytest.mark.parametrize(
    ("readings", "verdict"),
    [
        ([(NO, YES)], "nothing"),
        ([(NO, YES), (NO, YES)], "nothing"),
        ([(NO, YES), (YES, YES)], "held"),
        ([(NO, YES), (YES, YES), (NO, YES)], "good"),
        ([(YES, NO), (NO, NO)], "early"),
        ([(NO, NO), (NO, YES), (NO, NO)], "other"),
        ([(NO, NO), (YES, YES), (NO, NO)], "both"),
        # Not at the same moment
        ([(NO, NO), (YES, NO), (NO, YES)], "both"),
    ],
)
def test_what_a_hand_has_done(readings, verdict):
    assert steps.judge(readings) == verdict


@pytest.mark.parametrize(
    ("pin", "other"),
    [
        ("^PC2", "^!PC2"),
        ("^!PC2", "^PC2"),
        ("!^ tool:PB1", "^ tool:PB1"),
        ("PC2", "!PC2"),
    ],
)
def test_other_polarity(pin, other):
    assert steps.inverted(pin) == other


@pytest.mark.parametrize(
    ("start", "distance", "end"),
    [(5.0, 5.0, 10.0), (5.0, -5.0, 0.0), (-1.0, 1.0, 0.0), (12.0, -1.0, 11.0)],
)
def test_jog_within_the_limits_or_towards_them(start, distance, end):
    assert jogging.jogged("X", start, distance, 0.0, 10.0) == end


@pytest.mark.parametrize(
    ("start", "distance", "end"),
    [(5.0, -10.0, 2.0), (5.0, -3.0, 2.0), (5.0, -1.0, 4.0), (2.0, 1.0, 3.0)],
)
def test_jog_that_stops_by_itself(start, distance, end):
    assert jogging.jogged("Z", start, distance, 2.0, 9.0, stops=True) == end


@pytest.mark.parametrize(
    ("start", "distance", "words"),
    [
        # Nowhere to go
        (2.0, -0.1, "would lead to 1.900, outside 2.000"),
        (1.0, -0.1, "would lead to 0.900, outside 1.000"),
        (9.0, -10.1, "by 10 mm at most"),
        (8.5, 1.0, "outside 2.000 to 9.000"),
    ],
)
def test_jog_that_does_not_even_stop(start, distance, words):
    with pytest.raises(CalibrationError, match=words):
        jogging.jogged("Z", start, distance, 2.0, 9.0, stops=True)


@pytest.mark.parametrize(
    ("start", "distance", "words"),
    [
        (5.0, 5.1, "X=5.1 would lead to 10.100, outside 0.000 to 10.000"),
        (5.0, -5.1, "outside"),
        (-1.0, -0.1, "would lead to -1.100"),
        (5.0, 10.1, "by 10 mm at most"),
        (5.0, -10.1, "by 10 mm at most"),
    ],
)
def test_jog_too_far(start, distance, words):
    with pytest.raises(CalibrationError, match=words):
        jogging.jogged("X", start, distance, 0.0, 10.0)


@pytest.mark.parametrize(
    ("deviation", "word", "count"),
    [
        (0.0, "good", 3),
        (0.004, "good", 3),
        (0.006, "fair", 5),
        (0.02, "poor", 10),
    ],
)
def test_repeatability_and_samples(deviation, word, count):
    good, bad = [1.0, 1.0], [2.0 - deviation, 2.0 + deviation]
    found, samples = steps.repeatability([good, bad, []])
    assert found.startswith(word)
    assert samples == count
    # None of so poor ones
    enough = f"; {count} touches of each place are enough"
    assert found.endswith(enough) is (word != "poor")


@given(st.floats(-1, 1), st.floats(0.001, 1.5))
def test_paper_gives_back_the_switch_offset(contact, switch_offset):
    # The bed is switch_offset lower, the sheet is held 0.1 above it
    z = contact - switch_offset + steps.PAPER
    assert steps.from_paper(contact, z) == pytest.approx(
        switch_offset, abs=6e-4
    )
    assert not steps.is_too_high(contact, z)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (-0.01, "still too high, by 0.010 mm"),
        (0.0, "still too high, by 0.000 mm"),
        (0.0004, "still too high, by 0.000 mm"),
        (1.51, "none by more than 1.5 mm"),
    ],
)
def test_paper_where_no_switch_would_be(wrong, words):
    with pytest.raises(CalibrationError, match=words):
        steps.from_paper(0.3, 0.3 - wrong + steps.PAPER)


@pytest.mark.parametrize(
    ("wrong", "is_told"),
    [(0.001, True), (0.099, True), (0.1, False), (0.2, False), (1.5, False)],
)
def test_switch_that_hardly_moves_is_told(wrong, is_told):
    switch_offset = steps.from_paper(0.3, 0.3 - wrong + steps.PAPER)
    assert switch_offset == pytest.approx(wrong)
    text = steps.too_small(switch_offset)
    assert text.startswith(f"{wrong:.3f} mm is less than any") is is_told
    assert bool(text) is is_told


def test_lower_towards_the_sheet_in_small_steps_only():
    # The bed may lie at 0.3 or lower
    assert steps.paper_floor(0.3, 2.3, -1.0) == -1.2
    assert steps.paper_floor(0.3, 1.0, -1.0) == pytest.approx(0.4)
    assert steps.paper_floor(0.3, 0.2, -1.0) == 0.2
    assert steps.paper_floor(0.3, 0.2, -0.1) == -1.2


@pytest.mark.parametrize(
    ("pin", "z_offset", "step", "attached", "floor"),
    [
        (1.5, 6.5, "nozzle", False, 2.5),
        (-1.0, 6.5, "nozzle", False, 1.0),
        # A separate one
        (None, 6.5, "nozzle", False, 3.0),
        # With the length of the probe, and of its free plunger
        (1.5, 6.5, "nozzle", True, 10.0),
        (1.5, 6.5, "switch", True, 10.0),
        (1.5, 0.0, "switch", True, 13.5),
        (1.5, 1.9, "switch", False, 13.5),
    ],
)
def test_how_low_the_head_is_moved(pin, z_offset, step, attached, floor):
    settings = SimpleNamespace(position_endstop=pin, z_offset=z_offset)
    section = Interface(SimpleNamespace(host=None, settings=settings))
    section.pin_moved = lambda: ""
    head = GuidedHead(section)
    state = State()
    state.step = step
    assert head.jog_floor(state, attached) == floor
    # What is known of the pin since
    state.pin_below = 9.0
    if pin is None:
        assert head.jog_floor(state, attached) == 10.0
    state.touched["nozzle"] = SimpleNamespace(z=8.0)
    assert head.pin_z(state) == 8.0


def head_with(config):
    """On a printer with this printer.cfg."""
    configfile = SimpleNamespace(
        get_status=lambda eventtime: {"config": config}
    )
    printer = SimpleNamespace(lookup_object=lambda name: configfile)
    host = SimpleNamespace(printer=printer, eventtime=lambda: 0.0)
    return GuidedHead(SimpleNamespace(host=host))


@pytest.mark.parametrize("text", ["50, 308", "50,308,12"])
def test_place_in_the_dock(text):
    head = head_with({"dockable_probe": {"dock_position": text}})
    site = Site("bed", 60.0, 300.0, "The place of the bed")
    words = "The place of the bed is 12.8 mm from the dock; choose one"
    with pytest.raises(CalibrationError, match=words):
        head.check_dock(site)
    head.check_dock(site._replace(x=65.1, y=308.0))
    head_with({}).check_dock(site)


# What is saved as samples: fifteen touches are enough, or three


def proposed(count, step=0.0025, said=(), **options):
    """Of a section, on a printer with such steps of Z (mm)."""
    axes = SimpleNamespace(z_step=lambda: step)
    settings = make_settings(
        said=frozenset(said), target_uncertainty=0.008, **options
    )
    section = SimpleNamespace(
        host=SimpleNamespace(axes=axes), settings=settings
    )
    return Interface(section).proposed_samples(count)


@pytest.mark.parametrize(
    ("count", "said", "counting", "step", "samples"),
    [
        # As many as [probe] has, which are enough, or too few
        (3, (), FixedCount(), 0.0025, "auto"),
        (15, (), FixedCount(), 0.0025, "auto"),
        # His own, which are enough, or too few
        (3, ("samples",), FixedCount(3), 0.0025, ""),
        (15, ("samples",), FixedCount(3), 0.0025, "auto"),
        # That is what it is already
        (15, ("samples",), Automatic(0.008), 0.0025, ""),
        # Such steps cannot keep the target
        (3, (), FixedCount(), 0.01, ""),
        (15, (), FixedCount(), 0.01, "15"),
    ],
)
def test_samples_that_are_proposed(count, said, counting, step, samples):
    assert proposed(count, step, said, counting=counting) == samples
