"""The page draws all that a world has; its pictures run in node, without a browser."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest

import simplay
from simplay.film import Film, parts_of
from simplay.tests.everything import EVERYTHING
from simplay.watcher import TouchDone
from simprinter.world import Pose, World

PAGE = Path(simplay.__file__).with_name("page")
# As much of a document as the pictures need
DOCUMENT = """
class Element {
  constructor(name) { this.name = name; this.children = []; this.attributes = {}; }
  setAttribute(name, value) { this.attributes[name] = String(value); }
  append(...more) { this.children.push(...more); }
  replaceChildren(...more) { this.children = more; }
  addEventListener() {}
  remove() {}
  all() { return [this, ...this.children.flatMap((child) => child.all?.() || [])]; }
}
Element.prototype.dataset = {};
Object.defineProperty(Element.prototype, "firstChild", { get() { return this.children[0]; } });
Object.defineProperty(Element.prototype, "lastChild", { get() { return this.children.at(-1); } });
globalThis.document = {
  createElementNS: (space, name) => new Element(name),
  createElement: (name) => new Element(name),
};
const { Side } = await import("./side.js");
const { Lens } = await import("./lens.js");
const { Top } = await import("./top.js");
const { Hands } = await import("./hands.js");
const [parts, frames] = JSON.parse(process.argv[1]);
const [svg, plan, close, words, rows] = [1, 2, 3, 4, 5].map(() => new Element("x"));
const [side, top, lens] = [new Side(svg), new Top(plan, words), new Lens(close, new Element("x"))];
new Hands(rows, words, () => {}).build({ commands: ["attach", "lay"], wires: ["other"], parts });
const told = [];
for (const part of [side, top, lens]) part.build(parts);
for (const frame of frames) {
  const [x, y, z] = frame.way.at(-1);
  side.show(frame, { x, y, z });
  top.show(frame, { x, y, z });
  lens.show(frame, side.axes[0]);
  const of = (place) => place.all().map((e) => [e.attributes.class || e.name, e.textContent || ""]);
  told.push({ side: of(svg), top: of(plan), lens: lens.words.textContent, last: words.textContent });
}
const labels = rows.all().map((e) => e.attributes["aria-label"]).filter(Boolean);
console.log(JSON.stringify([told, labels]));
"""


def frame_at(film, world, *tips):
    """What the page is sent with the nozzles there."""
    film.seconds += 1
    world.observe(film.seconds, *tips)
    film.tips = tips
    return film.frame()


class Shown(Film):
    """Of a world that nobody drives."""

    def __init__(self, world):
        self.seconds, self.tips = 0, (Pose(0, 0, 50), Pose(240, 0, 50))
        rig = SimpleNamespace(
            seconds=lambda ns: self.seconds,
            poses=lambda ns: self.tips,
            asserted=lambda signal, ns: False,
        )
        clock = SimpleNamespace(now=lambda: self.seconds * 10**9)
        simulation = SimpleNamespace(clock=clock, pace=None)
        machine = SimpleNamespace(world=world, rig=rig, simulation=simulation)
        touches = [TouchDone("second_nozzle_other", 5.0, 26.0, 0.01)]
        watcher = SimpleNamespace(
            machine=machine, gap=None, spot=(0, 0, 0), touches=lambda: touches
        )
        super().__init__(watcher, lambda: True, lambda frame: None)


@pytest.fixture(scope="module")
def drawn():
    """What the pictures show of EVERYTHING, of three frames."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("NOT TESTED: no node (Debian: apt install nodejs)")
    world = World(EVERYTHING, 0)
    film = Shown(world)
    frames = [
        frame_at(film, world, Pose(40, 20, 5), Pose(240, 20, 4.8)),
        frame_at(film, world, Pose(40, 20, 5), Pose(210, 20, 4.8)),
        frame_at(film, world, Pose(0, 26, 1.3), Pose(5, 26, 1.1)),
    ]
    assert [frame["active"] for frame in frames] == [0, 1, 0]
    parts = parts_of(SimpleNamespace(world=EVERYTHING))
    words = [node, "--input-type=module", "-e", DOCUMENT]
    words.append(json.dumps([parts, frames]))
    done = subprocess.run(
        words, cwd=PAGE, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def kinds(shown, name):
    """How many of the elements are of a class."""
    return sum(name in kind.split() for kind, _ in shown)


def test_all_pins_membranes_docks_and_nozzles_are_there(drawn):
    frames, _ = drawn
    side, top = frames[0]["side"], frames[0]["top"]
    for what in ("pin", "membrane"):
        assert kinds(side, what) == kinds(top, what) == 2
    assert kinds(side, "nozzle") == 2
    assert kinds(top, "dock") == 2
    # Two probes and the coil; two nozzles
    assert kinds(top, "probe") == 3
    assert kinds(top, "cross") == 2
    texts = {text for _, text in side} | {text for _, text in top}
    assert {"pin", "pin other", "dock", "dock long"} <= texts


def test_second_nozzle_is_seen_near_its_pin(drawn):
    frames, _ = drawn
    assert frames[2]["lens"].startswith("second nozzle and pin other: 0.100")
    assert "second nozzle on pin other at X5.0" in frames[2]["last"]


def test_hands_have_a_row_for_each(drawn):
    _, labels = drawn
    wanted = ["pin other", "Probe", "Probe long", "Membrane", "Membrane thick"]
    assert labels[: len(wanted)] == wanted
