"""The strip of TsaiYoung as relative orientations, independent models, and one block of models."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.observations import FrameCoordinate
from factorgraph_adj.types import Array
from tests.loaders.tsaiyoung import PRINCIPAL_DISTANCE, Pair, Strip
from tests.networks.similarity import SEVEN

SIGMA_IMAGE = 0.001
"""Standard deviation of image coordinates, millimetres: σ0 is then in micrometres."""
BASE = 92.0
"""Length of the base along x in all models, millimetres: about that of the photos, 91 to 94."""
SIGMA_MODEL, SIGMA_CENTRE = (0.006, 0.006, 0.010), (0.015,) * 3
"""Standard deviations of model coordinates at image scale, millimetres."""


@dataclass(frozen=True)
class Model:
    """A model of two photos at image scale."""

    sigma0: float
    """Of the relative orientation, micrometres."""
    redundancy: int
    points: dict[str, Array]
    """Model coordinates, millimetres."""
    centres: dict[str, Array]
    """Projection centres, millimetres."""


def relatively_oriented(pair: Pair) -> Model:
    """Return the model of two photos: the left one and the length of the base along x are held."""
    network = fga.Network(f"{pair.left}-{pair.right}")
    network.add_camera("camera", NoDistortion(), {"c": PRINCIPAL_DISTANCE})
    held = ((True,) * 6, (False, False, False, True, False, False))
    for name, x, fixed in zip((pair.left, pair.right), (0.0, BASE), held, strict=True):
        network.add_photo(
            name, "camera", position=(x, 0.0, 0.0), omega_phi_kappa=(0.0, 0.0, 0.0), fixed=fixed
        )
    for name, (a, b) in pair.images.items():
        scale = BASE / (a[0] - b[0])
        network.add_point(name, (scale * a[0], scale * a[1], -scale * PRINCIPAL_DISTANCE))
    for i, photo in enumerate((pair.left, pair.right)):
        xy = np.array([images[i] for images in pair.images.values()])
        network.add_image_points(photo, list(pair.images), xy, sigma=SIGMA_IMAGE)
    solution = fga.adjust(network, tolerance=1e-8)
    return Model(
        solution.sigma0,
        solution.redundancy,
        {n: solution.point(n) for n in network.points},
        {n: solution.pose(n).position for n in network.photos},
    )


def block_of_models(strip: Strip, models: tuple[Model, ...]) -> fga.Network:
    """Return the models as frames with seven components, control held; nothing has start values.

    Projection centres are points of the network, as no image is in it.
    """
    network = fga.Network("strip of models")
    for name in dict.fromkeys(n for m in models for n in m.points):
        at = strip.control.get(name)
        network.add_point(name, at, fixed="" if at is None else "xyz")
    for name in dict.fromkeys(n for m in models for n in m.centres):
        network.add_point(f"photo {name}")
    middle = np.mean(list(strip.control.values()), axis=0)
    for i, model in enumerate(models, 1):
        frame = f"model {i}"
        network.add_frame(frame, free=SEVEN, origin=tuple(middle.tolist()))
        for name, x in model.points.items():
            network.add(FrameCoordinate(frame, name, tuple(x.tolist()), sigma=SIGMA_MODEL))
        for name, x in model.centres.items():
            at = tuple(x.tolist())
            network.add(FrameCoordinate(frame, f"photo {name}", at, sigma=SIGMA_CENTRE))
    return network


def network_of_photos(strip: Strip) -> fga.Network:
    """Return the strip as photos, control held, check points with their known coordinates.

    The photos start level, `BASE` apart along a line; a similarity in plan turns, scales and shifts
    them so that their images of control points lie on these. Points have no start values.
    """
    network = fga.Network("strip of photos")
    network.add_camera("camera", NoDistortion(), {"c": PRINCIPAL_DISTANCE})
    images: dict[str, dict[str, Array]] = {}
    for pair in strip.pairs:
        for name, (a, b) in pair.images.items():
            images.setdefault(pair.left, {})[name] = a
            images.setdefault(pair.right, {})[name] = b
    for name in dict.fromkeys(n for found in images.values() for n in found):
        at = strip.control.get(name)
        check = strip.check.get(name)
        network.add_point(name, at, fixed="" if at is None else "xyz", check=check)
    both = [
        (complex(BASE * k + xy[0], xy[1]), complex(*strip.control[name][:2]))
        for k, found in enumerate(images.values())
        for name, xy in found.items()
        if name in strip.control
    ]
    design = np.array([(1.0, s) for s, _ in both])
    (shift, turn), *_ = np.linalg.lstsq(design, np.array([x for _, x in both]), rcond=None)
    ground = float(np.mean([x[2] for x in strip.control.values()]))
    height = ground + PRINCIPAL_DISTANCE * abs(turn)
    for k, (photo, found) in enumerate(images.items()):
        at = shift + turn * BASE * k
        network.add_photo(
            photo,
            "camera",
            position=(at.real, at.imag, height),
            omega_phi_kappa=(0.0, 0.0, float(np.angle(turn))),
        )
        network.add_image_points(photo, list(found), np.array([*found.values()]), sigma=SIGMA_IMAGE)
    return network
