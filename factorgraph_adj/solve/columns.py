"""Adjusted points, photos and other unknowns as columns of arrays."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from ..columns import Columns
from ..models.variables import UNKNOWNS, VariableKind
from ..rotation import omega_phi_kappa
from ..types import Array
from .estimated import EstimatedPhotos
from .geographic import geographic


class Adjusted(EstimatedPhotos, Protocol):
    """What the columns are taken from."""

    def number(self, kind: VariableKind, name: str) -> int:
        """Return the number of a variable."""
        ...

    def variable_covariance(
        self, a: tuple[VariableKind, str], b: tuple[VariableKind, str] | None = None
    ) -> Array:
        """Return the covariance between two variables."""
        ...


def points(solution: Adjusted) -> Columns:
    """Return ``name``, ``x y z``, ``sigma_x …``, and whether each component is ``held_x …``.

    A frame with an ellipsoid adds ``latitude longitude height``, ``sigma_east …``.
    """
    table = solution.equations.unknowns["point"]
    out: dict[str, np.ndarray[Any, Any]] = {"name": np.array(table.names, dtype=object)}
    values = solution.state["point"]
    sigma = np.sqrt(np.maximum(np.einsum("nii->ni", solution.point_covariances), 0.0))
    for i, axis in enumerate("xyz"):
        out[axis] = values[:, i].copy()
    for i, axis in enumerate("xyz"):
        out[f"sigma_{axis}"] = sigma[:, i]
    found = geographic(solution.network.frame, values, solution.point_covariances)
    if found is not None:
        out |= {"latitude": found.latitude, "longitude": found.longitude, "height": found.height}
        out |= {f"sigma_{a}": found.sigma[:, i] for i, a in enumerate(("east", "north", "up"))}
    for i, axis in enumerate("xyz"):
        out[f"held_{axis}"] = ~table.free[:, i]
    return Columns("points", out)


def photos(solution: Adjusted) -> Columns:
    """Return ``name``, ``camera``, ``x y z``, ``omega phi kappa``, and σ.

    ``sigma_rx …`` are those of rotations about the axes of the camera, radians.
    """
    names = list(solution.network.photos)
    number = [solution.number("pose", n) for n in names]
    stored = solution.state["pose"][number]
    variances = [np.diag(solution.pose_covariance(n)) for n in names]
    sigma = np.sqrt(np.maximum(np.array(variances).reshape(-1, 6), 0.0))
    angles = [omega_phi_kappa(r) for r in stored[:, :9].reshape(-1, 3, 3)]
    about = np.array(angles, dtype=float).reshape(-1, 3)
    cameras = [f.camera for f in solution.network.photos.values()]
    out: dict[str, np.ndarray[Any, Any]] = {
        "name": np.array(names, dtype=object),
        "camera": np.array(cameras, dtype=object),
    }
    out |= {a: stored[:, 9 + i].copy() for i, a in enumerate("xyz")}
    out |= {a: about[:, i] for i, a in enumerate(("omega", "phi", "kappa"))}
    out |= {f"sigma_{a}": sigma[:, 3 + i] for i, a in enumerate("xyz")}
    out |= {f"sigma_r{a}": sigma[:, i] for i, a in enumerate("xyz")}
    return Columns("photos", out)


def others(solution: Adjusted) -> Columns:
    """Return ``kind``, ``name``, ``component``, ``value``, ``sigma``, ``held`` of other unknowns.

    These are calibrations and all that is stated or found besides points and photos.
    """
    unknowns = solution.equations.unknowns
    rows: list[tuple[str, str, str, float, float, bool]] = []
    for kind in UNKNOWNS:
        if kind in ("point", "pose"):
            continue
        table = unknowns[kind]
        for number, name in enumerate(table.names):
            values = unknowns.shown(solution.state, kind, number)
            tangent = solution.variable_covariance((kind, name))
            covariance = unknowns.covariance_of_given(solution.state, kind, number, tangent)
            sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
            names = unknowns.component_names(kind, number)
            held = ~table.free[number, : len(names)]
            for cells in zip(names, values, sigma, held, strict=True):
                component, value, s, is_held = cells
                rows.append((kind, name, component, float(value), float(s), bool(is_held)))
    header = ("kind", "name", "component", "value", "sigma", "held")
    types = (object, object, object, float, float, bool)
    columns = list(zip(*rows, strict=True)) if rows else [()] * len(header)
    return Columns(
        "unknowns",
        {n: np.array(c, dtype=t) for n, c, t in zip(header, columns, types, strict=True)},
    )
