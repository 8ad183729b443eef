"""COLMAP's camera models: image coordinates and rays of pycolmap."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from factorgraph_adj.io.photogrammetry.colmap_cameras import (
    CAMERA_MODEL_BY_NAME,
    CAMERA_MODELS,
    READABLE_NAMES,
    candidate_models,
    normalised_lens,
    smallest_model,
)
from factorgraph_adj.models.inverse_lens import directions
from factorgraph_adj.models.lens import BrownForwardLens, Lens, NormalisedLens
from factorgraph_adj.models.normalised_lens import AffineNormalisedLens, RationalLens
from factorgraph_adj.models.ray_lens import RayLens

DISTORTION = {"k": -0.12, "k1": -0.12, "k2": 0.05, "k3": -0.01, "k4": 0.002, "k5": 0.01}
DISTORTION |= {"k6": -0.004, "p1": 2e-3, "p2": -1.5e-3, "sx1": 1e-3, "sy1": -2e-3}
DISTORTION |= {"omega": 0.9, "alpha": 0.6, "beta": 1.1}
FOCAL = {"f": 700.0, "fx": 690.0, "fy": 710.0, "cx": 512.3, "cy": 380.9, "w": 1000.0, "h": 500.0}


def colmap_camera(name: str) -> Any:
    pycolmap = pytest.importorskip("pycolmap")
    parameters = [(FOCAL | DISTORTION)[p] for p in CAMERA_MODEL_BY_NAME[name].parameters]
    return pycolmap.Camera(model=name, width=1000, height=500, params=parameters)


def test_table_of_models_is_that_of_pycolmap() -> None:
    pycolmap = pytest.importorskip("pycolmap")
    numbers = {
        name: int(value)
        for name, value in pycolmap.CameraModelId.__members__.items()
        if name != "INVALID"
    }
    assert {m.name: m.number for m in CAMERA_MODELS} == numbers
    for model in CAMERA_MODELS:
        camera = pycolmap.Camera.create_from_model_name(1, model.name, 100.0, 100, 50)
        assert camera.params_info.replace(" ", "") == ",".join(model.parameters)


@pytest.mark.parametrize("name", READABLE_NAMES)
def test_image_coordinates_are_those_of_pycolmap(name: str) -> None:
    camera = colmap_camera(name)
    model = CAMERA_MODEL_BY_NAME[name]
    lens, values = model.lens, model.to_lens(camera.params)
    assert lens is not None
    k = np.array([[values.get(n, 0.0) for n in lens.names]])
    rng = np.random.default_rng(3)
    widest = np.radians(100.0 if isinstance(lens, RayLens) else 40.0)
    angle, turn = rng.uniform(0.0, widest, 400), rng.uniform(0.0, 2 * np.pi, 400)
    p = np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], 1)
    theirs = [camera.img_from_cam(ray) for ray in p]
    seen = np.array([t is not None for t in theirs])
    assert seen[angle < np.radians(40.0)].all()
    zero = np.zeros(seen.sum())
    x, y = lens.seen(tuple(p[seen].T), zero, zero, k, jacobians=False).v
    if name == "EQUIRECTANGULAR":
        x = x % 1000.0  # v is taken the shorter way round
    expected = np.array([t for t in theirs if t is not None])
    np.testing.assert_allclose(np.stack([x, -y], 1), expected, rtol=1e-12, atol=1e-9)
    near = angle[seen] < np.radians(60.0)
    back = directions(lens, np.stack([x, y], 1)[near], k)
    np.testing.assert_allclose(back, p[seen][near], atol=2e-8)
    assert model.from_lens(values, (1000, 500)) == pytest.approx(list(camera.params), rel=1e-14)


@pytest.mark.parametrize("name", READABLE_NAMES)
def test_smallest_model_of_all_parameters_of_a_model_is_itself(name: str) -> None:
    model = CAMERA_MODEL_BY_NAME[name]
    used = {*model.own, *(("b1",) if model.two_focal_lengths else ())}
    assert smallest_model(type(model.lens), used) is model


def test_frame_camera_of_metashape_has_the_affinity_in_pixels() -> None:
    values = {"c": 900.0, "x0": 500.0, "y0": -400.0, "k1": -0.1, "k2": 0.02, "k3": 1e-3}
    values |= {"p1": 1e-3, "p2": -2e-3, "b1": 4.0, "b2": -3.0, "k4": 0.0}
    kind, other = normalised_lens(AffineNormalisedLens(), values)
    assert kind is NormalisedLens
    t, xy = np.random.default_rng(5).uniform(-0.6, 0.6, (2, 20)), np.zeros((20, 2))
    given = other | {"k4": 0.0}
    v = []
    for lens, parameters in ((AffineNormalisedLens(), values), (RationalLens(), given)):
        k = np.array([[parameters.get(n, 0.0) for n in lens.names]])
        v.append(lens.residual(*t, xy, k, jacobians=False)[0])
    np.testing.assert_allclose(v[0], v[1], rtol=1e-13)
    assert smallest_model(kind, {"k1", "k2", "p1", "p2", "b1"}) is CAMERA_MODEL_BY_NAME["OPENCV"]
    assert smallest_model(kind, {"k1", "k4 r8"}) is None


def test_brown_forward_is_written_as_normalised_lens() -> None:
    values = {"c": 900.0, "x0": 500.0, "y0": -400.0, "k1": 1e-8, "k2": -2e-15, "k3": 1e-22}
    values |= {"p1": 1e-7, "p2": -2e-7}
    kind, other = normalised_lens(BrownForwardLens(), values)
    assert kind is NormalisedLens
    t, xy = np.random.default_rng(5).uniform(-0.6, 0.6, (2, 20)), np.zeros((20, 2))
    v = []
    for lens, given in ((BrownForwardLens(), values), (NormalisedLens(), other)):
        k = np.array([[given[n] for n in lens.names]])
        v.append(lens.residual(*t, xy, k, jacobians=False)[0])
    np.testing.assert_allclose(v[0], v[1], rtol=1e-13)


def test_lens_without_counterpart_has_no_model() -> None:
    assert smallest_model(RationalLens, {"b2"}) is None
    assert next(m.name for m in candidate_models(Lens)) == "SIMPLE_PINHOLE"
