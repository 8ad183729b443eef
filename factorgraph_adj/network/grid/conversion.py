"""A network in grid coordinates as a network in a geocentric or topocentric frame: `from_grid`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from ...crs.geoid import GeoidValues
from ...crs.reference_system import ReferenceSystem, reference_system
from ...entities import Photo
from ...errors import InputError, Problem, known, taking
from ...frames import Frame, LocalFrame
from ...models.unknown_registry import UNKNOWNS
from ...observations import Observation
from ...observations.base import of_quantities
from ...types import Array
from ..network import Network
from .model_coordinates import refuse_model_coordinates
from .observations import Context, converted, own_place
from .transformation import (
    OFFSET,
    Azimuths,
    Deflections,
    Distances,
    GridMove,
    GridOptions,
    Moved,
    Vectors,
    new_frame,
)
from .unknowns import moved_parameter, moved_photo, moved_point

CHOICES: dict[str, tuple[object, ...]] = {
    "azimuths": (None, "true", "grid"),
    "vectors": (None, "geocentric", "grid"),
    "horizontal_distances": ("measured", "ellipsoid", "sea_level", "grid"),
}
ELSEWHERE = 0.05
"""Smallest misfit of a vector, relative to its length, that other axes explain, and largest share
of it that is left then."""


@taking(Network)
def from_grid(
    network: Network,
    crs: ReferenceSystem | str | None = None,
    *,
    frame: Frame | Literal["topocentric", "geocentric"] = "topocentric",
    deflections: Deflections = "none",
    geoid_offset: float | None = None,
    azimuths: Azimuths | Mapping[str, Azimuths] | None = None,
    vectors: Vectors | None = None,
    horizontal_distances: Distances | Mapping[str, Distances] = "measured",
    sources: Mapping[tuple[str, str], str] | None = None,
) -> Network:
    """Return the network of grid coordinates in a frame where the Earth is as it is.

    Points, photos and observed positions of ``network`` have easting, northing and height of a
    reference system in a local frame, as if these were Cartesian. The new network has them in a
    geocentric or topocentric frame, so that neither the scale of the projection (up to 400 ppm)
    nor the curvature of the Earth enters distances, heights and calibrations. Its ids, names and
    everything that was measured between points are the same.

    - Points that are held in all coordinates stay held. Other held and weighted coordinates become
      observations: along east, north and up with the covariance of E, N, H turned by the
      convergence; heights as heights above the ellipsoid.
    - ω, φ, κ count from grid axes and the vertical at the photo; so do observed attitudes.
    - Levelled height differences get the difference of the undulations.
    - Readings of statoscopes, heights above water and hydrostatic readings get the undulation.
    - A coefficient of refraction below −0.5 is κ = k − 1 of a flat frame, as the readers of field
      books state it for the curvature of the Earth; the new frame is curved, and gets κ = k.

    Args:
        network: the network in the grid, with a flat local frame.
        crs: its reference system; None: ``network.crs``.
        frame: the new frame: topocentric with the origin in the middle of the points, geocentric,
            or one of these on the ellipsoid of the system's datum.
        deflections: deflections of the vertical at stations: ``none`` (ξ = η = 0), those of the
            geoid ``held``, or those of the geoid weighted with this σ, radians. Stations with
            stated deflections keep theirs.
        geoid_offset: σ, metres, of an unknown offset of the geoid that all levelled heights of
            control share (the level surface ``geoid`` of the new network); infinite: free; None:
            the geoid is taken as it is. Then no point is held in its height. Positions of GNSS and
            of photos take no part in it: their heights came from the ellipsoid.
        azimuths: whether azimuths count from ``true`` or from ``grid`` north, all of them or by id.
            A bearing of the grid becomes an azimuth by the convergence and by t − T, the curvature
            of the line in the grid, at approximate coordinates (`factorgraph_adj.network.grid.
            projected_lines`). A remark says where the target has none, and t − T is left out.
        vectors: whether GNSS vectors are ``geocentric``, or along ``grid`` east, grid north and up
            at their station.
        horizontal_distances: whether horizontal distances are as ``measured``, or were reduced to
            the ``ellipsoid``, to ``sea_level`` (the geoid) or to the ``grid`` with the scale of the
            projection. Reduced ones become arcs (`EllipsoidDistance`); one of the grid is divided
            by the scale along its line at approximate coordinates.
        sources: file and line by kind and name of points, for observations that represent their
            coordinates.

    Raises:
        InputError: no reference system, photos are a free model (`refuse_model_coordinates`), a
            geoid or grid is missing, a point is outside of it, or something counts from axes of
            the grid and cannot be converted; all is listed.
    """
    network = network.with_listed_points()
    stated = network.crs if crs is None else reference_system(crs)
    if stated is None:
        raise InputError(
            "the network has no reference system: from_grid(network, 'EPSG:25832+7837')"
        )
    options = GridOptions(deflections, geoid_offset, azimuths, vectors, horizontal_distances)
    _check(network, options)
    assert isinstance(network.frame, LocalFrame)
    refuse_model_coordinates(network, stated)
    names = list(network.points)
    xyz = np.array([p.coordinates for p in network.points.values()]).reshape(-1, 3)
    axes = np.vstack([network.frame.east_north, [0.0, 0.0, 1.0]])
    photos = _photo_positions(network)
    stated.checked().refuse_outside(xyz @ axes.T, names)
    found = new_frame(stated, np.vstack([xyz, photos]) @ axes.T, frame)
    if found is None:
        raise InputError("the new frame must be topocentric or geocentric, not a local one")
    stated.refuse_other(found)
    move = GridMove(stated, network.frame, found, options)
    middle = float(np.nanmean(xyz[:, 2])) if np.isfinite(xyz[:, 2]).any() else 0.0
    filled = np.where(np.isnan(xyz) & [False, False, True], middle, xyz)
    points = move.places(filled, names)
    out = Network(network.name, frame=found, datum=network.datum, crs=stated)
    out.cameras = network.cameras.copy()
    out.doubts = network.doubts.copy()
    out.left_out = network.left_out.copy()
    out.remarks = network.remarks.copy()
    out.unknowns_left_out = network.unknowns_left_out.copy()
    out.images = network.images.copy()
    out.clusters = network.clusters.copy()
    out.point_number = network.point_number.copy()
    out.photo_number = network.photo_number.copy()
    problems: list[Problem] = []
    more = [
        *_points(network, out, move, points, xyz, sources or {}, problems),
        *_photos(network, out, move, photos, problems),
    ]
    _parameters(network, out, move, points, photos, problems)
    _deflections(network, out, move, points, problems)
    _observations(network, out, move, points, photos, problems)
    if problems:
        raise InputError(problems)
    if geoid_offset is not None:
        sigma = None if np.isinf(geoid_offset) else geoid_offset
        out.set_level(OFFSET, 0.0, sigma=sigma)
    for ident, o in more:
        out.add(o if ident in out.observations else replace(o, id=ident))
    return out


def _check(network: Network, options: GridOptions) -> None:
    """Refuse wrong options, and networks that are not in a grid.

    Raises:
        InputError: all of them.
    """
    problems: list[Problem] = []
    if not isinstance(network.frame, LocalFrame):
        problems.append(Problem("the network is in a frame on the Earth already", "frame"))
    for name, valid in CHOICES.items():
        stated = getattr(options, name)
        every = dict.fromkeys(stated.values()) if isinstance(stated, Mapping) else (stated,)
        for given in every:
            if given not in valid:
                valid_names = known([v for v in valid if v is not None], meant=str(given))
                problems.append(Problem(f"unknown {name} {given!r}; valid: {valid_names}"))
    d = options.deflections
    if isinstance(d, str):
        if d not in ("none", "held"):
            what = f"unknown deflections {d!r}; valid: none, held, or σ in radians"
            problems.append(Problem(what))
    elif not 0 < d < np.inf:
        problems.append(Problem(f"σ of deflections must be positive, not {d!r}"))
    offset = options.geoid_offset
    if offset is not None and not offset > 0:
        problems.append(Problem(f"geoid_offset must be a positive σ in metres, not {offset!r}"))
    if offset is not None and OFFSET in network.of_kind("level"):
        problems.append(Problem(f"a level surface {OFFSET!r} is there already: name it otherwise"))
    if problems:
        raise InputError(problems)


def _photo_positions(network: Network) -> Array:
    """Return positions of the photos in the grid, (n, 3): their own, or observed ones."""
    positions = of_quantities(network.observations.values(), "coordinates of a photo")
    seen = {o.photo: o.value for o in positions if o.axes == "xyz"}
    nan = (np.nan,) * 3
    rows = [p.position or seen.get(n, nan) for n, p in network.photos.items()]
    return np.array(rows, dtype=float).reshape(-1, 3)


def _points(
    network: Network,
    out: Network,
    move: GridMove,
    places: Moved,
    xyz: Array,
    sources: Mapping[tuple[str, str], str],
    problems: list[Problem],
) -> list[tuple[str, Observation]]:
    nan = (np.nan,) * 3
    given = np.array([p.check or nan for p in network.points.values()]).reshape(-1, 3)
    check = np.where(np.isnan(given), xyz, given)
    check[np.isnan(given).all(axis=1)] = np.nan
    compared = move.places(check, list(network.points))
    more: list[tuple[str, Observation]] = []
    for row, (name, p) in enumerate(network.points.items()):
        try:
            point, found = moved_point(p, move, places, row, compared, sources.get(("point", name)))
        except InputError as error:
            problems += error.problems
            continue
        out.points[name] = point
        labels = _labels(name, found)
        more += zip(labels, found, strict=True)
    return more


def _labels(name: str, found: Sequence[Observation]) -> Iterable[str]:
    """Return ids of the observations of a point's coordinates."""
    return [f"{name} {'height' if len(o.component_names()) == 1 else 'control'}" for o in found]


def _photos(
    network: Network, out: Network, move: GridMove, positions: Array, problems: list[Problem]
) -> list[tuple[str, Observation]]:
    places = move.photos(positions, list(network.photos))
    more: list[tuple[str, Observation]] = []
    for row, (name, p) in enumerate(network.photos.items()):
        try:
            photo, found = moved_photo(p, places, row)
        except InputError as error:
            problems += error.problems
            continue
        out.photos[name] = _without_place(photo, p)
        more += [(f"{name} position", o) for o in found]
    return more


def _without_place(photo: Photo, given: Photo) -> Photo:
    """Return a photo without the position that only an observation has."""
    return photo if given.position is not None else replace(photo, position=None)


def _parameters(
    network: Network,
    out: Network,
    move: GridMove,
    points: Moved,
    positions: Array,
    problems: list[Problem],
) -> None:
    photos = move.photos(positions, list(network.photos))
    for kind, stated in network.parameters.items():
        record = UNKNOWNS[kind]
        at = (photos, network.photo_number) if record.in_photo else (points, network.point_number)
        for key, parameter in stated.items():
            try:
                out.of_kind(kind)[key] = moved_parameter(record, key, parameter, move, *at)
            except InputError as error:
                problems += error.problems


def _deflections(
    network: Network, out: Network, move: GridMove, places: Moved, problems: list[Problem]
) -> None:
    """State the deflections of the geoid at the stations that need verticals."""
    if move.options.deflections == "none":
        return
    stations = dict.fromkeys(
        str(getattr(o, attribute))
        for o in network.observations.values()
        for kind, attribute in o.record.parameters
        if kind == "vertical" and getattr(o, attribute, None) is not None
    )
    wanted = [n for n in network.points if n in stations and n not in network.of_kind("vertical")]
    rows = [network.point_number[n] for n in wanted if places.there(network.point_number[n])]
    wanted = [n for n in wanted if places.there(network.point_number[n])]
    if not rows:
        return
    latitude, longitude, _ = move.system.geodetic(move.new, places.xyz[rows])
    try:
        values: GeoidValues = move.system.geoid_at(latitude, longitude, wanted)
    except InputError as error:
        problems += error.problems
        return
    for name, xi, eta in zip(wanted, values.xi.tolist(), values.eta.tolist(), strict=True):
        if not np.isfinite([xi, eta]).all():
            what = f"{move.system.vertical} has no deflections there: deflections = 'none'"
            problems.append(Problem(what, f"point {name!r}"))
            continue
        held = isinstance(move.options.deflections, str)
        sigma = None if isinstance(move.options.deflections, str) else move.options.deflections
        if name in out.points:
            out.set_vertical(name, xi=xi, eta=eta, sigma=sigma, fixed=held)


def _observations(
    network: Network,
    out: Network,
    move: GridMove,
    points: Moved,
    photos: Array,
    problems: list[Problem],
) -> None:
    verticals = out.of_kind("vertical")
    context = Context(
        move,
        points,
        network.point_number,
        move.photos(photos, list(network.photos)),
        network.photo_number,
        {str(n): (p.values[0], p.values[1]) for n, p in verticals.items()},
        out.remarks,
    )
    contexts: dict[GridOptions, Context] = {}

    def of_observation(ident: str) -> Context:
        options = move.options.of(ident)
        if options not in contexts:
            contexts[options] = replace(context, move=replace(move, options=options))
        return contexts[options]

    observations = list(network.observations.items())
    own = [own_place(o, network.frame) for _, o in observations]
    nan = np.full(3, np.nan)
    rows = np.array([nan if a is None else a for a in own]).reshape(-1, 3)
    there = np.isfinite(rows).all(axis=1)
    names = [(*o.points(), *o.photos(), "")[0] for _, o in observations]
    places = move.places(np.where(there[:, None], rows, np.nan), names)
    clustered = {i for ids, _ in network.clusters for i in ids}
    became: dict[str, tuple[list[str], Array]] = {}
    for row, (ident, o) in enumerate(observations):
        try:
            found, matrix = converted(o, of_observation(ident), places, row)
        except InputError as error:
            problems += error.problems
            continue
        ids = [ident, *(f"{ident} height" for _ in found[1:])]
        for name, new in zip(ids, found, strict=True):
            if name in out.observations or (name != ident and name in network.observations):
                problems.append(Problem(f"duplicate id {name!r}", o.label()))
            out.observations[name] = new
            out.state_found(new)
        if _is_rotation(matrix):
            out.axes_of_files[ident] = matrix
        if ident in clustered:
            became[ident] = ids, matrix
    if problems:
        problems += _in_other_axes(network, move, points)
        return
    out.clusters = [
        (
            tuple(i for ident in ids for i in became[ident][0]),
            _propagated(covariance, [became[i][1] for i in ids]),
        )
        for ids, covariance in network.clusters
    ]


def _in_other_axes(network: Network, move: GridMove, points: Moved) -> Iterator[Problem]:
    """Find the vectors between known places that are not along the stated axes, the first one.

    Called where something else is wrong, which this may be the reason of: a vector along the grid
    needs a place, a geocentric one does not.
    """
    if move.options.vectors != "grid":
        return
    for o in of_quantities(network.observations.values(), "vector"):
        i, j = (network.point_number[n] for n in (o.station, o.target))
        if not (points.there(i) and points.there(j)):
            continue
        between, v = points.xyz[j] - points.xyz[i], np.array(o.value)
        stated, other = (np.linalg.norm(k @ v - between) for k in (points.turn[i], move.from_earth))
        if stated > ELSEWHERE * np.linalg.norm(v) and other < ELSEWHERE * stated:
            yield Problem(
                f"fits the given coordinates as a geocentric vector to {other:.3g} m, and along "
                f"the grid to {stated:.0f} m; say vectors = 'geocentric'",
                o.label(),
            )
            return


def _is_rotation(matrix: Array) -> bool:
    """Return whether components x, y, z were turned, and nothing else."""
    turned = matrix.shape == (3, 3) and not np.array_equal(matrix, np.eye(3))
    return turned and np.allclose(matrix @ matrix.T, np.eye(3), rtol=0.0, atol=1e-12)


def _propagated(covariance: Array, matrices: Sequence[Array]) -> Array:
    """Return M Σ Mᵀ with the blocks M of the members."""
    size = sum(len(m) for m in matrices)
    whole = np.zeros((size, size))
    at = 0
    for m in matrices:
        whole[at : at + len(m), at : at + len(m)] = m
        at += len(m)
    out = whole @ covariance @ whole.T
    return np.asarray((out + out.T) / 2.0)
