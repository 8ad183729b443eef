"""Camera models of COLMAP by name and number, and their parameters as lens models and back.

COLMAP counts pixels from the upper left corner of the image, so that the centre of the first pixel
is (0.5, 0.5), with y down. Networks have y up: y0 = −cy. Two focal lengths are f_y = c and
f_x = c (1 + b1). The names of the models and the order of their parameters are those of COLMAP's
``src/colmap/sensor/models.h`` (4.2).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...models.lens import BrownForwardLens, Lens, NormalisedLens
from ...models.normalised_lens import AffineNormalisedLens, RationalLens
from ...models.ray_lens import DivisionLens, EquirectangularLens, FisheyeLens, FovLens, UnifiedLens

LENS_SIGNS: Mapping[str, tuple[str, float]] = {
    "k": ("k1", 1.0),
    "p1": ("p2", -1.0),
    "p2": ("p1", 1.0),
    "sx1": ("s1", 1.0),
    "sy1": ("s2", -1.0),
    "omega": ("w", 1.0),
}
"""Parameters that have another name or sign as y points up here: name of the lens, and its sign."""
_RATIONAL, _FISHEYE = RationalLens(), FisheyeLens()
_TWO_FOCAL_LENGTHS = ("fx", "fy", "cx", "cy")
_ONE_FOCAL_LENGTH = ("f", "cx", "cy")


@dataclass(frozen=True)
class CameraModel:
    """A camera model of COLMAP."""

    number: int
    """Its number in binary files."""
    name: str
    """Its name."""
    parameters: tuple[str, ...]
    """Its parameters in their order."""
    lens: Lens | None
    """The lens model; None: it has none here."""

    @property
    def own(self) -> tuple[str, ...]:
        """Parameters of the lens that the model has besides c, x0, y0 and b1."""
        rest = (p for p in self.parameters if p not in ("f", "fx", "fy", "cx", "cy", "w", "h"))
        return tuple(LENS_SIGNS.get(p, (p, 1.0))[0] for p in rest)

    @property
    def two_focal_lengths(self) -> bool:
        """Whether the model has fx and fy."""
        return "fx" in self.parameters

    @property
    def unknowns(self) -> tuple[str, ...]:
        """Parameters of the lens that COLMAP estimates: all but the principal point."""
        if isinstance(self.lens, EquirectangularLens):
            return ()
        return ("c", *self.own, *(("b1",) if self.two_focal_lengths else ()))

    def to_lens(self, parameters: Sequence[float]) -> dict[str, float]:
        """Return the parameters of the lens by name, pixels, y up."""
        given = dict(zip(self.parameters, parameters, strict=True))
        if "w" in given:
            c = given["w"] / (2.0 * np.pi)
            return {"c": c, "x0": 0.5 * given["w"], "y0": -0.5 * given["h"]}
        out = {"c": given.get("f", given.get("fy", np.nan))}
        out |= {"x0": given["cx"], "y0": -given["cy"]}
        if self.two_focal_lengths:
            out["b1"] = given["fx"] / given["fy"] - 1.0
        for name, value in given.items():
            if name not in ("f", "fx", "fy", "cx", "cy"):
                ours, sign = LENS_SIGNS.get(name, (name, 1.0))
                out[ours] = sign * value
        return out

    def from_lens(self, values: Mapping[str, float], size: tuple[int, int]) -> list[float]:
        """Return the parameters of COLMAP of those of the lens, pixels from the corner, y up."""
        out = []
        for name in self.parameters:
            if name in ("w", "h"):
                out.append(float(size["wh".index(name)]))
            elif name in ("f", "fy"):
                out.append(values["c"])
            elif name == "fx":
                out.append(values["c"] * (1.0 + values.get("b1", 0.0)))
            elif name == "cx":
                out.append(values["x0"])
            elif name == "cy":
                out.append(-values["y0"])
            else:
                ours, sign = LENS_SIGNS.get(name, (name, 1.0))
                out.append(sign * values.get(ours, 0.0))
        return out


CAMERA_MODELS: tuple[CameraModel, ...] = (
    CameraModel(0, "SIMPLE_PINHOLE", _ONE_FOCAL_LENGTH, Lens()),
    CameraModel(1, "PINHOLE", _TWO_FOCAL_LENGTHS, _RATIONAL),
    CameraModel(2, "SIMPLE_RADIAL", (*_ONE_FOCAL_LENGTH, "k"), NormalisedLens()),
    CameraModel(3, "RADIAL", (*_ONE_FOCAL_LENGTH, "k1", "k2"), NormalisedLens()),
    CameraModel(4, "OPENCV", (*_TWO_FOCAL_LENGTHS, "k1", "k2", "p1", "p2"), _RATIONAL),
    CameraModel(5, "OPENCV_FISHEYE", (*_TWO_FOCAL_LENGTHS, "k1", "k2", "k3", "k4"), _FISHEYE),
    CameraModel(
        6,
        "FULL_OPENCV",
        (*_TWO_FOCAL_LENGTHS, "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
        _RATIONAL,
    ),
    CameraModel(7, "FOV", (*_TWO_FOCAL_LENGTHS, "omega"), FovLens()),
    CameraModel(8, "SIMPLE_RADIAL_FISHEYE", (*_ONE_FOCAL_LENGTH, "k"), _FISHEYE),
    CameraModel(9, "RADIAL_FISHEYE", (*_ONE_FOCAL_LENGTH, "k1", "k2"), _FISHEYE),
    CameraModel(
        10,
        "THIN_PRISM_FISHEYE",
        (*_TWO_FOCAL_LENGTHS, "k1", "k2", "p1", "p2", "k3", "k4", "sx1", "sy1"),
        _FISHEYE,
    ),
    CameraModel(
        11,
        "RAD_TAN_THIN_PRISM_FISHEYE",
        (
            *_TWO_FOCAL_LENGTHS,
            "k0",
            "k1",
            "k2",
            "k3",
            "k4",
            "k5",
            "p0",
            "p1",
            "s0",
            "s1",
            "s2",
            "s3",
        ),
        None,
    ),
    CameraModel(12, "SIMPLE_DIVISION", (*_ONE_FOCAL_LENGTH, "k"), DivisionLens()),
    CameraModel(13, "DIVISION", (*_TWO_FOCAL_LENGTHS, "k"), DivisionLens()),
    CameraModel(14, "SIMPLE_FISHEYE", _ONE_FOCAL_LENGTH, _FISHEYE),
    CameraModel(15, "FISHEYE", _TWO_FOCAL_LENGTHS, _FISHEYE),
    CameraModel(16, "EUCM", (*_TWO_FOCAL_LENGTHS, "alpha", "beta"), UnifiedLens()),
    CameraModel(17, "EQUIRECTANGULAR", ("w", "h"), EquirectangularLens()),
)
"""The camera models of COLMAP 4.2."""
CAMERA_MODEL_BY_NAME: Mapping[str, CameraModel] = {m.name: m for m in CAMERA_MODELS}
CAMERA_MODEL_BY_NUMBER: Mapping[int, CameraModel] = {m.number: m for m in CAMERA_MODELS}
READABLE_NAMES = [m.name for m in CAMERA_MODELS if m.lens is not None]
"""Names of the models that have a lens model here."""


def normalised_lens(lens: Lens, values: Mapping[str, float]) -> tuple[type[Lens], dict[str, float]]:
    """Return the lens as one of COLMAP's kind where it is the same function, with its parameters.

    `BrownForwardLens` subtracts its terms, k_i in 1/px^2i: k_i → −k_i c^2i, p → −p c. The affinity
    and shear of `AffineNormalisedLens` are in pixels, and its k4 is that of r⁸, ``k4 r8`` here.
    """
    out = dict(values)
    c = values["c"]
    if isinstance(lens, AffineNormalisedLens):
        out |= {"b1": values["b1"] / c, "b2": values["b2"] / c, "k4 r8": out.pop("k4")}
        return NormalisedLens, out
    if not isinstance(lens, BrownForwardLens):
        return type(lens), out
    for name, power in (("k1", 2), ("k2", 4), ("k3", 6), ("p1", 1), ("p2", 1)):
        out[name] = -values[name] * c**power
    return NormalisedLens, out


def candidate_models(lens: type[Lens]) -> list[CameraModel]:
    """Return the models of COLMAP that a lens model may be, those with fewest parameters first."""
    tangents = (Lens, NormalisedLens, RationalLens)
    kind = tangents if lens in tangents else (lens,)
    found = [m for m in CAMERA_MODELS if type(m.lens) in kind]
    return sorted(found, key=lambda m: (len(m.parameters), m.number))


def smallest_model(lens: type[Lens], used: set[str]) -> CameraModel | None:
    """Return the model of COLMAP with fewest parameters that has those ``used``; None: none has.

    Args:
        lens: the lens model.
        used: its parameters that are not zero, or not held, besides c, x0 and y0.
    """
    for model in candidate_models(lens):
        has = {*model.own, *(("b1",) if model.two_focal_lengths else ())}
        if used <= has:
            return model
    return None
