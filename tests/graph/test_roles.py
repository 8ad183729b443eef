"""A point, frame or size in several roles of one observation is one variable.

Every registered kind is used with every coincidence of its variables that it allows: the origin of
its frame is its station, its target or both, a second pair begins where the first one ends, both
sizes of a circle are the same. The reference is dense algebra on a network with a point of its own
for each role, whose columns are added.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import Any

import gtsam
import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.factor_graph.network_graph import build_graph
from factorgraph_adj.frames import LocalFrame
from factorgraph_adj.graph.equations import Equations, compile_network
from factorgraph_adj.graph.user_factors import KeyOf
from factorgraph_adj.graph.variables import State
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.models.unknown_registry import UNKNOWNS
from factorgraph_adj.observations import KINDS, ControlPoint, UnitVector
from factorgraph_adj.simulation.measurement import look_at, measure
from factorgraph_adj.types import Array
from tests.networks.every_kind import OBSERVED, TURNS_AND_ARM, add_unknowns
from tests.support.arrivals import bare, batch, chunks, difference
from tests.support.differences import whitened_system
from tests.support.graphs import normal_equations

LONG = pytest.mark.slow(
    "arrivals of every coincidence of roles; short tests compare the equations with dense algebra"
)

MIDDLE = np.array([12.0, -35.0, 110.0])
PLACES = MIDDLE + np.random.default_rng(36).uniform(-20.0, 20.0, (6, 3)) * [1.0, 1.0, 0.4]
"""Points; sights between them are some ten metres long."""
CONTROL = 0.003
"""Standard deviation of each coordinate of each point, metres: readings change much of it."""
SIGMAS = {"m": 0.002, "rad": 1e-4, "mixed": 1e-3, "image": 1e-3}
RADIUS = 7.0
"""Size of shapes, metres."""
PHOTOS = (
    "f",
    "g",
    *(f"{attribute}{n}" for attribute in ("photo", "photo2", "before") for n in "01"),
)
"""Photos, and those of each role, which may be one or two."""
TURN = {"rx": 0.1, "ry": -0.15, "rz": 0.4}
"""Rotation of the frames: nearly upright, as instruments on bodies and wires are."""


@dataclass(frozen=True)
class Case:
    """An observation with some of its variables in several roles."""

    observation: Any
    """The observation, whatever its names are."""
    origins: bool
    """Whether its frames have points as origins; else constants."""
    level: bool
    """Whether its frames are level at their origins."""
    points: dict[str, int]
    """Point of each role; equal numbers are one point."""
    others: dict[str, str]
    """Names of frames, photos and parameters by attribute."""


def partitions(n: int) -> list[tuple[int, ...]]:
    """Return all partitions of n things: the group of each thing."""
    out: list[tuple[int, ...]] = [()]
    for _ in range(n):
        out = [(*p, g) for p in out for g in range(max(p, default=-1) + 2)]
    return out


def cases_of(kind: str) -> list[Case]:
    """Return every coincidence of the variables of a kind, allowed or not."""
    record, out = KINDS[kind], {}
    for o in OBSERVED[kind]():
        given = [(k, a) for k, a in record.variables if "." in a or getattr(o, a) is not None]
        levels = (False, True) if record.frames else (False,)
        origins = (True, False) if any("." in a for _, a in given) else (False,)
        for level, at_points in product(levels, origins):
            roles = [a for k, a in given if k == "point" and ("." not in a or at_points)]
            apart = [
                [a for k, a in given if k == what]
                for what in dict.fromkeys(k for k, _ in given)
                if what != "point" and not UNKNOWNS[what].at_point
            ]
            several = [g for g in apart if len(g) > 1]
            for groups in product(*(partitions(len(g)) for g in several)):
                pairs = zip(several, groups, strict=True)
                same = {a: f"{g[0]}{n}" for g, p in pairs for a, n in zip(g, p, strict=True)}
                for numbers in partitions(len(roles)):
                    called = dict(zip(roles, numbers, strict=True))
                    origins_of = {
                        (same[a], called[f"{a}.origin"])
                        for a in record.frames
                        if a in same and f"{a}.origin" in called
                    }
                    if len(origins_of) > len({f for f, _ in origins_of}):
                        continue  # no frame has two origins
                    case = Case(o, at_points, level, called, same)
                    form = (at_points, level, numbers, groups, o.component_names(), len(given))
                    out.setdefault(form, case)
    return list(out.values())


def add_case(network: fga.Network, case: Case, number: int, apart: bool = False) -> None:
    """Add an observation with its points and frames, ``apart`` with a variable for each role.

    Raises:
        InputError: the kind does not allow this coincidence.
    """
    o, record = case.observation, KINDS[case.observation.kind]

    def own(name: str, attribute: str) -> str:
        return f"{name}~{number}~{attribute}" if apart else name

    called = {role: own(f"P{p}", role) for role, p in case.points.items()}
    for role, p in case.points.items():
        if called[role] not in network.points:
            network.add_point(called[role], PLACES[p])
            network.set_vertical(called[role], xi=1e-4, eta=-2e-4, sigma=2e-5)
            network.set_unknown("heading", called[role], (0.3,), sigma=1e-4)
    changes: dict[str, Any] = {a: n for a, n in called.items() if "." not in a}
    for what, attribute in record.variables:
        if "." in attribute or getattr(o, attribute) is None:
            continue
        shared = case.others.get(attribute, f"{what}0")
        if what == "frame":
            changes[attribute] = name = own(f"{shared} {number}", attribute)
            if name in network.frames:
                continue
            turned = 0.07 * sum(map(ord, shared)) % 0.1
            values = {a: v + turned for a, v in TURN.items()} | {"x": 0.3, "y": -0.2}
            network.add_frame(
                name,
                free=(),
                values=values,
                sigma=dict.fromkeys(values, 1e-3),
                origin=called.get(f"{attribute}.origin", tuple((MIDDLE + 3.0).tolist())),
                level=case.level,
            )
        elif what in ("size", "angle") and attribute != "sag":
            changes[attribute] = name = own(shared, attribute)
            network.set_unknown(what, name, (RADIUS if what == "size" else 0.4,), sigma=1e-3)
        elif attribute in case.others:
            changes[attribute] = shared
    d, sigma = len(o.component_names()), SIGMAS[record.unit]
    changes["sigma"] = (sigma,) * d if record.takes_covariance else sigma
    if record.takes_covariance:
        changes["covariance"] = None
    if np.ndim(o.value) == 0:
        changes["value"] = 1.0  # tells whether it is counted the other way round
    network.add(replace(o, **changes, id=f"reading {number}"))


def empty_network() -> fga.Network:
    """Return a network with photos and parameters, all of them weighted."""
    network = fga.Network("roles", frame=LocalFrame(curvature=True))
    network.add_camera("camera", NoDistortion(), {"c": 20.0})
    for n, name in enumerate(PHOTOS):
        at = MIDDLE + np.array([30.0 * n - 60.0, 90.0, 40.0])
        network.add_photo(
            name,
            "camera",
            position=at,
            rotation=look_at(at, MIDDLE),
            sigma_position=0.003,
            sigma_attitude=1e-4,
        )
    for name in ("cup", "imu"):
        values = dict.fromkeys(TURNS_AND_ARM, 0.01)
        network.set_mount(name, values=values, sigma=dict.fromkeys(values, 1e-4))
    network.set_size("sag", 0.004, sigma=1e-3)
    network.set_distance_meter("edm", sigma_scale=1e-5, sigma_zero=1e-3)
    network.set_model_deformation("film", values={"x": 0.01})
    network.set_gyro("gyro", 0.02, sigma=1e-4)
    network.set_refractive_index("water", 1.34, sigma=1e-3)
    for name, of in (
        ("refraction", "ray"),
        ("index_error", "circle"),
        ("collimation_error", "telescope"),
    ):
        network.set_unknown(name, of, (1e-4,), sigma=1e-4)
    add_unknowns(network, sigma=1e-4)
    return network


@dataclass(frozen=True)
class Coincidences:
    """The coincidences of a kind."""

    network: fga.Network
    """All that are allowed, measured."""
    apart: Equations
    """The same readings and places with a point for each role."""
    signs: dict[str, float]
    """−1 for readings that are counted from the other end, where their pairs have a common end."""
    refused: dict[str, str]
    """Messages of those that are refused, by what coincides."""
    cases: int
    """Number of the allowed ones."""


@cache
def coincidences_of(kind: str) -> Coincidences:
    """Return all coincidences of a kind, and what is said of those that are not allowed."""
    network, apart, refused, n = empty_network(), empty_network(), {}, 0
    for number, case in enumerate(cases_of(kind)):
        alone = empty_network()
        try:
            add_case(alone, case, number)
            equations = compile_network(alone)
            for block in equations.blocks:
                block.evaluate(alone.frame, equations.unknowns.start())
        except InputError as error:
            refused[f"{case.points} {case.others}"] = str(error)
            continue
        add_case(network, case, number)
        add_case(apart, case, number, apart=True)
        n += 1
    for p, x in enumerate(PLACES):
        if f"P{p}" in network.points:
            network.add(ControlPoint(f"P{p}", tuple(x), sigma=(CONTROL,) * 3, id=f"control {p}"))
    readings = network.observations.items()
    signs = {i: -1.0 if np.ravel(getattr(o, "value", 1.0))[0] < 0 else 1.0 for i, o in readings}
    return Coincidences(measure(network, seed=36), compile_network(apart), signs, refused, n)


def together(name: str) -> str:
    """Return the name of the one variable of which each role has a copy."""
    return re.sub(r"~\d+~[\w.]+", "", name)


@dataclass(frozen=True)
class Dense:
    """Residuals and partials of a network by dense algebra, whitened."""

    residual: Array
    """Residuals v (m,)."""
    a: Array
    """Partials (m, u)."""


def dense(found: Coincidences, equations: Equations, state: State) -> Dense:
    """Return residuals and partials from a network in which each role has its own point."""
    v, a = (
        np.full(equations.n_rows, np.nan),
        np.zeros((equations.n_rows, equations.unknowns.n_columns)),
    )
    apart = found.apart.unknowns.start()
    for kind, table in found.apart.unknowns.tables.items():
        for number, name in enumerate(table.names):
            there = equations.unknowns[kind].number.get(together(name))
            if there is not None:
                apart[kind][number] = state[kind][there]
    rows = {
        ident: block.first_row + block.dimension * i
        for block in equations.blocks
        for i, ident in enumerate(block.ids)
    }
    readings = {
        ident: found.signs.get(ident, 1.0) * block.observed[i]
        for block in equations.blocks
        for i, ident in enumerate(block.ids)
    }
    for source, here in ((found.apart, apart), (equations, state)):
        for block in source.blocks:
            single = block.prior or block.by_axis
            if single != (source is equations):
                continue
            if not single:
                assert not block.roles
                assert len(block.variables) == len(block.named)
                block = replace(block, observed=np.array([readings[i] for i in block.ids]))
            found_here = block.evaluate(source.network.frame, here)
            residual = block.whiten(found_here.residual)
            for i, ident in enumerate(block.ids):
                first = block.first_row + i * block.dimension if single else rows[ident]
                row = slice(first, first + block.dimension)
                sign = 1.0 if single else found.signs[ident]
                v[row] = sign * residual[i]
                for (kind, index), by in zip(block.variables, found_here.jacobians, strict=True):
                    name = source.unknowns[kind].names[index[i]]
                    number = equations.unknowns[kind].number[together(name)]
                    columns = equations.unknowns.columns(kind, number)
                    if len(columns):
                        free = equations.unknowns.free[columns]
                        part = block.whiten(by)[i][:, : len(columns)]
                        a[row, columns] += np.where(free, sign * part, 0.0)
    assert np.isfinite(v).all()
    return Dense(v, a)


WITH_ROLES = [
    kind
    for kind, record in KINDS.items()
    if kind in OBSERVED
    and any(
        n > 1 for what, n in Counter(k for k, _ in record.variables).items() if what != "vertical"
    )
]
"""Kinds whose variables can coincide."""


REASONS = re.compile(
    "to itself|the same two points|are the same: a (?:relative pose|turn|motion)"
    "|must name two frames|is the origin of frame|its offset has no direction"
)
"""Why some variables cannot coincide."""


@pytest.mark.parametrize("kind", WITH_ROLES)
def test_what_is_one_variable_is_adjusted_as_one(kind: str) -> None:
    found = coincidences_of(kind)
    wrong = [m for m in found.refused.values() if not REASONS.search(m) or "reading" not in m]
    assert not wrong, wrong
    if not found.cases:
        return
    solution = fga.adjust(found.network)
    assert solution.converged
    assert solution.iterations <= 4
    equations = solution.equations
    expected = dense(found, equations, solution.state)
    np.testing.assert_allclose(equations.residuals(solution.state), expected.residual, atol=1e-7)
    held = np.linalg.norm(expected.a, axis=0) == 0
    a = expected.a[:, ~held]
    q = np.linalg.inv(a.T @ a)
    unit = np.eye(equations.unknowns.n_columns)[:, ~held]
    ours = solution.cofactor_times(unit)[~held]
    sigma = np.sqrt(np.diag(q))
    np.testing.assert_allclose(ours / np.outer(sigma, sigma), q / np.outer(sigma, sigma), atol=1e-8)
    gradient = a.T @ expected.residual
    assert np.max(np.abs(q @ gradient) / sigma) < 1e-5
    r = fga.reliability(solution).redundancy_numbers
    np.testing.assert_allclose(r, 1.0 - np.sum(a @ q * a, axis=1)[: len(r)], atol=1e-8)


ALLOWED = [
    kind
    for kind in WITH_ROLES
    if any("." in a for _, a in KINDS[kind].variables) and KINDS[kind].in_frame == "nothing"
]
"""Kinds that allow a coincidence; readings of a place do not allow the origin of their frame."""


@pytest.mark.parametrize("kind", ALLOWED)
def test_a_variable_in_several_roles_has_one_key_in_the_graph(kind: str) -> None:
    equations = compile_network(coincidences_of(kind).network)
    assert any(block.roles for block in equations.blocks)
    built = build_graph(equations)
    for i in range(built.graph.size()):
        keys = list(built.graph.at(i).keys())
        assert len(set(keys)) == len(keys)
    n, g = normal_equations(built)
    a, v = whitened_system(equations, equations.unknowns.start())
    a = a * equations.unknowns.free
    size = np.linalg.norm(a, axis=0)
    scale = np.where(size > 0, size, 1.0)
    np.testing.assert_allclose(
        n / np.outer(scale, scale), a.T @ a / np.outer(scale, scale), atol=1e-9
    )
    np.testing.assert_allclose(g / scale, a.T @ v / scale, atol=1e-9 * np.linalg.norm(v))


@LONG
@pytest.mark.parametrize("kind", ALLOWED)
def test_arrivals_are_the_batch(kind: str) -> None:
    network = coincidences_of(kind).network  # its readings only: all else is there before
    inc = fga.IncrementalAdjustment(bare(network))
    for chunk in sorted(chunks(network, 36), key=lambda c: not isinstance(c[0], ControlPoint)):
        inc.add(chunk)
    inc.settle()
    solution = inc.solution()
    assert set(solution.network.observations) == set(network.observations)
    found = difference(solution, batch(inc))
    assert found.estimates < 1e-6
    assert found.sigmas < 1e-6


STATIONS = {
    "A": (0.0, 0.0, 0.0),
    "B": (20.0, 0.0, 1.0),
    "C": (10.0, 15.0, 3.0),
    "D": (-5.0, 12.0, 8.0),
    "E": (3.0, -9.0, 6.0),
}
"""Places of the station A and its targets."""


def unit_vectors(origin: str | tuple[float, float, float]) -> fga.Network:
    """Unit vectors in a frame that is not level, which do not depend on its origin."""
    network, rng = fga.Network("unit vectors"), np.random.default_rng(1)
    for name, x in STATIONS.items():
        network.add_point(name, x)
        given = np.array(x) + 0.001 * rng.standard_normal(3)
        network.add(ControlPoint(name, tuple(given), sigma=(0.001,) * 3))
    turns = {"rx": 0.001, "ry": -0.001, "rz": 0.002}
    network.add_frame("body", free=tuple(turns), values=turns, origin=origin)
    for name in "BCDE":
        r = np.subtract(STATIONS[name], STATIONS["A"])
        value = (r / np.linalg.norm(r))[:2] + 1e-4 * rng.standard_normal(2)
        network.add(UnitVector("body", "A", name, tuple(value), sigma=(1e-4, 1e-4)))
    return network


def test_every_figure_is_that_with_a_constant_origin() -> None:
    networks = [unit_vectors((0.0, 0.0, 0.0)), unit_vectors("A")]
    a, b = (fga.adjust(n) for n in networks)
    assert b.iterations == a.iterations
    assert b.vtpv == pytest.approx(a.vtpv, rel=1e-9)
    np.testing.assert_allclose(b.point_covariances, a.point_covariances, rtol=1e-9, atol=1e-18)
    for figures in (
        [fga.reliability(s).mdb for s in (a, b)],
        [fga.plan(n).reliability.mdb for n in networks],
        [fga.snoop(n).solution.state["point"] for n in networks],
        [fga.robust_adjust(n).solution.state["point"] for n in networks],
        [[c.factor for c in fga.estimate_variance_components(n).components] for n in networks],
    ):
        np.testing.assert_allclose(figures[1], figures[0], rtol=1e-7, atol=1e-12)


def test_readings_in_several_roles_wait_no_longer_than_others() -> None:
    given = unit_vectors("A")
    inc = fga.IncrementalAdjustment(bare(given))
    for chunk in reversed(chunks(given, None)):
        inc.add(chunk)
    inc.settle()
    assert set(inc.solution().network.observations) == set(given.observations)
    found = difference(inc.solution(), batch(inc))
    assert max(found.estimates, found.sigmas) < 1e-6


def test_a_key_twice_in_a_factor_is_one_variable() -> None:
    def doubled(twice: bool) -> fga.Solution:
        network = fga.Network("doubled")
        network.add_point("P", (10.01, 0.0, 0.0))
        network.add(ControlPoint("P", (10.0, 0.0, 0.0), sigma=(0.01,) * 3))

        def make(key: KeyOf) -> gtsam.NonlinearFactor:
            p = key("point", "P")

            def error(this: object, values: gtsam.Values, h: list[Array] | None) -> Array:
                x = values.atVector(p)
                if h is not None:
                    for slot in range(len(h)):
                        h[slot] = np.array([[2.0 / len(h), 0.0, 0.0]])
                return np.array([2.0 * x[0] - 20.02])

            keys = [p, p] if twice else [p]
            return gtsam.CustomFactor(gtsam.noiseModel.Isotropic.Sigma(1, 0.01), keys, error)

        return fga.adjust(network, extra_factors={"sum": make})

    once, twice = doubled(False), doubled(True)
    np.testing.assert_allclose(twice.point("P"), [10.008, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(twice.point_covariances, once.point_covariances, rtol=1e-12)
