"""Print the cases as a table: python -m tests.field."""

import sys

from tests.field.cases import NAMES, read, wanted
from tools.kit.tables import plain

_COLUMNS = ["case", "machine", "source", "wanted"]

if __name__ == "__main__":
    cases = {name: read(name) for name in NAMES}
    rows = [
        [name, case["machine"], case["source"], wanted(case)]
        for name, case in cases.items()
    ]
    sys.stdout.write(plain(_COLUMNS, rows) + "\n")
