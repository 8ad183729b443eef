"""PROJ through pyproj: systems by definition, best operations between them (no ballpark ones).

Axes are east, north, up (``always_xy``). A ballpark operation, which passes a height on as it is
where PROJ has no geoid, is never taken; a grid that is missing is an error that names it.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from contextlib import contextmanager
from functools import lru_cache
from types import ModuleType
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ..errors import InputError, Problem
from ..types import Array

if TYPE_CHECKING:
    from collections.abc import Iterator

PYPROJ_MISSING = "reference systems need pyproj: pip install 'factorgraph_adj[crs]'"
GEOID_HELP = (
    "give geoid = the path of a grid (.gtx, .tif, .gsb), of a table of points (.csv), or a "
    "constant undulation in metres; or heights = 'ellipsoidal' where the heights are such"
)

MAX_DEFINITION_CHARACTERS = 120
"""Number of characters of a definition that a message shows."""


class Operation(Protocol):
    """An operation of PROJ between two systems."""

    @property
    def description(self) -> str:
        """Its name."""
        ...

    @property
    def accuracy(self) -> float:
        """Its accuracy, metres; negative if it is unknown."""
        ...

    def transform(self, *coordinates: Any, **options: Any) -> Any:
        """Return the transformed coordinates."""
        ...


def pyproj() -> ModuleType:
    """Return pyproj; InputError says how to install it."""
    try:
        import pyproj as found
        import pyproj.transformer
    except ImportError:
        raise InputError(PYPROJ_MISSING) from None
    return found  # type: ignore[no-any-return, unused-ignore]


@lru_cache(maxsize=64)
def crs(definition: str) -> Any:
    """Return the system of a definition: EPSG:25832+7837, WKT, or a PROJ string.

    Raises:
        InputError: PROJ does not know it.
    """
    package = pyproj()
    try:
        with without_warnings():
            return package.CRS.from_user_input(definition)
    except (package.exceptions.CRSError, ValueError, TypeError) as error:
        shown = (
            definition
            if len(definition) <= MAX_DEFINITION_CHARACTERS
            else definition[:MAX_DEFINITION_CHARACTERS] + "…"
        )
        what = " ".join(str(error).replace(definition, shown).split())
        raise InputError(
            f"unknown reference system {shown!r}: {what}; valid: a code such as "
            "EPSG:25832+7837 (plan + heights), a PROJ string, or WKT"
        ) from None


@contextmanager
def without_warnings() -> Iterator[None]:
    """Keep warnings of pyproj from being printed: what they say becomes an error or a result."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def operation(source: Any, target: Any, *, what: str) -> Operation:
    """Return the best operation between two systems, never a ballpark one.

    Args:
        source: system of pyproj.
        target: system of pyproj.
        what: what is transformed, for messages.

    Raises:
        InputError: the best operation needs a grid that is missing, or there is none.
    """
    package = pyproj()
    try:
        with without_warnings():
            found: Operation = package.Transformer.from_crs(
                source, target, always_xy=True, allow_ballpark=False, only_best=True
            )
    except package.exceptions.ProjError as error:
        raise InputError(_why(source, target, what, error)) from None
    return found


def _why(source: Any, target: Any, what: str, error: Exception) -> Problem:
    """Return which grids an operation lacks, and where they are."""
    group = _group(source, target)
    if group is None:
        return Problem(
            f"cannot be used: PROJ knows no such projection or operation ({_short(error)}); valid: "
            "a code such as EPSG:25832, or a PROJ string or WKT with a projection of PROJ",
            what,
        )
    grids = [g for o in group.unavailable_operations for g in o.grids if not g.available]
    if grids:
        named = dict.fromkeys(f"{g.short_name} ({g.url})" if g.url else g.short_name for g in grids)
        some = " or ".join(list(named)[:3])
        return Problem(
            f"needs the grid {some}, which is not installed: put it into a folder of PROJ "
            f"(pyproj.datadir.append_data_dir), or {GEOID_HELP}",
            what,
        )
    if not group.transformers:
        return Problem(f"PROJ knows no operation for it, such as a geoid; {GEOID_HELP}", what)
    return Problem(_short(error), what)


def _short(error: Exception) -> str:
    return " ".join(str(error).split()).removeprefix("Error creating Transformer from CRS.: ")


def _group(source: Any, target: Any, **options: Any) -> Any | None:
    """Return the operations between two systems; None if PROJ cannot make one of them.

    pyproj raises IndexError where the list of operations is empty, as with a projection that PROJ
    does not know.
    """
    package = pyproj()
    try:
        with without_warnings():
            return package.transformer.TransformerGroup(
                source, target, always_xy=True, allow_ballpark=False, **options
            )
    except (package.exceptions.ProjError, IndexError):
        return None


def best_available(source: Any, target: Any, lonlat: Array) -> Operation:
    """Return the most accurate operation that is installed, over an area, never a ballpark one.

    Args:
        source: system of pyproj.
        target: system of pyproj.
        lonlat: longitudes and latitudes of the area, (n, 2) degrees.

    Raises:
        InputError: there is none.
    """
    package = pyproj()
    low, high = lonlat.min(axis=0), lonlat.max(axis=0)
    area = package.aoi.AreaOfInterest(*low.tolist(), *high.tolist())
    group = _group(source, target, area_of_interest=area)
    if group is None or not group.transformers:
        raise InputError(
            Problem(f"PROJ knows no operation to {target.name}", f"reference system {source.name}")
        )
    found: Operation = group.transformers[0]
    return found


def pipeline(text: str, *, what: str) -> Operation:
    """Return the operation of a PROJ pipeline.

    Raises:
        InputError: PROJ refuses it.
    """
    package = pyproj()
    try:
        found: Operation = package.Transformer.from_pipeline(text)
    except package.exceptions.ProjError as error:
        raise InputError(Problem(f"PROJ cannot use it: {_short(error)}", what)) from None
    return found


def transformed(
    op: Operation,
    coordinates: Array,
    *,
    what: str,
    inverse: bool = False,
    names: Iterable[str] | None = None,
    hint: Callable[[int], str] = lambda _: "",
) -> Array:
    """Return transformed coordinates (n, 3).

    Args:
        op: the operation.
        coordinates: (n, 3), in the units of the source system.
        what: what the operation is, for messages.
        inverse: whether from target to source.
        names: names of the points, for messages.
        hint: what may be wrong with a point that fails, by its row.

    Raises:
        InputError: points that the operation cannot transform, all of them.
    """
    package = pyproj()
    direction = "INVERSE" if inverse else "FORWARD"
    try:
        x, y, z = op.transform(*coordinates.T.copy(), direction=direction)
    except package.exceptions.ProjError as error:
        raise InputError(Problem(_short(error), what)) from None
    out = np.stack([x, y, z], axis=1)
    failed = ~np.isfinite(out).all(axis=1) & np.isfinite(coordinates).all(axis=1)
    refuse_points(
        failed, lambda i: f"is outside of {what}: {place_text(coordinates[i])}{hint(i)}", names
    )
    out[~np.isfinite(coordinates).all(axis=1)] = np.nan
    return out


def refuse_points(
    failed: np.ndarray[Any, Any], why: Callable[[int], str], names: Iterable[str] | None
) -> None:
    """Raise the points that failed, (n,) true, with the reason of each."""
    rows = np.flatnonzero(failed).tolist()
    if rows:
        labels = list(names) if names is not None else None
        raise InputError(
            Problem(why(i), f"point {labels[i]!r}" if labels else f"point number {i + 1}")
            for i in rows
        )


def place_text(coordinates: Array) -> str:
    """Return coordinates as text: metres to the millimetre, degrees to 1e-8."""
    size = np.abs(coordinates).max(initial=0.0)
    return ", ".join(f"{v:.3f}" if 360.0 < size < 1e9 else f"{v:.8g}" for v in coordinates.tolist())
