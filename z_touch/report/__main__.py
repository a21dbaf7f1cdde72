"""Run the report as a program: python3 .../z_touch/report HISTORY.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import os
import sys

# The folder that holds z_touch comes last: klippy/extras has a statistics.py, which
# would be found instead of that of Python.
sys.path.append(
    os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
)

from z_touch.report.program import main  # noqa: E402

sys.exit(main(sys.argv[1:]))
