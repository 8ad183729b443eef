"""Null space of the equations, and errors that name undetermined unknowns with the reasons."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import DatumError, SingularError
from ..errors import known as known_names
from ..graph.variables import State, Unknowns
from ..models.unknown_registry import UNKNOWNS, VariableKind
from ..observations.registry import in_image_table
from ..types import Array
from .coherent_part import largest_coherent_part
from .datum_defects import MAX_UNNOTICED, Defect, extent_of, find_defects, generators
from .defect_description import describe_defects
from .elimination_layers import layers_of
from .factorisation import EliminationPlan, Factorisation, PreparedElimination
from .linearised_equations import LinearisedEquations
from .normal_equations import NormalEquations
from .rigid_mounts import diagonal_without_stiffness

MAX_NULL_RATIO = 1e-7
"""Ratio |A z| / |√diag(N) z| below which a combination z counts as undetermined."""
REGULARISATION = MAX_NULL_RATIO**2
"""Share of the diagonal of N that is added to N, so that the search can invert it. It equals |A z|²
of a combination that is just determined; a larger share would let many weak combinations hide an
undetermined one."""
MIN_LARGE_NETWORK_COLUMNS = 5000
"""Number of columns above which points that only cameras see are eliminated first."""
REGULARISATION_LARGE = 1e-12
"""Share of the diagonal as `REGULARISATION` in such a network: normal equations resolve no smaller
one. Combinations that are determined by less than its root are distinguished by |A z| alone."""
FIRST_NULL_VECTORS = (4, 12)
"""Numbers of combinations that are searched first in such a network."""
MAX_NULL_VECTORS = 40
"""Largest number of undetermined combinations that are searched."""
MIN_RESOLVED_NULL_RATIO = 10.0 * REGULARISATION_LARGE**0.5
"""Largest |A z| / |√diag(N) z| in a search above which it has found all undetermined ones."""
INVERSE_ITERATION_VECTORS = 4
"""Number of vectors of the inverse iteration with a factor; it separates the weakest ones."""
MAX_UNOBSERVED_LISTED = 400
"""Largest number of unknowns without any observation that are listed."""
MIN_NAMED_SHARE = 0.05
"""Share of an unknown in undetermined combinations above which the unknown is named."""
DATUM_REMEDY = (
    'give control (fixed or weighted coordinates), or ask for a free network (datum = "free")'
)
"""What a user can do about datum defects."""
MIN_SOUND_PIVOT = 1e-6
"""Pivot of N relative to its diagonal element above which nothing is undetermined."""
MAX_DENSE_COLUMNS = 400
"""Number of columns up to which the null space is found from dense singular values."""
IS_NOT_DETERMINED = "is not determined"
"""What `undetermined_variables` says of variables in the null space."""
IS_NOT_JOINED = "is not joined to the free network"
"""What `undetermined_variables` says of variables that do not move with the free network."""
MIN_MOVED_SHARE = 1e-6
"""Share of a parameter in undetermined combinations above which it is named beside them."""
MAX_UNKNOWNS_IN_MESSAGE = 12
"""Largest number of unknowns that a message names."""
MIN_SAME_MOTION_COSINE = 0.999
"""Cosine of the angle between an undetermined combination and a motion that is the same."""
MAX_HARDLY_NOTICED_RATIO = 1.5e-4
"""Ratio |A g| / |√diag(N) g| below which a motion g of the network counts as unnoticed on the
curved Earth: attitudes of a photo flight are sensitive to a shift by 2e-5 to 6e-5. Where all but a
few points move together, their combination resembles a motion with a ratio of 5e-4 and more."""


def _scale(system: LinearisedEquations, diagonal: Array) -> Array:
    """Return √diag N without the stiffness of rigid mounts, 1 where it is zero, (n_columns,)."""
    eased = diagonal_without_stiffness(system, diagonal)
    return np.where(diagonal > 0, np.sqrt(np.maximum(eased, 0.0)), 1.0)


def null_space(
    system: LinearisedEquations, diagonal: Array, given: PreparedElimination | None = None
) -> Array:
    """Return an orthonormal basis (n_columns, d) of the null space of N, scaled by √diagonal.

    The method is inverse iteration with a block of vectors on the regularised normal equations;
    the result includes unknowns without any observation. Large networks are eliminated as it was
    ``given``, if it was.
    """
    unknowns = system.unknowns
    empty = unknowns.free & (diagonal <= 0)
    live = unknowns.free & ~empty
    scale = _scale(system, diagonal)
    large = len(diagonal) > MIN_LARGE_NETWORK_COLUMNS
    extra = np.where(empty, 1.0, (REGULARISATION_LARGE if large else REGULARISATION) * diagonal)
    if given is None or not large:
        touched = np.zeros(len(diagonal), dtype=bool)
        for e in system.extra:
            touched[e.columns] = True
        layers = layers_of(system.equations, reduce_points=large, touched=touched)
        given = PreparedElimination.of(system, EliminationPlan.of(system.equations, layers))
    factor = given.factorised(extra)
    found = np.zeros((len(diagonal), 0))
    for most in (*FIRST_NULL_VECTORS, MAX_NULL_VECTORS) if large else (MAX_NULL_VECTORS,):
        n = min(most, int(live.sum()))
        if n == found.shape[1]:
            break
        rng = np.random.default_rng(1)
        z = np.where(live[:, None], rng.standard_normal((len(diagonal), n)), 0.0)
        for _ in range(4):
            z = scale[:, None] * factor.solve(scale[:, None] * z)
            z[~live] = 0.0
            z, _ = np.linalg.qr(z)
        noticed = system.times(z / scale[:, None])
        values, right = np.linalg.eigh(noticed.T @ noticed)
        ratios = np.sqrt(np.maximum(values, 0))
        found = z @ right[:, ratios < MAX_NULL_RATIO]
        if (
            ratios[-1] > MIN_RESOLVED_NULL_RATIO
        ):  # below it the share of the diagonal makes all of them alike
            break
    unobserved = np.flatnonzero(empty)[:MAX_UNOBSERVED_LISTED]
    units = np.zeros((len(diagonal), len(unobserved)))
    units[unobserved, np.arange(len(unobserved))] = 1.0
    return np.concatenate([units, found], axis=1)


def undetermined_combinations(
    system: LinearisedEquations, diagonal: Array, factor: Factorisation, defects: Sequence[Defect]
) -> Array:
    """Return the undetermined combinations of a factorised network beside its datum defects.

    The method is inverse iteration with the factor. Rounding turns the factor of a singular N into
    that of N + E with |E| ≈ 10⁻¹⁶. Its pivots show little: the last one is |E| / z², where z is the
    share of its unknown in the undetermined combination. The combination z itself is precise, and
    so is |A z|, which avoids the squares of N. The motions of the datum are projected out, so that
    the choice of a minimal datum has no influence.

    Args:
        system: the linearised network.
        diagonal: diagonal of N, (n_columns,).
        factor: N, with a minimal datum if there are defects.
        defects: the datum defects that this datum fills.

    Returns:
        Orthonormal combinations z (n_columns, d), scaled by √diagonal.
    """
    scale = _scale(system, diagonal)[:, None]
    live = factor.free
    z = np.zeros((len(diagonal), min(INVERSE_ITERATION_VECTORS, int(live.sum()))))
    z[live] = np.random.default_rng(1).standard_normal((int(live.sum()), z.shape[1]))
    motions = _motions(scale, defects)
    for _ in range(2):
        z = scale * factor.solve(scale * z)
        z -= motions @ (motions.T @ z)
        z[live], _ = np.linalg.qr(z[live])
    # Columns that are parallel up to rounding leave arbitrary vectors after QR, motions included.
    z = _beside(z, motions)
    az = system.times(z / scale)
    empty = np.zeros((z.shape[1], z.shape[1]))  # there may be fewer observations than columns
    _, noticed, right = np.linalg.svd(np.concatenate([az, empty]), full_matrices=False)
    return np.asarray(z @ right[noticed < MAX_UNNOTICED].T)


def _is_bound(diagonal: Array, system: LinearisedEquations, z: Array) -> bool:
    """Return whether a search found as many combinations as it can find: there may be more.

    Args:
        diagonal: diagonal of N, (n_columns,).
        system: the linearised network.
        z: what `null_space` found.
    """
    free = system.unknowns.free
    unobserved = int(np.sum(free & (diagonal <= 0)))
    listed = min(unobserved, MAX_UNOBSERVED_LISTED)
    found, live = z.shape[1] - listed, int(np.sum(free)) - unobserved
    return unobserved > listed or MAX_NULL_VECTORS <= found < live


def _motions(scale: Array, defects: Sequence[Defect]) -> Array:
    """Return an orthonormal basis (n_columns, d) of the motions of the datum, scaled."""
    none = np.zeros((len(scale), 0))
    basis, _ = np.linalg.qr(np.concatenate([none, *(scale * d.motions for d in defects)], axis=1))
    return np.asarray(basis)


def _beside(z: Array, motions: Array) -> Array:
    """Return an orthonormal basis of z orthogonal to the motions of the datum, all scaled."""
    u, s, _ = np.linalg.svd(z - motions @ (motions.T @ z), full_matrices=False)
    return np.asarray(u[:, s > 0.5])


def undetermined_error(
    system: LinearisedEquations,
    diagonal: Array,
    defects: Sequence[Defect],
    *,
    free: bool = False,
    known: Array | None = None,
    remedy: str = DATUM_REMEDY,
) -> DatumError | None:
    """Return an error that names all undetermined unknowns; None: all are determined.

    Args:
        system: the linearised network.
        diagonal: diagonal of N, (n_columns,).
        defects: datum defects of the network.
        free: whether inner constraints fill the datum defects, so that these are no error.
        known: undetermined combinations beside the defects, see `undetermined_combinations`. The
            search of this function may miss them among many weak combinations.
        remedy: what a user can do about datum defects.
    """
    try:
        z = null_space(system, diagonal)
        bounded = _is_bound(diagonal, system, z)
    except SingularError:  # only the datum defects are known
        z, bounded = np.zeros((len(diagonal), 0)), True
    unknowns = system.unknowns
    scale = _scale(system, diagonal)[:, None]
    lines, names = [], []
    concerned: list[tuple[str, str]] = []
    motions = _motions(scale, defects)
    z = _beside(z, motions)
    if z.shape[1] == 0 and known is not None:
        z, bounded = _beside(known, motions), known.shape[1] >= INVERSE_ITERATION_VECTORS
    n_datum = 0 if free else sum(d.size for d in defects)
    if not free:
        lines += describe_defects(unknowns, defects, system.state)
        nearly, z = _nearly_unnoticed(system, z, scale)
        lines += [] if nearly is None else describe_defects(unknowns, [nearly])
        n_datum += 0 if nearly is None else nearly.size
    if z.shape[1]:
        shares = _shares(unknowns, z)
        concerned = [(kind, unknowns[kind].names[number]) for kind, number, *_ in shares]
        for kind, number, weakest, share in shares[:MAX_UNKNOWNS_IN_MESSAGE]:
            name = unknowns[kind].names[number]
            names.append(name)
            why = _support(system, kind, number, diagonal)
            lines.append(
                f"{UNKNOWNS[kind].noun} {name!r} is not determined ({why}; weakest component: "
                f"{weakest}, share {share:.2f})"
            )
        if len(shares) > MAX_UNKNOWNS_IN_MESSAGE:
            lines.append(f"… and {len(shares) - MAX_UNKNOWNS_IN_MESSAGE} more")
        along = _moved_along(unknowns, z, concerned)
        if along:
            lines.append(f"with them moves {known_names(along, most=MAX_UNKNOWNS_IN_MESSAGE)}")
    own = dict.fromkeys(UNKNOWNS[kind].remedy for kind, _ in concerned)
    lines += [what for what in own if what]
    if n_datum:
        lines.append(remedy)
    total = n_datum + z.shape[1]
    if total == 0:
        return None
    at_least = "at least " if bounded else ""
    head = f"the network is not determined: {at_least}{total} defect{'s' * (total > 1)}"
    message = "\n  ".join([head, *lines])
    apart = [] if free else _apart(unknowns, defects)
    return DatumError(message, defect=total, names=names, unknowns=concerned, apart=apart)


def _apart(unknowns: Unknowns, defects: Sequence[Defect]) -> list[tuple[str, str]]:
    """Return the variables that move with parts without a datum; none if all do.

    A point about which a part turns does not move, and stays.
    """
    moving = np.zeros(unknowns.n_columns, dtype=bool)
    for d in defects:
        moves = np.linalg.norm(d.motions, axis=1)
        moving |= moves > MIN_MOVED_SHARE * moves.max(initial=0.0)
    active = list(unknowns.active())
    found = [
        (kind, unknowns[kind].names[number])
        for kind, number in active
        if moving[unknowns.columns(kind, number)].any()
    ]
    return found if len(found) < len(active) else []


def _nearly_unnoticed(
    system: LinearisedEquations, z: Array, scale: Array
) -> tuple[Defect | None, Array]:
    """Return the motions of the network among undetermined combinations, and the others.

    On the curved Earth a shift also turns the horizons, by 1/R: attitudes are so little sensitive
    to it that it is not determined, but more than by rounding.

    Args:
        system: the linearised network.
        z: orthonormal undetermined combinations, scaled, (n_columns, d).
        scale: √diag(N), (n_columns, 1).
    """
    if not z.shape[1]:
        return None, z
    about = extent_of(system.state)
    g = generators(system.equations, system.state, about)
    moving = np.flatnonzero(np.linalg.norm(scale * g, axis=0) > 0)
    basis, r = np.linalg.qr(scale * g[:, moving])
    if len(r) < len(moving):  # fewer unknowns than motions
        return None, z
    if np.abs(np.diag(r)).min() < 1e-9 * np.abs(r).max():
        return None, z
    left, cosine, right = np.linalg.svd(basis.T @ z, full_matrices=False)
    mixed = np.linalg.solve(r, left)
    noticed = np.linalg.norm(system.times(g[:, moving] @ mixed), axis=0)
    alike = (cosine > MIN_SAME_MOTION_COSINE) & (noticed < MAX_HARDLY_NOTICED_RATIO)
    if not alike.any():
        return None, z
    mixture = np.zeros((7, int(alike.sum())))
    mixture[moving] = mixed[:, alike]
    share = np.linalg.qr(mixture)[0]
    pure = np.sum(share**2, axis=1) > MIN_SAME_MOTION_COSINE
    if pure.sum() == share.shape[1]:  # single motions, up to what the curvature mixes in
        mixture = np.eye(7)[:, pure]
    every = np.arange(system.unknowns.n_columns)
    inside = system.unknowns.free
    rest = z @ right[~alike].T
    return Defect(every, g @ mixture, mixture, about, inside), rest


def _shares(unknowns: Unknowns, z: Array) -> list[tuple[VariableKind, int, str, float]]:
    """Return the variables in z, largest first: kind, number, weakest component and its share.

    The order is that of the squares of all components of a variable, whose sum is the number of
    combinations that it holds alone, up to that of its components. The share is that of one
    component, the square of the cosine between it and the undetermined combinations, from 0 to 1:
    with 1 it is open whatever the others are.
    """
    leverage = np.sum(z * z, axis=1)
    out = []
    for kind, number in unknowns.active():
        columns = unknowns.columns(kind, number)
        own = leverage[columns]
        component = unknowns.component_names(kind, number)[int(np.argmax(own))]
        # Rounding leaves columns of z that are longer than 1 in the last digits.
        out.append((float(own.sum()), (kind, number, component, min(float(own.max()), 1.0))))
    out.sort(key=lambda item: -item[0])
    # In a network that turns as a whole, every unknown has a small part.
    least = min(MIN_NAMED_SHARE, 0.5 * out[0][0])
    return [item for together, item in out if together > least]


def _moved_along(
    unknowns: Unknowns, z: Array, concerned: Sequence[tuple[VariableKind, str]]
) -> list[str]:
    """Return the parameters that z moves, with their weakest component, beside those concerned.

    Their observations may be few and coarse, so that their share in z is small; yet it is they who
    leave it open, such as the slope of a height profile the tilt of a strip.
    """
    leverage = np.sum(z * z, axis=1)
    out = []
    for kind, number in unknowns.active():
        record, name = UNKNOWNS[kind], unknowns[kind].names[number]
        own = leverage[unknowns.columns(kind, number)]
        if not (record.additional or record.on_earth) or (kind, name) in concerned:
            continue
        if own.sum() > MIN_MOVED_SHARE:
            component = unknowns.component_names(kind, number)[int(np.argmax(own))]
            out.append(f"{record.noun} {name!r} ({component})")
    return out


def _support(system: LinearisedEquations, kind: str, number: int, diagonal: Array) -> str:
    """Return the numbers of observations of a variable by kind, in words."""
    counts: dict[str, int] = {}
    for lb in system.blocks:
        for what, index in lb.block.variables:
            if what == kind:
                n = int(np.sum(index == number))
                if n:
                    counts[lb.block.kind] = counts.get(lb.block.kind, 0) + n
    if not counts:
        return "no observation"
    image = "image ray" if kind == "point" else "image point"
    words = [(n, image if in_image_table(k) else k.replace("_", " ")) for k, n in counts.items()]
    return ", ".join(f"{n} {word}{'s' * (n > 1)}" for n, word in words)


def undetermined_variables(
    system: LinearisedEquations,
    state: State,
    *,
    free: bool,
    least: float,
    normal: NormalEquations | None = None,
) -> dict[tuple[VariableKind, str], str]:
    """Return the variables that the null space of a system moves, with what is wrong with each.

    Args:
        system: the linearised network.
        state: where it was linearised.
        free: whether one connected part may be without a datum.
        least: part of a null vector's length in a variable that counts as moved.
        normal: its normal equations, if their pivots are to be examined before null vectors are
            searched: that costs less, unless the network is small. They keep their factorisation.
    """
    unknowns, diagonal = system.unknowns, system.diagonal()
    empty = unknowns.free & (diagonal <= 0)
    if empty.any() and not free:  # without them the rest is smaller
        return _moved(unknowns, empty.astype(float), 0.0, IS_NOT_DETERMINED)
    if normal is not None and _is_determined(normal):
        return {}
    z = _whole_null_space(system, diagonal, None if normal is None else normal.elimination)
    if free and z.shape[1]:
        scale = _scale(system, diagonal)
        defects = find_defects(system, state, diagonal, free=True)
        if len(defects) < 2 and not _beside(z, _motions(scale[:, None], defects)).shape[1]:
            return {}
        inside = largest_coherent_part(system, state, z, scale)
        every = ((kind, unknowns[kind].names[number]) for kind, number in unknowns.active())
        return {v: IS_NOT_JOINED for v in every if v not in inside}
    if not z.shape[1]:
        return {}
    share = np.sum(z * z, axis=1)
    # What is spread thinly over very many variables concerns all of them.
    return _moved(unknowns, share, least, IS_NOT_DETERMINED) or _moved(
        unknowns, share, 0.0, "has no datum yet"
    )


def _is_determined(normal: NormalEquations) -> bool:
    """Return whether the pivots of N say that all is determined.

    Rounding leaves pivots up to 10⁻¹⁰ in a singular N, see `gauss_newton.IterationRule.poor`.
    """
    try:
        factor = normal.factorise(np.zeros(len(normal.diagonal)), keep=True)
    except SingularError:
        return False
    return factor.smallest_pivot(normal.diagonal) > MIN_SOUND_PIVOT


def _moved(
    unknowns: Unknowns, share: Array, least: float, why: str
) -> dict[tuple[VariableKind, str], str]:
    """Return the variables with more than a share in their columns."""
    out: dict[tuple[VariableKind, str], str] = {}
    sums = np.concatenate([[0.0], share])
    for kind, table in unknowns.tables.items():
        at = np.flatnonzero(table.offset >= 0)
        wide = np.arange(int(table.size[at].max(initial=0)))
        columns = np.where(wide < table.size[at][:, None], table.offset[at][:, None] + wide + 1, 0)
        found = at[sums[columns].sum(axis=1) > least]
        out |= {(kind, table.names[i]): why for i in found.tolist()}
    return out


def _whole_null_space(
    system: LinearisedEquations, diagonal: Array, given: PreparedElimination | None
) -> Array:
    """Return a basis of all that is undetermined, scaled by √diagonal, (n_columns, d)."""
    n = system.unknowns.n_columns
    if n > MAX_DENSE_COLUMNS:
        return null_space(system, diagonal, given)
    free = np.flatnonzero(system.unknowns.free)
    if not len(free):
        return np.zeros((n, 0))
    unit = np.zeros((n, len(free)))
    scale = _scale(system, diagonal)
    unit[free, np.arange(len(free))] = 1.0 / scale[free]
    _, s, vt = np.linalg.svd(system.times(unit), full_matrices=True)
    values = np.zeros(len(free))
    values[: len(s)] = s
    out = np.zeros((n, int((values < MAX_NULL_RATIO).sum())))
    out[free] = vt[values < MAX_NULL_RATIO].T
    return out
