"""Mounts, drifts, sizes and levels as a network states them."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga


def stated() -> fga.Network:
    network = fga.Network("stated")
    network.set_mount("imu", free=("rx", "ry"), sigma={"x": 0.01}, values={"x": 0.3, "rz": 0.1})
    network.set_drift("strip 1", free=("x", "y", "z"), sigma={"x_t": 0.1})
    network.set_size("radius")
    network.set_size("sag", 0.1, sigma=0.02)
    network.set_level("lake", 371.5, fixed=True)
    return network


def test_components_are_held_unless_they_are_free_or_weighted() -> None:
    network = stated()
    mount, drift = network.mounts["imu"], network.drifts["strip 1"]
    assert mount.fixed == (False, False, True, False, True, True)
    assert mount.values == (0.0, 0.0, 0.1, 0.3, 0.0, 0.0)
    assert drift.fixed == (False,) * 4 + (True,) * 5
    assert drift.sigma[3] == 0.1
    assert network.levels["lake"].fixed == (True,)
    assert np.isnan(network.sizes["radius"].values[0])


def test_a_project_keeps_them_to_the_bit(tmp_path) -> None:
    network = stated()
    fga.write_project(network, tmp_path / "project.toml")
    again = fga.read_project(tmp_path / "project.toml")
    for kind in ("mount", "drift", "size", "level"):
        first, second = network.of_kind(kind), again.of_kind(kind)
        assert list(first) == list(second)
        for a, b in zip(first.values(), second.values(), strict=True):
            assert (a.fixed, a.sigma) == (b.fixed, b.sigma)
            assert np.array_equal(a.values, b.values, equal_nan=True)


@pytest.mark.parametrize(
    ("state", "message"),
    [
        (
            lambda n: n.set_mount("m", free=("rw",)),
            "mount 'm': free must be some of rx, ry, rz, x, y, z, not 'rw'",
        ),
        (lambda n: n.set_mount("m", sigma={"rz": 1.0}), "weight rx and ry, the tilts"),
        (lambda n: n.set_drift("d", free=("x",), sigma={"x": 1.0}), "x: either free or sigma"),
        (lambda n: n.set_drift("d", values={"x": np.inf}), "values must be finite"),
        (lambda n: n.set_size("s", fixed=True), "size 's': it is held or weighted, and has no"),
        (lambda n: n.set_level("w", np.inf), "values must be finite"),
    ],
)
def test_what_is_wrong_is_named(state, message: str) -> None:
    with pytest.raises(fga.InputError, match=message):
        state(fga.Network("wrong"))
