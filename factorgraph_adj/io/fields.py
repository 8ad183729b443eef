"""Names of fields: which columns and keys each kind of observation has.

They follow from the dataclasses in `factorgraph_adj.observations`, so that a new kind with
known attributes needs nothing here.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from difflib import get_close_matches
from functools import lru_cache
from itertools import product

from ..models.registry import KINDS
from ..observations import OBSERVATIONS, ControlPoint
from ..units import ANGLE, LENGTH

NAMES = ("station", "target", "target2", "point", "photo")
HEIGHTS = ("instrument_height", "target_height", "target2_height")
TEXTS = ("set", "instrument", "refraction", "axes")
PARTS = {
    "ppm": ("slope_distance", "horizontal_distance"),
    "sqrt_km": ("height_difference",),
    "centring_instrument": None,
    "centring_target": None,
}
"""Further parts of a standard deviation, and the kinds they apply to (none: all with parts)."""
PART_ATTRIBUTES = {
    "ppm": "ppm",
    "sqrt_km": "per_sqrt_km",
    "centring_instrument": "centring_instrument",
    "centring_target": "centring_target",
}
LEVER_ARM = tuple(f"lever_arm_{a}" for a in "xyz")
PAIRS = tuple(a + b for axes in ("xyz", "enu") for a, b in product(axes, repeat=2))
"""Pairs of axes in names of covariances."""


def is_angle(kind: str) -> bool:
    """Return whether the value of a kind is an angle."""
    return kind in KINDS and KINDS[kind].unit == "rad"


@lru_cache
def attributes(kind: str) -> frozenset[str]:
    """Return the names of the attributes of a kind of observation."""
    return frozenset(f.name for f in fields(OBSERVATIONS[kind]))


@lru_cache
def has_parts(kind: str) -> bool:
    """Return whether the standard deviation of a kind may have several parts."""
    return any(f.name == "sigma" and f.type == "Sigma" for f in fields(OBSERVATIONS[kind]))


@lru_cache
def sigma_fields(kind: str) -> tuple[str, ...]:
    """Return the fields that can state the standard deviation or covariance of a kind."""
    if kind == "image":
        units: Iterable[str] = ("px", *LENGTH)
        return tuple(f"sigma{axis}_{u}" for axis in ("", "_x", "_y") for u in units)
    units = tuple(ANGLE) if is_angle(kind) else tuple(LENGTH)
    out = [f"sigma_{u}" for u in units]
    if has_parts(kind):
        for part, kinds in PARTS.items():
            if kinds is None or kind in kinds:
                out += ["ppm"] if part == "ppm" else [f"{part}_{u}" for u in LENGTH]
    if "covariance" in attributes(kind):
        axes = "xyzenu" if issubclass(OBSERVATIONS[kind], ControlPoint) else "xyz"
        out += [f"sigma_{a}_{u}" for a in axes for u in LENGTH]
        out += [
            f"covariance_{pair}_{u}2" for pair in PAIRS if set(pair) <= set(axes) for u in LENGTH
        ]
    return tuple(out)


def stand_in_sigma(kind: str) -> dict[str, object]:
    """Return any valid standard deviation of a kind, for where the real one was found wrong."""
    units = ("px", "m") if kind == "image" else ("rad",) if is_angle(kind) else ("m",)
    return {f"sigma_{u}": 1.0 for u in units}


def plain_fields(kind: str) -> tuple[str, ...]:
    """Return the fields of a kind but for its standard deviation."""
    have = attributes(kind)
    out = ["kind", "id", *(n for n in NAMES if n in have)]
    if kind == "image":
        return (*out, "x", "y")
    out += ["x", "y", "z"] if "covariance" in have else ["value"]
    out += ["unit", *(n for n in (*HEIGHTS, *TEXTS) if n in have)]
    out += ["length_km"] if "length_km" in have else []
    out += LEVER_ARM if "lever_arm" in have else []
    return tuple(out)


@lru_cache
def known_fields(kind: str | None = None) -> frozenset[str]:
    """Return every field that records of a kind, or of any kind, may have."""
    kinds = [kind] if kind else list(OBSERVATIONS)
    return frozenset(f for k in kinds for f in (*plain_fields(k), *sigma_fields(k), "remark"))


COLUMNS: tuple[str, ...] = (
    *("kind", "id", *NAMES, "value", "x", "y", "z", "unit", "axes"),
    *("set", "instrument", "refraction", *HEIGHTS, "length_km"),
    *(f"sigma{axis}_{u}" for axis in ("", *(f"_{a}" for a in "xyzenu")) for u in LENGTH),
    *(f"sigma_{u}" for u in (*ANGLE, "px")),
    "ppm",
    *(f"{part}_{u}" for part in PARTS if part != "ppm" for u in LENGTH),
    *(f"covariance_{pair}_{u}2" for pair in PAIRS for u in LENGTH),
    *LEVER_ARM,
)
"""Columns of observations.csv in the order in which they are written."""


def unknown_field(name: str, valid: Iterable[str]) -> str | None:
    """Return what is wrong with the name of a column or key; none if it is known."""
    names = set(valid)
    if name in names:
        return None
    stem, _, unit = name.rpartition("_")
    units = sorted({n.rpartition("_")[2] for n in names if n.rpartition("_")[0] == stem and stem})
    if stem and len(units) > 1:
        order = [u for u in (*LENGTH, *ANGLE, "px", *(f"{u}2" for u in LENGTH)) if u in units]
        return f"unknown unit {unit!r} in {name!r}; valid: {', '.join(order)}"
    close = get_close_matches(name, names, 1)
    if close:
        return f"unknown column {name!r}; did you mean {close[0]!r}?"
    stems = {n.rpartition("_")[0] for n in names if n.rpartition("_")[2] in (*LENGTH, *ANGLE)}
    short = sorted({n for n in names if n.rpartition("_")[0] not in stems})
    return (
        f"unknown column {name!r}; known: {', '.join([*short, *sorted(s + '_…' for s in stems)])}"
    )


def offer(kind: str) -> str:
    """Return the fields of a kind, with one unit for all."""
    unit = "mgon" if is_angle(kind) else "mm"
    stated = [f for f in sigma_fields(kind) if f.endswith(("_mm", f"_{unit}", "_mm2", "ppm"))]
    return ", ".join([*plain_fields(kind), *stated])
