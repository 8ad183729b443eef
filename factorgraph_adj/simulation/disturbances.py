"""Readings of a plan with noise and given systematic errors; gross errors, lost observations."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..entities import ImageTable, Parameter
from ..errors import Problem, known, unknown_name
from ..graph.equations import compile_rows
from ..graph.observation_selection import without
from ..models.unknown_registry import UNKNOWNS
from ..network.network import Network
from ..observations import KINDS, ControlPoint, Observation
from ..observations.registry import DISTANCE_QUANTITIES
from ..types import Array
from .measurement import Seed, measure
from .parameters import Parameters, number, path_of
from .planned_values import undetermined_points
from .systematic_errors import InImages, Systematic

GROSS, DROPPED = 1000, 1001
"""Streams of the seed for gross errors and drop-outs. Lower numbers are streams of measuring and
of approximate values; `GEOMETRY` is the stream of geometry."""

Reading = tuple[str, str]
"""Id of an observation and name of its component; the name is empty if it has only one."""


@dataclass(frozen=True)
class GrossError(Parameters):
    """Gross errors of named observations or of drawn observations.

    Example:
        ``GrossError(ids=("1/2/17",), component="x", size=0.1)``,
        ``GrossError(kind="slope_distance", count=3, times_sigma=20)``; errors of drawn
        observations have a drawn sign.
    """

    ids: tuple[str, ...] = ()
    """Ids of observations; the id of an image point is photo/point."""
    component: str = ""
    """Component with the error, ``x``, ``y`` …; empty: the first, of drawn observations any."""
    observations: str = ""
    """Kind of the observations from which the faulty ones are drawn; empty: all kinds."""
    count: int = number(0, least=0)
    """Number of drawn observations."""
    size: float | None = None
    """Size of the error: metres, radians, or mm for image coordinates."""
    times_sigma: float | None = None
    """Size in standard deviations of the observation, instead of ``size``."""

    def problems(self, where: str) -> list[Problem]:
        """Return the problems of the combination of fields."""
        found = []
        if (self.size is None) == (self.times_sigma is None):
            found.append(Problem("give either size or times_sigma", path_of(where, "size")))
        if bool(self.ids) == bool(self.count):
            found.append(Problem("give either ids or count", path_of(where, "ids")))
        if self.observations and self.observations not in KINDS:
            valid = known(KINDS, meant=self.observations, most=40)
            what = f"unknown kind {self.observations!r}; valid: {valid}"
            found.append(Problem(what, path_of(where, "observations")))
        return found

    def unknown(self, readings: Mapping[Reading, str], where: str) -> list[Problem]:
        """Return problems with names that a network with these readings (and kinds) lacks."""
        ids = {ident for ident, _ in readings}
        found = [
            Problem(
                unknown_name("observation", i, ids_in_order(readings)),
                path_of(where, "ids"),
            )
            for i in self.ids
            if i not in ids
        ]
        for i in self.ids:
            valid = [c for ident, c in readings if ident == i]
            if i in ids and self.component and self.component not in valid:
                names = known([c for c in valid if c], meant=self.component)
                what = f"observation {i!r} has no component {self.component!r}; valid: {names}"
                found.append(Problem(what, path_of(where, "component")))
        if self.count and self.count > (n := len(self._drawn_from(readings))):
            what = f"is {self.count}, but there are {n} such readings; valid: up to that"
            found.append(Problem(what, path_of(where, "count")))
        return found

    def _drawn_from(self, readings: Mapping[Reading, str]) -> list[Reading]:
        return [
            r
            for r, kind in readings.items()
            if self.observations in ("", kind) and self.component in ("", r[1])
        ]

    def chosen(
        self, readings: Mapping[Reading, str], rng: np.random.Generator
    ) -> list[tuple[Reading, float]]:
        """Return readings and the sign of their errors."""
        if self.ids:
            by_id: dict[str, Reading] = {}
            for r in readings:
                if r[0] in self.ids and self.component in ("", r[1]):
                    by_id.setdefault(r[0], r)
            return [(by_id[i], 1.0) for i in self.ids]
        candidates = self._drawn_from(readings)
        numbers = rng.permutation(len(candidates))[: self.count]
        signs = rng.choice([-1.0, 1.0], self.count)
        return [(candidates[i], float(s)) for i, s in zip(numbers, signs, strict=True)]


@dataclass(frozen=True)
class DropOut(Parameters):
    """Observations that are lost, each with the same probability."""

    probability: float = number(0.1, least=0, below=1)
    """Probability of the loss of each observation."""
    observations: str = ""
    """Kind of the observations; empty: all kinds except control and the mounts of rigs."""

    def problems(self, where: str) -> list[Problem]:
        """Return the problems of the fields."""
        if not self.observations or self.observations in KINDS:
            return []
        valid = known(KINDS, meant=self.observations, most=40)
        what = f"unknown kind {self.observations!r}; valid: {valid}"
        return [Problem(what, path_of(where, "observations"))]

    def takes(self, kind: str) -> bool:
        """Return whether observations of this kind may be lost."""
        if self.observations:
            return kind == self.observations
        # What leads from one pose to another is the mount of a rig, which does not get lost.
        leads = kind in KINDS and KINDS[kind].follower is not None
        return kind != ControlPoint.kind and not leads


@dataclass(frozen=True)
class Errors(Parameters):
    """Errors of a simulation; by default only the noise of the stochastic model."""

    noise: bool = True
    """Whether readings and weighted unknowns have random errors."""
    systematic: tuple[Systematic, ...] = ()
    """Systematic errors; all of them act together."""
    gross: tuple[GrossError, ...] = ()
    """Gross errors; several errors of one reading add up."""
    drop_outs: tuple[DropOut, ...] = ()
    """Losses of observations; observations with a gross error are never lost."""

    def unknown(self, plan: Network, where: str) -> list[Problem]:
        """Return problems with all names in the errors that the plan lacks."""
        readings = readings_of(plan)
        found = []
        for i, s in enumerate(self.systematic):
            found += s.unknown(plan, path_of(path_of(where, "systematic"), i))
        for i, g in enumerate(self.gross):
            found += g.unknown(readings, path_of(path_of(where, "gross"), i))
        return found


def ids_in_order(readings: Mapping[Reading, str]) -> list[str]:
    """Return the ids of readings, each once."""
    return list(dict.fromkeys(ident for ident, _ in readings))


def readings_of(network: Network) -> dict[Reading, str]:
    """Return the scalar readings of a network with the kinds of their observations."""
    found: dict[Reading, str] = {}
    for ident, o in network.observations.items():
        axes = o.component_names()
        found |= {(ident, c if len(axes) > 1 else ""): o.kind for c in axes}
    for ident in _image_ids(network):
        found[ident, "x"] = found[ident, "y"] = "image"
    return found


def _image_ids(network: Network) -> Iterator[str]:
    photo, point, _, _ = network.images.columns()
    photos, points = list(network.photos), list(network.points)
    ids = network.images.ids
    for row, (f, p) in enumerate(zip(photo.tolist(), point.tolist(), strict=True)):
        yield ids.get(row) or f"{photos[f]}/{points[p]}"


def true_plan(plan: Network, errors: Errors) -> Network:
    """Return a plan with the true values, from which the readings are made."""
    true = plan.copy()
    for s in errors.systematic:
        s.make_true(true)
    return true


def read(plan: Network, true: Network, errors: Errors, *, seed: Seed) -> Network:
    """Return a plan with readings that have noise and systematic errors, and with assumed values.

    Args:
        plan: the plan with the values that an adjustment assumes.
        true: the same plan with the true values, see `true_plan`.
        errors: the errors.
        seed: seed of the noise.
    """
    network = measure(true, seed=seed, noise=errors.noise)
    for ident, o in plan.observations.items():
        drawn = network.observations[ident]
        if o.record.quantity in DISTANCE_QUANTITIES:
            assumed: dict[str, Any] = {"instrument": getattr(o, "instrument", None)}
            network.observations[ident] = replace(drawn, **assumed)
    network.parameters = {
        kind: _assumed(given, true.of_kind(kind), network.of_kind(kind))
        if UNKNOWNS[kind].additional
        else network.of_kind(kind)
        for kind, given in plan.parameters.items()
    }
    _deform(network, true, errors)
    return network


def _assumed(
    plan: Mapping[str, Parameter], true: Mapping[str, Parameter], drawn: Mapping[str, Parameter]
) -> dict[str, Parameter]:
    """Return assumed unknowns plus the errors of the drawn ones, drawn − true."""
    found = {}
    for name, p in plan.items():
        error = np.subtract(drawn[name].values, true[name].values)
        found[name] = replace(p, values=tuple((np.array(p.values) + error).tolist()))
    return found


def _deform(network: Network, true: Network, errors: Errors) -> None:
    """Add the systematic errors of image coordinates to a network.

    The errors refer to the true principal point; a weighted camera in ``network`` has a drawn one.
    """
    acting = [s for s in errors.systematic if isinstance(s, InImages)]
    if not acting:
        return
    photo, _, xy, _ = network.images.columns()
    camera_of = [f.camera for f in network.photos.values()]
    moved = xy.copy()
    for name, camera in true.cameras.items():
        rows = np.flatnonzero([camera_of[i] == name for i in photo.tolist()])
        centred = xy[rows] - camera.values[1:3]
        for s in acting:
            if s.camera in ("", name):
                moved[rows] += s.shift(name, centred)
    _set_images(network, moved)


def _set_images(network: Network, xy: Array) -> None:
    """Replace the coordinates (n, 2) of the image points of a network."""
    network.images = network.images.with_columns(xy=xy)


def add_gross_errors(network: Network, errors: Errors, *, seed: Seed) -> dict[Reading, float]:
    """Add the gross errors to the readings of a network; return their sizes."""
    readings = readings_of(network)
    sizes: dict[Reading, float] = {}
    sigma: dict[Reading, float] = {}
    for i, gross in enumerate(errors.gross):
        rng = np.random.default_rng([seed, GROSS, i])
        if gross.times_sigma is not None and not sigma:
            sigma = _sigmas(network)
        for reading, sign in gross.chosen(readings, rng):
            if gross.times_sigma is not None:
                size = gross.times_sigma * sigma[reading]
            else:
                size = gross.size or 0.0
            sizes[reading] = sizes.get(reading, 0.0) + sign * size
    if not sizes:
        return sizes
    xy = network.images.columns()[2].copy()
    row_of = {ident: row for row, ident in enumerate(_image_ids(network))}
    for (ident, component), size in sizes.items():
        o = network.observations.get(ident)
        if o is None:
            xy[row_of[ident], "xy".index(component)] += size
        else:
            network.observations[ident] = _shifted(network, o, component, size)
    _set_images(network, xy)
    return sizes


def _shifted(network: Network, o: Observation, component: str, size: float) -> Observation:
    """Return an observation with an error in one component."""
    axes = o.component_names()
    if getattr(o, "local", False):
        value = np.zeros(len(axes))  # the reading of this kind is its displacement
    else:
        value = np.atleast_1d(np.array(getattr(o, "value"), dtype=float))  # noqa: B009
    error = np.zeros_like(value)
    error[axes.index(component) if component else 0] = size
    moved = o.record.with_errors(o, value, error)
    return o.with_reading(moved.tolist(), network.frame)


def _sigmas(network: Network) -> dict[Reading, float]:
    """Return the standard deviation of each reading."""
    of_images = network.images.columns()[3]
    found: dict[Reading, float] = {}
    for ident, s in zip(_image_ids(network), of_images.tolist(), strict=True):
        found[ident, "x"], found[ident, "y"] = s
    only = network.copy()
    only.images = ImageTable()
    equations = compile_rows(only)  # without the images, the network may be empty
    for block in equations.weighted_at(equations.unknowns.start()).blocks:
        for i, ident in enumerate(block.ids):
            for j in range(block.dimension):
                name = block.component(i, j)
                found[ident, name] = float(block.sigma[i, j])
                found.setdefault((ident, ""), float(block.sigma[i, j]))
    return found


def drop(
    network: Network, errors: Errors, keep: Mapping[Reading, float], *, seed: Seed
) -> tuple[Network, tuple[str, ...]]:
    """Remove lost observations; return the network without them, and their ids.

    Points that are no longer determined (see `undetermined_points`) are removed with all their
    observations. This is repeated for points that depended on the removed ones.
    """
    if not errors.drop_outs:
        return network, ()
    safe = {ident for ident, _ in keep}
    kinds = {ident: kind for (ident, _), kind in readings_of(network).items()}
    lost: dict[str, None] = {}
    for i, d in enumerate(errors.drop_outs):
        z = np.random.default_rng([seed, DROPPED, i]).random(len(kinds))
        for (ident, kind), draw in zip(kinds.items(), z.tolist(), strict=True):
            if d.takes(kind) and draw < d.probability and ident not in safe:
                lost[ident] = None
    left = without(network, lost)
    while lone := undetermined_points(left):
        left = without(left, (), points=lone)
    return left, tuple(lost)
