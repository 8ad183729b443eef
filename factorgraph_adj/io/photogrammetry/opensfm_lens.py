"""Cameras of OpenSfM and ODM as lens models, and back.

OpenSfM divides image coordinates by the larger side of the image; their origin is the middle of
the image, y points down. With (x, y) of a ray, r² = x² + y²:

    u = f (x d + 2 p1 x y + p2 (r² + 2x²)) + cx,   v likewise with p1 and p2 exchanged

OpenSfM counts pixels from the centre of the first one, so that its middle of the image is at
((w − 1)/2, (h − 1)/2): w/2, h/2 from the upper left corner of the image.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ...models.affine_normalised import AffineNormalisedLens
from ...models.lens import Lens, NormalisedLens
from ...models.ray_lens import FisheyeLens
from ..json_tree import Node

PARAMETERS = {
    "perspective": ("focal", "k1", "k2"),
    "simple_radial": ("focal_x", "focal_y", "c_x", "c_y", "k1"),
    "radial": ("focal_x", "focal_y", "c_x", "c_y", "k1", "k2"),
    "fisheye": ("focal", "k1", "k2"),
    "fisheye_opencv": ("focal_x", "focal_y", "c_x", "c_y", "k1", "k2", "k3", "k4"),
    "brown": ("focal_x", "focal_y", "c_x", "c_y", "k1", "k2", "p1", "p2", "k3"),
}
"""Parameters of the projections that can be read."""
FISHEYES = ("fisheye", "fisheye_opencv")
"""Projections by the angle θ = atan(ρ/z) in place of the tangent: u = f θ (1 + k1 θ² + …) x/ρ."""
IGNORED = ("projection_type", "width", "height", "focal_prior", "k1_prior", "k2_prior")
"""Members of a camera besides its parameters."""


@dataclass(frozen=True)
class SfmCamera:
    """A camera in pixels from the upper left corner, y up."""

    lens: Lens
    """The lens model."""
    values: dict[str, float]
    """Calibration by name, pixels."""
    size: tuple[float, float]
    """Width and height, pixels."""
    estimated: tuple[str, ...]
    """Parameters that OpenSfM estimates."""

    @property
    def side(self) -> float:
        """The larger side, pixels."""
        return max(self.size)

    def pixel(self, x: float, y: float) -> tuple[float, float]:
        """Return image coordinates, y up, of normalised ones, y down."""
        return self.size[0] / 2 + self.side * x, -self.size[1] / 2 - self.side * y


def read_camera(node: Node) -> SfmCamera:
    """Read a camera of a reconstruction.

    Raises:
        InputError: the projection is none that can be read, or a parameter is missing or unknown.
    """
    kind = node.get("projection_type")
    projection = "perspective" if kind is None else kind.text()
    names = PARAMETERS.get(projection)
    if names is None:
        valid = ", ".join(PARAMETERS)
        raise (kind or node).fail(f"projection {projection!r} cannot be read; valid: {valid}")
    unknown = [k for k in node.members() if k not in (*names, *IGNORED)]
    if unknown:
        raise node.fail(f"unknown parameter {unknown[0]!r} of {projection}; valid: {names}")
    size = (node.need("width").number(positive=True), node.need("height").number(positive=True))
    side = max(size)
    said: dict[str, float] = {}
    for name in names:
        member = node.need(name) if name.startswith("focal") else node.get(name)
        if member is not None:
            said[name] = member.number(positive=name.startswith("focal"))
    fx = side * said.get("focal_x", said.get("focal", 0.0))
    fy = side * said.get("focal_y", said.get("focal", 0.0))
    values = {"c": fy, "x0": size[0] / 2 + side * said.get("c_x", 0.0)}
    values["y0"] = -size[1] / 2 - side * said.get("c_y", 0.0)
    values |= {k: said.get(k, 0.0) for k in ("k1", "k2", "k3")}
    values |= {"p1": said.get("p2", 0.0), "p2": -said.get("p1", 0.0)}
    estimated = ["c", *(k for k in ("k1", "k2", "k3") if k in names)]
    if "c_x" in names:
        estimated += ["x0", "y0", "b1"]
    if "p1" in names:
        estimated += ["p1", "p2"]
    lens: Lens = NormalisedLens()
    if projection in FISHEYES:
        lens = FisheyeLens()
        values |= {"b1": fx / fy - 1.0, "k4": said.get("k4", 0.0)}
        estimated += ["k4"] if "k4" in names else []
    elif "focal_x" in names:
        lens = AffineNormalisedLens()
        values |= {"b1": fx - fy}
    return SfmCamera(lens, values, size, tuple(n for n in lens.names if n in estimated))


def write_camera(
    lens: Lens, values: Mapping[str, float], size: tuple[float, float]
) -> dict[str, object] | None:
    """Return a camera of a reconstruction; None if OpenSfM has no such lens.

    Args:
        lens: the lens model.
        values: its parameters by name, pixels from the upper left corner, y up.
        size: width and height, pixels.
    """
    if type(lens) not in (Lens, NormalisedLens, AffineNormalisedLens):
        return None
    k = {n: values.get(n, 0.0) for n in AffineNormalisedLens().names}
    if k["k4"] or k["b2"]:
        return None
    side = max(size)
    out: dict[str, object] = {"projection_type": "brown", "width": size[0], "height": size[1]}
    out |= {"focal_x": (k["c"] + k["b1"]) / side, "focal_y": k["c"] / side}
    out |= {"c_x": (k["x0"] - size[0] / 2) / side, "c_y": (-k["y0"] - size[1] / 2) / side}
    out |= {n: k[n] for n in ("k1", "k2", "k3")}
    return out | {"p1": -k["p2"] if k["p2"] else 0.0, "p2": k["p1"]}
