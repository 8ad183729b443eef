"""Calibrations of Metashape and PhotoScan as lens models, and back.

Both programs distort the ideal coordinates (x, y) of a ray, y down, r² = x² + y²:

    x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶ + k4 r⁸) + d_x,   y' = y (1 + …) + d_y

Since PhotoScan 1.3 a calibration has ``<f>``; the principal point counts from the image centre:

    u = w/2 + cx + x' f + x' b1 + y' b2,   v = h/2 + cy + y' f
    d_x = p1 (r² + 2x²) + 2 p2 x y,   d_y = p2 (r² + 2y²) + 2 p1 x y

Before it had ``<fx>`` and ``<fy>``, an absolute principal point, a skew, and p1 and p2 exchanged:

    u = cx + x' fx + y' skew,   v = cy + y' fy
    d_x = p2 (r² + 2x²) + 2 p1 x y,   d_y = p1 (r² + 2y²) + 2 p2 x y
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from ...models.affine_normalised import AffineNormalisedLens
from ...models.lens import Lens, NormalisedLens
from ...models.rational_lens import RationalLens
from ...models.ray_lens import FisheyeLens
from ..xml_tree import Element
from .reading import Reading

CURRENT = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")
OLD = ("fx", "fy", "cx", "cy", "skew", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")
FISHEYES = ("fisheye", "equidistant_fisheye")
"""Types whose distortion is applied to θ (x, y)/r, θ = atan r, in place of (x, y)."""
TYPES = ("frame", *FISHEYES)
IGNORED = ("resolution", "date")
"""Children of a calibration besides its numbers."""
EXTRA = ("k4", "b1", "b2")
"""Parameters that need the model with an affinity."""
OURS = {
    **{"f": "c", "fx": "c", "fy": "c", "cx": "x0", "cy": "y0", "aspect": "b1", "skew": "b2"},
    **{k: k for k in ("k1", "k2", "k3", "k4", "b1", "b2")},
}
"""Our names of the parameters but p1 and p2, which depend on the version."""


@dataclass(frozen=True)
class Calibration:
    """A calibration in pixels from the upper left corner, y up."""

    lens: Lens
    """The lens model."""
    values: dict[str, float]
    """Parameters by name."""
    size: tuple[float, float]
    """Width and height of the image, pixels."""
    free: tuple[str, ...]
    """Parameters that are unknown."""


def read_calibration(
    reading: Reading,
    element: Element,
    where: str,
    *,
    size: tuple[float, float],
    free: Collection[str],
) -> Calibration | None:
    """Read a calibration; None after a problem.

    Args:
        reading: where problems go.
        element: the element ``<calibration>``.
        where: file and line.
        size: width and height of the image, pixels.
        free: parameters that are unknown, by Metashape's names.
    """
    kind = element.attributes.get("type", "frame")
    if kind not in TYPES:
        types = ", ".join(TYPES)
        reading.wrong(f"a calibration of type {kind!r} cannot be read; valid: {types}", where)
        return None
    given = {c.tag: c for c in element.children if c.tag not in IGNORED}
    old = "f" not in given and ("fx" in given or "fy" in given)
    valid = OLD if old else CURRENT
    n = len(reading.problems)
    value = {}
    for name, child in given.items():
        if name not in valid:
            what = f"unknown parameter <{name}> of a calibration; valid: {', '.join(valid)}"
            reading.wrong(what, where)
            continue
        value[name] = reading.number(child.text.strip(), f"<{name}>", where) or 0.0
    for name in ("p3", "p4"):
        if value.get(name):
            reading.wrong(f"<{name}> is {value[name]:g}; this lens model has no {name}", where)
    main = ("fx", "fy") if old else ("f",)
    for name in main:
        if name not in value:
            reading.wrong(f"the calibration has no <{name}>", where)
        elif not value[name] > 0:
            reading.wrong(f"<{name}> must be greater than zero, not {value[name]:g}", where)
    if len(reading.problems) > n:
        return None
    p1, p2 = value.get("p1", 0.0), value.get("p2", 0.0)
    out = {k: value.get(k, 0.0) for k in ("k1", "k2", "k3", "k4")}
    if old:
        out |= {"c": value["fy"], "b1": value["fx"] - value["fy"], "b2": -value.get("skew", 0.0)}
        out |= {"x0": value.get("cx", size[0] / 2), "y0": -value.get("cy", size[1] / 2)}
        out |= {"p1": p2, "p2": -p1}
    else:
        out |= {"c": value["f"], "b1": value.get("b1", 0.0), "b2": -value.get("b2", 0.0)}
        out |= {"x0": size[0] / 2 + value.get("cx", 0.0), "y0": -size[1] / 2 - value.get("cy", 0.0)}
        out |= {"p1": p1, "p2": -p2}
    names = OURS | ({"p1": "p2", "p2": "p1"} if old else {"p1": "p1", "p2": "p2"})
    wanted = {names[n] for n in free if n in names}
    if kind in FISHEYES:
        out |= {"b1": out["b1"] / out["c"], "b2": out["b2"] / out["c"]}
        fisheye = FisheyeLens()
        values = {n: out.get(n, 0.0) for n in fisheye.names}
        return Calibration(fisheye, values, size, tuple(n for n in fisheye.names if n in wanted))
    plain = not any(out[n] or n in wanted for n in EXTRA)
    lens: Lens = NormalisedLens() if plain else AffineNormalisedLens()
    values = {n: out[n] for n in lens.names}
    return Calibration(lens, values, size, tuple(n for n in lens.names if n in wanted))


LOST: Mapping[type[Lens], tuple[str, ...]] = MappingProxyType(
    {
        Lens: (),
        NormalisedLens: (),
        AffineNormalisedLens: (),
        RationalLens: ("k4", "k5", "k6"),
        FisheyeLens: ("s1", "s2"),
    }
)
"""Lens models that are the same function as one of Metashape's, where these parameters are zero."""


def type_of(lens: Lens) -> str:
    """Return Metashape's type of a sensor with a lens that it has."""
    return FISHEYES[0] if type(lens) is FisheyeLens else TYPES[0]


def write_calibration(
    lens: Lens, values: Mapping[str, float], size: tuple[float, float]
) -> dict[str, float] | None:
    """Return Metashape's parameters of a lens in pixels; None if it has no such parameters.

    Args:
        lens: the lens model.
        values: its parameters by name, from the upper left corner, y up.
        size: width and height of the image, pixels.
    """
    lost = LOST.get(type(lens))
    if lost is None or any(values.get(n, 0.0) for n in lost):
        return None
    k = {n: values.get(n, 0.0) for n in AffineNormalisedLens().names}
    if "b1" in lens.names and type(lens) is not AffineNormalisedLens:  # relative to c
        k |= {"b1": k["b1"] * k["c"], "b2": k["b2"] * k["c"]}
    out = {"f": k["c"], "cx": k["x0"] - size[0] / 2, "cy": -k["y0"] - size[1] / 2}
    out |= {"b1": k["b1"], "b2": -k["b2"] if k["b2"] else 0.0}
    out |= {n: k[n] for n in ("k1", "k2", "k3", "k4")}
    out |= {"p1": k["p1"], "p2": -k["p2"] if k["p2"] else 0.0}
    return out
