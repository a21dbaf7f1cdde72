"""Takes docs/playground.png anew, with a browser without a window.

    python -m tools.playground.picture [FILE]

A calibration has just ended in it.
"""

from __future__ import annotations

import sys
from pathlib import Path

from simprinter.hosts.moonraker import free_port
from simprinter.tests.browser import browser
from tools.playground.tests.test_playground import terminal

FILE = Path(__file__).resolve().parents[2] / "docs" / "playground.png"
SIZE = (1280, 880)


def main() -> None:
    """Play, and take it."""
    file = Path(sys.argv[1]) if sys.argv[1:] else FILE
    options = ("--port", str(free_port()), "--seed", "1", "--speed", "4")
    with terminal(*options) as shown, browser(shown.page) as page:
        page.resize(*SIZE)
        page.until_ready()
        page.run("G28", "> G28")
        page.until(lambda: "mm" in page.text("#gap"), "homed")
        page.run("CALIBRATE_Z", "+-")
        page.until(lambda: page.text("#gap").startswith("0.0"), "the gap")
        page.driver.execute_script("document.activeElement.blur()")
        page.picture(file)


if __name__ == "__main__":
    main()
