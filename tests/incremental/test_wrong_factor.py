"""Factors that arrive and whose Jacobian or noise model is not what a test needs are refused."""

from __future__ import annotations

from collections.abc import Callable

import gtsam
import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import ControlPoint

SIGMA = gtsam.noiseModel.Isotropic.Sigma(1, 0.002)


def known() -> fga.IncrementalAdjustment:
    """Two points that are known to a centimetre."""
    network = fga.Network("two points")
    for name, x in (("P", 0.0), ("Q", 10.0)):
        network.add_point(name, (x, 0.0, 0.0))
        network.add(ControlPoint(name, (x, 0.0, 0.0), sigma=(0.01,) * 3))
    return fga.IncrementalAdjustment(network)


def tape(sign: float) -> Callable[[Callable[[str, str], int]], gtsam.NoiseModelFactor]:
    """Return a taped distance of 10 m whose Jacobian has a factor."""

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, h: list[np.ndarray] | None):
        p, q = map(values.atVector, factor.keys())
        way = q - p
        if h is not None:
            e = way / np.linalg.norm(way)
            h[0], h[1] = -sign * e[None], sign * e[None]
        return np.array([np.linalg.norm(way) - 10.0])

    return lambda key: gtsam.CustomFactor(SIGMA, [key("point", "P"), key("point", "Q")], error)


def test_a_right_one_is_accepted() -> None:
    (verdict,) = known().add(factors={"tape": tape(1.0)}).verdicts
    assert verdict.verdict == "accepted"


@pytest.mark.parametrize("sign", [-1.0, 0.3])
def test_a_wrong_jacobian_is_refused_by_name_and_nothing_changes(sign: float) -> None:
    inc = known()
    before = inc.estimate("Q")
    with pytest.raises(fga.InputError, match="tape"):
        inc.add(factors={"tape": tape(sign)})
    assert len(inc) == 2
    assert np.array_equal(inc.estimate("Q"), before)


def test_a_robust_noise_model_is_refused_by_name() -> None:
    robust = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(1.345), SIGMA)
    with pytest.raises(fga.InputError, match="'tape': has a robust noise model"):
        known().add(
            factors={
                "tape": lambda key: gtsam.RangeFactor3(
                    key("point", "P"), key("point", "Q"), 10.0, robust
                )
            }
        )
