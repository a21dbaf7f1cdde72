"""Which printers: each pair of what they may have is on one of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import combinations, product
from typing import Any, NamedTuple

from allpairspy import AllPairs

from tools.campaign.drawn import features, machines
from tools.campaign.drawn.machines import BASES, GENERIC

# Of a printer: what is chosen, and as what
Item = tuple[str, Any]
_PLATES = ("", "tilt", "bow", "texture")


class Row(NamedTuple):
    """What a printer is to have; an empty word: as the machine is.

    names: of Klipper's sections, see features.
    """

    base: str
    kinematics: str
    z_motors: int
    homing: str = ""
    plate: str = ""
    noise: str = ""
    left_out: str = ""
    names: frozenset[str] = frozenset()

    def items(self) -> set[Item]:
        """All that was chosen."""
        own = self._asdict()
        names = own.pop("names")
        return {*own.items(), *(("names", name) for name in names)}


def of_machine(base: str) -> Row:
    """The printer that a machine is by itself."""
    scene = BASES[base]
    return Row(base, scene.kinematics, len(scene.z_motors))


@lru_cache(maxsize=None)
def rows(is_generic: bool) -> Sequence[Row]:
    """Printers on which each pair is that can be together.

    is_generic: the host has generic_cartesian.
    """
    choices = _choices(is_generic)
    found = [*_all_pairs(choices), *_all_pairs(choices, is_turned=True)]
    return [*found, *_missing(choices, found)]


def _all_pairs(
    choices: dict[str, Sequence], is_turned: bool = False
) -> Iterator[Row]:
    """A covering array; what it is free to choose is mostly a choice's last.

    is_turned: or its first.
    """
    values = [found[:: -1 if is_turned else 1] for found in choices.values()]
    for chosen in AllPairs(values):
        yield _built(dict(zip(choices, chosen)))


def _choices(is_generic: bool) -> dict[str, Sequence]:
    gantries = {k for base in BASES for k in machines.kinematics_of(base)}
    if not is_generic:
        gantries.discard(GENERIC)
    counts = {n for base in BASES for n in machines.counts_of(base)}
    return {
        "base": sorted(BASES),
        "kinematics": sorted(gantries),
        "z_motors": sorted(counts),
        "homing": ("", "override"),
        "plate": _PLATES,
        "noise": ("", "some"),
        "left_out": ("", *machines.OURS),
        "mesh": ("", *features.MESHES),
        "frame": ("", *features.FRAMES),
        **{name: ("", name) for name in features.ALONE},
    }


def _built(chosen: dict[str, Any]) -> Row:
    """The printer; what its machine cannot have gives way."""
    base = chosen["base"]
    own = of_machine(base)
    names = [chosen.get(k, "") for k in ("mesh", "frame", *features.ALONE)]
    row = own._replace(
        names=features.possible(set(names) - {""}, BASES[base].sections),
        plate=chosen.get("plate", ""),
        noise=chosen.get("noise", ""),
    )
    if machines.can_leave_out(base, chosen.get("left_out", "")):
        row = row._replace(left_out=chosen["left_out"])
    if chosen.get("kinematics") in machines.kinematics_of(base):
        row = row._replace(kinematics=chosen["kinematics"])
    if chosen.get("z_motors") in machines.counts_of(base):
        row = row._replace(z_motors=chosen["z_motors"])
    # A macro of that name would call itself
    if machines.can_override(base) and "wrapped_homing" not in row.names:
        row = row._replace(homing=chosen.get("homing", ""))
    return row


def _missing(
    choices: dict[str, Sequence], found: Sequence[Row]
) -> Iterator[Row]:
    """Printers for pairs that have given way everywhere, where there are any."""
    pairs = {pair for row in found for pair in _pairs(row)}
    singles = [(name, value) for name in choices for value in choices[name]]
    for pair in combinations(singles, 2):
        wanted = {_item(*single) for single in pair if single[1] != ""}
        if len(wanted) < 2 or frozenset(wanted) in pairs:
            continue
        for base, mesh in product(choices["base"], ("", features.MESHES[0])):
            row = _built({"base": base, "mesh": mesh, **dict(pair)})
            if wanted <= row.items():
                pairs.update(_pairs(row))
                yield row
                break


def _item(name: str, value: Any) -> Item:
    return (name if name in Row._fields else "names", value)


def _pairs(row: Row) -> set[frozenset[Item]]:
    return {frozenset(pair) for pair in combinations(row.items(), 2)}
