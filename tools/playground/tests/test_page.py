"""The page of `make printer` in a real browser, used as a person does."""

from __future__ import annotations

import re
from contextlib import contextmanager

import psutil
import pytest
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

from simplay.tests.browser import LIMIT, browser, programs
from tools.playground import tour
from tools.playground.tests.test_playground import port, terminal

pytestmark = pytest.mark.slow

__all__ = ["port"]

# Seconds of a test that does more than one thing
LONG = pytest.mark.timeout(8 * LIMIT)


@contextmanager
def looking(port, *options):
    """A playground, and its page in a browser."""
    if programs() is None:
        # Before anything is started
        with browser(""):
            pass
    options = ("--port", port, "--seed", "1", *options)
    with terminal(*options) as shown, browser(shown.page) as page:
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
def test_it_fits(port):
    with looking(port) as (_, page):
        home(page)
        calibrate(page)
        page.resize(400, 900)
        assert page.value("document.documentElement.scrollWidth") <= 400
        page.resize(1400, 900, is_dark=True)
        assert page.value("document.documentElement.scrollWidth") <= 1400
        # Console and view share the height
        bottoms = page.value(
            "['view', 'talk'].map(id => document.getElementById(id)"
            ".getBoundingClientRect().bottom)"
        )
        assert bottoms[0] == pytest.approx(bottoms[1], abs=1.0)
        assert page.find("#console").size["height"] > 250
