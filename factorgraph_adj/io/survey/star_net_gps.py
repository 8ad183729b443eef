"""GPS vectors of STAR*NET: G0 to G3 lines, and .GPS options that weight them.

A vector is G1 with the names and ΔX, ΔY, ΔZ, geocentric metres whatever the unit of the project,
G2 with the variances (or standard errors) of X, Y, Z and G3 with the covariances (or correlations)
XY, XZ, YZ. G0 is a comment. Source: STAR*NET-PRO V6, Professional Edition Supplement; order of G3:
the converter of MicroSurvey from GeoLab; meaning of the factors: listing of STAR*NET-PRO 13.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ...observations import GnssVector
from ...types import Array
from .notes import Notes

WEIGHTS = ("COVARIANCE", "STDERRCORRELATION", "STDERRORS")
"""What G2 and G3 hold: variances and covariances, standard errors and correlations, or standard
errors alone."""
REFUSED = {
    "CENTERING": "add the centring to the standard errors",
    "ADDHIHT": "reduce the vectors to the marks",
    "NETWORK": "every vector takes part in the adjustment",
    "SIDESHOT": "every vector takes part in the adjustment",
    "USE": "every vector takes part in the adjustment",
    "FREE": "set vectors aside by snoop",
    "TRANSFORM": "rotations and scales of vectors are unknowns of frames, see add_frame",
    "DEFAULT": "enter G2 and G3 for every vector",
}
"""Words of .GPS that are not built, and what to do."""


@dataclass
class Vector:
    """A vector as its lines state it."""

    line: int
    """Line of G1."""
    names: list[str]
    """From and to."""
    value: list[float]
    """ΔX, ΔY, ΔZ, metres."""
    weight: str
    """What G2 and G3 hold."""
    factors: tuple[float, float]
    """Factors of the horizontal and the vertical standard errors."""
    diagonal: list[float] = field(default_factory=list)
    """Numbers of G2."""
    corners: list[float] = field(default_factory=list)
    """Numbers of G3: XY, XZ, YZ."""

    def covariance(self) -> Array:
        """Return the covariance, (3, 3) metres², without the factors."""
        xx, yy, zz = self.diagonal
        xy, xz, yz = self.corners or (0.0, 0.0, 0.0)
        matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if self.weight == "COVARIANCE":
            return matrix
        sigma = np.array(self.diagonal)
        correlation = matrix.copy()
        np.fill_diagonal(correlation, 1.0)
        return np.asarray(correlation * np.outer(sigma, sigma))


class StarNetVectors:
    """The vectors of the files, and the options in force."""

    def __init__(self, notes: Notes) -> None:
        """Start without vectors."""
        self.notes = notes
        self.vectors: list[Vector] = []
        self.weight = "COVARIANCE"
        self.factors = (1.0, 1.0)

    def option(self, line: int, words: list[str]) -> None:
        """Apply the words behind .GPS."""
        word = words[0].upper() if words else ""
        if word == "WEIGHT" and len(words) == 2:
            found = [w for w in WEIGHTS if w.startswith(words[1].upper())]
            if len(found) == 1:
                self.weight = found[0]
                return
            self.notes.add(line, f".GPS WEIGHT {words[1][:30]}: valid: {', '.join(WEIGHTS)}")
        elif word == "FACTOR" and (len(words) <= 2 or (len(words) == 4 and _vertical(words[2]))):
            given = [self.notes.finite(line, w, "factor of .GPS") for w in words[1::2]] or [1.0]
            if any(v <= 0 for v in given):
                self.notes.add(line, f"factors of .GPS must be > 0, not {' '.join(words[1:])}")
                return
            self.factors = given[0], given[-1]
        elif word in REFUSED:
            self.notes.add(line, f".GPS {word} is not built: {REFUSED[word]}")
        else:
            shown = " ".join(words)[:40]
            valid = "WEIGHT with one word, FACTOR f, FACTOR f VERT v"
            self.notes.add(line, f".GPS {shown} is unknown; valid: {valid}")

    def vector(self, line: int, names: list[str], words: list[str]) -> None:
        """Begin a vector: the words of a G1 line behind its names."""
        if len(words) != 3:
            self.notes.add(line, f"G1 takes From-To, ΔX, ΔY and ΔZ, not {len(words)} numbers")
        value = [self.notes.finite(line, w, "component of G1") for w in words[:3]]
        self.vectors.append(Vector(line, names, (value + [0.0] * 3)[:3], self.weight, self.factors))

    def weights(self, line: int, code: str, words: list[str]) -> None:
        """Add a G2 or G3 line to the vector before it."""
        if not self.vectors or (self.vectors[-1].diagonal and code == "G2"):
            self.notes.add(line, f"{code} without G1: it belongs to the vector before it")
            return
        last = self.vectors[-1]
        if len(words) != 3:
            self.notes.add(line, f"{code} takes three numbers, not {len(words)}")
            return
        numbers = [self.notes.finite(line, w, f"number of {code}") for w in words]
        if code == "G2":
            if any(v <= 0 for v in numbers):
                what = "variances" if last.weight == "COVARIANCE" else "standard errors"
                self.notes.add(line, f"{what} of G2 must be > 0, not {' '.join(words)}")
            last.diagonal = numbers
        elif last.corners or not last.diagonal:
            self.notes.add(line, "G3 follows G2 of its vector")
        else:
            last.corners = numbers

    def check(self) -> None:
        """Note the vectors that lack a line, or whose covariance is none."""
        for v in self.vectors:
            if not v.diagonal:
                self.notes.add(v.line, "the vector has no G2 line, its variances")
            elif not v.corners and v.weight != "STDERRORS":
                what = f"the vector has no G3 line, which {v.weight} needs"
                self.notes.add(v.line, f"{what}; valid without: .GPS WEIGHT STDERRORS")
            elif all(math.isfinite(n) for n in (*v.diagonal, *v.corners)):
                values = np.linalg.eigvalsh(v.covariance())
                if not values.min() > 0.0:
                    what = "G2 and G3 are no covariance: a combination has no positive variance"
                    self.notes.add(v.line, what)

    def observations(self, horizon: Callable[[list[str]], Array]) -> list[GnssVector]:
        """Return the vectors with their covariances, geocentric.

        Factors f and v multiply standard errors along the horizon and up:
        C' = (Eᵀ F E) C (Eᵀ F E), F = diag(f, f, v) and rows E of east, north, up.

        Args:
            horizon: returns the rows E (n, 3, 3) at stations, geocentric.
        """
        out = []
        turns = horizon([v.names[0] for v in self.vectors])
        for v, e in zip(self.vectors, turns, strict=True):
            f, up = v.factors
            scale = e.T @ np.diag([f, f, up]) @ e
            covariance = scale @ v.covariance() @ scale
            made = self.notes.attempt(
                v.line,
                GnssVector,
                *v.names,
                tuple(v.value),
                covariance=(covariance + covariance.T) / 2.0,
                source=self.notes.place(v.line),
            )
            if isinstance(made, GnssVector):
                out.append(made)
        return out


def _vertical(word: str) -> bool:
    return "VERTICAL".startswith(word.upper()) and word.upper().startswith("V")
