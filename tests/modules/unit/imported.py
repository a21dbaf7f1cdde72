"""The modules, and the parts of z_touch, as klippy has them: in one package."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

_PACKAGE = "extras"


def imported(name: str) -> ModuleType:
    """A module by its name, a part of z_touch as "z_touch.NAME"."""
    package = sys.modules.setdefault(_PACKAGE, ModuleType(_PACKAGE))
    package.__path__ = [str(Path(__file__).resolve().parents[3])]
    return importlib.import_module(f"{_PACKAGE}.{name}")
