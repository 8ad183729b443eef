"""Epochs of a network: by a length of time, by sets of readings, or by hand."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from ..errors import InputError, Problem
from ..instruments.message_rules import iso

SECONDS_OF = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
"""Units of lengths of epochs, seconds."""
MAX_EPOCH = 2**31 - 1
"""Largest number of an epoch, as its column in the database."""
GRACE_SHARE, MAX_GRACE = 0.1, 600.0
"""An epoch stays open for this share of its length, at most these seconds, after its end."""
_LENGTH = re.compile(r"\s*([0-9]+(?:\.[0-9]+)?)\s*(s|min|h|d|sets?)\s*")
VALID = '"6 h" (s, min, h, d), "2 sets", or "by hand"'
"""What may be stated, for messages."""


@dataclass(frozen=True)
class EpochSchedule:
    """When epochs end: after a length of time, after sets, or by hand where both are None.

    Epochs are numbered from 1; 0 is the epoch of the observations that the project has.
    """

    length: float | None = None
    """Length of an epoch, seconds; None: epochs have no length."""
    sets: int | None = None
    """Number of sets of each instrument that posts sets, after which the epoch ends; None: sets are
    not counted."""

    @classmethod
    def of(cls, text: str) -> EpochSchedule:
        """Return the schedule of a text, such as ``6 h``, ``2 sets`` or ``by hand``.

        Raises:
            InputError: the text is none of these, or a length is zero.
        """
        if text.strip() == "by hand":
            return cls()
        found = _LENGTH.fullmatch(text)
        if found is None or float(found[1]) <= 0.0:
            raise InputError(f"epochs = {text!r} states no length; valid: {VALID}")
        if found[2].startswith("set"):
            if not float(found[1]).is_integer():
                raise InputError(f"epochs {text!r}: the number of sets must be whole")
            return cls(sets=int(found[1]))
        return cls(length=float(found[1]) * SECONDS_OF[found[2]])

    @property
    def grace(self) -> float:
        """Time for which an epoch waits for late readings after its end, seconds."""
        return 0.0 if self.length is None else min(GRACE_SHARE * self.length, MAX_GRACE)

    def number(self, time: float, begun: float) -> int:
        """Return the number of the epoch of a time; the schedule must have a ``length``.

        Args:
            time: seconds since 1970 UTC.
            begun: a time in epoch 1, seconds since 1970 UTC. Epochs begin at whole multiples of the
                length since 1970, so that epochs of an hour begin with the hour. Times before
                epoch 1 have numbers below 1.
        """
        assert self.length is not None
        return math.floor(time / self.length) - math.floor(begun / self.length) + 1

    def number_of_reading(self, time: float, begun: float) -> int:
        """Return the number of the epoch of a reading, as `number`.

        Raises:
            InputError: it was measured before the first epoch.
        """
        number = self.number(time, begun)
        if number < 1:
            first = iso(self.bounds(1, begun)[0])
            what = f"time {iso(time)} is before the first epoch, which began at {first}"
            raise InputError(Problem(what, "time"))
        return number

    def bounds(self, number: int, begun: float) -> tuple[float, float]:
        """Return begin and end of an epoch, seconds since 1970 UTC, as `number` has them."""
        assert self.length is not None
        first = math.floor(begun / self.length) + number - 1
        return first * self.length, (first + 1) * self.length
