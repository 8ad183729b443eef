"""Solutions as labelled arrays of xarray; the extra ``xarray`` is required."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, known
from ..solve.solution import Solution
from ..types import Array
from ..version import __version__

if TYPE_CHECKING:
    import xarray

MISSING = "labelled arrays need xarray: pip install 'factorgraph_adj[xarray]'"
AXES = ["x", "y", "z"]
POSE = ["rx", "ry", "rz", "x", "y", "z"]
"""Components of the covariance of a photo: rotations about the axes of the camera, and X0."""


def to_xarray(solution: Solution) -> xarray.Dataset:
    """Return points, photos and observations with their covariances as a labelled data set.

    ======================  =========================================  ==============
    variable                dimensions                                 unit
    ======================  =========================================  ==============
    ``coordinates``         point, axis                                m
    ``covariance``          point, axis, axis2                         m²
    ``position``            photo, axis                                m
    ``rotation``            photo, axis, camera_axis (world_R_camera)  1
    ``pose_covariance``     photo, component, component2               rad², rad m, m²
    ``observed``            row                                        SI, image units
    ``residual``            row (computed − observed)                  SI, image units
    ``sigma``               row                                        SI, image units
    ======================  =========================================  ==============

    Rows have the coordinates ``id``, ``kind`` and ``observation_component``. The covariances are
    those of each point and each photo; `covariance_array` has those between points.

    Raises:
        InputError: xarray is not installed.
        SingularError: there are no covariances.
    """
    xr = _xarray()
    points, photos = list(solution.network.points), list(solution.network.photos)
    number = solution.equations.unknowns["pose"].number
    stored = solution.state["pose"][[number[n] for n in photos]]
    poses = np.array([solution.pose_covariance(n) for n in photos]).reshape(-1, 6, 6)
    table = solution.observations
    records = list(table)
    rows = {
        "observed": np.array([r.observed for r in records], dtype=float),
        "residual": table.residuals,
        "sigma": table.sigmas,
    }
    data: dict[str, Any] = {
        "coordinates": (("point", "axis"), solution.state["point"].copy(), {"units": "m"}),
        "covariance": (("point", "axis", "axis2"), solution.point_covariances, {"units": "m2"}),
        "position": (("photo", "axis"), stored[:, 9:12].copy(), {"units": "m"}),
        "rotation": (("photo", "axis", "camera_axis"), stored[:, :9].reshape(-1, 3, 3).copy()),
        "pose_covariance": (("photo", "component", "component2"), poses),
        **{name: (("row",), values) for name, values in rows.items()},
    }
    labels: dict[str, Any] = {
        "point": _texts(points),
        "photo": _texts(photos),
        "axis": AXES,
        "axis2": AXES,
        "camera_axis": AXES,
        "component": POSE,
        "component2": POSE,
        "id": ("row", _texts([r.id for r in records])),
        "kind": ("row", _texts([r.kind for r in records])),
        "observation_component": ("row", _texts([r.component for r in records])),
    }
    attributes = {
        "network": solution.network.name,
        "program": f"factorgraph_adj {__version__}",
        "sigma0": solution.sigma0,
        "redundancy": solution.redundancy,
        "variance": solution.variance,
        "converged": int(solution.converged),
    }
    return xr.Dataset(data, labels, attributes)


def covariance_array(solution: Solution, names: Sequence[str] | None = None) -> xarray.DataArray:
    """Return the joint covariance of points as an array with the names of points and axes.

    Args:
        solution: the result of an adjustment.
        names: n points; None: all of them. The array has 9 n² numbers.

    Returns:
        The covariance with the dimensions point, axis, point2, axis2, m²; zero for held
        components. In a free network it belongs to the inner constraints.

    Raises:
        InputError: xarray is not installed, or a point is unknown (all are listed) or named twice.
    """
    xr = _xarray()
    chosen = list(solution.network.points) if names is None else [str(n) for n in names]
    unknown = [n for n in chosen if n not in solution.network.points]
    if unknown:
        valid = known(solution.network.points, meant=unknown[0])
        raise InputError(f"unknown points {', '.join(map(repr, unknown))}; known: {valid}")
    if len(set(chosen)) < len(chosen):
        twice = sorted({n for n in chosen if chosen.count(n) > 1})
        raise InputError(f"points are named twice: {', '.join(twice)}")
    joint = _joint(solution, chosen).reshape(len(chosen), 3, len(chosen), 3)
    labels = {"point": _texts(chosen), "axis": AXES, "point2": _texts(chosen), "axis2": AXES}
    return xr.DataArray(
        joint, labels, ("point", "axis", "point2", "axis2"), "covariance", {"units": "m2"}
    )


def _joint(solution: Solution, names: Sequence[str]) -> Array:
    """Return the covariance of points, (3 n, 3 n) metres²."""
    if solution.reference is not None:
        # A change of the datum acts on blocks.
        return solution.covariance(names)
    table = solution.equations.unknowns["point"]
    number = np.array([table.number[n] for n in names], dtype=np.intp)
    free = (table.free[number] & (table.offset[number] >= 0)[:, None]).ravel()
    columns = (table.offset[number, None] + np.arange(3)).ravel()[free]
    unit = np.zeros((solution.equations.unknowns.n_columns, len(columns)))
    unit[columns, np.arange(len(columns))] = 1.0
    out = np.zeros((3 * len(names), 3 * len(names)))
    block = solution.cofactor_times(unit)[columns]
    out[np.ix_(free, free)] = (block + block.T) / 2.0 * solution.variance_factor
    return out


def _texts(values: Sequence[str]) -> np.ndarray[Any, Any]:
    """Return texts as an array whose type files of xarray can hold."""
    return np.array(values, dtype=str) if len(values) else np.zeros(0, dtype="<U1")


def _xarray() -> Any:
    try:
        import xarray
    except ImportError:
        raise InputError(MISSING) from None
    return xarray
