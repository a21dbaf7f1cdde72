"""The page of `make printer` in a real browser, used as a person does."""

from __future__ import annotations

import re
import time
from contextlib import contextmanager

import psutil
import pytest
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

from simplay.tests.browser import LIMIT, browser, programs
from tools.kit.setup_user import EMPTY
from tools.playground import tour
from tools.playground.tests.test_playground import port, terminal

pytestmark = pytest.mark.slow

__all__ = ["port"]

# Seconds of a test that does more than one thing
LONG = pytest.mark.timeout(8 * LIMIT)


@contextmanager
def looking(port, *options, size=(1400, 1000), is_dark=False):
    """A playground, and its page in a browser."""
    if programs() is None:
        # Before anything is started
        with browser(""):
            pass
    options = ("--port", port, "--seed", "1", *options)
    with terminal(*options) as shown, browser(shown.page) as page:
        page.resize(*size, is_dark)
        page.until_ready()
        yield shown, page
        assert page.complaints() == []


def gap(page):
    """The large figures, mm; None while they are not known."""
    found = re.fullmatch(r"(-?\d\.\d{3}) mm", page.text("#gap"))
    return float(found[1]) if found else None


def home(page):
    page.press("#shortcuts", "Home")
    page.until(lambda: gap(page) is not None, "the gap is known")


def calibrate(page):
    """By the button; the offset that the card shows."""
    before = page.console().count("Z-CALIBRATION: offset ")
    page.press("#shortcuts", "Calibrate")
    page.until(
        lambda: page.console().count("Z-CALIBRATION: offset ") > before,
        "a result",
    )
    page.until(
        lambda: "switch_offset=" in page.text("#result"), "how it was found"
    )
    return float(
        re.match(r"new Z offset(-?[\d.]+) mm", page.text("#result"))[1]
    )


def blue(page):
    """The buttons above the console that stand out."""
    return page.value(
        "[...document.querySelectorAll('#shortcuts .primary')]"
        ".map(b => b.textContent)"
    )


# By the size of the gap (mm): the colour, and what a first layer would do
VERDICTS = {
    "0.001": ["good", "right on the bed"],
    "-0.001": ["good", "right on the bed"],
    "0.02": ["good", "right on the bed"],
    "-0.02": ["good", "right on the bed"],
    "0.021": ["warn", "a little too high"],
    "-0.021": ["warn", "a little too low"],
    "0.1": ["warn", "a little too high"],
    "-0.1": ["warn", "a little too low"],
    "0.101": ["bad", "too high"],
    "-0.101": ["bad", "in the bed"],
    "1.277": ["bad", "too high"],
}


def verdicts(page):
    """What the page says of each of them."""
    return page.value(
        "import('/gap.js').then(({ verdict }) => Object.fromEntries("
        "arguments[0].map((gap) => [gap, verdict(Number(gap))])"
        ".map(([gap, [kind, words]]) => [gap, [kind, words.split(':')[0]]])))",
        list(VERDICTS),
    )


def has_card(page):
    """Whether a result is shown."""
    return page.find("#result").is_displayed()


# What is to be seen only while it calibrates: a contact, and how far it is
PASSING = tuple(
    f"document.querySelector('{selector}')"
    for selector in (
        "#signals .flash",
        "#progress:not([hidden]) progress[value]",
    )
)
AT_WORK = (
    "document.querySelector('#progress:not([hidden]) progress:not([value])')"
)


def set_speed(page, speed):
    """By its slider."""
    page.value(
        "(s => { s.value = arguments[0]; s.dispatchEvent(new Event('input'));"
        " return true; })(document.getElementById('speed'))".replace(
            "arguments[0]", str(speed)
        )
    )


@LONG
def test_page_calibrates(port, host):
    options = ("--perfect", "--host", host.name)
    with looking(port, *options) as (_, page):
        assert gap(page) is None
        assert blue(page) == ["Home"]
        assert page.text("#next-words").startswith("press Home")
        was_at_work = page.watch(AT_WORK)
        home(page)
        page.until(was_at_work, "a bar at work")
        page.until(
            lambda: page.text("#next-words").startswith("press Calibrate"),
            "what comes next",
        )
        assert blue(page) == ["Calibrate"]
        assert gap(page) == pytest.approx(-0.1, abs=0.03)
        assert verdicts(page) == VERDICTS
        page.find("#to-tour").click()
        page.until(lambda: page.find("#tour-steps li").is_displayed(), "a tour")
        shown = page.value(
            "[...document.querySelectorAll('#tour-steps li > strong')]"
            ".map(e => e.textContent)"
        )
        assert shown == [f"{step.title}. " for step in tour.steps()]
        assert page.text("#tour-steps em") == "Home"
        set_speed(page, 8)
        page.until(
            lambda: "8 times as fast" in page.text("#lines"), "the speed"
        )
        passed = page.watch(*PASSING)
        assert calibrate(page) == pytest.approx(0.16, abs=0.03)
        assert set(PASSING) == set(passed())
        page.until(
            lambda: gap(page) == pytest.approx(0.06, abs=0.006), "the gap"
        )
        assert page.find("#gap").get_attribute("class") == "big warn"
        assert "a little too high" in page.text("#gap-words")
        assert page.text("#next-words").startswith("look at the true gap")
        assert "probe on the bed" in page.text("#lines")
        assert "plunger on bed at X152" in page.text("#touched")
        dots = page.driver.find_elements(By.CSS_SELECTOR, "#top .dot")
        assert len(dots) >= 9
        assert page.value("drawn") > 30


@LONG
def test_crash_is_told(port):
    with looking(port, "--perfect") as (_, page):
        home(page)
        page.run("G90", "> G90")
        for script in ("G1 X150 Y150 F6000", "G1 Z6 F600"):
            page.run(script, f"> {script}")
        # Once the plunger is in, the body is what hits the plate
        crash = (
            r" *\d+\.\d s  CRASH: probe BODY on the bed +X150\.0 Y150\.0,"
            r" \d\.\d{3} mm deep, 0\.000 mm allowed"
        )
        bad = "[...document.querySelectorAll('#lines .bad')]"
        page.until(
            lambda: any(
                re.fullmatch(crash, line)
                for line in page.value(f"{bad}.map(e => e.textContent)")
            ),
            "a crash",
        )


@LONG
def test_every_result_is_in_large_figures(port):
    with looking(port, "--perfect") as (_, page):
        home(page)
        page.run("G90", "> G90")
        for script, card in (
            (
                "PROBE_Z_ACCURACY SAMPLES=3",
                "touches of the nozzle: standard deviation0.0000 mm",
            ),
            ("G1 X150 Y150 F6000\nPROBE", r"triggered at Z-?\d\.\d{3} mm"),
            (
                "G1 Z10 F600\nPROBE_ACCURACY",
                r"touches: standard deviation0\.0000 mm",
            ),
            (
                "CALIBRATE_Z_ACCURACY CYCLES=6",
                r"one CALIBRATE_Z± 0\.\d{4} mmverdict of \w+: \w",
            ),
        ):
            for line in script.splitlines():
                page.send(line)
            page.until(
                lambda wanted=card: re.match(wanted, page.text("#result")),
                f"the card of {script}",
            )


@LONG
def test_broken_wire_is_refused_and_repaired(port):
    with looking(port, "--perfect") as (_, page):
        home(page)
        calibrate(page)
        assert has_card(page)
        # A command of the terminal, typed as G-code is
        page.run("break probe", "the wire of probe is broken")
        page.until(
            lambda: "wire of probe is broken" in page.text("#told"), "told"
        )
        page.run("CALIBRATE_Z", "the probe reads triggered")
        page.until(lambda: not has_card(page), "the result holds no longer")
        refused = page.driver.find_elements(By.CSS_SELECTOR, "#console .error")[
            -1
        ]
        assert refused.text.startswith("!! z_calibration: ")
        assert page.text("#next-words").startswith("read the red line")
        page.until(
            lambda: page.find("#signals [data-signal=probe].on"), "lamp is on"
        )
        page.do("repair")
        page.until(lambda: "as good as new" in page.text("#told"), "told")
        assert page.text("#next-words").startswith("press Calibrate")
        assert calibrate(page) == pytest.approx(0.16, abs=0.03)
        # Klippy's own, and what is none of theirs
        page.run("HELP", "Available extended commands")
        page.run("help", "a wire breaks")
        page.run("press nothing", "no wire nothing")
        page.run("quit", "only in the terminal")
        page.run("nonsense", 'Unknown command:"NONSENSE"')


@LONG
def test_result_is_taken_back_and_warnings_colour_it(port):
    with looking(port, "--perfect") as (_, page):
        home(page)
        calibrate(page)
        assert "doubtful" not in page.find("#result").get_attribute("class")
        home(page)
        page.until(lambda: not has_card(page), "it is of another Z")
        page.run("dirt 0.1", "plastic")
        # In a window that is too small for all of its lines
        page.resize(1050, 700)
        calibrate(page)
        page.until(
            lambda: (
                page.value(
                    "(e => e.scrollHeight - e.clientHeight - e.scrollTop)"
                    "(document.getElementById('console'))"
                )
                < 5
            ),
            "the end of the console, of which the card has taken some",
            5.0,
        )
        page.until(
            lambda: (
                "doubtful" in page.find("#result").get_attribute("class")
                and "Warning: " in page.text("#result")
            ),
            "a warning",
        )
        assert page.find("#console .warning").is_displayed()
        page.press("#shortcuts", "Report")
        page.until(
            lambda: page.find("#report-picture").is_displayed(), "a report"
        )
        with page.restarts():
            page.press("#shortcuts", "Restart")
        assert page.console().endswith("Klipper is ready")
        assert not has_card(page)
        assert not page.find("#report-picture").is_displayed()


@LONG
def test_hands_change_what_is_measured(port):
    """Each by its button; what they type is what is told."""
    with looking(port, "--perfect") as (_, page):
        home(page)
        first = calibrate(page)
        page.do("nozzle 0.15")
        # It hangs lower, so Z=0 is lower until it is measured
        page.until(lambda: "another nozzle" in page.text("#told"), "told")
        assert calibrate(page) == pytest.approx(first + 0.15, abs=0.01)
        page.do("plate 0.2")
        assert calibrate(page) == pytest.approx(first + 0.35, abs=0.01)
        page.do("nozzle 0")
        page.do("plate 0")
        assert calibrate(page) == pytest.approx(first, abs=0.01)
        page.do("off")
        page.until(lambda: "off the toolhead" in page.text("#told"), "told")
        page.run("CALIBRATE_Z", "!! z_calibration: ")
        page.do("drop")
        page.until(
            lambda: "!! the toolhead does not" in page.text("#told"), "told"
        )
        page.do("attach")
        page.until(lambda: "is on the toolhead" in page.text("#told"), "told")
        page.do("dirt 0.05")
        page.until(lambda: "plastic" in page.text("#told"), "told")
        page.do("short x_endstop")
        page.until(lambda: "shorted to ground" in page.text("#told"), "told")
        page.do("repair")
        assert calibrate(page) == pytest.approx(first, abs=0.01)


@LONG
def test_membrane_by_dialogs(port):
    options = ("--scene", "extra_probe", "--perfect", "--speed", "10")
    with looking(port, *options) as (_, page):
        home(page)
        page.press("#shortcuts", "Calibrate")
        page.until(lambda: page.buttons("#dialog"), "a dialog")
        # It has one of its own
        assert blue(page) == []
        page.do("lay")
        # Of the printer's time, of which a slow browser takes much
        set_speed(page, 1)
        page.press("#dialog", "Continue")
        page.until(
            lambda: "within 20 seconds" in page.text("#dialog"), "it waits"
        )
        page.do("press membrane")
        page.until(
            lambda: "hand away" in page.text("#dialog"), "the switch works"
        )
        set_speed(page, 10)
        page.press("#dialog", "Continue")
        page.until(
            lambda: (
                "Take the switch away" in page.text("#dialog")
                and "Continue" in page.buttons("#dialog")
            ),
            "the second question",
        )
        page.do("take")
        page.press("#dialog", "Continue")
        page.until(lambda: "SAVE_CONFIG" in page.console(), "it is to save")
        assert re.match(r"new Z offset-?\d\.\d{3} mm", page.text("#result"))
        with page.restarts():
            page.press("#shortcuts", "Save config")
        page.until(lambda: gap(page) is None, "nothing is homed")
        home(page)
        # Told where the membrane was laid
        assert page.text("#point") == "at X30 Y20"
        page.until(lambda: abs(gap(page)) <= 0.02, "the gap is right")
        assert page.find("#gap").get_attribute("class") == "big good"


@LONG
def test_another_printer_and_its_own_file(port):
    with looking(port, "--perfect") as (shown, page):
        home(page)
        calibrate(page)
        page.press("#shortcuts", "Report")
        page.until(
            lambda: page.find("#report-picture").is_displayed(), "a report"
        )
        page.value(
            "(s => { s.value = 'auto_z_offset';"
            " s.dispatchEvent(new Event('change')); })"
            "(document.getElementById('scene'))"
        )
        shown.until("^Printer +auto_z_offset, perfect")
        page.until(
            lambda: (
                "AUTO_Z_CALIBRATE"
                in str(
                    page.value(
                        "[...document.querySelectorAll('[data-runs]')]"
                        ".map(b => b.dataset.runs)"
                    )
                )
            ),
            "its own button",
        )
        page.until_ready()
        assert not has_card(page)
        assert not page.find("#report-picture").is_displayed()
        assert "CALIBRATE_Z" not in page.console()
        assert blue(page) == ["Home"]
        assert "[auto_z_offset]" in (shown.config / "printer.cfg").read_text()
        home(page)
        page.find("#config summary").click()
        page.until(
            lambda: (
                "[auto_z_offset]"
                in page.value("document.getElementById('config-text').value")
            ),
            "its printer.cfg",
        )


@LONG
def test_wrong_configuration_is_told_and_mended(port):
    """It waits for its owner; who wrote meanwhile is not overwritten."""
    with looking(port, "--perfect") as (shown, page):
        page.find("#config summary").click()
        text = page.find("#config-text")
        page.until(lambda: "[printer]" in text.get_property("value"), "text")
        text.send_keys("\n[nonsense]\n")
        page.press("#config", "Save and restart")
        page.until(
            lambda: "'nonsense' is not a valid" in page.text("#away"), "why not"
        )
        # Beside the button, in view
        told = page.find("#config-told")
        page.until(
            lambda: re.match(
                "klippy refuses it: .*'nonsense' is not a valid", told.text
            ),
            "why not",
        )
        assert told.get_attribute("class") == "bad-text"
        assert page.value(
            "(({ top, bottom }) => top >= 0 && bottom <= innerHeight)"
            "(document.getElementById('config-told').getBoundingClientRect())"
        )
        assert not page.find("#progress").is_displayed()
        assert "correct printer.cfg" in page.text("#next-words")
        file = shown.config / "printer.cfg"
        right = file.read_text().replace("[nonsense]", "")
        page.press("#config", "Read again")
        page.until(lambda: page.text("#config-told") == "", "read again")
        assert "[nonsense]" in text.get_property("value")
        file.write_text(right)
        page.press("#config", "Save and restart")
        page.until(
            lambda: "changed meanwhile" in page.text("#config-told"), "a hint"
        )
        assert file.read_text() == right
        # Longer than its serial line can hold what nobody reads
        time.sleep(75.0)
        page.press("#config", "Read again")
        page.press("#shortcuts", "Restart")
        page.until_ready()
        home(page)
        # Said by the browser itself
        assert all("412" in text for text in page.complaints())


@LONG
def test_who_is_away_is_said(port):
    with looking(port, "--perfect") as (shown, page):
        page.value("fetch('/printer.cfg').then(() => 0)")
        (moonraker,) = [
            p
            for p in psutil.process_iter(["cmdline"])
            if "moonraker" in (p.info["cmdline"] or ())
            and str(shown.config.parent) in p.info["cmdline"]
        ]
        home(page)
        page.send("CALIBRATE_Z")
        page.until(lambda: page.find("#progress").is_displayed(), "at work")
        page.press("#shortcuts", "Emergency stop")
        page.until(lambda: "shutdown" in page.text("#away"), "a shutdown")
        page.until(lambda: gap(page) is None, "no gap is claimed")
        assert page.text("#gap-words") == "not known: klippy has stopped"
        assert not page.find("#progress").is_displayed()
        assert "press Restart" in page.text("#next-words")
        page.press("#shortcuts", "Restart")
        page.until_ready()
        moonraker.kill()
        page.until(
            lambda: "Moonraker does not answer" in page.text("#away"), "away"
        )
        assert page.find("#state-moonraker").get_attribute("class") == "bad"
        # It is started again, as systemd does
        page.until_ready()
        home(page)
        shown.close()
        page.until(
            lambda: "start it with `make printer`" in page.text("#away"), "away"
        )
        # The browser itself tells of connections that were refused
        assert all("WebSocket" in text for text in page.complaints())


@LONG
def test_report_is_shown(port):
    with looking(port, "--perfect") as (_, page):
        home(page)
        for _ in range(2):
            calibrate(page)
        page.press("#shortcuts", "Report")
        page.until(
            lambda: page.value(
                "document.getElementById('report-picture').naturalWidth"
            ),
            "the picture",
        )


@LONG
def test_correction_of_an_inductive_probe_is_shown(port):
    options = ("--scene", "auto_z_offset", "--perfect", "--speed", "10")
    with looking(port, *options) as (_, page):
        home(page)
        assert page.find("#gap").get_attribute("class") != "big good"
        page.press("#shortcuts", "Calibrate")
        page.until(lambda: "correction=" in page.console(), "a result")
        shown = r"correction of the probe-?\d\.\d{3} mm"
        page.until(lambda: re.match(shown, page.text("#result")), "the card")
        page.until(
            lambda: "SAVE_CONFIG" in page.console(), "the end of the run"
        )
        # Of all cycles and the mean the last one stands out
        (line,) = page.driver.find_elements(By.CSS_SELECTOR, "#console .result")
        assert line.text.startswith("AUTO_Z_CALIBRATE: ")
        # z_offset wants 0.2 mm, of which the bed has given way by some
        page.until(lambda: gap(page) == pytest.approx(0.15, abs=0.03), "high")
        assert page.find("#gap").get_attribute("class") == "big good"
        assert "above the bed on purpose" in page.text("#gap-words")


@LONG
def test_keyboard_alone(port):
    with looking(port, "--perfect") as (_, page):
        field = page.find("#input")
        field.send_keys("calibrate_z")
        # The same name goes on; Tab shows what begins so
        field.clear()
        field.send_keys("PROBE_Z", Keys.TAB)
        assert field.get_property("value").startswith("PROBE_Z_ACCURACY")
        field.clear()
        completed = "CALIBRATE_Z_ACCURACY CYCLES="
        field.send_keys("CALIBRATE_Z_", Keys.TAB, "cyc", Keys.TAB)
        assert field.get_property("value") == completed
        # One is not given twice; Escape, and Tab leaves the field
        field.send_keys("3 CY")
        assert not page.find("#proposals").is_displayed()
        field.send_keys(Keys.BACKSPACE, Keys.BACKSPACE, "H")
        assert "HOME" in page.text("#proposals")
        field.send_keys(Keys.ESCAPE, Keys.TAB)
        assert page.value("document.activeElement.textContent") == "Send"
        field.clear()
        field.send_keys("G28", Keys.ENTER)
        page.until(lambda: gap(page) is not None, "homed")
        field.send_keys("M114", Keys.ENTER)
        field.send_keys(Keys.ARROW_UP, Keys.ARROW_UP)
        assert field.get_property("value") == "G28"
        field.send_keys(Keys.ARROW_DOWN)
        assert field.get_property("value") == "M114"
        # All that can be pressed can be reached, and is seen when it is
        page.value("document.activeElement.blur()")
        reached, unseen = set(), []
        for _ in range(120):
            page.driver.switch_to.active_element.send_keys(Keys.TAB)
            found = page.value(
                "(e => [e.id || e.dataset.does || e.dataset.runs ||"
                " e.textContent, e === document.body ||"
                " getComputedStyle(e).outlineStyle !== 'none'])"
                "(document.activeElement)"
            )
            reached.add(found[0])
            if not found[1]:
                unseen.append(found[0])
        everything = page.value(
            "[...document.querySelectorAll('button, input, select, summary')]"
            ".filter(e => e.checkVisibility() && !e.disabled)"
            ".map(e => e.id || e.dataset.does || e.dataset.runs ||"
            " e.textContent)"
        )
        assert set(everything) <= reached
        assert unseen == []


@LONG
@pytest.mark.parametrize("is_dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [1400, 400])
def test_it_fits_and_can_be_read(port, width, is_dark):
    with looking(port, size=(width, 900), is_dark=is_dark) as (_, page):
        home(page)
        calibrate(page)
        assert page.value("document.documentElement.scrollWidth") <= width
        if width > 1000:
            # Console and view share the height
            bottoms = page.value(
                "['view', 'talk'].map(id => document.getElementById(id)"
                ".getBoundingClientRect().bottom)"
            )
            assert bottoms[0] == pytest.approx(bottoms[1], abs=1.0)
            assert page.find("#console").size["height"] > 250
        assert contrasts(page) == []


# Text against what is behind it, as WCAG 2 counts it
_CONTRASTS = """(() => {
  const canvas = document.createElement('canvas').getContext('2d',
    {willReadFrequently: true});
  const rgb = (text) => {
    canvas.clearRect(0, 0, 1, 1); canvas.fillStyle = text;
    canvas.fillRect(0, 0, 1, 1); return canvas.getImageData(0, 0, 1, 1).data;
  };
  const bright = ([r, g, b]) => [r, g, b].map((v) => v / 255).map((v) =>
    v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
  const behind = (e) => {
    for (; e; e = e.parentElement) {
      const colour = rgb(getComputedStyle(e).backgroundColor);
      if (colour[3] === 255) return colour;
    }
    return rgb('white');
  };
  const bad = [];
  for (const e of document.querySelectorAll('body *:not(svg *)')) {
    const own = [...e.childNodes].some((n) => n.nodeType === 3
      && n.textContent.trim());
    if (!own || e.offsetParent === null || e.disabled) continue;
    const [a, b] = [bright(rgb(getComputedStyle(e).color)), bright(behind(e))];
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (ratio < 4.5) bad.push(`${e.textContent.slice(0, 30)} ${ratio}`);
  }
  return bad;
})()"""


def contrasts(page):
    """Texts that are too pale, each with its ratio."""
    return page.value(_CONTRASTS)


@LONG
def test_set_up_from_nothing_by_buttons(port):
    """As the tour has it, but for the terminal: nothing is typed."""
    with looking(port, "--perfect", "--speed", "4") as (shown, page):
        page.find("#config summary").click()
        text = page.find("#config-text")
        page.until(lambda: "[printer]" in text.get_property("value"), "text")
        without = r"^(%s)\b.*\n" % "|".join(EMPTY)
        page.value(
            "(t => { t.value = t.value.replace(/%s/gm, ''); })"
            "(document.getElementById('config-text'))"
            % without.replace("\\n", "\\n")
        )
        page.press("#config", "Save and restart")
        page.until(lambda: "run Z_CALIBRATION_SETUP" in page.console(), "note")
        page.until_ready()
        home(page)
        page.press("#shortcuts", "Set up")
        with page.restarts():
            guide(page)
        page.until(lambda: gap(page) is None, "nothing is homed")
        assert "switch_offset" in (shown.config / "printer.cfg").read_text()
        page.do("attach")
        home(page)
        calibrate(page)
        page.until(lambda: abs(gap(page)) < 0.06, "the gap is about 0")
        # Told where it is measured, which the set-up has proposed
        places = re.findall(
            r"bed_xy_position = ([\d.]+), ([\d.]+)",
            (shown.config / "printer.cfg").read_text(),
        )
        ((x, y),) = places
        assert page.text("#point") == f"at X{float(x):g} Y{float(y):g}"


# What hands do before a step's first button is pressed, and what is told then; what
# they do after it
BEFORE = {
    "OFF": ("off", "off the toolhead"),
    "PROBE": ("attach", "on the toolhead"),
    "GAP": ("off", "off the toolhead"),
}
AFTER = {"PIN": "press z_endstop", "PROBE": "press probe"}


def guide(page):
    """The buttons of its dialogs, and hands, until it saves."""
    for _ in range(60):
        gcode = page.until(lambda: first_button(page), "a dialog")
        step = re.search(r"STEP=(\w+)", gcode)[1]
        if step in BEFORE:
            hand, words = BEFORE[step]
            page.do(hand)
            page.until(lambda w=words: w in page.text("#told"), hand)
        if step == "SWITCH" and has_button(page, "X+1 mm"):
            check_pad(page)
            # The plunger is over the pin: along the body
            before = pin_in_lens(page)
            for _ in range(4):
                jog(page, "X+1 mm")
            page.until(lambda b=before: pin_in_lens(page) < b - 5, "it moves")
        elif step == "PAPER":
            lower(page)
        label = page.until(lambda: first_button(page, "textContent"), "asked")
        if step in AFTER:
            # It waits for 20 s of the printer, of which a slow browser takes much
            set_speed(page, 1)
        page.press("#dialog", label)
        if step in AFTER:
            page.until(
                lambda: "press it now" in page.text("#dialog"), "it watches"
            )
            page.do(AFTER[step])
            set_speed(page, 4)
        if label == "Save":
            return
        until_asked(page, gcode)
    raise AssertionError("the guide does not end")


def until_asked(page, before):
    """What follows; while a switch is watched, there is nothing but Abort."""

    def is_asked():
        gcode = first_button(page) or ""
        return gcode not in ("", before) and "STEP=ABORT" not in gcode

    page.until(is_asked, f"what follows {before}")


def first_button(page, what="dataset.runs"):
    """Its G-code, or what it says; None while there is no dialog."""
    button = "document.querySelector('#dialog .footer button')"
    return page.value(f"{button}?.{what}")


def lower(page):
    """By the buttons, until a sheet of paper would be held."""
    for step in (1.0, 0.1, 0.01):
        if has_button(page, f"{step:g} mm") and not is_step(page, step):
            jog(page, f"{step:g} mm")
        while height(page) > 0.1 + step and has_button(page, f"Z-{step:g} mm"):
            jog(page, f"Z-{step:g} mm")


def is_step(page, mm):
    """Whether a button moves by so much already."""
    pressed = "#dialog .steps [aria-pressed=true]"
    return page.text(pressed) == f"{mm:g} mm"


def check_pad(page):
    """A cross with a chooser of the step; the view is turned to X."""
    boxes = page.value(
        "Object.fromEntries([...document.querySelectorAll('#dialog .jog')]"
        ".map(b => [b.textContent, b.getBoundingClientRect()])"
        ".map(([name, { x, y }]) => [name.slice(0, 2), [x, y]]))"
    )
    left, right = boxes["X-"], boxes["X+"]
    far, near = boxes["Y+"], boxes["Y-"]
    assert left[0] < far[0] == near[0] < right[0]
    assert far[1] < left[1] == right[1] < near[1]
    assert boxes["Z+"][0] == boxes["Z-"][0] > right[0]
    assert boxes["Z+"][1] < boxes["Z-"][1]
    assert is_step(page, 1)
    page.until(lambda: "seen along Y" in page.text("#side"), "the view turns")


def pin_in_lens(page):
    """Where the pin is in the close-up, which may be drawn anew just now."""
    script = (
        "(pin => pin && [Number(pin.getAttribute('x'))])"
        "(document.querySelector('#lens .pin'))"
    )
    (x,) = page.until(lambda: page.value(script), "a pin in the close-up")
    return x


def jog(page, label):
    """By a button, until the dialog names the new height.

    The toolhead is seen to move before; the buttons may be others then.
    """
    before = page.text("#dialog")
    page.press("#dialog", label)
    page.until(lambda: page.text("#dialog") not in ("", before), "asked again")


def has_button(page, label):
    return page.value(
        "[...document.querySelectorAll('#dialog button')]"
        ".some(b => b.textContent === arguments[0])",
        label,
    )


def height(page):
    """Of the nozzle above the bed, as the close-up tells it, mm."""
    pattern = r"nozzle and bed: ([\d.]+) mm apart"
    found = page.until(
        lambda: re.match(pattern, page.text("#lens-words")), "it is near"
    )
    return float(found[1])


@pytest.mark.timeout(600)
def test_half_an_hour_costs_no_memory(port):
    """30 minutes of the printer at speed 10: the page, and each program."""
    with looking(port, "--speed", "10") as (shown, page):
        home(page)
        playground = psutil.Process(shown.pid)

        def minutes():
            """Of the printer's time."""
            path = "/printer/objects/query?toolhead=estimated_print_time"
            status = shown.get(path).json()["result"]["status"]
            return status["toolhead"]["estimated_print_time"] / 60.0

        def used():
            """MB: of the page's objects, and of each program."""
            page.value("gc()")
            heap = page.value("performance.memory.usedJSHeapSize")
            programs = [playground, *playground.children(recursive=True)]
            return {0: heap / 1e6} | {
                program.pid: program.memory_info().rss / 1e6
                for program in programs
            }

        begin, found, runs = minutes(), [], 0
        while minutes() - begin < 30.0:
            runs += 1
            # A terminal that nobody reads holds the printer up when it is full
            shown.read()
            page.send("CALIBRATE_Z")
            # Answered behind it; the console forgets its first lines
            over = f"RUN_{runs}"
            page.send(over)
            page.until(
                lambda told=f'Unknown command:"{over}"': told in page.console(),
                "the end of a run",
            )
            if not found and minutes() - begin > 5.0:
                found.append(used())
        found.append(used())
        before, then = found
        assert runs > 20
        # The page, the playground, klippy and Moonraker
        assert len(before) >= 4
        assert then.keys() == before.keys()
        assert then[0] - before[0] < 2.0, found
        assert max(then[pid] - before[pid] for pid in then) < 15.0, found
        assert page.value("document.querySelectorAll('*').length") < 2500
