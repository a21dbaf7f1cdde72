"""What a module costs the host: CPU time, time of loading, memory."""

from __future__ import annotations

import re
import statistics
from pathlib import Path
from typing import Any, NamedTuple

from simprinter.hosts.environment import run
from simprinter.hosts.hosts import Host, Installed
from simprinter.simulation import Simulation
from tools.kit.printer import MODULES, module_files

LOADINGS = 11
# Of the host, loaded the same way for scale
STOCK = "bed_mesh"
_LOADING = Path(__file__).with_name("module_cost.py")


def cpu_seconds(simulation: Simulation) -> float:
    """CPU time of klippy's process up to now, all threads together, s."""
    info = Path(f"/proc/self/fdinfo/{simulation.process_fd}").read_text()
    match = re.search(r"^Pid:\s*(\d+)$", info, re.MULTILINE)
    assert match is not None
    tasks = Path(f"/proc/{match[1]}/task").glob("*/schedstat")
    # Its first number; in /proc/PID/stat there are hundredths only
    return sum(int(task.read_text().split()[0]) for task in tasks) * 1e-9


class Names(NamedTuple):
    """How klippy's parts are imported: from where, its program, packages."""

    path: Path
    main: str
    extras: str
    own: str


def names(installed: Installed) -> Names:
    """As the host does it itself."""
    tree, folder = installed.cwd, installed.host.layout.module_dir
    own = folder.replace("/", ".")
    if (tree / "klippy" / "printer.py").exists():
        return Names(tree, "klippy.printer", "klippy.extras", own)
    if installed.host.layout.script is None:
        return Names(tree, "klippy.klippy", "klippy.extras", own)
    return Names(tree / "klippy", "klippy", "extras", "extras")


def load(installed: Installed, what: str, module: str) -> float:
    """Load it in a new process; what: "time" or "memory"."""
    found = names(installed)
    environment = installed.environment()
    environment["PYTHONPATH"] = str(found.path)
    before = [found.main, f"{found.extras}.probe"]
    return float(
        run(
            [installed.argv[0], _LOADING, what, *before, module],
            f"loading {module}",
            cwd=installed.cwd,
            env=environment,
        )
    )


def loading(installed: Installed, name: str, module: str) -> dict[str, Any]:
    """Figures of a module: measured several times, after one that compiles.

    name: what it is called.
    """
    load(installed, "time", module)
    times = [load(installed, "time", module) for _ in range(LOADINGS)]
    return {
        "host": installed.host.name,
        "module": name,
        "import_ms": round(statistics.median(times) * 1e3, 2),
        "memory_kib": round(load(installed, "memory", module) / 1024.0, 1),
    }


def loadings(host: Host) -> list[dict[str, Any]]:
    """Our modules on a host, and one of its own for scale."""
    installed = host.install(module_files())
    found = names(installed)
    wanted = {name: f"{found.own}.{name}" for name in MODULES}
    wanted[f"{STOCK} of the host"] = f"{found.extras}.{STOCK}"
    return [loading(installed, *item) for item in wanted.items()]
