"""Explain by name what the observations do not determine."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import DatumError
from ..graph.variables import Unknowns
from ..models.variables import UNKNOWNS, VariableKind
from ..types import Array, Index
from .datum import Defect, in_part
from .factor import Factor
from .linear import LinearSystem
from .plan import make_plan
from .rays import Rays
from .tree import SingularError, TreeFactors

REGULARISED = 1e-10
"""Share of its diagonal added to N to make it invertible for the search."""
NULL = 1e-7
"""|A z| relative to independent unknowns, below which z counts as undetermined."""
MOST = 40
"""Largest number of undetermined combinations that are looked for."""
MOST_UNOBSERVED = 400
"""The same for unknowns without any observation."""
LISTED = 12
"""Unknowns that a message names."""


def null_space(system: LinearSystem, diagonal: Array) -> Array:
    """Return an orthonormal basis (n_columns, d) of what is undetermined, scaled by √diagonal.

    Inverse iteration with a block of vectors on the regularised normal equations; unknowns
    without any observation are among the result.
    """
    unknowns = system.unknowns
    empty = unknowns.free & (diagonal <= 0)
    live = unknowns.free & ~empty
    scale = np.where(diagonal > 0, np.sqrt(np.maximum(diagonal, 0)), 1.0)
    plan = make_plan(
        system.equations, reduce_points=False, touched=np.zeros(len(diagonal), dtype=bool)
    )
    rays = Rays(system.equations, plan) if plan.reduced.any() else None
    extra = np.where(empty, 1.0, REGULARISED * diagonal)
    factor = Factor(plan, rays, system, TreeFactors(plan, system), extra, qr=True)
    n = min(MOST, int(live.sum()))
    found = np.zeros((len(diagonal), 0))
    if n:
        rng = np.random.default_rng(1)
        z = np.where(live[:, None], rng.standard_normal((len(diagonal), n)), 0.0)
        for _ in range(4):
            z = scale[:, None] * factor.solve(scale[:, None] * z)
            z[~live] = 0.0
            z, _ = np.linalg.qr(z)
        noticed = system.times(z / scale[:, None])
        values, right = np.linalg.eigh(noticed.T @ noticed)
        found = z @ right[:, np.sqrt(np.maximum(values, 0)) < NULL]
    unobserved = np.flatnonzero(empty)[:MOST_UNOBSERVED]
    units = np.zeros((len(diagonal), len(unobserved)))
    units[unobserved, np.arange(len(unobserved))] = 1.0
    return np.concatenate([units, found], axis=1)


def undetermined(
    system: LinearSystem, diagonal: Array, defects: Sequence[Defect], *, free: bool = False
) -> DatumError | None:
    """Return an error that names everything that is not determined, or none.

    Args:
        system: the linearised network.
        diagonal: that of N, (n_columns,).
        defects: its datum defects.
        free: whether inner constraints fill them, so that they are no fault.
    """
    try:
        z = null_space(system, diagonal)
    except SingularError:  # nothing more is to be learnt than the defects of datum
        z = np.zeros((len(diagonal), 0))
    if z.shape[1] == 0 and not defects:
        return None
    unknowns = system.unknowns
    scale = np.where(diagonal > 0, np.sqrt(np.maximum(diagonal, 0)), 1.0)
    lines, names = [], []
    concerned: list[tuple[str, str]] = []
    if defects:
        motions = scale[:, None] * np.concatenate([d.motions for d in defects], axis=1)
        basis, _ = np.linalg.qr(motions)
        z = z - basis @ (basis.T @ z)
        u, s, _ = np.linalg.svd(z, full_matrices=False)
        z = u[:, s > 0.5]
        if not free:
            lines += describe_defects(unknowns, defects)
    n_datum = 0 if free else sum(d.size for d in defects)
    if z.shape[1]:
        shares = _shares(unknowns, z)
        concerned = [(kind, unknowns[kind].names[number]) for kind, number, *_ in shares]
        for kind, number, share, weakest in shares[:LISTED]:
            name = unknowns[kind].names[number]
            names.append(name)
            why = _support(system, kind, number, diagonal)
            lines.append(
                f"{UNKNOWNS[kind].noun} {name!r} is not determined ({why}; weakest component: "
                f"{weakest}, share {share:.2f})"
            )
        if len(shares) > LISTED:
            lines.append(f"… and {len(shares) - LISTED} more")
    if n_datum:
        lines.append(
            "give control (fixed or weighted coordinates), or ask for a free network "
            '(datum = "free")'
        )
    total = n_datum + z.shape[1]
    if total == 0:
        return None
    at_least = "at least " if z.shape[1] >= MOST else ""
    head = f"the network is not determined: {at_least}{total} defect{'s' * (total > 1)}"
    message = "\n  ".join([head, *lines])
    return DatumError(message, defect=total, names=names, unknowns=concerned)


def describe_defects(unknowns: Unknowns, defects: Sequence[Defect]) -> list[str]:
    """Return one line for each part without a datum."""
    lines = []
    if len(defects) > 1:
        lines.append(f"the network falls into {len(defects)} unconnected parts without datum")
    for d in defects:
        found = dict.fromkeys(_names_in(unknowns, d.part))
        some = ", ".join(list(found)[:6]) + (" …" if len(found) > 6 else "")
        whole = len(found) == len(_names_in(unknowns, np.arange(unknowns.n_columns)))
        which = "" if whole else f" of the part with {some}"
        lines.append(f"datum defect {d.size}{which}: missing {', '.join(d.names())}")
    return lines


def _names_in(unknowns: Unknowns, columns: Index) -> list[str]:
    inside = np.zeros(unknowns.n_columns, dtype=bool)
    inside[columns] = True
    out = []
    for kind in ("point", "pose"):
        table = unknowns[kind]
        on = np.flatnonzero(in_part(table, inside))
        out += [table.names[i] if kind == "point" else f"photo {table.names[i]}" for i in on]
    return out


def _shares(unknowns: Unknowns, z: Array) -> list[tuple[VariableKind, int, float, str]]:
    """Return kind, number, share and weakest component of the variables in z, largest first."""
    leverage = np.sum(z * z, axis=1)
    out = []
    for kind, number in unknowns.active():
        columns = unknowns.columns(kind, number)
        own = leverage[columns]
        share = float(own.sum())
        if share > 0.05:
            component = unknowns.component_names(kind, number)[int(np.argmax(own))]
            out.append((kind, number, share, component))
    return sorted(out, key=lambda item: -item[2])


def _support(system: LinearSystem, kind: str, number: int, diagonal: Array) -> str:
    """Say what observes a variable."""
    counts: dict[str, int] = {}
    for lb in system.blocks:
        for what, index in lb.block.variables:
            if what == kind:
                n = int(np.sum(index == number))
                if n:
                    counts[lb.block.kind] = counts.get(lb.block.kind, 0) + n
    if not counts:
        return "no observation"
    words = {"image": "image ray" if kind == "point" else "image point"}
    return ", ".join(
        f"{n} {words.get(k, k.replace('_', ' '))}{'s' * (n > 1)}" for k, n in counts.items()
    )
