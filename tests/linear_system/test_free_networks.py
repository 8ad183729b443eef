"""Free networks with rows beside their base: every cofactor is in one datum, every test has it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.dependence import Variable
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.graph.observation_selection import without
from factorgraph_adj.ledger.ledger import Ledger
from factorgraph_adj.linear_system.engines import rows_beside
from factorgraph_adj.linear_system.front_system import FrontSystem
from factorgraph_adj.linear_system.linear_system import rows_of
from factorgraph_adj.linear_system.linearisation_error import is_small
from factorgraph_adj.linear_system.predictions import innovation_tests, joined
from factorgraph_adj.quality.group_tests import critical_t2
from factorgraph_adj.types import Array, Index
from tests.networks.free import FREE, rest, with_datum
from tests.support.arrivals import bare, items
from tests.support.dense import Dense

ALPHA = 1e-3
SPACING = 5
"""One of so many observations joins the base, and one is left out; the others determine it."""
ROUNDING = 1e-6
"""Relative difference that rounding leaves between two ways to the same figure."""
OF_WEIGHTS = 1e-4
"""Relative difference of σ of readings with centring at two states."""


@dataclass(frozen=True)
class Case:
    """A free network, of which some observations joined the base and some are left out."""

    system: FrontSystem
    """The base, and what joined it."""
    ledger: Ledger
    """The ledger with all observations."""
    out: Index
    """Those that are left out."""
    q: Array
    """Cofactors by dense matrices without these, on the inner constraints, (n_columns,) * 2."""
    a: Array
    """Whitened partials of all rows at the base, (n_rows, n_columns)."""
    v: Array
    """Whitened residuals where everything is, (n_rows,)."""
    rows: dict[int, Index]
    """Rows of each that is left out."""
    raw: dict[int, Array]
    """L of each with Σ = L Lᵀ."""


@cache
def case(name: str) -> Case:
    make, _, datum, _ = FREE[name]
    network = with_datum(make(), datum)
    ledger = fga.IncrementalAdjustment(network, engine="fronts")._state.ledger
    every = ledger.having("accepted")
    beside, out = every[1::SPACING], every[3::SPACING]
    left = without(network, ledger.ids_of(np.union1d(beside, out)))
    base = FrontSystem.of(fga.adjust(left, tolerance=rest(name)))
    joint = rows_beside(base, ledger, beside)
    assert joint is not None and len(joint.forms.v)
    system = joint.after
    equations = compile_network(network)
    unknowns, its = equations.unknowns, base.base.equations.unknowns
    at_base = unknowns.carried(unknowns.start(), its, base.base.state)
    here = unknowns.carried(at_base, its, system.state)
    dense = Dense.at(equations.weighted_at(at_base), at_base)
    a = np.zeros((len(dense.design), len(dense.free)))
    a[:, dense.free] = dense.design
    found, raw = rows_of(ledger.units(out), equations.weighted_at(at_base))
    rows = dict(zip(out.tolist(), found, strict=True))
    inside = np.setdiff1d(np.arange(len(a)), np.concatenate(list(rows.values())))
    assert base.base.datum is not None
    of_datum = np.zeros(len(dense.free), dtype=bool)
    for column in np.flatnonzero(base.base.datum.columns).tolist():
        kind, point, _ = its.describe(column)
        number = unknowns[kind].number[point]
        first = its.columns(kind, its[kind].number[point])[0]
        of_datum[unknowns.columns(kind, number)[column - first]] = True
    q = replace(dense, design=dense.design[inside]).cofactor(of_datum)
    return Case(
        system,
        ledger,
        out,
        q,
        a,
        Dense.at(equations.weighted_at(here), here).residual,
        rows,
        dict(zip(out.tolist(), raw, strict=True)),
    )


@pytest.mark.parametrize("name", FREE)
def test_all_blocks_of_cofactors_are_on_the_inner_constraints(name: str) -> None:
    """Variances and covariances, of what rows beside the base touch and of what they do not."""
    c = case(name)
    equations = compile_network(with_datum(FREE[name][0](), FREE[name][2]))
    unknowns = equations.unknowns
    variables = [(k, unknowns[k].names[i], unknowns.columns(k, i)) for k, i in unknowns.active()]
    sigma = np.sqrt(np.diag(c.q))
    sigma = np.maximum(sigma, ROUNDING * sigma.max())  # one datum point has none
    for kind, first, at in variables:
        for other, second, there in variables:
            found = c.system.cofactors((kind, first), (other, second))
            scale = np.outer(sigma[at], sigma[there])
            difference = np.abs(found - c.q[np.ix_(at, there)])
            assert (difference <= ROUNDING * scale).all(), (first, second)


@pytest.mark.parametrize("name", FREE)
def test_what_is_left_out_has_the_tests_of_dense_matrices(name: str) -> None:
    """C = I + A Q Aᵀ, e = C⁻¹v, T² = vᵀe and w_i = (L⁻ᵀe)_i/√(L⁻ᵀC⁻¹L⁻¹)_ii, of every one."""
    c = case(name)
    tests = {t.row: t for t in innovation_tests(c.ledger, c.system, c.out, ALPHA)}
    assert set(tests) == set(c.rows) and len(tests) >= len(c.out) > 0
    for row, own in c.rows.items():
        root = np.linalg.inv(c.raw[row])
        m = np.linalg.inv(np.eye(len(own)) + c.a[own] @ c.q @ c.a[own].T)
        e = m @ c.v[own]
        t2 = tests[row].ratio * critical_t2(ALPHA, len(own))
        assert t2 == pytest.approx(float(c.v[own] @ e), rel=ROUNDING)
        largest = float(np.max(np.abs(root.T @ e) / np.sqrt(np.diag(root.T @ m @ root))))
        assert tests[row].w == pytest.approx(largest, rel=ROUNDING)
        figures = tests[row]
        w = root.T @ e / np.sqrt(np.diag(root.T @ m @ root))
        np.testing.assert_allclose(figures.of_components, w, rtol=ROUNDING)
        # Σ of readings with centring is that at the base here, and at the present estimates there.
        np.testing.assert_allclose(figures.innovation, c.raw[row] @ c.v[own], rtol=OF_WEIGHTS)
        variances = np.diag(c.raw[row] @ np.linalg.inv(m) @ c.raw[row].T)
        np.testing.assert_allclose(figures.sigma, np.sqrt(variances), rtol=OF_WEIGHTS)
        r = np.diag(c.raw[row] @ m @ root)
        np.testing.assert_allclose(figures.redundancy_numbers, r, rtol=ROUNDING)
        alone = joined(c.ledger, c.system, np.array([row]), np.array([], dtype=np.intp))
        assert alone is not None
        np.testing.assert_allclose(alone.v, e, rtol=ROUNDING)


@pytest.mark.parametrize("name", ["images", "total station"])
def test_together_or_alone_they_have_the_same_tests(name: str) -> None:
    c = case(name)
    together = list(innovation_tests(c.ledger, c.system, c.out, ALPHA))
    for test in together:
        (alone,) = innovation_tests(c.ledger, c.system, np.array([test.row]), ALPHA)
        for figure, expected in zip(alone, test, strict=True):
            assert figure == pytest.approx(expected, rel=ROUNDING)


def test_spoiled_cofactors_leave_no_observation_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where C is not positive there is no test, and that is said of each observation."""
    c = case("images")
    spoiled = np.where(np.arange(len(c.out)) % 2, 1.0, -2.0)

    def cofactors(_: FrontSystem, touched: object, a: Array, groups: list[Index]) -> list[Array]:
        return [s * np.eye(len(g)) for s, g in zip(spoiled, groups, strict=True)]

    monkeypatch.setattr(FrontSystem, "function_cofactors", cofactors)
    tests = list(innovation_tests(c.ledger, c.system, c.out, ALPHA))
    assert [t.row for t in tests] == c.out.tolist()
    assert [t.answered for t in tests] == (spoiled > 0.0).tolist()


@pytest.mark.parametrize("name", ["total station", "images", "levelling", "plane angles", "gnss"])
def test_small_free_networks_keep_rows_beside_their_base(name: str) -> None:
    """Their standard deviations are compared in one datum: a fitting row needs no new base."""
    network = with_datum(FREE[name][0](), FREE[name][2])
    every = items(network)
    if name == "images":  # the last ray bends: few determine the distortion
        every.append(every.pop(-2))
    inc = fga.IncrementalAdjustment(bare(network))
    inc.add(every[:-1])
    before = inc._state.system
    assert isinstance(before, FrontSystem) and before.is_free and is_small(before)
    inc.add(every[-1])
    after = inc._state.system
    assert isinstance(after, FrontSystem) and after.base is before.base
    assert len(after.update.signs) > 0
    batch, accuracy = fga.adjust(network), inc._rules.accuracy
    assert inc.sigma0 == pytest.approx(batch.sigma0, rel=accuracy)
    rounding = ROUNDING * max(batch.standard_deviations(p).max() for p in network.points)
    for point in network.points:
        own: Variable = ("point", point)
        found = np.sqrt(np.maximum(np.diag(after.cofactors(own, own)), 0.0))
        wanted = batch.standard_deviations(point)[: len(found)]
        np.testing.assert_allclose(found, wanted, rtol=accuracy, atol=rounding)
