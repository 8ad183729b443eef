"""An unknown and observations that the package does not know, added without touching it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.models.unknown_registry import UnknownTable, unknown_kind
from factorgraph_adj.report.catalogue import Texts
from factorgraph_adj.solve.datum_defects import generators
from tests.networks import extension
from tests.networks.every_kind import (
    EXAMPLES,
    GEOMETRIES,
    OBSERVED,
    Example,
    Stated,
    sight_equations,
)
from tests.networks.everything import everything
from tests.networks.extension import (
    SIMILARITY,
    TREND,
    TRUE,
    DriftingStep,
    SamePoint,
    drifting_levels,
    registered,
    two_epochs,
)
from tests.networks.random_small import random_network
from tests.support.dense import Dense
from tests.support.differences import assert_partials_are_right, observed_as_computed
from tests.support.same import assert_same_network


@pytest.fixture(autouse=True)
def kinds() -> Iterator[None]:
    """Let the package know the kinds of this module."""
    with registered():
        yield


# -- the unknown in every part of the package -----------------------------------------------------


@pytest.mark.parametrize("make", [two_epochs, drifting_levels])
def test_partials_are_right(make: Any) -> None:
    equations = compile_network(make())
    state = equations.unknowns.start()
    steps = np.full(equations.unknowns.n_columns, 1e-2)
    assert_partials_are_right(observed_as_computed(equations, state), state, steps)


@pytest.mark.parametrize("datum", ["given", "free"])
def test_the_adjustment_and_its_covariances_are_those_of_dense_algebra(datum: str) -> None:
    network = two_epochs(datum=datum)
    solution = fga.adjust(network)
    assert solution.converged
    assert solution.datum_defect == (6 if datum == "free" else 0)
    unknowns = solution.equations.unknowns
    dense = Dense.at(solution.equations, solution.state)
    points = np.zeros(unknowns.n_columns, dtype=bool)
    points[: 3 * len(network.points)] = True
    q = dense.cofactor(points & unknowns.free)
    for kind, name in (("similarity", "shift"), ("point", "B3")):
        columns = unknowns.columns(kind, unknowns[kind].number[name])
        found = solution.variable_covariance((kind, name))
        own = q[np.ix_(columns, columns)]
        np.testing.assert_allclose(found, own, atol=1e-7 * np.abs(own).max())
    columns = unknowns.columns("similarity", 0), unknowns.columns("point", 9)
    cross = solution.variable_covariance(("similarity", "shift"), ("point", "B3"))
    wanted = q[np.ix_(*columns)]
    np.testing.assert_allclose(cross, wanted, atol=1e-6 * np.abs(wanted).max())
    assert solution.vtpv == pytest.approx(dense.vtpv_after_step(), rel=1e-9)


def test_the_true_similarity_is_found_within_its_covariance() -> None:
    solution = fga.adjust(two_epochs())
    found = solution.unknown("similarity", "shift")
    assert found.names == tuple(c.name for c in SIMILARITY.components)
    covariance = solution.variable_covariance(("similarity", "shift"))
    error = SIMILARITY.local(
        SIMILARITY.store(TRUE[None]), SIMILARITY.store(np.asarray(found.values)[None])
    )[0]
    squared = float(error @ np.linalg.solve(covariance, error))
    assert 0.5 < squared < 24.3  # χ² with 7 degrees of freedom, 99.9 %


def test_a_free_network_is_that_of_a_given_datum_but_for_its_place() -> None:
    """Distances, vᵀPv and the scale, which no motion of the whole changes, are the same."""
    network = two_epochs(datum="free")
    free = fga.adjust(network)
    for name, held in (("A0", "xyz"), ("A1", "yz"), ("A3", "z")):
        flags = ("x" in held, "y" in held, "z" in held)
        network.points[name] = replace(network.points[name], fixed=flags)
    given = fga.adjust(network, datum="given")
    assert free.vtpv == pytest.approx(given.vtpv, rel=1e-8)
    assert free.redundancy == given.redundancy
    lengths = [np.linalg.norm(s.point("A1") - s.point("B4")) for s in (given, free)]
    assert lengths[0] == pytest.approx(lengths[1], abs=1e-8)
    scales = [s.unknown("similarity", "shift")["ln_scale"] for s in (given, free)]
    assert scales[0] == pytest.approx(scales[1], abs=1e-11)


def test_motions_of_the_whole_are_unnoticed() -> None:
    """A g = 0 for shifts and rotations, and a finite motion leaves vᵀPv as it was."""
    solution = fga.adjust(two_epochs(datum="free"))
    equations = solution.equations
    g = generators(equations, solution.state)[:, :6]
    dense = Dense.at(equations, solution.state)
    noticed = np.linalg.norm(dense.design @ g[dense.free], axis=0)
    size = np.linalg.norm(dense.design, axis=0) @ np.abs(g[dense.free])
    assert np.all(noticed < 1e-10 * size)


@pytest.mark.parametrize(
    ("stated", "free"),
    [
        ({"fixed": True}, []),
        ({"fixed": ["ln_scale"]}, ["rx", "ry", "rz", "tx", "ty", "tz"]),
        ({"fixed": ["rx", "ry", "rz"], "sigma": {"tx": 1e-6}}, ["ty", "tz", "ln_scale"]),
        ({"sigma": [1e-7] * 3 + [np.inf] * 4}, ["tx", "ty", "tz", "ln_scale"]),
    ],
)
def test_components_may_be_free_weighted_or_held(stated: Any, free: list[str]) -> None:
    network = two_epochs(similarity=stated)
    solution = fga.adjust(network)
    assert solution.converged
    found = solution.unknown("similarity", "shift")
    given = np.asarray(network.of_kind("similarity")["shift"].values)
    weighted = stated.get("sigma", {})
    for i, name in enumerate(found.names):
        if name in free:
            assert found.sigma(name) > 2e-7
            assert abs(found[name] - given[i]) > 1e-6
        elif found.sigma(name) == 0.0:
            assert found[name] == pytest.approx(given[i], abs=1e-15)
        else:
            assert weighted
            assert abs(found[name] - given[i]) < 1e-5
    rel = fga.reliability(solution)
    assert rel.redundancy_numbers.sum() == pytest.approx(solution.redundancy, abs=1e-8)


@pytest.mark.parametrize("datum", ["given", "free"])
def test_reliability_takes_it(datum: str) -> None:
    solution = fga.adjust(two_epochs(datum=datum))
    rel = fga.reliability(solution)
    assert rel.redundancy_numbers.sum() == pytest.approx(solution.redundancy, abs=1e-7)
    parts = rel.redundancy_numbers + rel.e1 + rel.e2 + rel.e12
    np.testing.assert_allclose(parts, 1.0, atol=1e-7)
    row = int(np.argmax(rel.delta_bar))
    assert rel.effect_on(row, ("similarity", "shift")).shape == (7,)


def test_a_gross_error_of_the_new_kind_is_found() -> None:
    network = two_epochs(seed=2)
    ident = next(i for i, o in network.observations.items() if o.kind == "same_point")
    good = network.observations[ident]
    assert isinstance(good, SamePoint)
    x, y, z = good.value
    network.observations[ident] = replace(good, value=(x + 0.05, y, z))
    assert [r.id for r in fga.snoop(network).rejected] == [ident]


@pytest.mark.slow("three orders of arrival for each network; short tests take one order")
@pytest.mark.parametrize("make", [two_epochs, drifting_levels])
def test_arriving_in_any_order_gives_what_the_batch_gives(make: Any) -> None:
    network = make()
    batch = fga.adjust(network)
    for order in (None, 1, 2):
        arriving = list(network.observations.items())
        if order is not None:
            np.random.default_rng(order).shuffle(arriving)  # type: ignore[arg-type]
        start = network.copy()
        start.observations = {}
        inc = fga.IncrementalAdjustment(start, policy="accept")
        for ident, o in arriving:
            inc.add(replace(o, id=ident))
        inc.settle()
        assert not inc.waiting
        found = inc.solution()
        kind = next(k for k in ("similarity", "trend") if network.of_kind(k))
        for key in network.of_kind(kind):
            a, b = (s.unknown(kind, key) for s in (batch, found))
            np.testing.assert_allclose(a.values, b.values, atol=2e-6 * a.sigmas.min())
            np.testing.assert_allclose(a.sigmas, b.sigmas, rtol=1e-5)
        assert found.redundancy == batch.redundancy


def test_a_project_keeps_it_to_the_bit(tmp_path: Any) -> None:
    for network in (
        two_epochs(similarity={"fixed": ["ln_scale"], "sigma": {"tx": 0.01}}),
        drifting_levels(),
    ):
        path = tmp_path / network.name / "project.toml"
        fga.write_project(network, path)
        again = fga.read_project(path)
        assert_same_network(network, again)
        assert again.parameters == network.parameters
    header, row = (tmp_path / "two epochs" / "similarities.csv").read_text().splitlines()
    assert header.split(",") == [
        *("name", "rx_mgon", "ry_mgon", "rz_mgon", "tx_mm", "ty_mm", "tz_mm", "ln_scale_ppm"),
        *("sigma_tx_mm", "fixed"),
    ]
    assert row.endswith(",10,ln_scale")


def test_the_report_shows_it(tmp_path: Any, capsys: pytest.CaptureFixture[str]) -> None:
    fga.write_project(two_epochs(), tmp_path / "project.toml")
    assert main(["adjust", str(tmp_path), "--full", "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "Similarity\n----------\n" in said
    assert "similarity shift" in said
    rows = (tmp_path / "out" / "unknowns.csv").read_text().splitlines()
    assert sum(r.startswith("similarity,shift,") for r in rows) == 7
    others = json.loads((tmp_path / "out" / "results.json").read_text())["others"]
    assert {o["component"] for o in others} == {c.name for c in SIMILARITY.components}


def test_the_factor_graph_has_it() -> None:
    """GTSAM's linear factors of the similarity give the step of the batch adjustment."""
    network = two_epochs(similarity={"fixed": ["ln_scale"]})
    graph = fga.build_graph(network)
    values = graph.values
    for _ in range(6):
        step = graph.graph.linearize(values).optimize()
        values = values.retract(step)
    key = graph.keys.key("similarity", "shift")
    assert gtsam.DefaultKeyFormatter(key) == "S0"
    solution = fga.adjust(network)
    np.testing.assert_allclose(
        values.atVector(key), solution.unknown("similarity", "shift").values, atol=1e-9
    )
    assert 2 * graph.graph.error(values) == pytest.approx(solution.vtpv, rel=1e-9)


def test_a_rotation_vector_beyond_pi_is_refused_in_the_graph() -> None:
    """GTSAM adds to the vector; the same rotation by the opposite turn has other partials."""
    graph = fga.build_graph(two_epochs())
    values = gtsam.Values(graph.values)
    values.update(graph.keys.key("similarity", "shift"), np.array([3.3, 0, 0, 0, 0, 0, 0.0]))
    with pytest.raises(fga.AdjustmentError, match="longer than π"):
        graph.graph.error(values)


def test_what_is_not_determined_is_named() -> None:
    network = two_epochs()
    network.observations = {
        i: o for i, o in network.observations.items() if not hasattr(o, "similarity")
    }
    with pytest.raises(fga.DatumError, match="similarity 'shift' is not determined"):
        fga.adjust(network)


def test_each_drift_has_its_own_degree() -> None:
    solution = fga.adjust(drifting_levels())
    assert solution.unknown("trend", "old").names == ("a0", "a1")
    new = solution.unknown("trend", "new")
    assert new.names == ("a0", "a1", "a2")
    assert np.all(np.abs(new.values - [0.001, 0.003, -0.002]) < 4 * new.sigmas)
    dense = Dense.at(solution.equations, solution.state)
    q = dense.cofactor(np.zeros(solution.equations.unknowns.n_columns, dtype=bool))
    columns = solution.equations.unknowns.columns("trend", 1)
    np.testing.assert_allclose(new.sigmas**2, np.diag(q)[columns], rtol=1e-9)


def test_taking_observations_out_takes_their_unknowns_along() -> None:
    network = drifting_levels()
    new = [i for i, o in network.observations.items() if getattr(o, "trend", "") == "new"]
    left = fga.without(network, new)
    assert list(left.of_kind("trend")) == ["old"]
    assert list(network.of_kind("trend")) == ["old", "new"]


def test_an_unknown_of_a_kind_that_the_network_does_not_state_is_named() -> None:
    network = two_epochs()
    with pytest.raises(fga.InputError, match="unknown similarity 'other'; known: shift"):
        network.add(SamePoint("A0", "B0", "other", (0.0, 0.0, 0.0), sigma=(1.0, 1.0, 1.0)))
    with pytest.raises(fga.InputError, match="it needs 7 values"):
        network.set_unknown("similarity", "x", (1.0, 2.0))
    with pytest.raises(fga.InputError, match="hold all three rotations or none"):
        network.set_unknown("similarity", "x", TRUE, fixed=["rx"])
    with pytest.raises(fga.InputError, match="fixed must name some of rx"):
        network.set_unknown("similarity", "x", TRUE, fixed=["scale"])
    with pytest.raises(fga.InputError, match="tx: either fixed or sigma"):
        network.set_unknown("similarity", "x", TRUE, fixed=["tx"], sigma={"tx": 1.0})


def test_its_german_names_are_those_of_its_records() -> None:
    """The catalogue of texts has no row for it."""
    german = Texts("de")
    assert german.kind("drifting step") == "Höhenunterschied mit Gang"
    assert german.kind("trend of level") == german.kind("trend") == "Gang des Nivelliers"
    assert german.kind("weighted trend") == "gewichtet Gang des Nivelliers"
    assert german.kind("same point") == "same point"  # whose record has none


def test_an_example_of_it_is_enough_for_networks_of_every_kind(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    example = Example(
        lambda: [DriftingStep("i", "l", 0.1, sigma=0.01, trend="old", time=1 / 3)],
        (Stated("trend", "old", (0.3, -1 / 7), (1e-2,)),),
    )
    monkeypatch.setitem(EXAMPLES, "drifting_step", example)
    monkeypatch.setitem(OBSERVED, "drifting_step", example.observations)
    equations, steps = sight_equations("curved", GEOMETRIES["ordinary"])
    assert "drifting_step" in {block.kind for block in equations.blocks}
    assert steps[equations.unknowns.columns("trend", 0)].tolist() == [1e-2, 1e-2]
    assert "drifting_step" in {o.kind for o in everything("local").observations.values()}
    drawn = [random_network(seed) for seed in range(20)]
    observed = [DriftingStep in {type(item) for item in d.items} for d in drawn]
    assert 0 < sum(observed) < len(drawn)
    assert ["old" in d.bare.of_kind("trend") for d in drawn] == observed


def test_the_records_are_those_of_the_documentation() -> None:
    """CONTRIBUTING.md and the pages on kinds refer to these names."""
    assert unknown_kind("trend") is TREND
    assert unknown_kind("similarity").table == UnknownTable("similarities")
    assert extension.DRIFTING_STEP.texts == ("trend",)
