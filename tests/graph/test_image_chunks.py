"""Image coordinates in chunks are those of the model, row by row."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph import image_blocks
from factorgraph_adj.graph.blocks import Block
from factorgraph_adj.graph.equations import Equations, compile_network
from factorgraph_adj.graph.image_blocks import ImageChunks
from factorgraph_adj.models.image import depth
from factorgraph_adj.models.lens import BrownLens, NormalisedLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ImagePoint
from factorgraph_adj.solve.linearised_rays import LinearRays
from tests.networks.small_block import plan, small_block


def own_calibrations() -> Network:
    """Every photo has a calibration."""
    network = small_block(4)
    network.cameras = {n: replace(c, per_photo=True) for n, c in network.cameras.items()}
    return network


def two_cameras() -> Network:
    """Photos of two cameras with different lenses, in turns; one has held parameters."""
    network = plan()
    network.add_camera("other", NormalisedLens(), {"c": 30.0, "k1": 0.01}, free=("c", "k1"))
    network.add_camera("third", BrownLens(), {"c": 28.0}, free=("x0",))
    for photo, camera in (("F2", "other"), ("F3", "third")):
        network.photos[photo] = replace(network.photos[photo], camera=camera)
    return network


def held_photo() -> Network:
    """One photo is held, another one in part."""
    network = small_block(4)
    network.photos["F1"] = replace(network.photos["F1"], fixed=True)
    return network


def rolling_shutter() -> Network:
    """Photos of a rolling shutter: one moves freely, one in part, one as given; others stand."""
    network = small_block(4)
    camera = network.cameras["D3"]
    network.cameras["D3"] = replace(
        camera, format=(36.0, 24.0), readout=0.03, readout_towards="right"
    )
    motion = (6.0, -2.0, 1.0, 0.5, -0.8, 0.6)
    network.set_unknown("photo_motion", "F1", motion)
    network.set_unknown("photo_motion", "F2", motion, fixed=("x_t", "ry_t"), sigma={"y_t": 1.0})
    network.set_unknown("photo_motion", "F3", motion, fixed=True)
    return network


NETWORKS = {
    "small block": lambda: small_block(4),
    "own calibrations": own_calibrations,
    "two cameras": two_cameras,
    "held photo": held_photo,
    "rolling shutter": rolling_shutter,
}


def compiled(name: str) -> Equations:
    return compile_network(NETWORKS[name]())


def of_rays(equations: Equations) -> list[tuple[ImageChunks, Block]]:
    return [(c, equations.blocks[place]) for place, c in equations.rays.items()]


@pytest.mark.parametrize("rays", [5, 12_000])
@pytest.mark.parametrize("name", NETWORKS)
def test_residuals_and_partials_are_those_of_the_model(
    name: str, rays: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Chunks of 5 rays divide photos; those of 12 000 join them."""
    monkeypatch.setattr(image_blocks, "RAYS", rays)
    equations = compiled(name)
    state = equations.unknowns.start()
    for chunks, block in of_rays(equations):
        assert all(c.rows.stop - c.rows.start <= rays for c in chunks.chunks)
        expected = block.evaluate(equations.network.frame, state)
        white = block.whiten(expected.residual)
        np.testing.assert_allclose(chunks.residuals(state), white, rtol=1e-12, atol=1e-9)
        np.testing.assert_allclose(
            chunks.residuals(state, whitened=False), expected.residual, rtol=1e-12, atol=1e-12
        )
        linear = LinearRays.at(chunks, state)
        np.testing.assert_array_equal(linear.residual(), chunks.residuals(state))
        for (kind, index), found, partials in zip(
            block.variables, linear.a, expected.jacobians, strict=True
        ):
            table = equations.unknowns[kind]
            if not (table.offset[index] >= 0).any():
                assert not len(found)
                continue
            wanted = block.whiten(partials) * table.free[index][:, None, : partials.shape[2]]
            scale = np.abs(wanted).max()
            np.testing.assert_allclose(found, wanted, rtol=1e-10, atol=1e-12 * scale)


@pytest.mark.parametrize("name", NETWORKS)
def test_weights_of_any_form_are_applied(name: str) -> None:
    equations = compiled(name)
    state = equations.unknowns.start()
    rng = np.random.default_rng(2)
    for _, block in of_rays(equations):
        n = block.n
        unequal = replace(block, sigma=rng.uniform(0.001, 0.01, (n, 2)))
        whitener = rng.normal(size=(n, 2, 2))
        for weighted in (unequal, replace(block, whitener=whitener)):
            chunks = ImageChunks(weighted, equations.unknowns)
            expected = weighted.evaluate(equations.network.frame, state)
            np.testing.assert_allclose(
                chunks.residuals(state), weighted.whiten(expected.residual), rtol=1e-11, atol=1e-8
            )
            linear = LinearRays.at(chunks, state)
            (kind, index), partials = weighted.variables[2], expected.jacobians[2]
            free = equations.unknowns[kind].free[index]
            wanted = weighted.whiten(partials) * free[:, None]
            np.testing.assert_allclose(
                linear.a[2], wanted, rtol=1e-9, atol=1e-11 * np.abs(wanted).max()
            )


@pytest.mark.parametrize("rays", [7, 12_000])
@pytest.mark.parametrize("name", NETWORKS)
def test_products_are_those_of_the_partials(
    name: str, rays: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(image_blocks, "RAYS", rays)
    equations = compiled(name)
    state = equations.unknowns.start()
    unknowns = equations.unknowns
    rng = np.random.default_rng(5)
    for chunks, block in of_rays(equations):
        linear = LinearRays.at(chunks, state)
        whole = np.zeros((block.n, 2, unknowns.n_columns))
        for (kind, index), a in zip(block.variables, linear.a, strict=True):
            for i in range(len(a)):
                columns = unknowns.columns(kind, int(index[i]))
                whole[i][:, columns] += a[i][:, : len(columns)]
        flat = whole.reshape(2 * block.n, -1)
        g, z = rng.normal(size=(unknowns.n_columns, 3)), rng.normal(size=(block.n, 2, 3))
        np.testing.assert_allclose(
            linear.times(g).reshape(2 * block.n, 3),
            flat @ g,
            rtol=1e-9,
            atol=1e-9 * np.abs(flat).max(),
        )
        out = np.zeros((unknowns.n_columns, 3))
        linear.add_transposed(out, z)
        wanted = flat.T @ z.reshape(-1, 3)
        np.testing.assert_allclose(out, wanted, rtol=1e-9, atol=1e-10 * np.abs(wanted).max())
        diagonal = np.zeros(unknowns.n_columns)
        linear.add_diagonal(diagonal)
        np.testing.assert_allclose(diagonal, np.sum(flat**2, axis=0), rtol=1e-11)
        gradient = np.zeros(unknowns.n_columns)
        linear.add_gradient(gradient)
        wanted = flat.T @ linear.residual().ravel()
        np.testing.assert_allclose(gradient, wanted, rtol=1e-9, atol=1e-10 * np.abs(wanted).max())
        of_points = np.zeros(unknowns.n_columns)
        linear.only(("point",)).add_gradient(of_points)
        columns = unknowns["point"].columns
        np.testing.assert_array_equal(of_points[columns], gradient[columns])
        assert not np.delete(of_points, np.arange(columns.start, columns.stop)).any()
        some = np.sort(rng.permutation(block.n)[:11])
        for part, every in zip(linear.partials(some), linear.a, strict=True):
            np.testing.assert_array_equal(part, every[some] if len(every) else every)
        only = linear.only(["point"])
        assert not len(only.a[0]) and len(only.a[2]) == block.n
        np.testing.assert_array_equal(only.times(g).shape, (block.n, 2, 3))


@pytest.mark.parametrize("name", NETWORKS)
def test_depths_are_those_of_the_model(name: str) -> None:
    equations = compiled(name)
    state = equations.unknowns.start()
    for chunks, block in of_rays(equations):
        photo, point = block.variables[0][1], block.variables[2][1]
        wanted = depth(state["pose"][photo], state["point"][point])
        np.testing.assert_allclose(chunks.depths(state), wanted, rtol=1e-12)


def test_all_rays_in_a_focal_plane_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of every chunk, at once."""
    monkeypatch.setattr(image_blocks, "RAYS", 2)
    network = fga.Network("focal plane")
    network.add_camera("camera", BrownLens(), {"c": 50.0})
    for i in range(3):
        network.add_photo(f"f{i}", "camera", position=(0.0, 0.0, 20.0), rotation=np.eye(3))
    for name, z in (("P", 0.0), ("Q", 20.0)):
        network.add_point(name, (1.0, 2.0, z))
        for i in range(3):
            network.add(ImagePoint(f"f{i}", name, 0.0, 0.0, sigma=0.01))
    equations = compile_network(network)
    with pytest.raises(fga.InputError) as caught:
        equations.residuals(equations.unknowns.start())
    assert [p.where for p in caught.value.problems] == [f"image f{i} Q" for i in range(3)]
