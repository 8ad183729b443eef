"""Records of kinds of observations: wrong ones raise, right ones weigh as they say."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.base import Linearised
from factorgraph_adj.models.shape_outlines import LINE, SPHERE
from factorgraph_adj.models.unknown_registry import unknown_kind
from factorgraph_adj.observations import (
    KINDS,
    Observation,
    ObservationKind,
    SlopeDistance,
    Weight,
    observation_kind,
    register_observation,
)
from factorgraph_adj.observations.variances import LENGTHS
from tests.networks.extension import (
    SAME_POINT,
    SamePoint,
    registered,
)


@pytest.fixture(autouse=True)
def kinds() -> Iterator[None]:
    """Let the package know the kinds of `tests.networks.extension`."""
    with registered():
        yield


@dataclass(frozen=True)
class Interval(SlopeDistance):
    """A distance by another instrument."""

    kind: ClassVar[str] = "interval"


@dataclass(frozen=True)
class Nameless(SlopeDistance):
    """A class without a name of a kind."""

    kind: ClassVar[str] = ""


@dataclass(frozen=True)
class Several(SamePoint):
    """A vector whose components cannot be names of columns."""

    kind: ClassVar[str] = "several"
    components: ClassVar[tuple[str, ...]] = ("U", "v v")


def _no_answer(frame: Any, a: Any, b: Any, c: Any, *, observed: Any) -> Linearised:
    raise NotImplementedError


INTERVAL = replace(KINDS["slope_distance"], observation=Interval)


@pytest.mark.parametrize(
    ("kind", "what"),
    [
        (SAME_POINT, "a kind of this name is registered already"),
        (replace(INTERVAL, observation=Nameless), "no name of a kind"),
        (replace(INTERVAL, weight=None), "weight must say how they make a variance"),
        (replace(INTERVAL, weight=Weight(LENGTHS.variance, ("length",))), "parts of its weight"),
        (replace(INTERVAL, variables=(("place", "station"),)), "unknown kind of unknowns 'place'"),
        (replace(INTERVAL, variables=(("point", "from"),)), "no attribute 'from'"),
        (replace(INTERVAL, variables=()), "its variables are missing"),
        (replace(INTERVAL, constants=("width",)), "no attribute 'width' for a constant"),
        (replace(INTERVAL, constants=()), "its model needs the keyword 'instrument_height'"),
        (replace(INTERVAL, model=_no_answer), "its model has no keyword 'instrument_height'"),
        (replace(INTERVAL, variables=(("point", "station"),)), "must take the frame and 1"),
        (replace(INTERVAL, model=3), "its model must be a function"),
        (replace(INTERVAL, unit="foot"), "its unit must be m, rad"),
        (replace(INTERVAL, circular=True), "its unit must be rad"),
        (replace(SAME_POINT, observation=Several), "names of its components are columns"),
        (replace(INTERVAL, instrument="edm"), "instrument 'edm' must be an attribute that names"),
        (replace(INTERVAL, outline=SPHERE), "no attribute 'radius' for its outline"),
        (replace(INTERVAL, outline=LINE), "it must name a frame and a point"),
        (replace(INTERVAL, observation=int), "must be a frozen dataclass derived from Observation"),
    ],
)
def test_a_wrong_kind_of_observation_is_refused(kind: ObservationKind, what: str) -> None:
    with pytest.raises(fga.InputError, match=what):
        register_observation(kind)


def test_a_kind_that_is_not_registered_is_refused_when_it_is_made() -> None:
    with pytest.raises(
        fga.InputError, match="unknown kind of observation 'interval'; valid: slope"
    ):
        Interval("A", "B", 10.0, sigma=0.002)
    with pytest.raises(fga.InputError, match="unknown kind of observation 'interval'"):
        observation_kind("interval")
    with pytest.raises(fga.InputError, match="unknown kind of unknowns 'shape'; valid: point"):
        unknown_kind("shape")


def test_a_new_distance_weighs_by_its_own_record_as_a_slope_distance_does() -> None:
    """Once its ppm was ignored without a word, and a centring for angles was applied."""
    sigma = fga.StandardDeviation(0.002, ppm=20, centring_target=0.003)
    register_observation(INTERVAL)
    try:
        weighed = {}
        for cls in (SlopeDistance, Interval):
            network = fga.Network("line")
            network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
            network.add_point("B", (240.0, 0.0, 0.0), fixed="yz")
            network.add(cls("A", "B", 240.0, sigma=sigma))
            solution = fga.adjust(network)
            weighed[cls.kind] = float(solution.observations.sigmas[0])
            path_kind: type[Observation] = type(network.observations["1"])
            assert path_kind is cls
    finally:
        del KINDS["interval"]
    assert weighed["interval"] == weighed["slope_distance"]
    assert weighed["interval"] == pytest.approx(np.hypot(0.002 + 20e-6 * 240, 0.003), rel=1e-12)
