"""What is left out, predicted from what is in: the test that it has in an adjustment with it."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.incremental import commands
from factorgraph_adj.ledger.command_input import Engine
from factorgraph_adj.linear_system.predictions import innovation_tests, near_enough
from factorgraph_adj.observations import GnssVector, SlopeDistance

MM = 1e-3
CORNERS = {"A": (0.0, 0.0, 0.0), "B": (80.0, 0.0, 0.0), "C": (0.0, 60.0, 10.0)}
PLACES = {"P": (40.0, 30.0, 5.0), "Q": (50.0, 20.0, 1.0)}


def covariance() -> np.ndarray:
    """Return the covariance matrix of a vector, square metres."""
    return MM**2 * np.array([[4.0, 1.0, 0.0], [1.0, 4.0, 1.0], [0.0, 1.0, 9.0]])


def vector(a: str, b: str, at: dict[str, np.ndarray], off: np.ndarray, ident: str) -> GnssVector:
    """Return a vector with an error, metres, and correlated components."""
    return GnssVector(a, b, tuple(at[b] - at[a] + off), covariance=covariance(), id=ident)


def distance(at: dict[str, np.ndarray], off: float) -> float:
    """Return the distance from A to P with an error, metres."""
    return float(np.linalg.norm(at["P"] - at["A"])) + off


def with_suspects(engine: Engine) -> fga.IncrementalAdjustment:
    """Return two points with suspects of one and of three components, of all sizes."""
    rng = np.random.default_rng(3)
    network = fga.Network("two points")
    at = {n: np.array(p) for n, p in (CORNERS | PLACES).items()}
    for name, place in (CORNERS | PLACES).items():
        network.add_point(name, place, fixed="xyz" if name in CORNERS else "")
    for a in CORNERS:
        for b in PLACES:
            off = rng.normal(0.0, 2 * MM, 3)
            network.add(vector(a, b, at, off, f"{a} to {b}"))
    inc = fga.IncrementalAdjustment(network, engine=engine)
    for i in range(4):
        inc.add(vector("P", "Q", at, rng.normal(0.0, 12 * MM, 3) + 8 * MM, f"vector {i}"))
        length = distance(at, rng.uniform(9 * MM, 15 * MM))
        inc.add(SlopeDistance("A", "P", length, sigma=2 * MM, id=f"distance {i}"))
    return inc


@pytest.mark.parametrize("engine", ["isam2", "fronts"])
def test_the_test_is_that_of_an_adjustment_with_it(engine: Engine) -> None:
    """T² = vᵀPv with it − vᵀPv without; w² is at most that, and this with one component."""
    inc = with_suspects(engine)
    ledger, system = inc._state.ledger, inc._state.system
    assert system is not None and system.engine == engine
    rows = ledger.having("suspect")
    assert len(rows) > 4
    for test in innovation_tests(ledger, system, rows, inc.alpha):
        unit = ledger.unit(test.row)
        network = inc.network()
        without = fga.adjust(network)
        network.add(unit.item)
        both = fga.adjust(network)
        (verdict,) = (v for v in inc.suspects if v.id == unit.ids[0])
        t2 = test.ratio * verdict.critical
        assert t2 == pytest.approx(both.vtpv - without.vtpv, rel=2e-3)
        assert test.w <= np.sqrt(t2) * (1.0 + 1e-12)
        assert len(verdict.components) > 1 or test.w == pytest.approx(np.sqrt(t2), rel=1e-12)


@pytest.mark.parametrize("engine", ["isam2", "fronts"])
def test_what_is_out_is_tested_against_what_is_in_by_now(engine: Engine) -> None:
    """Also what a search has rejected, whose own verdict has no figures; nothing changes."""
    inc = with_suspects(engine)
    before, state = {v.id: v for v in inc.suspects}, inc._state
    at = {n: inc.estimate(n) for n in ("A", "P")}
    for v in inc.tested_now():
        assert v.verdict == "suspect" and v.innovation is not None and v.w is not None
        assert v.t2 == pytest.approx(before[v.id].t2, rel=0.05), "little has come since"
        if v.kind == "slope_distance":
            length = float(np.linalg.norm(at["P"] - at["A"]))
            reading = inc.observation(v.id)
            assert isinstance(reading, SlopeDistance)
            assert v.innovation[0] == pytest.approx(length - reading.value, rel=1e-3)
            assert v.w[0] ** 2 == pytest.approx(v.t2, rel=1e-9)
    assert inc._state is state and len(before) == len(inc.tested_now())
    inc.accept([*before])
    inc.snoop()
    searched = [v.id for v in inc.rejected if v.cause == "snooping"]
    assert searched and all(v.innovation is None for v in inc.rejected)
    now = {v.id: v for v in inc.tested_now()}
    assert set(now) == set(searched) and all(v.test > 1.0 for v in now.values())


@pytest.mark.parametrize("engine", ["isam2", "fronts"])
def test_w_of_correlated_components_is_theirs_and_not_that_of_whitened_ones(engine: Engine) -> None:
    """w_i = (Pd)_i/√P_ii with the covariance P⁻¹ of the innovation d in metres."""
    inc = with_suspects(engine)
    ledger, system = inc._state.ledger, inc._state.system
    assert system is not None
    at = {n: inc.estimate(n) for n in PLACES}
    q = inc.covariance("P", "P") + inc.covariance("Q", "Q")
    q = q - inc.covariance("P", "Q") - inc.covariance("Q", "P")
    differences = []
    for test in innovation_tests(ledger, system, ledger.having("suspect"), inc.alpha):
        reading = ledger.unit(test.row).item
        if not isinstance(reading, GnssVector):
            continue
        d, root = at["Q"] - at["P"] - np.array(reading.value), np.linalg.cholesky(covariance())
        p = np.linalg.inv(covariance() + q)
        assert test.w == pytest.approx(np.max(np.abs(p @ d) / np.sqrt(np.diag(p))), rel=2e-3)
        turned = root.T @ p
        of_whitened = np.abs(turned @ d) / np.sqrt(np.diag(turned @ root))
        differences.append(abs(np.max(of_whitened) / test.w - 1.0))
    assert max(differences) > 0.02


@pytest.mark.parametrize("engine", ["isam2", "fronts"])
def test_nothing_that_fits_is_too_far_to_be_tested(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever has entered since its last test; others are too far, or there were no need of it."""
    monkeypatch.setattr(commands, "readmitted_suspects", lambda state, told, _: (state, told))
    inc = with_suspects(engine)
    at = {n: np.array(p) for n, p in (CORNERS | PLACES).items()}
    fitting, far = 0, 0
    for i in range(8):
        inc.add(SlopeDistance("A", "P", distance(at, 5 * MM), sigma=2 * MM, id=f"shifted {i}"))
        ledger, system = inc._state.ledger, inc._state.system
        assert system is not None
        rows = ledger.having("suspect")
        near = set(near_enough(ledger, system, rows).tolist())
        fits = {t.row for t in innovation_tests(ledger, system, rows, inc.alpha) if t.ratio <= 1}
        assert fits <= near
        fitting, far = fitting + len(fits), far + len(rows) - len(near)
    assert fitting and far
