"""Worlds as data: TOML files, described by world.schema.json."""

from .making import made_from
from .reading import SCHEMA, WorldFile, WorldFileError, read
from .wiring import scene_of

__all__ = [
    "SCHEMA",
    "WorldFile",
    "WorldFileError",
    "made_from",
    "read",
    "scene_of",
]
