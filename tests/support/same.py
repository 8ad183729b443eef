"""Comparison of networks to the bit."""

from __future__ import annotations

import math
from copy import deepcopy
from dataclasses import fields, is_dataclass

import numpy as np

from factorgraph_adj.network.network import Network

PARTS = (
    *("name", "frame", "datum", "points", "cameras", "photos", "orientations", "refractions"),
    *("verticals", "distance_meters", "observations", "clusters"),
)


def assert_same(a: object, b: object, where: str = "") -> None:
    """Compare to the bit, but for ids that the network gave and sources."""
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        assert np.array_equal(np.asarray(a), np.asarray(b), equal_nan=True), where
    elif isinstance(a, dict):
        assert list(a) == list(b), where
        for key in a:
            assert_same(a[key], b[key], f"{where}[{key!r}]")
    elif isinstance(a, list | tuple):
        assert len(a) == len(b), where
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            assert_same(x, y, f"{where}[{i}]")
    elif is_dataclass(a):
        assert type(a) is type(b), where
        for f in fields(a):
            if f.name not in ("source", "id"):
                assert_same(getattr(a, f.name), getattr(b, f.name), f"{where}.{f.name}")
    elif isinstance(a, float):
        both_nan = math.isnan(a) and math.isnan(b)
        same = a == b and math.copysign(1, a) == math.copysign(1, b)
        assert same or both_nan, (where, a, b)
    else:
        assert a == b, (where, a, b)


def assert_same_network(a: Network, b: Network) -> None:
    """Compare two networks to the bit."""
    for part in PARTS:
        assert_same(getattr(a, part), getattr(b, part), part)
    assert_same(a.images.columns(), b.images.columns(), "images")
    assert_same(a.images.correlation, b.images.correlation, "correlations of image points")
    assert a.images.ids == b.images.ids
    assert_same(a.images.joint, b.images.joint, "joint covariances of image points")


def contents(network: Network) -> dict[str, object]:
    """Return everything that a network says, in a form that can be compared."""
    said = {k: deepcopy(v) for k, v in vars(network).items() if k not in ("images", "clusters")}
    said["images"] = [c.tolist() for c in network.images.columns()]
    said["image correlations"] = network.images.correlation.tolist()
    said["image ids"] = dict(network.images.ids)
    said["joint image points"] = [(r.tolist(), q.tolist()) for r, q in network.images.joint]
    said["clusters"] = [(ids, c.tolist()) for ids, c in network.clusters]
    for name in ("photos", "observations"):  # arrays inside do not compare
        said[name] = repr(said[name])
    return said
