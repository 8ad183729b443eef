"""Differences between two epochs with cofactors and open motions; reference and object points.

d = x₂ − x₁ and Q_d = Q₁ + Q₂; where both epochs stand in one adjustment, with the first and the
second place of a point as two points, Q_d = Q₁₁ + Q₂₂ − Q₁₂ − Q₂₁. The motions G that the
observations of either epoch leave open (the datum defects of free networks) move d as well.

One rule for every network says what a point is: a point that both epochs determine and that is not
named as an object is a reference point. Reference points are tested together, and those that moved
leave. It does not matter whether held points, observations of coordinates or nothing at all carries
the datum: a test of each point against the datum alone would see as little as the datum is worth,
whatever the points determine about each other. Points that both epochs hold are part of every
reference, untested.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError, Problem, known
from ..frames import Frame
from ..rotation import exp_rotation
from ..types import Array, Index, Mask
from .epoch_coordinates import EpochCoordinates

MIN_RELATIVE_MOTION = 1e-6
"""Relative size of a motion of d below which it is rounding."""
MAX_ALIGNMENT_ITERATIONS = 50
"""Largest number of steps in which the second epoch is moved onto the first."""
NOT_NAMED = "neither named as reference nor as object"
"""Why points are not compared if both are named."""
ONE_EPOCH_ALONE = ("in the first epoch alone", "in the second epoch alone")
"""Why points are not compared that the other epoch lacks."""
LEFT_OUT = (
    "left out of the first epoch as undetermined",
    "left out of the second epoch as undetermined",
)
"""Why points are not compared that were left out of an epoch, see `determined_part`."""
HELD_IN_ONE = ("held in the first epoch alone", "held in the second epoch alone")
"""Why points are not compared that one epoch holds and the other determines."""


@dataclass(frozen=True, eq=False)
class Differences:
    """Differences of coordinates between two epochs, k coordinates of each of n points."""

    names: tuple[str, ...]
    """Names of the points in the first epoch."""
    later: tuple[str, ...]
    """Their names in the second epoch."""
    axes: str
    """The coordinates that are compared: those of ``xyz`` that are free in both epochs."""
    places: Array
    """Coordinates of the first epoch, (n, 3) metres."""
    d: Array
    """Differences second − first, (n k,) metres, the coordinates of a point together."""
    cofactor: Array
    """Q_d (n k, n k), metres²: covariance for σ0 = 1."""
    motions: Array
    """G (n k, g): motions of d that the observations leave open, orthonormal."""
    vtpv: tuple[float, ...]
    """vᵀPv of each adjustment: of two epochs, or of both in one."""
    redundancy: tuple[int, ...]
    """Redundancy of each adjustment."""
    frame: Frame
    """The frame of both epochs."""

    def rows(self, names: Sequence[str]) -> Index:
        """Return the rows of d of some points, in the order of the names."""
        number = {n: i for i, n in enumerate(self.names)}
        k = len(self.axes)
        at = np.array([number[n] for n in names], dtype=np.intp)
        return (at[:, None] * k + np.arange(k)).ravel()


def differences_between(
    first: EpochCoordinates,
    second: EpochCoordinates,
    pairs: Mapping[str, str],
    *,
    onto: Sequence[str] | None = None,
) -> Differences:
    """Return the differences of two adjustments.

    The second epoch is moved onto the first. What the open motions G are to first order is then
    left of it: a rotation ε of points at the distance r from each other, which displaced points
    cause, changes their differences by r ε²/2.

    Args:
        first: the first epoch.
        second: the second epoch.
        pairs: names in the second epoch by names in the first.
        onto: points by which the second epoch is moved; None: all of them.

    Raises:
        InputError: points are unknown, or held, or points do not have the same free coordinates;
            the frames differ; the second epoch cannot be moved onto the first.
    """
    if first.frame != second.frame:
        raise InputError(
            f"the epochs have different frames: {first.frame} and {second.frame}; "
            "adjust both in one"
        )
    one, two = epoch_places(first, tuple(pairs)), epoch_places(second, tuple(pairs.values()))
    axes, free = _axes((one, two), pairs)
    mixture = _basis(np.hstack([one.mixture(free), two.mixture(free)]))
    # Grid coordinates of thousands of kilometres are rounded more than the alignment is.
    origin = one.coordinates.mean(axis=0)
    there = one.coordinates - origin
    part = None if onto is None else np.isin(one.names, list(onto))
    moved, turn = aligned_points(two.coordinates - origin, there, mixture, part)
    turns = np.kron(np.eye(len(one.names)), turn[np.ix_(free, free)])
    return Differences(
        tuple(pairs),
        tuple(pairs.values()),
        axes,
        one.coordinates,
        (moved - there)[:, free].ravel(),
        one.cofactor(free) + turns @ two.cofactor(free) @ turns.T,
        _basis(_seven(one.coordinates)[:, free].reshape(-1, 7) @ mixture),
        (first.vtpv, second.vtpv),
        (first.redundancy, second.redundancy),
        first.frame,
    )


def differences_within(both: EpochCoordinates, pairs: Mapping[str, str]) -> Differences:
    """Return the differences of pairs of points of one adjustment of both epochs.

    Args:
        both: both epochs, in which a point that may have moved is given twice.
        pairs: names of the second places by names of the first.

    Raises:
        InputError: as `differences_between`.
    """
    one, two = epoch_places(both, tuple(pairs)), epoch_places(both, tuple(pairs.values()))
    axes, free = _axes((one, two), pairs)
    d = (two.coordinates - one.coordinates)[:, free].ravel()
    a, b = one.numbers[:, free].ravel(), two.numbers[:, free].ravel()
    q = both.cofactors_of(np.concatenate([a, b]))
    n = len(a)
    cofactor = q[:n, :n] + q[n:, n:] - q[:n, n:] - q[n:, :n]
    g = two.motions(free) - one.motions(free)
    size = max(float(np.linalg.norm(two.motions(free))), 1.0)
    # A motion of the whole object turns the differences too, by far less than it moves points.
    open_ones = g[:, np.linalg.norm(g, axis=0) > 1e-2 * size] if g.size else g
    return Differences(
        tuple(pairs),
        tuple(pairs.values()),
        axes,
        one.coordinates,
        d,
        (cofactor + cofactor.T) / 2.0,
        _basis(open_ones),
        (both.vtpv,),
        (both.redundancy,),
        both.frame,
    )


@dataclass(frozen=True, eq=False)
class EpochPlaces:
    """Points of one epoch."""

    epoch: EpochCoordinates
    names: tuple[str, ...]
    coordinates: Array
    numbers: Index
    """Numbers 3·point + axis of the coordinates in the epoch, (n, 3)."""
    free: Mask
    """Flags of free coordinates, (n, 3)."""

    def cofactor(self, free: Mask) -> Array:
        """Return Q of the free coordinates (3,) of all points."""
        return self.epoch.cofactors_of(self.numbers[:, free].ravel())

    def motions(self, free: Mask) -> Array:
        """Return how the datum defects move the free coordinates, (n k, d)."""
        return self.epoch.motions_of(self.numbers[:, free].ravel())

    def mixture(self, free: Mask) -> Array:
        """Return the datum defects as mixtures of the seven motions of `_seven`, (7, d)."""
        seven = _seven(self.coordinates)[:, free].reshape(-1, 7)
        scale = np.maximum(np.linalg.norm(seven, axis=0), 1e-300)
        # The motions that move nothing here, such as a rotation about x of a network in plan,
        # have no part in a mixture.
        seven = np.where(scale > MIN_RELATIVE_MOTION * scale.max(), seven, 0.0)
        return np.asarray(np.linalg.lstsq(seven, self.motions(free), rcond=MIN_RELATIVE_MOTION)[0])


def epoch_places(epoch: EpochCoordinates, names: tuple[str, ...]) -> EpochPlaces:
    """Return some points of an epoch.

    Raises:
        InputError: points are unknown.
    """
    number = {n: i for i, n in enumerate(epoch.names)}
    wrong = [n for n in names if n not in number]
    if wrong:
        raise InputError(
            Problem(f"unknown point; known: {known(epoch.names, meant=n)}", f"point {n!r}")
            for n in wrong
        )
    at = np.array([number[n] for n in names], dtype=np.intp)
    return EpochPlaces(
        epoch, names, epoch.coordinates[at], 3 * at[:, None] + np.arange(3), epoch.free[at]
    )


def _axes(epochs: tuple[EpochPlaces, EpochPlaces], pairs: Mapping[str, str]) -> tuple[str, Mask]:
    """Return the coordinates that are free for every point in both epochs.

    Raises:
        InputError: points are held, or differ in what is free.
    """
    free = epochs[0].free & epochs[1].free
    held = [n for n, f in zip(pairs, free, strict=True) if not f.any()]
    if held:
        raise InputError(
            Problem(
                "is held in an epoch: it cannot be seen to move; a point that both epochs hold is "
                "part of the reference without being named",
                f"point {n!r}",
            )
            for n in held
        )
    if len(free) == 0:
        raise InputError("no points to compare: the epochs have no free points in common")
    common: Mask = np.asarray(free.all(axis=0))
    other = [n for n, f in zip(pairs, free, strict=True) if (f != common).any()]
    if other:
        words = {
            n: "".join(a for a, f in zip("xyz", free[i], strict=True) if f)
            for i, n in enumerate(pairs)
            if n in other
        }
        raise InputError(
            Problem(
                f"has {words[n]} free, others have not: compare points of the same coordinates",
                f"point {n!r}",
            )
            for n in other
        )
    return "".join(a for a, f in zip("xyz", common, strict=True) if f), common


def _basis(g: Array) -> Array:
    """Return an orthonormal basis of motions, (n, rank)."""
    if g.shape[1] == 0:
        return g
    g = g / np.maximum(np.linalg.norm(g, axis=0), 1e-300)
    u, s, _ = np.linalg.svd(g, full_matrices=False)
    return np.asarray(u[:, s > MIN_RELATIVE_MOTION * s[0]])


def _seven(x: Array) -> Array:
    """Return how seven motions move points x (n, 3): shifts, rotations about x, y, z, and scale.

    Rotations and scale are about the mean place, and move points by 1 m at the largest distance
    from it; (n, 3, 7).
    """
    r = x - x.mean(axis=0)
    size = max(float(np.linalg.norm(r, axis=1).max()), 1e-300)
    turns = np.stack([np.cross(axis, r) for axis in np.eye(3)], axis=2) / size
    shifts = np.broadcast_to(np.eye(3), (len(x), 3, 3))
    return np.concatenate([shifts, turns, (r / size)[:, :, None]], axis=2)


def aligned_points(
    x: Array, onto: Array, mixture: Array, part: Mask | None = None
) -> tuple[Array, Array]:
    """Move points onto others by a similarity of some motions, so that Σ |Δ|² is least.

    Args:
        x: the points, (n, 3).
        onto: where they shall go, (n, 3).
        mixture: the motions that may be used, mixtures of the seven of `_seven`, (7, g).
        part: points that count in the sum, (n,); None: all of them.

    Returns:
        The moved points (n, 3), and the rotation with scale (3, 3) that turned them.

    Raises:
        InputError: the iteration does not come to rest.
    """
    total = np.eye(3)
    if mixture.shape[1] == 0:
        return x, total
    counted = np.ones(len(x), dtype=bool) if part is None else part
    for _ in range(MAX_ALIGNMENT_ITERATIONS):
        size = max(float(np.linalg.norm(x - x.mean(axis=0), axis=1).max()), 1e-300)
        g = _seven(x)[counted].reshape(-1, 7) @ mixture
        t = mixture @ np.linalg.lstsq(g, (onto - x)[counted].ravel(), rcond=MIN_RELATIVE_MOTION)[0]
        turn = np.exp(t[6] / size) * exp_rotation(t[3:6] / size)
        centre = x.mean(axis=0)
        x = (x - centre) @ turn.T + centre + t[:3]
        total = turn @ total
        if np.abs(t).max() < 1e-12 * size:
            return x, total
    raise InputError(
        "the second epoch cannot be moved onto the first: are the points the same, with the same "
        "names? Adjust the second epoch with start=first"
    )


@dataclass(frozen=True)
class PointRoles:
    """Points of a comparison, by their names in the first epoch."""

    reference: tuple[str, ...]
    """Reference points: tested for a change of their shape."""
    objects: tuple[str, ...]
    """Points that are tested each against the stable reference points."""
    held: Mapping[str, Array]
    """Points that both epochs hold, which are part of the reference without a test: coordinates of
    the second epoch less those of the first, (3,) metres."""
    not_compared: Mapping[str, str]
    """Why other points are not compared, by their names; of the second epoch for those that the
    first lacks."""


def point_roles(
    first: EpochCoordinates,
    second: EpochCoordinates,
    reference: Sequence[str] | None,
    objects: Sequence[str] | None,
    pairs: Mapping[str, str],
) -> PointRoles:
    """Return what the points of two adjustments are.

    Args:
        first: the first epoch.
        second: the second epoch.
        reference: the reference points; None: all points that both epochs determine, without the
            objects.
        objects: the objects; None: without ``reference`` none, and otherwise all other points that
            both epochs determine.
        pairs: names in the second epoch by names in the first, where they differ.

    Raises:
        InputError: a point is named as reference and as object; names are no list.
    """
    one, two = ({n: i for i, n in enumerate(e.names)} for e in (first, second))
    later = {n: pairs.get(n, n) for n in one}
    gone = first.undetermined, second.undetermined
    free: list[Mask] = [np.any(e.free, axis=1) for e in (first, second)]
    left_out: dict[str, str] = {}
    both: list[str] = []
    held: dict[str, Array] = {}
    for name, other in later.items():
        if other not in two:
            left_out[name] = LEFT_OUT[1] if other in gone[1] else ONE_EPOCH_ALONE[0]
            continue
        here, there = bool(free[0][one[name]]), bool(free[1][two[other]])
        if here and there:
            both.append(name)
        elif here or there:
            left_out[name] = HELD_IN_ONE[int(here)]
        else:
            held[name] = second.coordinates[two[other]] - first.coordinates[one[name]]
    reached = set(later.values())
    earlier = {b: a for a, b in pairs.items()}
    left_out |= {
        n: LEFT_OUT[0] if earlier.get(n, n) in gone[0] else ONE_EPOCH_ALONE[1]
        for n in two
        if n not in reached
    }
    left_out |= {n: LEFT_OUT[0] for n in gone[0] if pairs.get(n, n) in gone[1]}
    named = {*_listed("reference", reference), *_listed("objects", objects)}
    rest = tuple(n for n in both if n not in named)
    some = rest if reference is None else tuple(reference)
    if objects is not None:
        others = tuple(objects)
    else:
        others = () if reference is None else rest
    refuse_two_roles(some, others)
    compared = {*some, *others}
    left_out |= {n: NOT_NAMED for n in both if n not in compared}
    return PointRoles(tuple(dict.fromkeys(some)), tuple(dict.fromkeys(others)), held, left_out)


def point_roles_in_one(
    reference: Sequence[str] | None,
    objects: Sequence[str] | None,
    pairs: Mapping[str, str] | None,
) -> PointRoles:
    """Return what the points of one adjustment of both epochs are.

    Points that stand once are the reference, and hold it as all observations together tell.

    Raises:
        InputError: no pairs, or points without a second place; as `point_roles`.
    """
    some, named = _listed("reference", reference), _listed("objects", objects)
    if not pairs:
        raise InputError(
            "one solution of both epochs needs pairs: names of the second places by names of "
            "the first"
        )
    others = tuple(named if objects is not None else [n for n in pairs if n not in some])
    missing = [n for n in (*some, *others) if n not in pairs]
    if missing:
        raise InputError(Problem("has no second place in pairs", f"point {n!r}") for n in missing)
    refuse_two_roles(some, others)
    compared = {*some, *others}
    left_out = {n: NOT_NAMED for n in pairs if n not in compared}
    return PointRoles(tuple(dict.fromkeys(some)), tuple(dict.fromkeys(others)), {}, left_out)


def refuse_two_roles(reference: Sequence[str], objects: Sequence[str]) -> None:
    """Raise the points that are named as reference and as object.

    Raises:
        InputError: there are such points.
    """
    twice = [n for n in dict.fromkeys(reference) if n in objects]
    if twice:
        raise InputError(
            Problem("is named as reference and as object", f"point {n!r}") for n in twice
        )


def _listed(what: str, given: Sequence[str] | None) -> tuple[str, ...]:
    if isinstance(given, str):
        raise InputError(f"{what} must be a list of names, not the one name {given!r}")
    return tuple(given or ())
