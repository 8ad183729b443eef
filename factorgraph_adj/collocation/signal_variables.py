"""Signals as variables of a network: deformation of a block and its adjustment at once.

Point P of the block is at X, in the undeformed system of the control at X' = X + s, with signals s
that have a joint covariance C. X' of control and of points that are to be predicted are points of
the network, "P+s": what is known of a control point, held, weighted or observed with the noise D,
is known of P+s, and the differences

    X' − X = 0,   joint covariance C

are correlated observations. The adjustment is then the collocation ℓ = A x + s + n with the whole
block as its trend: of P+s it has the filtered or predicted coordinates with σ and covariances. It
has the same x̂ as control with the covariance C + D. No kind of observation is new, so that all
that an adjustment has, reliability, snooping, files, arrivals, is there for signals too.

The signal of the images of a camera, s(x, y) in x and in y with the covariance C over the image, is
the sum of its modes with independent amplitudes (Karhunen & Loève),

    s = Σ_i a_i φ_i,   a_i ~ N(0, σ²),   φ_i = √λ_i u_i,   ϱ(nodes) = Σ_i λ_i u_i u_iᵀ

so that weighted amplitudes, parameters of the camera, stand for the full covariance of all its
images: Ayeni's method 27 without a dense matrix. Modes are bilinear between nodes, with weights b
of the four nodes around an image point. What they lack there, of the signal between the nodes and
of modes that are left out,

    σ² (1 − 2 bᵀc + bᵀK b) + σ² (bᵀK b − Σ_i φ_i²),

with the correlations K of the nodes and c of the nodes with the point, is noise of its coordinates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from ..entities import JointImagePoints
from ..errors import InputError, Problem, taking, unknown_name
from ..frames import GeocentricFrame
from ..models.grid_lens import GridLens
from ..network.network import Network
from ..observations.correlated_observations import Correlated
from ..observations.positions import ControlPoint
from ..observations.relations import CoordinateDifference
from ..types import Array
from .covariance_function import CovarianceFunction
from .point_corrections import covariance_of_control

NODES_PER_LENGTH = 5.0
"""Number of distances between nodes in the length L of the covariance function, at least: of a
gaussian one 3 % of σ are lost in the middle of a cell, h²/(8 L²) √32 σ."""
MOST_NODES = 3000
"""Largest number of nodes that follows from L without being stated; their matrix is full."""
MODES_LEFT_OUT = 1e-4
"""Share of the variance of a signal that its smallest modes have, which are left out."""
MOST_MODES = 500
"""Largest number of modes in x and in y: twice as many are parameters of the camera."""
WITH_SIGNAL = "+s"
"""Behind the name of a point: the point with its signal."""


@taking(Network)
def with_signals(
    network: Network,
    *,
    covariance: CovarianceFunction | None,
    height: CovarianceFunction | Literal["same"] | None = "same",
    points: Sequence[str] = (),
) -> Network:
    """Return a network in which control has signals with a joint covariance, see the module.

    Args:
        network: the network; it stays unchanged. Distances of points follow from their given
            coordinates, x and y.
        covariance: covariance function of the signals in x and y, metres; None: there are none.
        height: the same of z; ``same``: that of the plan.
        points: further points of which a point with the signal is wanted, besides control.

    Returns:
        The network with points "P+s" for each control point and each of ``points``. Their
        components without a signal are held where P is given, and mean nothing.

    Raises:
        InputError: a point is unknown or has no given coordinates, no component has a signal, no
            point has control, or control is known along other axes.
    """
    if isinstance(network.frame, GeocentricFrame):
        raise InputError("signals are along x, y and z of a local or topocentric frame")
    functions = (covariance, covariance, covariance if isinstance(height, str) else height)
    axes = "".join(
        a for a, f in zip("xyz", functions, strict=True) if f is not None and f.sigma > 0
    )
    if not axes:
        raise InputError("there is no signal: state a covariance function with σ > 0")
    on = np.array([a in axes for a in "xyz"])
    control = _control(network, axes, on)
    if unknown := [p for p in points if p not in network.points]:
        raise InputError(unknown_name("point", unknown[0], network.points))
    names = [*dict.fromkeys([*control, *points])]
    places = np.array([network.points[n].coordinates for n in names], dtype=float)
    if bad := [n for n, at in zip(names, places, strict=True) if not np.isfinite(at).all()]:
        raise InputError(
            Problem("signals need given, or approximate, coordinates", f"point {bad[0]!r}")
        )
    out = network.copy()
    for name in names:
        p = network.points[name]
        known = control.get(name, False)
        sigma = p.sigma if p.sigma is not None else (np.inf,) * 3
        own = [s if k else np.inf for s, k in zip(sigma, on, strict=True)]
        held = [f and not k for f, k in zip(p.fixed, on.tolist(), strict=True)]
        left = tuple(np.inf if k else s for s, k in zip(sigma, on, strict=True))
        out.add_point(
            name + WITH_SIGNAL,
            p.coordinates,
            fixed="".join(a for a, k, f in zip("xyz", on, p.fixed, strict=True) if not k or f),
            sigma=own if known and np.isfinite(own).any() else None,
            check=p.check,
        )
        out.points[name] = replace(
            p,
            fixed=(held[0], held[1], held[2]),
            sigma=(left[0], left[1], left[2]) if np.isfinite(left).any() else None,
        )
    for ident, o in network.observations.items():
        if isinstance(o, ControlPoint) and set(o.axes) & set(axes):
            _move(out, ident, o, axes)
    out.add(_signals(names, places[:, :2], functions, axes))
    return out


def _control(network: Network, axes: str, on: Array) -> dict[str, bool]:
    """Return the points of which a component with a signal is held, weighted or observed.

    Raises:
        InputError: there are none, or control is observed along axes of the horizon.
    """
    found: dict[str, bool] = {}
    for p in network.points.values():
        weighted = np.isfinite(p.sigma if p.sigma is not None else (np.inf,) * 3)
        if ((weighted | np.array(p.fixed)) & on).any():
            found[p.name] = True
    problems = []
    for o in network.observations.values():
        if isinstance(o, ControlPoint):
            if o.local:
                what = "signals are along x, y, z: state the control along these axes"
                problems.append(Problem(what, o.label()))
            elif set(o.axes) & set(axes):
                found[o.point] = True
    if problems:
        raise InputError(problems)
    if not found:
        raise InputError(f"no control in {', '.join(axes)}: signals cannot be told from the block")
    return found


def _move(out: Network, ident: str, o: ControlPoint, axes: str) -> None:
    """Let an observation of control be one of the point with its signal, as far as it has one.

    Raises:
        InputError: it is correlated with components without a signal.
    """
    with_signal = o.point + WITH_SIGNAL
    if set(o.axes) <= set(axes):
        out.observations[ident] = replace(o, point=with_signal)
        return
    on = [i for i, a in enumerate(o.axes) if a in axes]
    off = [i for i, a in enumerate(o.axes) if a not in axes]
    full = covariance_of_control(o)
    if full[np.ix_(on, off)].any() or any(ident in ids for ids, _ in out.clusters):
        what = "components with and without a signal are correlated: give all of them a signal"
        raise InputError(Problem(what, o.label()))

    def part(numbers: list[int]) -> ControlPoint:
        return replace(
            o,
            value=tuple(o.value[i] for i in numbers),
            axes="".join(o.axes[i] for i in numbers),
            sigma=None,
            covariance=full[np.ix_(numbers, numbers)],
        )

    out.observations[ident] = part(off)
    out.add(replace(part(on), point=with_signal, id=None))


def _signals(
    names: Sequence[str],
    places: Array,
    functions: Sequence[CovarianceFunction | None],
    axes: str,
) -> Correlated:
    """Return the differences X' − X = 0 with the joint covariance of the signals."""
    n, d = len(names), len(axes)
    joint = np.zeros((n, d, n, d))
    used = [f for f, a in zip(functions, "xyz", strict=True) if a in axes]
    for k, function in enumerate(used):
        assert function is not None
        joint[:, k, :, k] = function.between(places)
    differences = tuple(
        CoordinateDifference(name, name + WITH_SIGNAL, (0.0,) * d, axes=axes, sigma=1.0)
        for name in names
    )
    try:
        return Correlated(differences, joint.reshape(n * d, n * d))
    except InputError as error:
        smooth = " and ".join(dict.fromkeys(str(f) for f in used))
        what = (
            f"signals of {n} points with {smooth} are so alike that they cannot be unknowns "
            f"({str(error).rsplit(': ', 1)[-1]}): take a rougher function such "
            "as matern52, a shorter length or fewer points, or point_corrections, which needs no "
            "inverse of this covariance"
        )
        raise InputError(what) from None


@taking(Network)
def with_image_signals(
    network: Network,
    *,
    covariance: CovarianceFunction,
    cameras: Sequence[str] | None = None,
    nodes: int | None = None,
    left_out: float = MODES_LEFT_OUT,
) -> Network:
    """Return a network whose cameras have signals in their images as unknowns, see the module.

    Args:
        network: the network; it stays unchanged.
        covariance: covariance function of the signals in x and y over the image, image units.
        cameras: names of the cameras; by default all.
        nodes: number of nodes along the longer side of the image; by default their distance is L/5
            or less.
        left_out: share of the variance of the signal that modes which are left out have; it becomes
            noise of the image points.

    Returns:
        The network; the lens of each camera is a `GridLens` before its own one, with the amplitudes
        as weighted parameters. Variances of its image points have the variance of the signal that
        the modes lack.

    Raises:
        InputError: a camera is unknown or takes no grid, or L is so short that there would be too
            many nodes or modes.
    """
    if nodes is not None and nodes < 2:
        raise InputError(f"nodes must be 2 or more, not {nodes}")
    if not 0 < left_out < 1:
        raise InputError(f"left_out must be between 0 and 1, not {left_out}")
    out = network.copy()
    photo, _, xy, _ = network.images.columns()
    for name in network.cameras if cameras is None else cameras:
        if name not in network.cameras:
            raise InputError(unknown_name("camera", name, network.cameras))
        camera = network.cameras[name]
        on = np.array([f.camera == name for f in network.photos.values()], dtype=bool)[photo]
        if camera.corners() is None and not on.any():
            continue
        corners = camera.corners() or (xy[on].min(axis=0), xy[on].max(axis=0))
        lens = camera.lens if isinstance(camera.lens, GridLens) else GridLens(camera.lens)
        if lens.modes:
            raise InputError(Problem("its images have signals already", f"camera {name!r}"))
        side = float((corners[1] - corners[0]).max())
        step = side / (nodes - 1) if nodes else covariance.length / NODES_PER_LENGTH
        count = max(int(np.ceil(side / step * (1.0 - 1e-12))) + 1, 2)
        lens = lens.refined(step) if lens.x else empty_grid(lens, corners, count)
        _check_size(lens, name, stated=nodes is not None)
        unit = replace(covariance, sigma=1.0)
        modes = _modes(lens, unit, left_out)
        n = len(modes)
        if n > MOST_MODES:
            what = (
                f"a signal with {covariance} over an image of {side:g} has {n} modes, "
                f"{MOST_MODES} at most are possible: state a larger left_out (what is left out "
                "is noise), or take a smoother function such as matern52 or a longer L"
            )
            raise InputError(Problem(what, f"camera {name!r}"))
        lens = replace(lens, modes=tuple(tuple(m) for m in modes.tolist()))
        _add_noise(out, on, covariance.sigma**2 * _variance_lost(lens, unit, xy[on]))
        out.cameras[name] = replace(
            camera,
            lens=lens,
            values=(*camera.values, *(0.0,) * (2 * n)),
            fixed=(*camera.fixed, *(False,) * (2 * n)),
            sigma=(*camera.sigma, *(covariance.sigma,) * (2 * n)),
        )
    return out


def _check_size(lens: GridLens, camera: str, *, stated: bool) -> None:
    """Raise InputError if nodes that are not stated are too many."""
    if stated or len(lens.x) * len(lens.y) <= MOST_NODES:
        return
    what = (
        f"the length of the covariance function is so short that the image needs "
        f"{len(lens.x)} × {len(lens.y)} nodes: state nodes, of which the distance should be a "
        "quarter of the length or less, or take such a short signal for noise"
    )
    raise InputError(Problem(what, f"camera {camera!r}"))


def _modes(lens: GridLens, unit: CovarianceFunction, left_out: float) -> Array:
    """Return the modes √λ u of the correlations of the nodes, largest first, (n, nodes)."""
    values, vectors = np.linalg.eigh(unit.between(_nodes(lens)))
    values, vectors = values[::-1], vectors[:, ::-1]
    n = int(np.searchsorted(np.cumsum(values), (1.0 - left_out) * values.sum())) + 1
    n = min(n, int((values > 0.0).sum()))
    return np.asarray((vectors[:, :n] * np.sqrt(values[:n])).T)


def _nodes(lens: GridLens) -> Array:
    """Return x and y of the nodes of a grid, row by row from below, (nodes, 2)."""
    x, y = np.meshgrid(np.array(lens.x), np.array(lens.y))
    return np.column_stack([x.ravel(), y.ravel()])


def _variance_lost(lens: GridLens, unit: CovarianceFunction, at: Array) -> Array:
    """Return the share of the variance that modes lack at places (n, 2), see the module, (n,)."""
    number, b = lens.neighbours(at[:, 0], at[:, 1])
    nodes = _nodes(lens)[number]
    joint = unit(np.linalg.norm(nodes[:, :, None] - nodes[:, None], axis=3))
    with_place = unit(np.linalg.norm(nodes - at[:, None], axis=2))
    between = np.einsum("ni,nij,nj->n", b, joint, b)
    phi = np.einsum("mni,ni->mn", np.array(lens.modes)[:, number], b)
    lost = 1.0 - 2.0 * np.einsum("ni,ni->n", b, with_place) + 2.0 * between - (phi**2).sum(axis=0)
    return np.asarray(np.maximum(lost, 0.0))


def _add_noise(out: Network, on: Array, variance: Array) -> None:
    """Add a variance to x and y of the image points ``on`` (rows,); covariances stay the same."""
    images = out.images
    more = np.zeros(images.size)
    more[on] = variance
    old = images.columns()[3]
    sigma = np.sqrt(old**2 + more[:, None])
    rho = images.correlation * (old / sigma).prod(axis=1)
    out.images = images.with_columns(sigma=sigma)
    out.images.rho = [rho] if rho.any() else []
    out.images.joint = [
        JointImagePoints(rows, full + np.diag(np.repeat(more[rows], 2)))
        for rows, full in images.joint
    ]


def empty_grid(lens: GridLens, corners: tuple[Array, Array], nodes: int) -> GridLens:
    """Return a grid of zeros over the image, with so many nodes along its longer side."""
    low, high = corners
    size = high - low
    counts = np.maximum(np.ceil(size / size.max() * (nodes - 1)).astype(int) + 1, 2)
    x, y = (np.linspace(low[i], high[i], counts[i]) for i in range(2))
    zero = ((0.0,) * counts[0],) * counts[1]
    return replace(lens, x=tuple(x.tolist()), y=tuple(y.tolist()), dx=zero, dy=zero)
