"""Start values along relative poses: members, carriers, mounts, odometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from factorgraph_adj import ApproximationError, LocalFrame, Network, adjust
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.models.unknown_registry import UNKNOWNS
from factorgraph_adj.observations import ImagePoint, RelativePosition, RelativeRotation
from factorgraph_adj.rotation import log_rotation
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.start.approximate_values import partial_approximation
from tests.networks.odometry import odometry
from tests.networks.rigs import MOUNTS, PARTS, on_mount, rig

EVERY = 32


def cold(network: Network, *, mounts: bool = False) -> Network:
    """Return the network without values of free photos and points, and of mounts if asked for."""
    out = network.copy()
    out.photos = {
        n: f if any(f.fixed) else replace(f, position=None, rotation=None)
        for n, f in network.photos.items()
    }
    out.points = {
        n: p if p.held else replace(p, coordinates=(np.nan,) * 3) for n, p in network.points.items()
    }
    if mounts:
        for name, p in network.mounts.items():
            out.mounts[name] = replace(p, values=(0.0,) * 6)
    return out


def photos_off(network: Network, truth: Network) -> float:
    """Return by how much start values of photos are off at most, metres and radians."""
    state, problems = partial_approximation(compile_network(network))
    assert not problems
    off = 0.0
    for (name, f), at in zip(truth.photos.items(), state["pose"], strict=True):
        assert f.rotation is not None
        turn = log_rotation((f.rotation.T @ at[:9].reshape(3, 3))[None])
        off = max(off, float(np.abs(turn).max()), float(np.abs(at[9:] - f.position).max()))
        assert np.isfinite(off), name
    return off


def test_members_without_points_follow_their_carriers_and_carriers_their_members() -> None:
    true = rig(4, free=(), held_points=EVERY)
    network = measure(true, seed=1)
    photos = list(network.photos)
    for gone in ("back", "E"):  # members of one mount; then all carriers
        seen = [f.endswith("back") if gone == "back" else " " not in f for f in photos]
        less = network.copy()
        less.image_mask(~np.array(seen)[network.images.columns()[0]])
        assert photos_off(cold(less), true) < 0.1  # of a resection with few points


def test_unknown_mounts_come_from_photos_that_were_resected_on_both_sides() -> None:
    true = rig(6, held_points=EVERY)
    network = cold(measure(true, seed=1), mounts=True)
    state, problems = partial_approximation(compile_network(network))
    assert not problems
    given = UNKNOWNS["mount"].given(state["mount"])[1:]
    for name, found in zip(network.mounts, given, strict=True):
        assert np.abs(found - MOUNTS[name]).max() < 0.03
    assert adjust(network).converged


def test_one_photo_in_a_wrong_place_does_not_spoil_a_mount() -> None:
    network = measure(rig(6, held_points=EVERY), seed=1)
    for name in network.mounts:
        network.mounts[name] = replace(network.mounts[name], values=(0.0,) * 6)
    wrong = network.photos["E3 left"]
    assert wrong.position is not None
    network.photos["E3 left"] = replace(wrong, position=(9.0, 9.0, 9.0), rotation=np.eye(3))
    state, _ = partial_approximation(compile_network(network))
    found = UNKNOWNS["mount"].given(state["mount"])[1 + list(network.mounts).index("left")]
    assert np.abs(found - MOUNTS["left"]).max() < 0.01


def test_held_components_of_a_mount_are_kept() -> None:
    true = rig(6, free=PARTS[3:], held_points=EVERY)
    network = measure(true, seed=1)
    values = network.mounts["left"].values
    network.mounts["left"] = replace(network.mounts["left"], values=(*values[:3], 0.0, 0.0, 0.0))
    state, _ = partial_approximation(compile_network(network))
    found = UNKNOWNS["mount"].given(state["mount"])[1 + list(network.mounts).index("left")]
    assert found[:3] == pytest.approx(values[:3], abs=1e-12)
    assert np.abs(found[3:] - values[3:]).max() < 0.01


def test_odometry_leads_from_the_first_photo_to_all() -> None:
    true = odometry(30)
    assert photos_off(cold(measure(true, seed=1)), true) < 0.3


def test_a_free_network_of_odometry_starts_anywhere() -> None:
    true = odometry(8)
    network = cold(measure(true, seed=1))
    network.photos["F0"] = replace(
        network.photos["F0"], fixed=(False,) * 6, position=None, rotation=None
    )
    network.datum = "free"
    state, problems = partial_approximation(compile_network(network), datum="free")
    assert not problems
    assert np.isfinite(state["pose"]).all()
    a, b = (np.linalg.norm(s[4] - s[0]) for s in (state["pose"][:, 9:], positions(true)))
    assert a == pytest.approx(float(b), abs=0.1)


def positions(network: Network) -> np.ndarray:
    """Return the projection centres."""
    return np.array([f.position for f in network.photos.values()])


def test_a_calibrated_stereo_rig_starts_a_free_network_without_any_coordinates() -> None:
    network = Network("stereo", frame=LocalFrame(), datum="free")
    network.add_camera("camera", NoDistortion(), {"c": 10.0})
    mount = (0.0, 0.05, 0.0, 0.8, 0.0, 0.0)
    network.set_mount("right", values=dict(zip(PARTS, mount, strict=True)))
    rng = np.random.default_rng(2)
    for i in range(20):
        network.add_point(f"P{i}", rng.uniform((-3, -3, 6), (3, 3, 10)))
    for i in range(3):
        at = np.array([0.5 * i, 0.2 * i, 0.0])
        turned, centre = on_mount(np.eye(3), at, mount)
        network.add_photo(f"L{i}", "camera", position=at, rotation=np.eye(3))
        network.add_photo(
            f"R{i}", "camera", position=centre, rotation=turned, carrier=f"L{i}", mount="right"
        )
    for photo in network.photos:
        for point in network.points:
            network.add(ImagePoint(photo, point, 0.0, 0.0, sigma=0.002))
    s = adjust(cold(measure(network, seed=3)))
    assert s.converged
    assert s.datum_defect == 6
    x, y = (np.array(network.points[n].coordinates) for n in ("P0", "P9"))
    apart = float(np.linalg.norm(x - y))
    assert float(np.linalg.norm(s.point("P0") - s.point("P9"))) == pytest.approx(apart, rel=0.01)


def test_photos_that_are_not_reached_are_told_why() -> None:
    network = cold(measure(rig(3, free=(), held_points=3), seed=1))
    with pytest.raises(ApproximationError, match="all photos that its relative poses lead to"):
        adjust(network)
    network = cold(measure(odometry(4, closures=0, joint=False), seed=1))
    del network.observations["step 1 2"]
    with pytest.raises(ApproximationError, match="its 2 relative poses lack the rotation"):
        adjust(network)
    network = Network("one pair")
    network.add_camera("camera", NoDistortion(), {"c": 10.0})
    network.add_photo("A", "camera", position=(0, 0, 0), rotation=np.eye(3), fixed=True)
    network.add_photo("B", "camera")
    network.set_mount("arm", free=PARTS)
    zero, one = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
    network.add(
        RelativeRotation("A", "B", zero, sigma=one, mount="arm"),
        RelativePosition("A", "B", zero, sigma=one, mount="arm"),
    )
    with pytest.raises(ApproximationError, match="its mount is unknown"):
        adjust(network)
