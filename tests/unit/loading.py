"""The modules as klippy has them: in one package with z_touch."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[2]
_PACKAGE = "extras_of_the_tests"


def load(name: str) -> ModuleType:
    """A module by its name."""
    if _PACKAGE not in sys.modules:
        package = sys.modules[_PACKAGE] = ModuleType(_PACKAGE)
        package.__path__ = [str(ROOT)]
    return importlib.import_module(f"{_PACKAGE}.{name}")
