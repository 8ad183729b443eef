"""Traverses of STAR*NET: TB, T and TE lines as angles, azimuths and measurements."""

from __future__ import annotations

import math
from collections.abc import Callable

from ...observations import Azimuth, HorizontalAngle
from .star_net_lines import BEARING, DMS, Values
from .star_net_points import StarNetPoints


class StarNetTraverse:
    """The traverse that is being read, if there is one."""

    def __init__(
        self,
        values: Values,
        points: StarNetPoints,
        observe: Callable[..., None],
        add: Callable[..., None],
    ) -> None:
        """Start outside of a traverse.

        Args:
            values: reads the words of lines.
            points: points of the file.
            observe: observes a T line: its number, data type, names and words.
            add: adds an observation: line, kind, names, value, standard deviation.
        """
        self.values = values
        self.points = points
        self.observe = observe
        self.add = add
        self.stations: list[str] | None = None
        """Stations so far, the backsight first; None: outside of a traverse."""
        self.begun = 1
        """Line of its TB."""
        self.backsight: float | None = None
        """Bearing of TB, radians; None: its backsight is a station."""
        self.pending: tuple[int, str, list[str]] | None = None
        """Last T line, whose target is not known yet: its number, station and words."""

    def read(self, line: int, code: str, words: list[str]) -> None:
        """Read a TB, T or TE line."""
        if code == "TB":
            if self.stations is not None:
                self.values.notes.add(line, "TB within a traverse: TE is missing")
            self.stations, self.backsight, self.pending, self.begun = [], None, None, line
            if len(words) != 1:
                self.values.notes.add(line, "TB takes the backsight, a station or a bearing")
            elif BEARING.fullmatch(words[0]) or DMS.fullmatch(words[0]):
                self.backsight = self.values.bearing(line, words[0], "bearing of TB")
            else:
                self.stations.append(words[0])
            return
        if self.stations is None:
            self.values.notes.add(line, f"{code} without TB: a traverse begins with TB")
            return
        if not words:
            self.values.notes.add(line, f"{code} takes the name of the station")
            return
        self._leg(words[0])
        self.stations.append(words[0])
        if code == "T":
            self.pending = (line, words[0], words[1:])
            return
        if len(words) > 1:
            self._closing(line, words)
        self.stations = self.pending = None

    def _leg(self, to: str) -> None:
        """Observe the last T line, whose target is known now."""
        if self.pending is None or self.stations is None:
            return
        line, at, words = self.pending
        if to == at:
            self.values.notes.add(line, f"T joins {at!r} to itself")
        elif len(self.stations) > 1:
            self.observe(line, "T", [at, self.stations[-2], to], words)
        elif words:
            # The backsight is a bearing: the angle from it is an azimuth.
            self.observe(line, "T", [at, to], words, azimuth=self.backsight)

    def _closing(self, line: int, words: list[str]) -> None:
        """Observe the closing angle of a TE line."""
        at, back = words[0], (self.stations or ["", ""])[-2:][0]
        if len(words) not in (3, 4) or len(self.stations or []) < 2:
            self.values.notes.add(
                line, "TE takes the station, and a closing angle with the foresight"
            )
            return
        angle = self.values.angle(line, words[1], "closing angle")
        sigma = self.values.sigma(line, words[3] if len(words) > 3 else None, "angle")
        self.points.use(line, at, back)
        if BEARING.fullmatch(words[2]):
            value = self.values.bearing(line, words[2], "closing bearing") - angle
            self.add(line, Azimuth, [at, back], value % (2 * math.pi), sigma)
            return
        self.points.use(line, words[2])
        self.add(line, HorizontalAngle, [at, back, words[2]], angle % (2 * math.pi), sigma)
