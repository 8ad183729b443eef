"""Columns of shared errors: heights, constants, centring, turned sets, staffs, refocusing.

Each error is a column of partials for each place where it may have happened. `ERROR_FAMILIES` has
those of readings between points: a new error is one more row, with the kinds of readings that may
have it.

A camera that was refocused between two photos has the principal distance c + ∇ in all photos from
one on, in the order of the network. The column of ∇ is ∂f/∂c of their image coordinates.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from scipy.sparse import coo_array, csc_array

from ...errors import InputError
from ...graph.equations import Equations
from ...graph.variables import State
from ...observations.registry import (
    DISTANCE_QUANTITIES,
    INCLINATION_QUANTITIES,
    TOTAL_STATION_QUANTITIES,
    Quantity,
)
from ...types import Array, Index
from ...units import PPM
from .readings import ONE_TARGET, Readings

ErrorQuantity: TypeAlias = Literal[
    "length", "angle", "turn", "ppm", "ratio", "image", "number", "curvature"
]
"""Quantity of an error; a turn is an angle of any size, such as that between two norths."""

MIN_PHOTOS_OF_FOCUS = 2
"""Smallest number of photos before and after the change: one could have another place instead."""
MAX_REFOCUSING_ENTRIES = 2_000_000
"""Largest number of image points times photos of a camera with which a change is searched for."""
PRINCIPAL_DISTANCE = "c"
"""Name of the principal distance among the components of a calibration."""


@dataclass(frozen=True)
class ErrorColumns:
    """One cause at several places."""

    cause: str
    """What is wrong, a noun with its article."""
    sizes: tuple[ErrorQuantity, ...]
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


def grouped_errors(
    r: Readings,
    cause: str,
    sizes: Sequence[ErrorQuantity],
    keys: Sequence[Array | Index],
    values: Array,
    where: Callable[[int], str],
    components: Sequence[str] = (),
    rank: int = 1,
    recorded: Array | None = None,
) -> ErrorColumns:
    """Return one hypothesis for each set of equal keys.

    Args:
        r: the readings.
        cause: what is wrong.
        sizes: quantity of each component, (q,).
        keys: what the readings of a place have in common, arrays (m,).
        values: change of f by each component, (m, q).
        where: returns the name of a place by one of its rows.
        components: names of the components, (q,).
        rank: as in `ErrorColumns`.
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
    return ErrorColumns(cause, tuple(sizes), tuple(components), names, columns, rank, heights)


def shared_error_columns(r: Readings) -> Iterator[ErrorColumns]:
    """Iterate over the causes that readings between points may have, see `ERROR_FAMILIES`."""
    for quantities, family in ERROR_FAMILIES:
        some = r.of_quantities(quantities)
        if len(some.row):
            yield from family(some)


def _point(r: Readings) -> Callable[[int], str]:
    names = r.equations.unknowns["point"].names
    return lambda number: repr(names[number])


def _heights(r: Readings) -> Iterator[ErrorColumns]:
    """Recorded − true heights of instruments and targets: computed with the recorded ones."""
    name = _point(r)
    height, target = r.constant("instrument_height"), r.constant("target_height")
    by_instrument = -r.by_constant("instrument_height")[:, None]
    by_target = -r.by_constant("target_height")[:, None]
    yield grouped_errors(
        r,
        "the height of the instrument",
        ("length",),
        (r.station, height),
        by_instrument,
        lambda i: f"at {name(r.station[i])} ({height[i]:g} m)",
        recorded=height,
    )
    yield grouped_errors(
        r,
        "the height of the target",
        ("length",),
        (r.target, target),
        by_target,
        lambda i: f"at {name(r.target[i])} ({target[i]:g} m)",
        rank=2,
        recorded=target,
    )
    yield grouped_errors(
        r,
        "the height of the target",
        ("length",),
        (r.station, r.target, target),
        by_target,
        lambda i: f"at {name(r.target[i])} ({target[i]:g} m) seen from {name(r.station[i])}",
        recorded=target,
    )


def _vertical_circle(r: Readings) -> Iterator[ErrorColumns]:
    """Zenith angles observed too large by one angle, vertical angles too small."""
    values = np.where(r.quantity == "zenith angle", 1.0, -1.0)[:, None]
    cause = "the index error of the vertical circle"
    yield from _at_stations_and_everywhere(r, cause, "angle", values)


def _at_stations_and_everywhere(
    r: Readings, cause: str, size: ErrorQuantity, values: Array, components: Sequence[str] = ()
) -> Iterator[ErrorColumns]:
    """Return a hypothesis for the readings of each station, and one for all of them."""
    name = _point(r)
    yield grouped_errors(
        r,
        cause,
        (size,),
        (r.station,),
        values,
        lambda i: f"at station {name(r.station[i])}",
        components,
    )
    every = (np.zeros(len(r.row)),)
    yield grouped_errors(
        r, cause, (size,), every, values, lambda _: "everywhere", components, rank=2
    )


def _curvature(r: Readings) -> Iterator[ErrorColumns]:
    """Zenith angles observed too large by a share s of h / 2R, vertical angles too small.

    s is 1 − k, with the coefficient of refraction k, where a plane frame leaves the curvature of
    the Earth out; 2 k or −2 k where the refraction has the wrong sign.
    """
    cause = "the curvature of the Earth or refraction"
    share = ("factor of d²/2R",)
    values = -r.by_unknown("refraction")[:, None]
    yield from _at_stations_and_everywhere(r, cause, "curvature", values, share)


def _distances(r: Readings) -> Iterator[ErrorColumns]:
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
        sizes: tuple[ErrorQuantity, ...] = (size,)  # type: ignore[assignment]
        yield grouped_errors(
            r, cause, sizes, (r.station,), values, lambda i: f"at station {name(r.station[i])}"
        )
        if several:
            yield grouped_errors(
                r, cause, sizes, (meter,), values, lambda i: f"of meter {meters[meter[i]]!r}"
            )
        yield grouped_errors(r, cause, sizes, (nothing,), values, lambda _: "everywhere", rank=2)
    cause = "the zero constant (prism constant) of distances"
    yield grouped_errors(
        r, cause, ("length",), (r.target,), one, lambda i: f"to {name(r.target[i])}", rank=2
    )


def _centring(r: Readings) -> Iterator[ErrorColumns]:
    """Offset of the instrument from its mark, horizontally."""
    name = _point(r)
    height = r.constant("instrument_height")
    both: tuple[ErrorQuantity, ...] = ("length", "length")
    yield grouped_errors(
        r,
        "the centring of the instrument",
        both,
        (r.station, height),
        r.by_end("station"),
        lambda i: f"at {name(r.station[i])} (height {height[i]:g} m)",
        ("east", "north"),
    )


def _centring_of_targets(r: Readings) -> Iterator[ErrorColumns]:
    """Offset of the target from its mark, horizontally, at all its sights or at one."""
    name = _point(r)
    both: tuple[ErrorQuantity, ...] = ("length", "length")
    yield grouped_errors(
        r,
        "the centring of the target",
        both,
        (r.target,),
        r.by_end("target"),
        lambda i: f"at {name(r.target[i])}",
        ("east", "north"),
        rank=2,
    )
    yield grouped_errors(
        r,
        "the centring of the target",
        both,
        (r.station, r.target),
        r.by_end("target"),
        lambda i: f"at {name(r.target[i])} seen from {name(r.station[i])}",
        ("east", "north"),
    )


def _sets(r: Readings) -> Iterator[ErrorColumns]:
    """A set of directions that turned, or was moved, on the way."""
    name, sets = _point(r), r.variable("orientation")
    names = r.equations.unknowns["orientation"].names
    yield grouped_errors(
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
    r: Readings, cause: str, size: ErrorQuantity, where: Sequence[str], parts: Sequence[Index]
) -> ErrorColumns:
    """Return hypotheses that change some rows each by the same amount."""
    column = np.repeat(np.arange(len(parts)), [len(p) for p in parts])
    row = r.row[np.concatenate(parts)]
    shape = (r.equations.n_rows, len(parts))
    entries = coo_array((np.ones(len(row)), (row, column)), shape=shape)
    return ErrorColumns(cause, (size,), (), tuple(where), csc_array(entries))


def _antennas(r: Readings) -> Iterator[ErrorColumns]:
    """Recorded − true heights of antennas, at either end of the vectors with one of them."""
    name = _point(r)
    m = len(r.row)
    point = np.concatenate([r.station, r.target])
    height = np.concatenate([r.constant(f"{e}_height") for e in ("instrument", "target")])
    values = np.concatenate([-r.by_constant(f"{e}_height") for e in ("instrument", "target")])
    twice = r.only(np.concatenate([np.arange(m), np.arange(m)]))
    yield grouped_errors(
        twice,
        "the height of the antenna",
        ("length",),
        (point, height),
        values[:, None],
        lambda i: f"at {name(point[i])} ({height[i]:g} m)",
        recorded=height,
    )


def _azimuths(r: Readings) -> Iterator[ErrorColumns]:
    """Azimuths from another north, or set by a wrong backsight: all of them turned by one angle."""
    one = np.ones((len(r.row), 1))
    cause = "the north of azimuths"
    yield from _at_stations_and_everywhere(r, cause, "turn", one)


def _levelled(r: Readings) -> Iterator[ErrorColumns]:
    """Height differences from a staff whose divisions are not metres.

    Recorded = true (1 + s). The column is the computed difference: what of it other readings
    control is that of the held heights alone, without any error of a reading, whatever s is. With
    one held height nothing is left of it.
    """
    nothing = np.zeros(len(r.row))
    values = r.computed[:, None]
    cause = "the scale of levelled height differences (staff or line of sight)"
    yield grouped_errors(r, cause, ("ratio",), (nothing,), values, lambda _: "everywhere", rank=2)


ERROR_FAMILIES: tuple[
    tuple[frozenset[Quantity], Callable[[Readings], Iterator[ErrorColumns]]], ...
] = (
    (TOTAL_STATION_QUANTITIES, _heights),
    (INCLINATION_QUANTITIES, _vertical_circle),
    (DISTANCE_QUANTITIES, _distances),
    (TOTAL_STATION_QUANTITIES, _centring),
    (ONE_TARGET, _centring_of_targets),
    (frozenset({"direction"}), _sets),
    (INCLINATION_QUANTITIES, _curvature),
    (frozenset({"azimuth", "gyro azimuth"}), _azimuths),
    (frozenset({"height difference"}), _levelled),
    (frozenset({"vector"}), _antennas),
)
"""Quantities of readings, and the errors that they may share. A horizontal angle has two targets:
the centring of one of them is no error of all of it."""


def refocusing_columns(equations: Equations, state: State) -> Iterator[ErrorColumns]:
    """Iterate over cameras, with a change of the principal distance at each of their photos.

    Args:
        equations: the observation equations.
        state: values of all variables.
    """
    unknowns = equations.unknowns
    for row, photo, camera, by_c in _rays(equations, state):
        for number in np.unique(camera).tolist():
            at = np.flatnonzero(camera == number)
            seen, place = np.unique(photo[at], return_inverse=True)
            starts = np.arange(MIN_PHOTOS_OF_FOCUS, len(seen) - MIN_PHOTOS_OF_FOCUS + 1)
            if not len(starts) or len(at) * len(seen) > MAX_REFOCUSING_ENTRIES:
                continue
            ray, change = np.nonzero(place.ravel()[:, None] >= starts)
            rows, values = row[at[ray]], by_c[at[ray]]
            column = np.broadcast_to(change[:, None], rows.shape)
            entries = coo_array(
                (values.ravel(), (rows.ravel(), column.ravel())),
                shape=(equations.n_rows, len(starts)),
            )
            name = unknowns["calibration"].names[number]
            where = tuple(
                f"from photo {unknowns['pose'].names[p]!r} on, of camera {name!r}"
                for p in seen[starts].tolist()
            )
            cause = "the principal distance, another one"
            yield ErrorColumns(cause, ("image",), (), where, csc_array(entries), rank=2)


def _rays(equations: Equations, state: State) -> Iterator[tuple[Index, Index, Index, Array]]:
    """Iterate over blocks of image points with a principal distance.

    Yields rows (n, 2), numbers of the photos and of the calibrations (n,), and ∂f/∂c (n, 2).
    """
    for block in equations.blocks:
        if block.lens is None or PRINCIPAL_DISTANCE not in block.lens.names:
            continue
        kinds = [kind for kind, _ in block.variables]
        try:
            found = block.evaluate(equations.network.frame, state)
        except InputError:
            continue
        by_c = found.jacobians[kinds.index("calibration")][
            :, :, block.lens.names.index(PRINCIPAL_DISTANCE)
        ]
        rows = np.arange(block.rows.start, block.rows.stop).reshape(block.observed.shape)
        photo, camera = (block.variables[kinds.index(k)][1] for k in ("pose", "calibration"))
        yield rows, photo, camera, by_c
