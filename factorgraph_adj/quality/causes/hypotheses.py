"""Errors that surveyors know, as columns: of heights, constants, centring, directions, levelling.

`FAMILIES` has them all: a new error is one more row, with the kinds of readings that may have it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from scipy.sparse import coo_array, csc_array

from ...types import Array, Index
from .readings import Readings

Size: TypeAlias = Literal["length", "angle", "turn", "ppm", "ratio", "image", "number", "curvature"]
"""Quantity of an error; a turn is an angle of any size, such as that between two norths."""

DISTANCES = ("slope_distance", "horizontal_distance")
INCLINATIONS = ("zenith_angle", "vertical_angle")
SIGHTS = (*DISTANCES, *INCLINATIONS, "direction", "azimuth", "horizontal_angle")
"""Kinds that are read at a total station."""
PPM = 1e-6


@dataclass(frozen=True)
class Hypotheses:
    """One cause at several places."""

    cause: str
    """What is wrong, a noun with its article."""
    sizes: tuple[Size, ...]
    """Quantity of each component, (q,)."""
    components: tuple[str, ...]
    """Names of the components, (q,); empty for one alone."""
    where: tuple[str, ...]
    """The places, (h,)."""
    columns: csc_array
    """C, not whitened, (n_rows, h q): the components of a place beside one another."""
    rank: int = 1
    """Place among causes that explain as much: 0 for given values, 1 for what one set-up makes, 2
    for what several have in common."""
    recorded: Array | None = None
    """Recorded height at each place, (h,) metres; none for other causes."""


def grouped(
    r: Readings,
    cause: str,
    sizes: Sequence[Size],
    keys: Sequence[Array | Index],
    values: Array,
    where: Callable[[int], str],
    components: Sequence[str] = (),
    rank: int = 1,
    recorded: Array | None = None,
) -> Hypotheses:
    """Return one hypothesis for each set of equal keys.

    Args:
        r: the readings.
        cause: what is wrong.
        sizes: quantity of each component, (q,).
        keys: what the readings of a place have in common, arrays (m,).
        values: change of f by each component, (m, q).
        where: returns the name of a place by one of its rows.
        components: names of the components, (q,).
        rank: as in `Hypotheses`.
        recorded: recorded height of each reading, (m,) metres.
    """
    _, first, group = np.unique(
        np.stack([np.asarray(k, dtype=float) for k in keys]),
        axis=1,
        return_index=True,
        return_inverse=True,
    )
    q = values.shape[1]
    column = group.ravel()[:, None] * q + np.arange(q)
    row = np.broadcast_to(r.row[:, None], column.shape)
    shape = (r.equations.n_rows, len(first) * q)
    entries = coo_array((values.ravel(), (row.ravel(), column.ravel())), shape=shape)
    names = tuple(where(int(i)) for i in first)
    heights = None if recorded is None else recorded[first]
    columns = csc_array(entries)
    return Hypotheses(cause, tuple(sizes), tuple(components), names, columns, rank, heights)


def hypotheses(r: Readings) -> Iterator[Hypotheses]:
    """Iterate over the causes that readings between points may have, see `FAMILIES`."""
    for kinds, family in FAMILIES:
        some = r.of_kinds(*kinds)
        if len(some.row):
            yield from family(some)


def _point(r: Readings) -> Callable[[int], str]:
    names = r.equations.unknowns["point"].names
    return lambda number: repr(names[number])


def _heights(r: Readings) -> Iterator[Hypotheses]:
    """Recorded − true heights of instruments and targets: computed with the recorded ones."""
    name = _point(r)
    height, target = r.constant("instrument_height"), r.constant("target_height")
    by_instrument = -r.by_constant("instrument_height")[:, None]
    by_target = -r.by_constant("target_height")[:, None]
    yield grouped(
        r,
        "the height of the instrument",
        ("length",),
        (r.station, height),
        by_instrument,
        lambda i: f"at {name(r.station[i])} ({height[i]:g} m)",
        recorded=height,
    )
    yield grouped(
        r,
        "the height of the target",
        ("length",),
        (r.target, target),
        by_target,
        lambda i: f"at {name(r.target[i])} ({target[i]:g} m)",
        rank=2,
        recorded=target,
    )
    yield grouped(
        r,
        "the height of the target",
        ("length",),
        (r.station, r.target, target),
        by_target,
        lambda i: f"at {name(r.target[i])} ({target[i]:g} m) seen from {name(r.station[i])}",
        recorded=target,
    )


def _vertical_circle(r: Readings) -> Iterator[Hypotheses]:
    """Zenith angles observed too large by one angle, vertical angles too small."""
    values = np.where(r.kind == "zenith_angle", 1.0, -1.0)[:, None]
    cause = "the index error of the vertical circle"
    yield from _at_stations_and_everywhere(r, cause, "angle", values)


def _at_stations_and_everywhere(
    r: Readings, cause: str, size: Size, values: Array, components: Sequence[str] = ()
) -> Iterator[Hypotheses]:
    """Return a hypothesis for the readings of each station, and one for all of them."""
    name = _point(r)
    yield grouped(
        r,
        cause,
        (size,),
        (r.station,),
        values,
        lambda i: f"at station {name(r.station[i])}",
        components,
    )
    every = (np.zeros(len(r.row)),)
    yield grouped(r, cause, (size,), every, values, lambda _: "everywhere", components, rank=2)


def _curvature(r: Readings) -> Iterator[Hypotheses]:
    """Zenith angles observed too large by a share s of h / 2R, vertical angles too small.

    s is 1 − k, with the coefficient of refraction k, where a plane frame leaves the curvature of
    the Earth out; 2 k or −2 k where the refraction has the wrong sign.
    """
    cause = "the curvature of the Earth or refraction"
    share = ("factor of d²/2R",)
    values = -r.by_unknown("refraction")[:, None]
    yield from _at_stations_and_everywhere(r, cause, "curvature", values, share)


def _distances(r: Readings) -> Iterator[Hypotheses]:
    name = _point(r)
    one, length = np.ones((len(r.row), 1)), PPM * r.computed[:, None]
    meter = r.variable("edm")
    meters = r.equations.unknowns["edm"].names
    nothing = np.zeros(len(r.row))
    several = len(np.unique(meter)) > 1
    for cause, size, values in (
        ("the zero constant (prism constant) of distances", "length", one),
        ("the scale of distances", "ppm", length),
    ):
        sizes: tuple[Size, ...] = (size,)  # type: ignore[assignment]
        yield grouped(
            r, cause, sizes, (r.station,), values, lambda i: f"at station {name(r.station[i])}"
        )
        if several:
            yield grouped(
                r, cause, sizes, (meter,), values, lambda i: f"of meter {meters[meter[i]]!r}"
            )
        yield grouped(r, cause, sizes, (nothing,), values, lambda _: "everywhere", rank=2)
    cause = "the zero constant (prism constant) of distances"
    yield grouped(
        r, cause, ("length",), (r.target,), one, lambda i: f"to {name(r.target[i])}", rank=2
    )


def _centring(r: Readings) -> Iterator[Hypotheses]:
    """Offset of the instrument from its mark, horizontally."""
    name = _point(r)
    height = r.constant("instrument_height")
    both: tuple[Size, ...] = ("length", "length")
    yield grouped(
        r,
        "the centring of the instrument",
        both,
        (r.station, height),
        r.by_end("station"),
        lambda i: f"at {name(r.station[i])} (height {height[i]:g} m)",
        ("east", "north"),
    )


def _centring_of_targets(r: Readings) -> Iterator[Hypotheses]:
    """Offset of the target from its mark, horizontally, at all its sights or at one."""
    name = _point(r)
    both: tuple[Size, ...] = ("length", "length")
    yield grouped(
        r,
        "the centring of the target",
        both,
        (r.target,),
        r.by_end("target"),
        lambda i: f"at {name(r.target[i])}",
        ("east", "north"),
        rank=2,
    )
    yield grouped(
        r,
        "the centring of the target",
        both,
        (r.station, r.target),
        r.by_end("target"),
        lambda i: f"at {name(r.target[i])} seen from {name(r.station[i])}",
        ("east", "north"),
    )


def _sets(r: Readings) -> Iterator[Hypotheses]:
    """A set of directions that turned, or was moved, on the way."""
    name, sets = _point(r), r.variable("orientation")
    names = r.equations.unknowns["orientation"].names
    yield grouped(
        r,
        "the set of directions, read from a place beside the mark,",
        ("length", "length"),
        (sets,),
        r.by_end("station"),
        lambda i: f"of set {names[sets[i]]!r}",
        ("east", "north"),
    )
    parts, where = [], []
    for number in np.unique(sets).tolist():
        at = np.flatnonzero(sets == number)
        for first in range(2, len(at) - 1):
            where.append(f"of set {names[number]!r} from target {name(r.target[at[first]])} on")
            parts.append(at[first:])
    if parts:
        yield _of_rows(r, "the orientation, turned on the way,", "angle", where, parts)


def _of_rows(
    r: Readings, cause: str, size: Size, where: Sequence[str], parts: Sequence[Index]
) -> Hypotheses:
    """Return hypotheses that change some rows each by the same amount."""
    column = np.repeat(np.arange(len(parts)), [len(p) for p in parts])
    row = r.row[np.concatenate(parts)]
    shape = (r.equations.n_rows, len(parts))
    entries = coo_array((np.ones(len(row)), (row, column)), shape=shape)
    return Hypotheses(cause, (size,), (), tuple(where), csc_array(entries))


def _antennas(r: Readings) -> Iterator[Hypotheses]:
    """Recorded − true heights of antennas, at either end of the vectors with one of them."""
    name = _point(r)
    m = len(r.row)
    point = np.concatenate([r.station, r.target])
    height = np.concatenate([r.constant(f"{e}_height") for e in ("instrument", "target")])
    values = np.concatenate([-r.by_constant(f"{e}_height") for e in ("instrument", "target")])
    twice = r.only(np.concatenate([np.arange(m), np.arange(m)]))
    yield grouped(
        twice,
        "the height of the antenna",
        ("length",),
        (point, height),
        values[:, None],
        lambda i: f"at {name(point[i])} ({height[i]:g} m)",
        recorded=height,
    )


def _azimuths(r: Readings) -> Iterator[Hypotheses]:
    """Azimuths from another north, or set by a wrong backsight: all of them turned by one angle."""
    one = np.ones((len(r.row), 1))
    cause = "the north of azimuths"
    yield from _at_stations_and_everywhere(r, cause, "turn", one)


def _levelled(r: Readings) -> Iterator[Hypotheses]:
    """Height differences from a staff whose divisions are not metres.

    Recorded = true (1 + s). The column is the computed difference: what of it other readings
    control is that of the held heights alone, without any error of a reading, whatever s is. With
    one held height nothing is left of it.
    """
    nothing = np.zeros(len(r.row))
    values = r.computed[:, None]
    cause = "the scale of levelled height differences (staff or line of sight)"
    yield grouped(r, cause, ("ratio",), (nothing,), values, lambda _: "everywhere", rank=2)


FAMILIES: tuple[tuple[tuple[str, ...], Callable[[Readings], Iterator[Hypotheses]]], ...] = (
    (SIGHTS, _heights),
    (INCLINATIONS, _vertical_circle),
    (DISTANCES, _distances),
    (SIGHTS, _centring),
    (tuple(k for k in SIGHTS if k != "horizontal_angle"), _centring_of_targets),
    (("direction",), _sets),
    (INCLINATIONS, _curvature),
    (("azimuth", "gyro_azimuth"), _azimuths),
    (("height_difference",), _levelled),
    (("gnss_vector",), _antennas),
)
"""Kinds of readings, and the errors that they may share. A horizontal angle has two targets: the
centring of one of them is no error of all of it."""
