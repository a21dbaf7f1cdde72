"""What is known of where the probe is, and why.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from ..attached import ATTACHED, UNKNOWN


class Known:
    """What the pins cannot tell by what they read now.

    proven is where the last trip has put the probe, if the pins were seen to change on it;
    UNKNOWN: what they read proves nothing.  may_be_on says whether it may be attached where
    they read as if it were docked.  seen_on says whether the last look has found it attached:
    where it reads docked after that, somebody has put it there, which is believed.

        what happens                                    proven     may_be_on
        klippy starts                                   UNKNOWN    no
        a trip begins, or the toolhead enters the dock  UNKNOWN    yes
        a trip has fetched it, and the pins changed     ATTACHED   yes
        a trip has docked it, and the pins changed      DOCKED     no
        in and out of the dock, and it stayed there     UNKNOWN    as before that
        a touch or a pin was not as it has to be        UNKNOWN    as it was
        the user says ATTACHED                          UNKNOWN    yes
        the user, or two pins of their own, say DOCKED  UNKNOWN    no
        the user says UNKNOWN                           UNKNOWN    as it was
    """

    def __init__(self) -> None:
        self.proven = UNKNOWN
        self.may_be_on = False
        self.seen_on = False

    def is_guarded(self) -> bool:
        """Return whether what goes down has to look where the probe is."""
        return self.may_be_on or self.seen_on

    def look_has(self, state: str) -> None:
        """Note what the pins read; what contradicts itself says nothing new."""
        if state != UNKNOWN:
            self.seen_on = state == ATTACHED

    def trip_begins(self) -> None:
        """Note that the probe is about to be attached or docked."""
        self.proven, self.may_be_on = UNKNOWN, True

    def trip_ended(self, state: str) -> None:
        """Note where a trip has put it, on which the pins were seen to change."""
        self.proven, self.may_be_on = state, state == ATTACHED

    def stayed_docked(self, might_be_on: bool) -> None:
        """Note that it did not come out of the dock: as doubtful as before that."""
        self.may_be_on = might_be_on

    def distrust(self) -> None:
        """Note that what the pins read proves nothing from now on."""
        self.proven = UNKNOWN

    def be_told(self, state: str) -> None:
        """Note where it is by somebody who has looked, or who wants it seen."""
        self.distrust()
        if state != UNKNOWN:
            self.may_be_on = state == ATTACHED
