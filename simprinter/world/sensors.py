"""How a switch answers, touch by touch; mm, positive is deeper.

A switch is described by one number: how far its actuator is beyond the nominal
trigger point (mm, negative before it).  Everything that differs from one touch
to the next is in TouchState; geometry is elsewhere.
"""

from __future__ import annotations

import random
from typing import Optional

from .spec import NoiseSpec

# A switch let go by this much (mm), and clear of what noise can add, gets a
# new trigger point; less is the same touch still.
REARM = 0.2
# Gauss without end would leave no height above which nothing can trigger
SIGMAS = 5.0


class TouchState:
    """Trigger point of the current or next touch.

    shift: mm by which this touch triggers earlier than nominal (noise)
    early: mm earlier because of a fault, negative for later
    mute: a fault hides the contact
    pressed: committed state, for the hysteresis
    spent: this trigger point has been used by a touch
    armed: for the next touch, while this one still presses

    One draw is made per touch: at the first of "let go for long enough" and
    "armed again and let go" after it.  So the draws depend on the sequence of
    touches and not on how often anybody looked.
    """

    __slots__ = (
        "_noise",
        "_play",
        "_play_random",
        "_random",
        "armed",
        "early",
        "hysteresis",
        "mute",
        "pressed",
        "rearm",
        "shift",
        "spent",
    )

    def __init__(
        self,
        noise: NoiseSpec,
        generator: random.Random,
        play_generator: Optional[random.Random] = None,
        play: float = 0.0,
    ) -> None:
        """play: mm by which what presses it may hang lower, see z_play."""
        self._noise = noise
        self._random = generator
        self._play_random = play_generator or generator
        self._play = play
        self.hysteresis = noise.hysteresis
        outlier = max(0.0, noise.outlier_size) if noise.outlier_chance else 0.0
        self.rearm = REARM + noise.hysteresis + SIGMAS * noise.sigma + outlier
        self.rearm += play
        self.early = 0.0
        self.mute = False
        self.pressed = False
        self.spent = False
        self.armed = False
        self.shift = self._draw()

    def asserted(self, beyond: float) -> bool:
        """Level for an actuator `beyond` mm past the nominal trigger."""
        if self.mute:
            return False
        margin = self.shift + self.early
        if self.pressed:
            margin += self.hysteresis
        return beyond + margin >= 0.0

    def arm(self, early: float, mute: bool) -> None:
        """A new homing or probing operation starts."""
        self.early = early
        self.mute = mute
        # Klippy may say so while the lift before it has yet to begin: the
        # touch of now keeps its trigger point
        self.armed = self.pressed
        if not self.pressed:
            self._renew()

    def mend(self) -> None:
        """It triggers where it should again."""
        self.early = 0.0
        self.mute = False

    def settle(self, pressed: bool, beyond: float) -> None:
        """Commit the state of the actuator (`beyond` as in asserted)."""
        self.pressed = pressed
        if pressed:
            self.spent = True
        elif beyond < -(self.rearm - REARM if self.armed else self.rearm):
            self._renew()

    def _renew(self) -> None:
        self.armed = False
        if self.spent:
            self.spent = False
            self.shift = self._draw()

    def _draw(self) -> float:
        noise, hangs = self._noise, 0.0
        if self._play:
            hangs = self._play_random.uniform(0.0, self._play)
        if not noise.sigma and not noise.outlier_chance:
            return hangs
        # Both numbers are always drawn, so that changing one setting leaves
        # the other's sequence alone
        spread = self._random.gauss(0.0, 1.0)
        chance = self._random.random()
        shift = noise.sigma * max(-SIGMAS, min(SIGMAS, spread))
        if chance < noise.outlier_chance:
            shift += noise.outlier_size
        return shift + hangs
