"""A real browser without a window, and what a person does with the page."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, Optional

import pytest
from selenium import webdriver
from selenium.common.exceptions import StaleElementReferenceException
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webdriver import WebDriver
from selenium.webdriver.remote.webelement import WebElement

# Real seconds for whatever is waited for, also on a busy machine
LIMIT = 60.0
_LOOK_EVERY = 0.05
_OPTIONS = (
    "--headless=new",
    "--no-sandbox",  # as root there is none
    "--disable-dev-shm-usage",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    # As of a window that is looked at
    "--disable-background-timer-throttling",
    "--disable-renderer-backgrounding",
    "--enable-precise-memory-info",
    "--js-flags=--expose-gc",
)


def programs() -> Optional[tuple[str, str]]:
    """The browser and its driver, if both are here."""
    browser, driver = shutil.which("chromium"), shutil.which("chromedriver")
    return (browser, driver) if browser and driver else None


class Page:
    """The page in a browser; every wait has a limit."""

    def __init__(self, driver: WebDriver):
        self.driver = driver
        self._watches = 0

    def find(self, selector: str) -> WebElement:
        """The first that is there."""
        return self.driver.find_element(By.CSS_SELECTOR, selector)

    def text(self, selector: str) -> str:
        """What stands in it, shown or not."""
        # No script: the browser keeps what it returns, and the console is long
        while True:
            # The page may draw it anew between finding and reading it
            with suppress(StaleElementReferenceException):
                return self.find(selector).get_property("textContent")

    def value(self, script: str, *arguments: Any) -> Any:
        """What a script in the page says."""
        return self.driver.execute_script(f"return {script}", *arguments)

    def until(
        self, done: Callable[[], Any], what: str, limit: float = LIMIT
    ) -> Any:
        """Wait for something that is true; it."""
        end = time.monotonic() + limit
        while time.monotonic() < end:
            found = done()
            if found:
                return found
            time.sleep(_LOOK_EVERY)
        raise AssertionError(
            f"{what}: not within {limit} s; the page says"
            f" {self.text('#away')!r}, its console:\n{self.console()[-2000:]}"
        )

    def until_ready(self) -> None:
        """Wait until klippy is ready and the machine is seen."""
        self.until(
            lambda: (
                self.find("#state-klippy").get_attribute("class") == "on"
                and self.find("#state-printer").get_attribute("class") == "on"
                and self.buttons("#shortcuts")
            ),
            "all is there",
        )

    def watch(self, *conditions: str) -> Callable[[], list[str]]:
        """Look from now on; what is returned tells which were true meanwhile.

        conditions: JavaScript. One may be true for less than a look from here takes.
        """
        self._watches += 1
        name = f"seen{self._watches}"
        looks = "".join(
            f"if ({condition}) {name}.add(arguments[1][{number}]);"
            for number, condition in enumerate(conditions)
        )
        self.driver.execute_script(
            f"const {name} = globalThis[arguments[0]] = new Set();"
            f"const look = () => {{ {looks} }};"
            "new MutationObserver(look).observe(document.body, {subtree: true,"
            " attributes: true, childList: true, characterData: true});",
            name,
            conditions,
        )
        return lambda: self.value(f"[...{name}]")

    @contextmanager
    def restarts(self) -> Iterator[None]:
        """What is done inside restarts klippy: wait until it is ready again."""
        # Moonraker may tell that klippy is away long after the machine has lost its
        # place, and that it is ready again before anybody looks here
        was_away = self.watch("!document.querySelector('#state-klippy.on')")
        yield
        self.until(was_away, "klippy is away")
        self.until_ready()

    def console(self) -> str:
        """All of its lines."""
        return self.text("#console")

    def buttons(self, place: str) -> list[str]:
        """What those below a place say that are shown."""

        # One script, as the page may draw them anew between two questions
        script = (
            "[...document.querySelectorAll(arguments[0])]"
            ".filter(b => b.checkVisibility()).map(b => b.textContent)"
        )
        return self.value(script, f"{place} button")

    def press(self, place: str, label: str) -> None:
        """Press a button once it is there and may be pressed."""

        # One dialog may take the place of another meanwhile
        script = (
            "[...document.querySelectorAll(arguments[0])].some(b =>"
            " b.textContent === arguments[1] && !b.disabled"
            " && b.checkVisibility() && (b.click(), true))"
        )
        self.until(
            lambda: self.value(script, f"{place} button", label),
            f"button {label} of {place}",
        )

    def do(self, line: str) -> None:
        """What hands do, by the button for it."""
        # One script, as the page may draw it anew between finding and pressing it
        script = (
            "[...document.querySelectorAll('[data-does]')].some(b =>"
            " b.dataset.does === arguments[0] && (b.click(), true))"
        )
        self.until(
            lambda: self.value(script, line), f"a button that does {line}"
        )

    def send(self, script: str) -> None:
        """Type G-code."""
        field = self.find("#input")
        field.send_keys(script, Keys.ENTER)

    def run(self, script: str, answer: str, limit: float = LIMIT) -> None:
        """Type G-code and wait for what the console says then."""
        before = len(self.console())
        self.send(script)
        self.until(
            lambda: answer in self.console()[before:],
            f"{answer} after {script}",
            limit,
        )

    def complaints(self) -> list[str]:
        """What the browser had to say against the page."""
        return [entry["message"] for entry in self.driver.get_log("browser")]

    def emulate(self, command: str, **parameters: Any) -> None:
        """A command of Chromium's own protocol."""
        self.driver.execute_cdp_cmd(f"Emulation.{command}", parameters)

    def resize(self, width: int, height: int, is_dark: bool = False) -> None:
        """A window of that size, in one of the two themes."""
        self.emulate(
            "setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )
        theme = "dark" if is_dark else "light"
        feature = {"name": "prefers-color-scheme", "value": theme}
        self.emulate("setEmulatedMedia", features=[feature])


@contextmanager
def browser(url: str) -> Iterator[Page]:
    """A page at an address; a visible skip where there is no browser."""
    found = programs()
    if found is None:
        pytest.skip(
            "NOT TESTED: no chromium with its driver (Debian: apt install"
            " chromium chromium-driver)"
        )
    options = webdriver.ChromeOptions()
    options.binary_location = found[0]
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    for option in _OPTIONS:
        options.add_argument(option)
    driver = webdriver.Chrome(options, webdriver.ChromeService(found[1]))
    try:
        driver.set_page_load_timeout(LIMIT)
        page = Page(driver)
        page.resize(1400, 1000)
        driver.get(url)
        yield page
    finally:
        driver.quit()
