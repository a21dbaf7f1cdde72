"""What the random printers of all modules have in common.

A module's printer is a subclass: what it really is, what its owner has
configured, and what a calibration has to do with it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, Optional, Union

from hypothesis import strategies as st

from simprinter import Scene
from simprinter.world import Bed, DriftSpec, NoiseSpec, Touch
from tools.campaign.drawn_machines import (
    GIVE,
    OTHER_BOARD_STOPS,
    Gantry,
    Homing,
    Plate,
    Sampling,
    inverted,
    on_other_board,
    with_options,
    z_section,
)
from tools.campaign.gap_bounds import (
    DIGIT,
    Interval,
    drift_bound,
    frame_bound,
    has_outlier,
    hidden_outlier,
    seen_bound,
)

# What an owner may have wrong: a refusal is right then
Mistake = Callable[[Any, Scene], Scene]
# Of an option, where it depends on the printer; None: it is left out
Text = Union[str, None, Callable[[Any], Optional[str]]]


@dataclass(frozen=True)
class Drawn(ABC):
    """A printer; a module's defaults are a scene that works.

    bed: the point that is measured. other_board: the input that is on a board
    of its own, that many s away. offset: G-code Z offset of before.
    """

    gantry: Gantry = Gantry()
    plate: Plate = Plate()
    bed: tuple[float, float] = (150.0, 150.0)
    homing: Homing = Homing()
    sampling: Sampling = Sampling()
    drift: DriftSpec = field(default_factory=DriftSpec)
    other_board: str = ""
    board_latency: float = 0.002
    offset: float = 0.0
    mistake: str = ""
    seed: int = 0

    module: ClassVar[str]
    command: ClassVar[str]
    # What is touched at last
    final: ClassVar[tuple[str, str]]
    mistakes: ClassVar[Mapping[str, Mistake]]

    @classmethod
    @abstractmethod
    def printers(cls, kinematics: tuple[str, ...]) -> st.SearchStrategy:
        """Random ones, with kinematics that a host knows."""

    @abstractmethod
    def healthy(self) -> Scene:
        """The machine with a configuration without a mistake, on one board."""

    @property
    @abstractmethod
    def sites(self) -> dict[str, tuple[tuple[float, float], int]]:
        """Where the toolhead is to touch each, and how often at least."""

    @abstractmethod
    def place(self, touches: Sequence[Touch]) -> tuple[float, float]:
        """The point of the bed that G-code Z=0 is about, mm."""

    @abstractmethod
    def gaps(
        self, homing: Sequence[Touch], touches: Sequence[Touch], now: float
    ) -> Interval:
        """What is right at time now (s), after homing and these touches."""

    @abstractmethod
    def nominal(self, touch: Touch) -> float:
        """Pose.z at which it triggers without noise or drift, mm."""

    @abstractmethod
    def excuses(self) -> Iterable[str]:
        """Words of reasons for which a healthy printer may be refused."""

    @abstractmethod
    def tolerated(self) -> dict[str, float]:
        """Mm beyond the trigger that the floors leave to a dead touch."""

    @abstractmethod
    def clear_z(self) -> float:
        """Pose.z (mm) from which nothing of the toolhead touches the bed."""

    @property
    def board_signal(self) -> str:
        """The input that is on another board."""
        return self.other_board

    @cached_property
    def scene(self) -> Scene:
        """The printer with its boards, and with its mistake."""
        scene = self.healthy()
        if self.other_board:
            scene = on_other_board(scene, self.board_signal, self.board_latency)
        if self.mistake:
            scene = self.mistakes[self.mistake](self, scene)
        return scene

    @cached_property
    def surface(self) -> Bed:
        """The plate."""
        return Bed(self.scene.world.bed)

    def overtravel(self, fastest: float, *noises: NoiseSpec) -> float:
        """What switches touched at a speed (mm/s) have to give, mm."""
        stopping = max(noise.latency for noise in noises)
        stopping += OTHER_BOARD_STOPS if self.other_board else 0.0
        return GIVE + fastest * stopping

    def bound(
        self,
        touches: Sequence[Touch],
        retracts: Mapping[str, float],
        seconds: float,
    ) -> float:
        """Of what all modules' gaps have: steps, and drift in this time."""
        frame = frame_bound(self.gantry, touches, retracts)
        drift = drift_bound(self.drift, seconds)
        return seen_bound(self.gantry) + DIGIT + frame + drift

    def hidden(
        self,
        touches: Sequence[Touch],
        heights: Iterable[tuple[str, NoiseSpec, int]],
    ) -> float:
        """Mm by which outliers among the touches may have gone unseen.

        heights: each one's site, noise and number of samples.
        """
        found = 0.0
        for site, noise, samples in heights:
            here = [touch for touch in touches if touch.site == site]
            if has_outlier(here, noise, self.nominal):
                found += hidden_outlier(
                    noise, self.sampling, samples, self.gantry.step
                )
        return found


# Mistakes


def other(section: str, **options: Text) -> Mistake:
    """Other options in a section; "z": the one with the endstop of Z."""

    def change(printer: Drawn, scene: Scene) -> Scene:
        texts = {
            name: text(printer) if callable(text) else text
            for name, text in options.items()
        }
        name = z_section(scene) if section == "z" else section
        return with_options(scene, name, **texts)

    return change


def wrong_sense(section: str, option: str, signal: str) -> Mistake:
    """A pin that reads the other way round."""

    def change(printer: Drawn, scene: Scene) -> Scene:
        pin = inverted(scene.wiring.inputs[signal])
        return other(section, **{option: pin})(printer, scene)

    return change


def sticky(part: str, lift: Callable[[Any], float]) -> Mistake:
    """A part of the world lets go only above where the next touch begins."""

    def change(printer: Drawn, scene: Scene) -> Scene:
        spec = getattr(scene.world, part)
        noise = replace(spec.noise, hysteresis=lift(printer) + 0.5)
        return scene.with_world(**{part: replace(spec, noise=noise)})

    return change


# Both modules have a probe of their own
OFFSETS_OF_WRONG_SIGN = other(
    "probe",
    x_offset=lambda printer: f"{-printer.probe.x:g}",
    y_offset=lambda printer: f"{-printer.probe.y:g}",
)
# What the host cannot tell from so short an axis
NOT_UP = {"homing_positive_dir": "False"}
