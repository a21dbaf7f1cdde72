"""Prepare and print all hosts and Moonraker.

    python -m simprinter.hosts.prepare

Needs the standard library only, as it runs while the tools are installed.
"""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor

from simprinter.hosts.environment import HostError, check_python
from simprinter.hosts.hosts import find_hosts, missing_hosts
from simprinter.hosts.moonraker_package import (
    find_moonraker,
    moonraker_version,
)
from simprinter.hosts.trees import python_version


def main() -> int:
    """Print one line for each host; return the exit code."""
    check_python()
    try:
        missing_hosts(forget=True)
        with ThreadPoolExecutor() as pool:
            found = pool.submit(find_moonraker)
            hosts = find_hosts()
            moonraker = found.result()
    except HostError as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    rows = [("host", "version", "Python", "prepared in")]
    rows += [
        (host.name, host.version, python_version(host.python), host.directory)
        for host in hosts
    ]
    if moonraker is not None:
        version = moonraker_version(moonraker)
        folder = moonraker.parents[1]
        rows.append(("moonraker", version, python_version(moonraker), folder))
    rows += [(name, "MISSING", "-", "-") for name in missing_hosts()]
    lines = [[str(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*lines)]
    for line in lines:
        padded = (cell.ljust(width) for cell, width in zip(line, widths))
        sys.stdout.write("  ".join(padded).rstrip() + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
