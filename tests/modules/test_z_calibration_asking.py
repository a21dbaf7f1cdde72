"""Z_CALIBRATION_REPORT writes what an owner may attach where he asks."""

from __future__ import annotations

import os
import re
import socket
from pathlib import Path

from tools.kit.z_calibration import reported
from z_touch import __version__

MARK = "attach "
SECRET = "hunter2"


def asked(printer) -> tuple[Path, str]:
    """The file that the console names, and what is in it."""
    told = reported(printer, MARK)
    path = Path(re.search(MARK + r"(\S+\.txt)", told)[1])
    return path, path.read_text(encoding="utf-8")


def test_text_has_what_helps_and_nothing_private(start, tmp_path):
    folder = tmp_path / "anna"
    changes = {
        "z_calibration": {
            "history": str(folder),
            "samples_tolerance": "0.009",
            "target_uncertainty": "0.005",
            "end_gcode": f"DOCK_IT KEY={SECRET}",
        },
        "gcode_macro DOCK_IT": {"gcode": f"\n  M400 ; {SECRET}"},
        "respond": {},
    }
    printer = start(changes=changes).homed()
    error = printer.fail("CALIBRATE_Z BED_POSITION=0,0")
    printer.run("CALIBRATE_Z")
    result = printer.status("z_calibration")["last_result"]
    path, text = asked(printer)
    assert path.parent == folder
    assert path.with_suffix(".svg").exists()
    # Versions
    info = printer.session.call("info", {})
    assert f"z_calibration: {__version__}\n" in text
    assert f"Klipper: {info['software_version']}\n" in text
    assert re.search(r"(?m)^Python: \d+\.\d+\.\d+$", text)
    # What happened
    reason = re.search("Last error: (.*)", text)[1]
    assert "BED_POSITION" in reason and reason in " ".join(error.split())
    assert "option 'target_uncertainty' is ignored" in text
    assert f'"offset": {result["offset"]:.6g}' in text
    assert text.count('"ok": true') == text.count('"ok": false') == 1
    # How it is set up
    for line in (
        "[z_calibration]",
        "samples_tolerance: 0.009",
        "end_gcode: runs DOCK_IT",
        "history: <path>",
        "[probe]",
        "[stepper_z]",
    ):
        assert f"{line}\n" in text, line
    assert "[mcu]" not in text and "gcode_macro" not in text
    # Whose it is
    for name in (
        str(tmp_path),
        str(printer.session.data),
        os.path.expanduser("~") + "/",
        SECRET,
        *printer.machine.serials.values(),
    ):
        assert str(name) not in text, name
    if len(socket.gethostname()) > 3:
        assert socket.gethostname() not in text


def test_ten_texts_are_kept(start):
    printer = start().homed()
    first, _ = asked(printer)
    for number in range(11):
        other = first.with_name(f"report-printer-20200101-0000{number:02d}.txt")
        other.write_text("old")
    asked(printer)
    assert len(list(first.parent.glob("report-*.txt"))) == 10
    assert first.exists()


def test_before_any_run(start):
    printer = start()
    printer.session.require_ready()
    _, text = asked(printer)
    assert "Last error: none is kept" in text
    assert "Last runs:\nnone" in text
