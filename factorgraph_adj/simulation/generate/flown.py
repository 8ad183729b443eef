"""Strips of photos as they were flown: times and places along them, and what is drawn of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from ...types import Array
from .part import Scene

Known = Literal["free", "weighted", "held"]
"""What an adjustment knows of an unknown: nothing, its value with a standard deviation, all."""


@dataclass(frozen=True)
class Exposure:
    """A photo in its strip."""

    photo: str
    """Its name."""
    along: float
    """Horizontal distance from the middle of the strip, metres, in the direction of flight."""
    direction: Array
    """Horizontal unit vector of the flight, (3,); zero in a strip of one photo."""


def exposures(scene: Scene, strip: Sequence[str]) -> list[Exposure]:
    """Return the photos of a strip with their true places along it."""
    at = np.array([scene.plan.photos[n].position for n in strip], dtype=float)
    line = (at[-1] - at[0]) * [1.0, 1.0, 0.0]
    length = float(np.linalg.norm(line))
    direction = line / length if length else line
    along = (at - at.mean(axis=0)) @ direction
    return [Exposure(n, float(s), direction) for n, s in zip(strip, along, strict=True)]


def strips_kept(
    scene: Scene, parts: Sequence[int], without: float, rng: np.random.Generator
) -> list[list[Exposure]]:
    """Return the photos of each strip that have readings.

    Args:
        scene: the scene.
        parts: earlier parts; empty: all.
        without: share of the photos of each strip that have none, rounded.
        rng: stream by which they are drawn.
    """
    out = []
    for strip in scene.strips_of(parts):
        kept = len(strip) - round(without * len(strip))
        chosen = sorted(rng.permutation(len(strip))[:kept].tolist())
        flown = exposures(scene, strip)
        out.append([flown[i] for i in chosen])
    if not any(out):
        scene.fail("without", f"is {without:g}, which leaves no photo with a reading")
    return out


def stated(true: Mapping[str, float], sigma: Mapping[str, float], known: Known) -> dict[str, Any]:
    """Return the arguments by which a network states an unknown with true values.

    Args:
        true: values of the components that act, by name; all others are held at zero.
        sigma: standard deviations by which they were drawn, the weights of weighted ones.
        known: what an adjustment knows of them.
    """
    free = tuple(true) if known == "free" else ()
    weights = {n: sigma[n] for n in true} if known == "weighted" else {}
    return {"free": free, "values": dict(true), "sigma": weights}


def drawn(sigma: Mapping[str, float], rng: np.random.Generator) -> dict[str, float]:
    """Return normal values of the components whose standard deviation is not zero.

    Every component takes its number from the stream, so that the others stay the same.
    """
    z = rng.standard_normal(len(sigma)).tolist()
    return {n: s * e for (n, s), e in zip(sigma.items(), z, strict=True) if s > 0}
