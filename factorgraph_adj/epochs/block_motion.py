"""Common motion of points: a rigid block, a similarity, or the strain of a body, with its test.

The displacements d_i of points at x_i are explained by few parameters p, d = B p + v, weighted with
their joint cofactors Q:

    p = (BᵀQ⁻¹B)⁻¹BᵀQ⁻¹d,  Q_p = (BᵀQ⁻¹B)⁻¹,  Ω = dᵀQ⁻¹(d − B p)

- rigid: a shift and rotations, d = t + ω × (x − x̄)
- similarity: with a scale, d = t + ω × (x − x̄) + m (x − x̄)
- affine: with a homogeneous strain, d = t + (E + W)(x − x̄), E symmetric and W antisymmetric

x̄ is the mean place of the points. Ω/(h σ0²) tests whether the parameters explain the
displacements.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from ..blas_threads import with_one_thread
from ..errors import DatumError, InputError, Problem, known, taking
from ..types import Array
from .comparison_result import EpochComparison
from .congruence_tests import HypothesisTest

MotionModel: TypeAlias = Literal["rigid", "similarity", "affine"]
"""How the points of a block move together."""


@dataclass(frozen=True, eq=False)
class BlockMotion:
    """Common motion of some points between two epochs."""

    points: tuple[str, ...]
    """Names of the points."""
    model: MotionModel
    """How they move together."""
    centre: Array
    """Mean place x̄ of the points, (3,) metres."""
    names: tuple[str, ...]
    """Names of the parameters: shifts ``tx ty tz`` of x̄ in metres, rotations ``rx ry rz`` in
    radians, ``scale``, strains ``exx eyy ezz exy exz eyz``; those of the coordinates compared."""
    values: Array
    """Estimates p."""
    cofactor: Array
    """Cofactors Q_p."""
    variance: float
    """σ0² of the tests."""
    residuals: Array
    """d − B p of each point, (n, k) metres."""
    fit: HypothesisTest | None
    """Test of the model: whether the points moved like this; None without redundancy."""
    motion: HypothesisTest
    """Test of the motion: whether all parameters are zero."""

    @property
    def sigmas(self) -> Array:
        """Standard deviations of the parameters."""
        return np.sqrt(self.variance * np.diag(self.cofactor))

    def __getitem__(self, name: str) -> float:
        """Return a parameter by its name.

        Raises:
            InputError: no such parameter.
        """
        if name not in self.names:
            raise InputError(f"no parameter {name!r}; known: {known(self.names, meant=name)}")
        return float(self.values[self.names.index(name)])

    def principal_strains(self) -> tuple[Array, Array]:
        """Return the principal strains, descending, and their directions as rows.

        Raises:
            InputError: the model is not affine.
        """
        if self.model != "affine":
            raise InputError(f"a {self.model} motion has no strain; ask for model='affine'")
        axes = [a for a in "xyz" if f"t{a}" in self.names]
        e = np.array([[self["e" + "".join(sorted((a, b)))] for b in axes] for a in axes])
        values, vectors = np.linalg.eigh(e)
        return values[::-1], vectors[:, ::-1].T


@taking(EpochComparison)
@with_one_thread
def block_motion(
    found: EpochComparison, points: Sequence[str], *, model: MotionModel = "rigid"
) -> BlockMotion:
    """Return the common motion of some points against the stable reference points.

    Args:
        found: the comparison of two epochs.
        points: names of points that are not stable reference points.
        model: how they move together.

    Raises:
        InputError: no points, unknown or stable points, an unknown model, one coordinate alone.
        DatumError: the points do not determine the parameters.
    """
    if model not in get_args(MotionModel):
        raise InputError(f"unknown model {model!r}; valid: {known(get_args(MotionModel))}")
    if isinstance(points, str) or not points:
        raise InputError(f"points of a block must be a list of names, not {points!r}")
    loose = [n for n, x in found.displacements.items() if not x.stable]
    wrong = [n for n in dict.fromkeys(points) if n not in loose]
    if wrong:
        raise InputError(
            Problem(f"is not one of the points that may have moved: {known(loose)}", f"point {n!r}")
            for n in wrong
        )
    names = tuple(dict.fromkeys(points))
    axes = found.differences.axes
    k = len(axes)
    columns = ["xyz".index(a) for a in axes]
    rows = np.array([loose.index(n) * k + i for n in names for i in range(k)], dtype=np.intp)
    q = found.joint[np.ix_(rows, rows)]
    d = np.concatenate([found.displacements[n].vector[columns] for n in names])
    places = np.array([found.displacements[n].place for n in names])
    centre = places.mean(axis=0)
    parameters, b = _design(places - centre, axes, model)
    weight = np.linalg.inv(q)
    normal = b.T @ weight @ b
    scale = np.sqrt(np.diag(normal))
    if (scale == 0).any() or np.linalg.cond(normal / np.outer(scale, scale)) > 1e12:
        raise DatumError(
            f"{', '.join(names)} {'does' if len(names) == 1 else 'do'} not determine the "
            f"{len(parameters)} parameters of a motion, {model} ({', '.join(parameters)}): "
            "take more points, not on one line",
            defect=int(b.shape[1] - np.linalg.matrix_rank(b)),
        )
    q_p = np.linalg.inv(np.asarray(normal, dtype=np.float64))
    p = q_p @ (b.T @ weight @ d)
    v = d - b @ p
    h = len(d) - len(p)
    fit = found.scale.test(float(v @ weight @ v), h, found.alpha) if h > 0 else None
    motion = found.scale.test(float(p @ normal @ p), len(p), found.alpha)
    return BlockMotion(
        names,
        model,
        centre,
        parameters,
        p,
        q_p,
        found.scale.variance,
        v.reshape(-1, k),
        fit,
        motion,
    )


def _design(x: Array, axes: str, model: MotionModel) -> tuple[tuple[str, ...], Array]:
    """Return the names of the parameters and B (n k, u) for places x (n, 3) from their mean."""
    columns: dict[str, Array] = {}
    for i, a in enumerate("xyz"):
        if a in axes:
            columns[f"t{a}"] = np.tile(np.eye(3)[i], (len(x), 1))
    for i, a in enumerate("xyz"):
        others = [o for o in "xyz" if o != a]
        if all(o in axes for o in others):
            columns[f"r{a}"] = np.cross(np.eye(3)[i], x)
    if model == "similarity":
        columns["scale"] = x
    if model == "affine":
        for i, a in enumerate("xyz"):
            for j, c in enumerate("xyz"):
                if j >= i and a in axes and c in axes:
                    e = np.zeros((3, 3))
                    e[i, j] = e[j, i] = 1.0
                    columns[f"e{a}{c}"] = x @ e
    keep = ["xyz".index(a) for a in axes]
    b = np.stack([c[:, keep].ravel() for c in columns.values()], axis=1)
    return tuple(columns), b
