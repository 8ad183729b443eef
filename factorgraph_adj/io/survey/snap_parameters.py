"""Parameters of SNAP's jobs: refraction, scale, orientation, reference frames.

Format: LINZ, SNAP help, "Additional parameter commands" and "The reference_frame command", and
``control.c``, ``rftrans.c`` of the program (BSD-3).
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace

import numpy as np

from ...types import Array
from ...units import ARCSEC
from .snap_data_commands import BEARING_ERROR, DISTANCE_SCALE, REFERENCE_FRAME, REFRACTION
from .snap_lines import read_epoch, wildcard_pattern
from .snap_selections import JobLine

DEFAULT_REFRACTION = 0.075
"""Bomford's coefficient of refraction: the bending of the ray over the angle at the centre."""
DEFAULT_CODE, ZERO_CODE, GNSS_CODE = "DEFAULT", "ZERO", "GPS"
"""Codes of zenith distances and of GNSS observations without one; refraction is 0 for ``ZERO``."""
TO_BE_FOUND = "?"
PPM = 1e-6
IERS = 1e-3
"""IERS counts mm, parts per billion and milliseconds of arc."""
FRAME_PARTS = {
    "translation": (0, 3),
    "scale": (3, 1),
    "rotation": (4, 3),
    "translation_rate": (7, 3),
    "scale_rate": (10, 1),
    "rotation_rate": (11, 3),
    "iers_tsr": (0, 7),
    "iers_etsr": (0, 14),
}
"""First parameter and number of parameters of each word: tx ty tz s rx ry rz, and their rates."""
ORIGINS = ("default", "zero", "0", "topocentre")


@dataclass(frozen=True)
class ParameterValue:
    """Value of a parameter."""

    value: float
    """Value in the unit of SNAP: a coefficient, ppm, seconds of arc."""
    calculated: bool
    """Whether the adjustment finds it."""


@dataclass
class Parameters:
    """Parameters of one sort, by codes with wildcards."""

    class_name: str
    """Classification that has the code of an observation."""
    values: list[tuple[re.Pattern[str], ParameterValue]] = field(default_factory=list)
    """Statements of values, in order."""
    same: list[tuple[re.Pattern[str], str]] = field(default_factory=list)
    """Codes that are the same as another."""
    default: float = 0.0
    """Value of a code that no statement concerns."""

    def code(self, code: str) -> str:
        """Return the code in capital letters that a code is the same as."""
        found = code.upper()
        for pattern, other in self.same:
            if pattern.fullmatch(found):
                found = other.upper()
        return found

    def of(self, code: str) -> ParameterValue:
        """Return the value of a code."""
        found = ParameterValue(0.0 if code.upper() == ZERO_CODE else self.default, False)
        for pattern, value in self.values:
            if pattern.fullmatch(code):
                found = value
        return found

    def state(self, at: JobLine, default: float) -> None:
        """Take a command: ``use CLASS``, ``CODE = CODE``, ``[calculate] CODE [value [?]]``."""
        words = list(at.words)
        first = words[0].lower() if words else ""
        if first == "use" and len(words) == 2:
            self.class_name = words[1].lower()
            return
        calculated = first == "calculate"
        words = words[1:] if calculated else words
        if len(words) == 3 and words[1] == "=" and not calculated:
            self.same.append((wildcard_pattern(words[0]), words[2]))
            return
        if words[2:] == [TO_BE_FOUND]:
            calculated = True
            words = words[:2]
        if not words or len(words) > 2 or (len(words) == 1 and not calculated):
            valid = "use CLASS; CODE = CODE; [calculate] CODE [value [?]]"
            at.wrong(f"{' '.join(at.words)[:40]!r} is not read; valid: {valid}")
            return
        value = default
        if len(words) == 2:
            value = at.source.field(at.line, words[1], f"value of {words[0]}").number()
        self.values.append((wildcard_pattern(words[0]), ParameterValue(value, calculated)))


@dataclass(frozen=True)
class ReferenceFrame:
    """Reference frame of GNSS observations: observed = T (X + t), T = (1 + s) Rx Ry Rz."""

    code: str
    """Its code."""
    parameters: tuple[float, ...] = (0.0,) * 14
    """tx ty tz (m), s (ppm), rx ry rz (seconds of arc), and their rates by year."""
    calculated: tuple[bool, ...] = (False,) * 14
    """Which of them the adjustment finds."""
    epoch: float | None = None
    """Epoch of the parameters, years."""
    topocentric: bool = False
    """Whether they count from east, north and up of the middle of the network."""
    place: str = ""
    """File and line."""

    @property
    def has_rates(self) -> bool:
        """Whether it changes with time."""
        return any(self.parameters[7:]) or any(self.calculated[7:])

    def at(self, years: float) -> Array:
        """Return tx ty tz s rx ry rz after some years."""
        p = np.array(self.parameters)
        return np.asarray(p[:7] + p[7:] * years)


def frame_matrix(parameters: Array, horizon: Array | None) -> Array:
    """Return T (3, 3) of parameters tx ty tz s rx ry rz.

    Rotations have the sign of the National Geodetic Survey: R(θ) has +sin θ above its diagonal.

    Args:
        parameters: metres, ppm, seconds of arc.
        horizon: east, north, up as rows (3, 3) of a topocentric frame; None: geocentric.
    """
    out = np.eye(3)
    for axis in (2, 1, 0):
        angle = float(parameters[4 + axis]) * ARCSEC
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn = np.eye(3)
        turn[i, i] = turn[j, j] = np.cos(angle)
        turn[i, j], turn[j, i] = np.sin(angle), -np.sin(angle)
        out = turn @ out
    out = (1.0 + float(parameters[3]) * PPM) * out
    return out if horizon is None else np.asarray(horizon.T @ out @ horizon)


def frame_shift(parameters: Array, horizon: Array | None) -> Array:
    """Return t (3,) of parameters, geocentric, metres."""
    t = np.asarray(parameters[:3])
    return t if horizon is None else np.asarray(horizon.T @ t)


class JobParameters:
    """All parameters of a job."""

    def __init__(self) -> None:
        """Start with the defaults."""
        self.refraction = Parameters(REFRACTION, default=DEFAULT_REFRACTION)
        self.distance_scale = Parameters(DISTANCE_SCALE)
        self.bearing_error = Parameters(BEARING_ERROR)
        self.frame_class = REFERENCE_FRAME
        self.frames: dict[str, ReferenceFrame] = {}

    def state_frame(self, at: JobLine) -> None:
        """Take a command ``reference_frame``."""
        words = list(at.words)
        if not words:
            at.wrong("reference_frame needs a code")
            return
        code = words.pop(0)
        if code.lower() == "use":
            self.frame_class = at.source.field(at.line, " ".join(words), "class").name().lower()
            return
        before = self.frames.get(code.upper(), ReferenceFrame(code, place=at.source.place(at.line)))
        values, found = list(before.parameters), list(before.calculated)
        topocentric, epoch, calculate, iers = before.topocentric, before.epoch, False, False
        while words:
            word = words.pop(0).lower()
            if word == "calculate":
                calculate = True
            elif word in ("topocentric", "geocentric"):
                topocentric = word == "topocentric"
            elif word == "epoch":
                epoch = self._epoch(at, words)
            elif word == "origin":
                # An origin changes which numbers scale and rotation are, and no residual.
                at.source.field(at.line, (words or [""]).pop(0).lower(), "origin").word(ORIGINS)
            elif word in FRAME_PARTS:
                iers = word.startswith("iers")
                if word == "iers_etsr":
                    epoch = self._epoch(at, words)
                self._values(at, words, word, values, found, calculate)
            else:
                valid = ("calculate", "topocentric", "geocentric", "epoch", "origin", *FRAME_PARTS)
                at.source.field(at.line, word, "word of reference_frame").word(valid)
                return
        if iers:
            signs = np.array([1, 1, 1, 1, -1, -1, -1] * 2)
            values = (np.array(values) * IERS * signs).tolist()
            if topocentric:
                at.wrong("parameters of the IERS are geocentric: leave out topocentric")
        self.frames[code.upper()] = replace(
            before,
            parameters=tuple(values),
            calculated=tuple(found),
            epoch=epoch,
            topocentric=topocentric,
        )

    @staticmethod
    def _epoch(at: JobLine, words: list[str]) -> float:
        return read_epoch(at.source.field(at.line, words.pop(0) if words else None, "epoch"))

    @staticmethod
    def _values(
        at: JobLine,
        words: list[str],
        word: str,
        values: list[float],
        found: list[bool],
        calculate: bool,
    ) -> None:
        """Take the values behind a word; none where all are calculated."""
        first, size = FRAME_PARTS[word]
        given = bool(words) and re.match(r"[+-]?\.?\d", words[0]) is not None
        for i in range(first, first + size):
            found[i] = calculate
            if not given:
                continue
            text = words.pop(0) if words else ""
            if text.endswith(TO_BE_FOUND):
                found[i] = True
                text = text[:-1]
            values[i] = at.source.field(at.line, text, word).number()
            if words and words[0] == TO_BE_FOUND:
                words.pop(0)
                found[i] = True
        if not given and not calculate:
            at.wrong(f"reference_frame: {word} needs {size} values, or calculate before it")
