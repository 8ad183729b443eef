"""A strip of four photos: repository TsaiYoung/Analytical-Aerotriangulation, commit 274cc719.

What was found about its data:

- Image coordinates are in 0.1 µm.
- Points that two pairs share are measured in their common photo twice, up to 10 µm apart; the mean
  of both is what the relative orientations and the block are compared with.
- The second pair lists photo 3 before photo 2. The last line of a pair begins with a minus sign.
- Ground coordinates are X north, Y east, Z up.
- The X of check point 1207 has a typing error of 1000 m: 24218.292 is 23218.292.
- Its published result is wrong by up to 640 m, and no reference.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from factorgraph_adj.types import Array

PRINCIPAL_DISTANCE = 153.033
"""Millimetres."""
TENTH_MICROMETRES = 1e-4
"""Unit of the image coordinates, millimetres."""
MISTYPED = {"1207": np.array([0.0, -1000.0, 0.0])}
"""Corrections of typing errors, east, north, up, metres."""


@dataclass(frozen=True)
class Pair:
    """Two overlapping photos."""

    left: str
    right: str
    images: dict[str, tuple[Array, Array]]
    """Image coordinates (2,) in the left and in the right photo by point, millimetres."""


@dataclass(frozen=True)
class Strip:
    """The strip."""

    pairs: tuple[Pair, ...]
    control: dict[str, Array]
    """East, north, up of control points, metres."""
    check: dict[str, Array]
    """The same of check points."""


def read_strip(folder: Path) -> Strip:
    """Read the strip; the left photo of each pair lies where the strip begins."""
    pairs = []
    files = (("1", "2", "像对一.txt"), ("3", "2", "像对二.txt"), ("3", "4", "像对三.txt"))
    for first, second, file in files:
        images = {}
        for words in _rows(folder / file):
            xy = np.array([float(w) for w in words[1:5]]) * TENTH_MICROMETRES
            images[words[0].lstrip("-")] = (xy[:2], xy[2:])
        if int(first) > int(second):
            images = {n: (b, a) for n, (a, b) in images.items()}
            first, second = second, first
        pairs.append(Pair(first, second, images))
    return Strip(
        _with_means(pairs), _ground(folder / "控制点数据.txt"), _ground(folder / "检查点数据.txt")
    )


def _with_means(pairs: list[Pair]) -> tuple[Pair, ...]:
    """Return the pairs with one measurement of each point in each photo."""
    seen: dict[tuple[str, str], list[Array]] = {}
    for p in pairs:
        for n, (a, b) in p.images.items():
            seen.setdefault((p.left, n), []).append(a)
            seen.setdefault((p.right, n), []).append(b)
    mean = {at: np.mean(found, axis=0) for at, found in seen.items()}
    return tuple(
        replace(p, images={n: (mean[p.left, n], mean[p.right, n]) for n in p.images}) for p in pairs
    )


def _rows(file: Path) -> list[list[str]]:
    return [w for line in file.read_text(encoding="utf-8").splitlines() if (w := line.split())]


def _ground(file: Path) -> dict[str, Array]:
    found = {}
    for name, north, east, up in _rows(file):
        at = np.array([float(east), float(north), float(up)])
        found[name] = at + MISTYPED.get(name, 0.0)
    return found
