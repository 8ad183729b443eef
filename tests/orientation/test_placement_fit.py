"""The fit of a part's place: partials, all starts side by side, starts that cannot be computed."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.blocks import Block
from factorgraph_adj.graph.equations import Equations, compile_network
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.models.similarity import Similarity
from factorgraph_adj.observations import (
    Azimuth,
    Direction,
    HeightDifference,
    HorizontalDistance,
    PhotoBase,
    PhotoPosition,
    ZenithAngle,
)
from factorgraph_adj.orientation.block_input import KnownPlaces, Views, given_places
from factorgraph_adj.orientation.block_placement import (
    MAX_FINE_STEPS,
    MAX_ROUGH_STEPS,
    _placement_rows,
    fit_placement,
)
from factorgraph_adj.orientation.partial_block import PartialBlock
from factorgraph_adj.orientation.robust_similarity import even_rotations
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.types import Array

FIRST = Similarity(2.0, np.eye(3), np.array([3.0, -2.0, 1.0]))
"""Where the fits begin."""
STEP = 1e-6
"""Change of a parameter by which misfits are differentiated for the comparison."""


class Part:
    """Five points and two photos in axes of their own, and what is measured among them."""

    def __init__(self, *, unplaced: bool = False) -> None:
        rng = np.random.default_rng(8)
        x = rng.uniform(-20.0, 20.0, (5, 3))
        centre = np.array([[0.0, -5.0, 60.0], [15.0, 5.0, 60.0]])
        rotation = exp_rotation(rng.normal(0.0, 0.1, (2, 3)))
        network = fga.Network("part", datum="given")
        names = [f"P{i}" for i in range(5)]
        for name in [*names, "Q"]:
            network.add_point(name)
        network.add_camera("K", BrownLens(), {"c": 30.0})
        for f in range(2):
            network.add_photo(f"F{f}", "K")
        for j in (1, 2, 3, 4):
            d = x[j] - x[0]
            across = float(np.hypot(d[0], d[1]))
            bearing = float(np.arctan2(d[0], d[1]))
            network.add(
                Direction("P0", names[j], (bearing - 0.7) % (2 * np.pi), sigma=1e-3),
                ZenithAngle("P0", names[j], float(np.arctan2(across, d[2])), sigma=1e-3),
                HorizontalDistance("P0", names[j], across, sigma=0.01),
                HeightDifference("P0", names[j], float(d[2]), sigma=0.01),
            )
        if unplaced:
            network.add(Direction("P0", "Q", 1.0, sigma=1e-3))
        d = x[2] - x[1]
        network.add(
            Azimuth("P1", "P2", float(np.arctan2(d[0], d[1])) % (2 * np.pi), sigma=1e-3),
            PhotoBase("F0", "F1", float(np.linalg.norm(centre[1] - centre[0])), sigma=0.01),
            PhotoPosition("F0", tuple(centre[0].tolist()), sigma=(0.01,) * 3),
        )
        for f in range(2):
            network.add_image_points(f"F{f}", names, rng.normal(0.0, 5.0, (5, 2)), sigma=1e-3)
        self.network, self.x = network, x
        self.equations: Equations = compile_network(network)
        self.known: KnownPlaces = given_places(self.equations)
        views = Views.of(network)
        growth = PartialBlock.empty(views, views.calibrations(), np.ones(views.n, dtype=bool))
        # Known axes of the part: turned by more than the fit begins with.
        self.own = Similarity(0.4, exp_rotation(np.array([0.9, -0.6, 1.4])), np.full(3, 7.0))
        back = self.own
        growth.point[:5] = (x - back.shift) @ back.rotation / back.scale
        growth.pose[:, 9:] = (centre - back.shift) @ back.rotation / back.scale
        growth.pose[:, :9] = (back.rotation.T @ rotation).reshape(-1, 9)
        self.growth = growth

    def misfits(self, p: Array, base: Array) -> tuple[Array, Array]:
        rows = _placement_rows(self.growth, self.equations, self.known)
        assert rows is not None
        return rows.misfits(p, base, FIRST)


def test_partials_of_misfits_are_their_differences():
    """Those of directions are by the mean of their set, whose orientation is a median."""
    part = Part()
    rng = np.random.default_rng(3)
    base, p = np.array(even_rotations())[[0, 5, 17]], rng.normal(0.0, 0.2, (3, 7))
    _, a = part.misfits(p, base)
    either = [
        [part.misfits(p + sign * STEP * e, base)[0] for sign in (1.0, -1.0)] for e in np.eye(7)
    ]
    slope = np.stack([(ahead - behind) / (2 * STEP) for ahead, behind in either], axis=2)
    rows = _placement_rows(part.growth, part.equations, part.known)
    assert rows is not None
    of_kind = np.repeat([b.kind for b in rows.chosen], [b.observed.size for b in rows.chosen])
    directions = np.append(of_kind == "direction", np.zeros(a.shape[1] - len(of_kind), dtype=bool))
    least = 1e-8 * np.abs(a).max()
    np.testing.assert_allclose(a[:, ~directions], slope[:, ~directions], rtol=1e-6, atol=least)
    own, theirs = (x[:, directions] for x in (a, slope))
    centred = theirs - theirs.mean(axis=1, keepdims=True)
    np.testing.assert_allclose(own, centred, rtol=1e-6, atol=least)


@pytest.mark.parametrize("unplaced", [False, True])
def test_the_place_is_found_from_far_away(unplaced):
    """A direction to a point that the part does not have takes nothing from the others."""
    part = Part(unplaced=unplaced)
    found = fit_placement(part.growth, part.equations, part.known, FIRST)
    assert found is not None
    assert found.open == 0
    np.testing.assert_allclose(found.to_frame.of(part.growth.point[:5]), part.x, atol=1e-4)


def test_all_starts_are_evaluated_side_by_side(monkeypatch):
    """The number of evaluations is that of the steps, not of the starts and parameters."""
    part = Part()
    calls = dict.fromkeys(("azimuth", "photo_base"), 0)
    evaluate = Block.evaluate

    def counted(self: Block, *arguments: object, **options: object) -> object:
        if self.kind in calls:
            calls[self.kind] += 1
        return evaluate(self, *arguments, **options)

    monkeypatch.setattr(Block, "evaluate", counted)
    assert fit_placement(part.growth, part.equations, part.known, FIRST) is not None
    most = 2 + MAX_ROUGH_STEPS + MAX_FINE_STEPS
    assert all(0 < n <= most for n in calls.values()), calls


def test_a_start_that_cannot_be_computed_leaves_the_others_as_they_are():
    """Points above each other have no azimuth."""
    part = Part()
    x = part.growth.point
    x[2] = x[1] + [0.0, 0.0, 5.0]
    base = np.array(even_rotations())
    p = np.zeros((len(base), 7))
    together, _ = part.misfits(p, base)
    alone = [part.misfits(p[i : i + 1], base[i : i + 1])[0][0] for i in range(len(base))]
    lost = np.isinf(together).any(axis=1)
    assert 0 < lost.sum() < len(base)
    np.testing.assert_array_equal(np.isinf(together), lost[:, None] & np.ones(together.shape, bool))
    for one, other in zip(together, alone, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)


def test_nothing_that_depends_on_the_place_gives_none():
    part = Part()
    for name in list(part.network.observations):
        del part.network.observations[name]
    equations = compile_network(part.network)
    assert fit_placement(part.growth, equations, given_places(equations), FIRST) is None
