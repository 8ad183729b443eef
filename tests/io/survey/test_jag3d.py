"""Projects of JAG3D against JAG3D's own adjustment; flat files, their traps, writing, damage."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.errors import InputError
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.io.survey.jag3d import is_jag3d
from factorgraph_adj.io.survey.jag3d_model import gaussian_radius
from factorgraph_adj.io.survey.jag3d_project import point_pairs
from factorgraph_adj.observations import (
    CoordinateDifference,
    Direction,
    GnssVector,
    HeightDifference,
    HorizontalDistance,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.stochastic_model import StandardDeviation
from factorgraph_adj.units import GON
from tests.hostile.readers import judge
from tests.networks import jag3d
from tests.networks.jag3d import (
    FLAT,
    Rows,
    column,
    database,
    deflected_site,
    reduced_site,
    script,
    site,
    turned_site,
    two_epochs,
)

TENTH_MICRON = 2e-7
WEIGHTS = 1e-3
"""Relative: JAG3D takes lengths in σ from approximate coordinates, fga from adjusted ones."""


def project(folder: Path, rows: Rows, *, cached: bool = False) -> Path:
    path = folder / "site.script"
    if cached:
        text, data = database(rows)
        path.with_suffix(".data").write_bytes(data)
    else:
        text = script(rows)
    path.write_text(text, encoding="utf-8")
    return path


def flat(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def refused(path, **options) -> list[str]:
    with pytest.raises(InputError) as caught:
        fga.read_jag3d(path, **options)
    return [str(p) for p in caught.value.problems]


# -- projects, compared with JAG3D ----------------------------------------------------------------


@pytest.fixture(scope="module")
def solution(tmp_path_factory) -> fga.Solution:
    path = project(tmp_path_factory.mktemp("site"), site())
    return fga.adjust(fga.read(path), variance="a-posteriori")


def test_a_site_of_every_kind_has_the_result_of_jag3d(solution):
    assert solution.redundancy == jag3d.SITE_REDUNDANCY
    assert math.isclose(solution.vtpv, jag3d.SITE_OMEGA, rel_tol=WEIGHTS)
    for name, (place, sigma) in jag3d.SITE_POINTS.items():
        held = solution.network.points[name].fixed
        for k in range(3):
            if held[k]:
                continue
            assert abs(solution.point(name)[k] - place[k]) < TENTH_MICRON
        found = 1e3 * solution.standard_deviations(name)
        free = [k for k in range(3) if not held[k]]
        assert np.allclose(found[free], np.array(sigma)[free], rtol=WEIGHTS)


def test_additional_parameters_have_the_values_of_jag3d(solution):
    expected = jag3d.SITE_PARAMETERS
    for station in "PQA":
        found = solution.orientation(station, f"Directions {station}")
        value, sigma = expected[f"orientation {station}"]
        assert abs(found.values[0] - value) < 0.01 * sigma
        assert math.isclose(found.sigmas[0], sigma, rel_tol=WEIGHTS)
    meter = solution.unknown("edm", "Slope")
    value, sigma = expected["zero"]
    assert math.isclose(meter.values[0], 1 / 1.00001 - 1, rel_tol=1e-9)
    assert abs(meter.values[1] + value / 1.00001) < 0.01 * sigma
    assert math.isclose(meter.sigmas[1], sigma, rel_tol=WEIGHTS)
    value, sigma = expected["refraction"]
    k = solution.unknown("refraction", "Zenith")
    assert abs(k.values[0] - value) < 0.01 * sigma
    assert math.isclose(k.sigmas[0], sigma, rel_tol=WEIGHTS)


def test_reliability_and_tests_are_those_of_jag3d(tmp_path):
    solution = fga.adjust(fga.read_jag3d(project(tmp_path, site())))
    rel = fga.reliability(solution)
    assert round(rel.delta0, 2) == 4.13
    rows = {}
    for i, r in enumerate(solution.observations):
        o = solution.network.observations.get(r.id)
        if o is not None and not r.component:
            rows[o.kind, o.station, o.target] = i
    for kind, a, b, sigma, r, mdb, t_prio, v in jag3d.SITE_OBSERVATIONS:
        i = rows[kind, a, b]
        found = solution.observations[i]
        assert math.isclose(1e6 * found.sigma, sigma, rel_tol=WEIGHTS)
        assert abs(rel.redundancy_numbers[i] - r) < 2e-4
        assert math.isclose(1e6 * rel.mdb[i], abs(mdb), rel_tol=2e-3)
        assert math.isclose(rel.w[i] ** 2, t_prio, rel_tol=3e-3, abs_tol=5e-4)
        assert math.isclose(1e6 * found.residual, v, rel_tol=2e-3, abs_tol=0.02)


def test_unknown_scale_and_rotation_of_gnss_are_those_of_jag3d(tmp_path):
    network = fga.read_jag3d(project(tmp_path, turned_site()))
    solution = fga.adjust(network, variance="a-posteriori")
    assert solution.redundancy == jag3d.TURNED_REDUNDANCY
    assert math.isclose(solution.vtpv, jag3d.TURNED_OMEGA, rel_tol=WEIGHTS)
    found = solution.unknown("frame", "GNSS3D")
    expected = jag3d.TURNED_FRAME
    for name, k in (("rx", 1), ("ry", 0), ("rz", 2)):  # axes are east and north here
        value, sigma = expected[name]
        assert abs(found.values[k] + value) < 0.02 * sigma
        assert math.isclose(found.sigmas[k], sigma, rel_tol=WEIGHTS)
    assert abs(math.exp(-found.values[6]) - expected["m"][0]) < 0.01 * expected["m"][1]


def test_rotations_that_are_held_turn_vectors_as_in_jag3d(tmp_path):
    """GNSSBaselineDelta{X,Y,Z}3D.java at once, with rotations of tenths of radians."""
    rows = site()
    angles = {8: 0.1, 9: -0.2, 10: 0.3}
    for kind, value in angles.items():
        where = {"group_id": 7, "type": kind}
        column(rows, "AdditionalParameterApriori", "value_0", value, where)
    rx, ry, rz = angles.values()
    (cx, cy, cz), (sx, sy, sz) = np.cos([rx, ry, rz]), np.sin([rx, ry, rz])
    y, x, z = np.subtract(jag3d.POINTS["P"], jag3d.POINTS["A"])
    observed = (
        -cy * sz * x + (cx * cz - sx * sy * sz) * y + (sx * cz + cx * sy * sz) * z,
        cy * cz * x + (cx * sz + sx * sy * cz) * y + (sx * sz - cx * sy * cz) * z,
        sy * x - sx * cy * y + cx * cy * z,
    )
    for name, value in zip(("y0", "x0", "z0"), observed, strict=True):
        column(rows, "GNSSObservationApriori", name, float(value), {"id": 0})
    network = fga.read_jag3d(project(tmp_path, rows))
    equations = compile_network(network)
    block = next(b for b in equations.blocks if b.kind == "frame_vector")
    found = block.evaluate(network.frame, equations.unknowns.start())
    assert np.abs(found.residual[0]).max() < 1e-9


def test_a_free_network_with_reductions_has_the_result_of_jag3d(tmp_path):
    network = fga.read_jag3d(project(tmp_path, reduced_site()))
    assert network.datum == "free"
    assert network.refractions["Zenith"].values == (0.13 - 1.0,)  # curvature of the Earth
    solution = fga.adjust(network, variance="a-posteriori")
    assert solution.redundancy == jag3d.REDUCED_REDUNDANCY
    assert math.isclose(solution.vtpv, jag3d.REDUCED_OMEGA, rel_tol=WEIGHTS)
    for name, (place, sigma) in jag3d.REDUCED_POINTS.items():
        assert np.allclose(solution.point(name), place, atol=TENTH_MICRON, rtol=0)
        found = 1e3 * solution.standard_deviations(name)
        assert np.allclose(found, sigma, rtol=WEIGHTS)


def test_deflections_of_the_vertical_have_the_signs_of_jag3d(tmp_path):
    """The site was simulated without them: σ̂0 is 15, and weights move points by 0.01 mm."""
    solution = fga.adjust(fga.read_jag3d(project(tmp_path, deflected_site())))
    assert solution.redundancy == jag3d.DEFLECTED_REDUNDANCY
    assert math.isclose(solution.vtpv, jag3d.DEFLECTED_OMEGA, rel_tol=WEIGHTS)
    for name, (place, _) in jag3d.DEFLECTED_POINTS.items():
        assert np.allclose(solution.point(name), place, atol=2e-5, rtol=0)
    xi, eta = solution.unknown("vertical", "Q").values
    assert np.allclose((-xi, eta), jag3d.DEFLECTION_Q, atol=2e-7)
    without = deflected_site()
    without["VerticalDeflectionApriori"] = []
    flat_one = fga.adjust(fga.read_jag3d(project(tmp_path, without)))
    assert abs(flat_one.point("Q")[2] - jag3d.DEFLECTED_POINTS["Q"][0][2]) > 0.01


@pytest.mark.parametrize("indexes", [1, 2, 5])
def test_cached_tables_are_those_of_the_script(tmp_path, indexes):
    memory = fga.read_jag3d(project(tmp_path, site()))
    text, data = database(site(), indexes=indexes)
    (tmp_path / "site.script").write_text(text)
    (tmp_path / "site.data").write_bytes(data)
    cached = fga.read_jag3d(tmp_path / "site.data")
    assert list(cached.points.values()) == list(memory.points.values())
    assert cached.parameters == memory.parameters
    for a, b in zip(cached.observations.values(), memory.observations.values(), strict=True):
        assert repr(a).replace(a.source, "") == repr(b).replace(b.source, "")
        assert a.source.startswith("site.data, byte ")
        assert b.source.startswith("site.script:")


def test_a_congruence_analysis_has_the_result_of_jag3d(tmp_path):
    """Both epochs in one adjustment; T = ∇ᵀQ⁻¹∇ / 3, divided by σ̂0² in T post."""
    path = project(tmp_path, two_epochs())
    pairs = point_pairs(path)
    assert pairs == {"P1": "P2", "Q1": "Q2"}
    solution = fga.adjust(fga.read_jag3d(path))
    assert solution.redundancy == jag3d.EPOCHS_REDUNDANCY
    assert math.isclose(solution.vtpv, jag3d.EPOCHS_OMEGA, rel_tol=1e-8)
    post = fga.congruence(solution, pairs=pairs, alpha=0.001)
    prio = fga.congruence(solution, pairs=pairs, alpha=0.001, variance="a-priori")
    for name, (vector, sigma, t_prio, t_post) in jag3d.EPOCHS_PAIRS.items():
        found = post.displacement(name)
        assert np.allclose(1e3 * found.vector, vector, atol=2e-7)
        assert np.allclose(1e3 * found.sigmas, sigma, rtol=1e-6)
        assert math.isclose(found.test.value, t_post, rel_tol=1e-7)
        assert math.isclose(prio.displacement(name).test.value, t_prio, rel_tol=1e-7)
    assert post.moved == ("P1",)
    first, second = (fga.read_jag3d(path, epoch=e) for e in ("reference", "control"))
    assert len(first.observations) == len(second.observations) == 60


def test_a_point_in_two_pairs_is_refused(tmp_path):
    rows = two_epochs()
    rows["CongruenceAnalysisPointPairApriori"].append([4, 0, "P1", "Q2", True])
    with pytest.raises(InputError, match="is compared with 'P2' and 'Q2'"):
        point_pairs(project(tmp_path, rows))


# -- σ and radius by hand -------------------------------------------------------------------------


def test_standard_deviations_of_groups_by_hand(tmp_path):
    """ObservationGroup.java, getStd; DirectionGroup.java, DeltaZGroup.java."""

    def sigma(kind: str, row: str) -> object:
        (tmp_path / kind).mkdir(exist_ok=True)
        files = {"new_points_3d.txt": "A 0 0 0\nB 50 0 1\n", f"{kind}.txt": row}
        (o,) = fga.read_jag3d(flat(tmp_path / kind, files)).observations.values()
        return o.sigma

    direction = math.hypot(0.3e-3 * GON, 0.5e-3 / 50)
    assert math.isclose(sigma("directions", "A B 100.0 50\n"), direction)
    assert math.isclose(sigma("zenith_angles", "A B 100.0 50\n"), direction)
    assert math.isclose(sigma("levelling", "A B 1.0 0.0007\n"), 0.0007)
    level = sigma("levelling", "A B 1.0 400\n")
    assert level == StandardDeviation(1e-4, per_sqrt_km=1e-3, combine="quadratic")
    distance = sigma("slope_distances", "A B 60.0\n")
    assert distance == StandardDeviation(2e-3, ppm=2.0, combine="quadratic")
    found = sigma("gnss_3d", "A B 50 -2000 1\n")
    by_hand = [math.hypot(0.025, 50e-6 * d) for d in (50, 2000, 1)]
    assert np.allclose(found, by_hand, rtol=1e-12)


def test_parts_that_fall_with_the_root_of_the_length_are_computed_at_the_coordinates(tmp_path):
    """DirectionGroup.java: b / √d, with d in metres, in plan."""
    rows = site()
    network = fga.read_jag3d(project(tmp_path, rows))
    found = next(
        o for o in network.observations.values() if isinstance(o, Direction) and o.station == "Q"
    )
    q, a = jag3d.POINTS["Q"], jag3d.POINTS["A"]
    d = math.hypot(q[0] - a[0], q[1] - a[1])
    by_hand = math.sqrt((3e-4 * GON) ** 2 + (5e-4 * GON) ** 2 / d + (5e-4 / d) ** 2)
    assert math.isclose(found.sigma, by_hand, rel_tol=1e-12)


def test_the_radius_is_that_of_the_sphere_of_gauss():
    """√(M N): 6 382 644 m at 51.566° (0.9 rad) on GRS80."""
    a, b, f = 6378137.0, 6356752.3, 0.9
    e2 = 1 - (b / a) ** 2
    m = a * (1 - e2) / (1 - e2 * math.sin(f) ** 2) ** 1.5
    n = a / math.sqrt(1 - e2 * math.sin(f) ** 2)
    assert math.isclose(gaussian_radius(a, b, f), math.sqrt(m * n), rel_tol=1e-14)


# -- what takes part in a project ------------------------------------------------------------------


def test_what_is_switched_off_is_left_out(tmp_path):
    rows = site()
    column(rows, "PointApriori", "enable", False, {"name": "N1"})
    network = fga.read_jag3d(project(tmp_path, rows))
    assert "N1" not in network.points
    assert not any("N1" in o.points() for o in network.observations.values())
    assert not any(o.points() == ("A", "B") and isinstance(o, HorizontalDistance)
                   for o in network.observations.values())  # fmt: skip


def test_observations_of_one_epoch_are_read(tmp_path):
    rows = site()
    column(rows, "ObservationGroup", "reference_epoch", False, {"id": 3})
    path = project(tmp_path, rows)
    kinds = {
        epoch: {o.kind for o in fga.read_jag3d(path, epoch=epoch).observations.values()}
        for epoch in ("both", "reference", "control")
    }
    assert kinds["control"] == {"slope_distance"}
    assert kinds["reference"] == kinds["both"] - {"slope_distance"}
    assert "epoch" in refused(path, epoch="first")[0]


def test_groups_without_sigma_have_the_default_of_jag3d(tmp_path):
    """SQLAdjustmentManager.java: a missing or negative part is the default, c = 0 is stated."""
    rows = site()
    rows["ObservationGroupUncertainty"] = [[3, 10, 0.004], [3, 12, 0.0]]
    network = fga.read_jag3d(project(tmp_path, rows))
    of = {type(o): o.sigma for o in network.observations.values()}
    assert of[SlopeDistance] == 0.004
    assert of[ZenithAngle] == StandardDeviation(3e-4 * GON, centring_target=5e-4,
                                                combine="quadratic")  # fmt: skip


def test_scales_that_are_held_are_taken_out_of_heights_and_vectors(tmp_path):
    """DeltaZ.java: Δz / m; GNSSBaselineDeltaX3D.java: m Δx."""
    plain = fga.read_jag3d(project(tmp_path, site()))
    rows = site()
    for group in (6, 7):
        where = {"group_id": group, "type": 2}
        column(rows, "AdditionalParameterApriori", "value_0", 1.001, where)
    scaled = fga.read_jag3d(project(tmp_path, rows))
    for a, b in zip(plain.observations.values(), scaled.observations.values(), strict=True):
        if isinstance(a, HeightDifference):
            assert math.isclose(b.value, 1.001 * a.value)
            assert b.sigma == a.sigma.scaled(1.001)
        elif isinstance(a, GnssVector):
            assert np.allclose(b.value, np.divide(a.value, 1.001))
            assert np.allclose(b.sigma, np.divide(a.sigma, 1.001))


def test_an_orientation_that_is_held_is_given_to_every_station(tmp_path):
    rows = site()
    column(rows, "AdditionalParameterApriori", "enable", False, {"group_id": 0})
    column(rows, "AdditionalParameterApriori", "value_0", 0.7, {"group_id": 0})
    network = fga.read_jag3d(project(tmp_path, rows))
    assert network.parameters["orientation"][("P", "Directions P")].values == (0.7,)
    assert fga.adjust(network).redundancy == jag3d.SITE_REDUNDANCY + 1


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"table": "ReductionDefinition", "name": "projection_type", "value": 3, "where": {}},
         "a local ellipsoidal system"),
        ({"table": "AdditionalParameterApriori", "name": "enable", "value": True,
          "where": {"group_id": 6, "type": 2}}, "an unknown scale, which levelling do not have"),
        ({"table": "AdditionalParameterApriori", "name": "enable", "value": True,
          "where": {"group_id": 7, "type": 8}}, "are unknown together, or held together"),
        ({"table": "AdditionalParameterApriori", "name": "value_0", "value": -1.0,
          "where": {"group_id": 3, "type": 2}}, "a scale of -1.0; valid: near 1"),
        ({"table": "PointGroup", "name": "type", "value": 3, "where": {"id": 2}},
         "reference point 'A' beside datum points"),
        ({"table": "PointGroup", "name": "dimension", "value": 2, "where": {"id": 2}},
         "slope_distances join points of 3 dimensions, 'P' has 2"),
        ({"table": "ObservationGroup", "name": "type", "value": 9, "where": {"id": 3}},
         "observations of type 9 are not known"),
        ({"table": "ObservationApriori", "name": "start_point_name", "value": "Q",
          "where": {"group_id": 0, "end_point_name": "A"}},
         "one unknown orientation for directions of 2 stations"),
        ({"table": "ObservationApriori", "name": "end_point_name", "value": "X",
          "where": {"group_id": 3}}, "unknown point 'X'"),
        ({"table": "PointApriori", "name": "z0", "value": math.inf, "where": {"name": "B"}},
         "z0 is inf"),
        ({"table": "ReductionDefinition", "name": "minor_axis", "value": 0.0, "where": {}},
         "of an ellipsoid"),
    ],
)  # fmt: skip
def test_what_cannot_be_expressed_is_refused_with_its_line(tmp_path, change, said):
    rows = site()
    column(rows, change["table"], change["name"], change["value"], change["where"])
    if math.isinf(change["value"]) if isinstance(change["value"], float) else False:
        text = script(rows).replace("INFE0", "1E0/0")
        path = tmp_path / "site.script"
        path.write_text(text)
    else:
        path = project(tmp_path, rows)
    found = refused(path)
    assert any(said in f for f in found), found
    assert all("site.script" in f for f in found)


def test_a_levelled_point_with_a_deflection_is_refused(tmp_path):
    rows = site()
    rows["VerticalDeflectionGroup"] = [[0, "held", 1, True, 0]]
    rows["VerticalDeflectionApriori"] = [[0, 0, "P", 1e-4, 0.0, 0.0, 0.0, True]]
    assert "JAG3D turns its height" in refused(project(tmp_path, rows))[0]


def test_umlauts_quotes_and_unfinished_projects(tmp_path):
    rows = site()
    for table, name in (("PointApriori", "name"), ("ObservationApriori", "end_point_name")):
        column(rows, table, name, "Kirche 'Süd', Ω", {name: "C"})
    column(rows, "GNSSObservationApriori", "start_point_name", "Kirche 'Süd', Ω",
           {"start_point_name": "C"})  # fmt: skip
    path = project(tmp_path, rows)
    assert "Kirche 'Süd', Ω" in fga.read_jag3d(path).points
    assert "Kirche 'Süd', Ω" in fga.read_jag3d(project(tmp_path, rows, cached=True)).points
    path.with_suffix(".log").write_text("DELETE FROM X\n")
    assert "site.log holds statements" in refused(path)[0]
    path.with_suffix(".log").unlink()
    path.with_suffix(".data").unlink()
    assert "site.data, which cannot be read" in refused(path)[0]


def test_another_database_is_no_project(tmp_path):
    path = tmp_path / "other.script"
    path.write_text('CREATE MEMORY TABLE PUBLIC."A"("id" INTEGER)\nINSERT INTO "A" VALUES(1)\n')
    assert "no project of JAG3D" in refused(path)[0]
    with pytest.raises(InputError):
        fga.read(path)


# -- flat files -----------------------------------------------------------------------------------


def test_flat_files_of_every_kind_are_read(tmp_path):
    network = fga.read(flat(tmp_path, FLAT))
    p = network.points
    assert p["B"].coordinates == (1120.0, 2010.0, 53.0)
    assert p["B"].held == "xyz"
    assert p["C"].sigma == (0.003, 0.003, 0.002)
    assert (p["N1"].held, p["M"].held, p["R"].held) == ("z", "xy", "xyz")
    of: dict[type, list] = {}
    for o in network.observations.values():
        of.setdefault(type(o), []).append(o)
    directions = of[Direction]
    sets = [(o.station, o.set) for o in directions]
    assert len(set(sets)) == 3  # P, A, and P once more
    assert sets[0] == sets[3] != sets[-1] == sets[-2]
    assert math.isclose(directions[0].value, 205.43606 * GON)
    assert math.isclose(directions[3].sigma, 0.0004 * GON)
    slope = of[SlopeDistance]
    assert (slope[0].instrument_height, slope[0].target_height) == (1.52, 1.5)
    assert [o.sigma for o in slope[::2]] == [0.001, 0.001]
    plane = of[HorizontalDistance]
    assert math.isclose(plane[2].sigma, math.hypot(0.002, 2e-6 * 5))
    zenith = of[ZenithAngle]
    assert math.isclose(zenith[2].value, 110 * GON)  # second face
    levels = of[HeightDifference]
    assert [o.length_km for o in levels[::2]] == [0.030, 0.037]
    assert levels[1].sigma == 0.0002
    vector = of[GnssVector][0]
    assert vector.value == (50.006, 50.007, 2.505)
    assert vector.sigma == (0.01, 0.01, 0.015)
    differences = of[CoordinateDifference]
    assert [(o.axes, o.value) for o in differences] == [
        ("z", (10.292,)), ("z", (1.8,)), ("xy", (-30.003, -29.996)),
    ]  # fmt: skip
    assert slope[0].source == "Schrägstrecken.txt:1"
    assert fga.adjust(network).redundancy == 20


def test_flat_files_give_the_network_of_the_project(tmp_path):
    """The same rows as flat files, without the parameters that these cannot hold."""
    rows = site()
    for number in (3, 5):
        column(rows, "AdditionalParameterApriori", "enable", False, {"group_id": number})
    column(rows, "AdditionalParameterApriori", "value_0", 1.0, {"type": 2})
    column(rows, "AdditionalParameterApriori", "value_0", 0.0, {"type": 4})
    expected = fga.adjust(fga.read_jag3d(project(tmp_path, rows)))
    fga.write(expected.network, tmp_path / "flat", format="jag3d")
    again = fga.adjust(fga.read(tmp_path / "flat"))
    assert again.redundancy == expected.redundancy
    assert math.isclose(again.vtpv, expected.vtpv, rel_tol=WEIGHTS)
    for name in expected.network.points:
        plan = 2 if name == "N1" else 3  # files of 2-D points have no z
        assert np.allclose(again.point(name)[:plan], expected.point(name)[:plan], atol=1e-5)
    names = sorted(f.name for f in (tmp_path / "flat").iterdir())
    assert names == sorted(
        f"{n}.txt" for n in (
            "directions", "gnss_1d", "gnss_2d", "gnss_3d", "horizontal_distances", "levelling",
            "new_points_1d", "new_points_2d", "new_points_3d",
            "reference_points_3d", "slope_distances", "stochastic_points_3d", "zenith_angles",
        )
    )  # fmt: skip


TRAPS = {
    "P Q 12,345\n": "has a comma: write a decimal point",
    "P P 12.3\n": "joins 'P' to itself",
    "P Q\n": "a station, a target and numbers",
    "P Q 1.5 1.5 12.3 0.001 remark\n": "word 7: 'remark' is not a number",
    "P Q 1 2 3 4 5\n": "at most 6 words",
    "P Q nan\n": "word 3: 'nan' is not a finite number",
    "P Q 12.3 -0.001\n": "must not be negative",
    "P X 12.3\n": "unknown point 'X'",
    "P Q -5\n": "negative",
    "P Q 1e300\n": "word 3",
}
POINT_TRAPS = {
    "P 1 2\n": "has 3 or 4 or 5 or 6 numbers, not 2",
    "P 1 2 3 0.1 0 0.1\n": "must be > 0",
    "P 1 2 3\nP 1 2 3\n": "stands in new_points_3d.txt:1 already",
    "P 1 2 x\n": "word 4: 'x' is not a number",
    f"{'P' * 300} 1 2 3\n": "more than 256 characters",
}


@pytest.mark.parametrize("row", TRAPS)
def test_rows_that_jag3d_would_skip_or_misread_are_problems(tmp_path, row):
    flat(tmp_path, {"new_points_3d.txt": "P 0 0 0\nQ 50 0 1\n", "slope_distances.txt": row})
    (found,) = refused(tmp_path)
    assert found.startswith("slope_distances.txt:1")
    assert TRAPS[row] in found


@pytest.mark.parametrize("row", POINT_TRAPS)
def test_points_that_jag3d_would_skip_are_problems(tmp_path, row):
    flat(tmp_path, {"new_points_3d.txt": row})
    (found,) = refused(tmp_path)
    assert found.startswith("new_points_3d.txt:")
    assert POINT_TRAPS[row] in found


def test_a_last_number_of_one_and_more_is_a_length_and_not_a_sigma(tmp_path):
    flat(tmp_path, {"new_points_3d.txt": "A 0 0 0\nB 50 0 1\n",
                    "levelling.txt": "A B 1.0 0.9999\nA B 1.0 1\n"})  # fmt: skip
    first, second = fga.read_jag3d(tmp_path).observations.values()
    assert first.sigma == 0.9999
    assert second.length_km == 0.001


def test_a_levelled_line_needs_its_length_or_sigma_where_points_have_no_plan(tmp_path):
    flat(tmp_path, {"reference_points_1d.txt": "A 10\n", "new_points_1d.txt": "B 11\n",
                    "levelling.txt": "A B 1.0\nA B 1.0001 0.0002\n"})  # fmt: skip
    (found,) = refused(tmp_path)
    assert found.startswith("levelling.txt:1")
    assert "write a σ or the length" in found
    network = fga.read_jag3d(tmp_path, levelling_mm_per_sqrt_km=0)
    assert fga.adjust(network).redundancy == 1


def test_units_of_flat_files_are_options(tmp_path):
    flat(tmp_path, {"new_points_3d.txt": "A 0 0 0\nB 50000 0 1000\n",
                    "directions.txt": "A B 90 0.001\n"})  # fmt: skip
    network = fga.read_jag3d(tmp_path, length="mm", angle="deg")
    (o,) = network.observations.values()
    assert network.points["B"].coordinates == (50.0, 0.0, 1.0)
    assert math.isclose(o.value, math.pi / 2)
    assert math.isclose(o.sigma, math.radians(0.001))
    assert len(refused(tmp_path, length="cubit", angle="turn")) == 2
    assert "distance_mm" in refused(tmp_path, distance_mm=0)[0]


def test_additional_parameters_of_flat_files_are_estimated_where_asked(tmp_path):
    folder = flat(tmp_path, FLAT)
    network = fga.read_jag3d(folder, estimate="zero,refraction")
    meters = network.parameters["edm"]
    assert set(meters) == {"Schrägstrecken", "horizontal_distances"}
    assert meters["Schrägstrecken"].fixed == (True, False)
    assert not network.refractions["zenith"].fixed[0]
    assert fga.adjust(network).redundancy == 20 - 3
    assert "unknown parameter 'tilt'" in refused(folder, estimate=["tilt"])[0]


def test_names_that_do_not_tell_the_kind_are_stated(tmp_path):
    flat(tmp_path, {"a.txt": "A 0 0 0\nB 50 0 1\n", "b.txt": "A B 50.01\n"})
    assert len(refused(tmp_path)) == 2
    kinds = {"a.txt": "datum_points_3d", "b.txt": "slope_distances"}
    assert len(fga.read_jag3d(tmp_path, kinds=kinds).observations) == 1
    files = [tmp_path / "a.txt", tmp_path / "b.txt"]
    assert len(fga.read_jag3d(files, kinds=kinds).observations) == 1
    words = {"a.txt": "Datumspunkte 3D", "b.txt": "Schrägstrecken"}
    assert fga.read_jag3d(tmp_path, kinds=words).observations.keys() == {"1"}
    assert "unknown kind 'x'" in refused(tmp_path, kinds={**kinds, "a.txt": "x"})[0]
    assert "none of the files" in refused(tmp_path, kinds={**kinds, "c.txt": "levelling"})[0]


def test_a_folder_with_one_name_that_does_not_tell_its_kind_says_which(tmp_path):
    """Points of a file that was not read are not told as unknown."""
    flat(tmp_path, {"Neupunkte_3D.txt": "A 10 20 3\n", "Gruppe 1.txt": "B 50 20 1\n"})
    flat(tmp_path, {"Raumstrecken.txt": "A B 40.05\n", "Zenitwinkel.txt": "A B 1O3\n"})
    with pytest.raises(fga.InputError) as error:
        fga.read(tmp_path)
    first, second = error.value.problems
    assert "Gruppe 1.txt: its name does not tell what it holds: rename it, or state" in str(first)
    assert str(second).startswith("Zenitwinkel.txt:1")
    (tmp_path / "project.toml").touch()  # a project, whatever stands beside it
    assert not is_jag3d(tmp_path)


def test_one_flat_file_is_told_by_its_name(tmp_path):
    """Its suffix is that of other formats too."""
    flat(tmp_path, {"Neupunkte_3D.txt": "A 10 20 3\n", "problem.txt": "A 10 20 3\n"})
    assert fga.read(tmp_path / "Neupunkte_3D.txt").points["A"].coordinates == (10.0, 20.0, 3.0)
    with pytest.raises(fga.InputError, match=r"is not .* JAG3D: text that begins with 'A 10 20 3'"):
        fga.read(tmp_path / "problem.txt")


def test_the_command_checks_flat_files_without_doubts(tmp_path, capsys):
    """Directions have no heights in flat files where distances and zenith angles have them."""
    folder = flat(
        tmp_path,
        {
            "Festpunkte_3D.txt": "A 1000 2000 50\nB 1120 2010 53\n",
            "Richtungen.txt": "A B 94.70685\n",
            "Raumstrecken.txt": "A B 1.6 1.5 120.4494\n",
        },
    )
    assert main(["check", str(folder)]) == 0
    assert "doubt" not in capsys.readouterr().out
    file = folder / "Raumstrecken.txt"
    file.write_text("A B 1.6 1.5 120.4494\nA B 0 1.5 120.4537\nA B 1.6 1.5 120.4494\n")
    main(["check", str(folder)])
    assert "1 of 3 readings at station 'A' have no height of the in" in capsys.readouterr().out


def test_the_command_converts_there_and_back(tmp_path, capsys):
    (tmp_path / "in").mkdir()
    folder = flat(tmp_path / "in", FLAT)
    assert main(["convert", str(folder), str(tmp_path / "p.toml")]) == 0
    assert main(["convert", str(tmp_path / "p.toml"), str(tmp_path / "out"), "--to", "jag3d"]) == 0
    again = fga.read(tmp_path / "out")
    first = fga.read_jag3d(folder)
    assert len(again.observations) == len(first.observations)
    assert again.points["M"] == first.points["M"]
    capsys.readouterr()


# -- writing --------------------------------------------------------------------------------------


def test_an_adjusted_free_network_comes_back_with_its_deflections(tmp_path):
    network = fga.Network("free", datum="free")
    for name, at in {"A": (0, 0, 0), "B": (90, 10, 3), "C": (40, 80, -2), "D": (10, 60, 4)}.items():
        network.add_point(name, at, datum=name != "D")
    network.set_vertical("A", xi=1e-5, eta=-2e-5, fixed=True)
    network.set_vertical("B", xi=1e-5, eta=2e-5, sigma=(3e-6, 4e-6))
    rng = np.random.default_rng(3)
    for a in "ABCD":
        for b in "ABCD":
            if a != b:
                d = np.subtract(network.points[b].coordinates, network.points[a].coordinates)
                s = float(np.linalg.norm(d)) + 0.001 * rng.normal()
                network.add(SlopeDistance(a, b, s, sigma=0.001))
                angle = math.atan2(d[0], d[1]) % (2 * math.pi)
                for n in "12":
                    network.add(Direction(a, b, angle, sigma=1e-5, set=n))
    solution = fga.adjust(network)
    fga.write_jag3d(solution.as_network(), tmp_path / "out")
    assert (tmp_path / "out" / "directions_2.txt").exists()
    again = fga.read_jag3d(tmp_path / "out")
    assert again.datum == "free"
    assert [p.datum for p in again.points.values()] == [True, True, True, False]
    for name in "AB":
        assert np.allclose(again.parameters["vertical"][name].values,
                           network.parameters["vertical"][name].values, atol=1e-5)  # fmt: skip
    adjusted = fga.adjust(again)
    assert math.isclose(adjusted.vtpv, solution.vtpv, rel_tol=0.2)
    assert adjusted.redundancy == solution.redundancy
    fga.write_jag3d(fga.read_jag3d(flat(tmp_path, {
        "new_points_3d.txt": "A 0 0 0\n"})), tmp_path / "out")  # fmt: skip
    assert [f.name for f in (tmp_path / "out").iterdir()] == ["new_points_3d.txt"]


def test_what_flat_files_cannot_hold_is_refused_all_at_once_and_nothing_is_written(tmp_path):
    network = fga.Network("no", datum="free")
    network.add_point("a b", (0, 0, 0), fixed="xyz")
    network.add_point("C", (10, 0, 0), fixed="x")
    network.add_point("D", None)
    network.add_point("E", (1, 2, 3), check=(1, 1, 1))
    network.set_refraction(value=0.13)
    network.set_orientation("C", value=0.1, fixed=True)
    network.add(fga.VerticalAngle("C", "E", 0.1, sigma=1e-4))
    network.set_distance_meter("meter", free=["zero"])
    network.add(SlopeDistance("C", "E", 10.0, sigma=1e-3, instrument="meter"))
    with pytest.raises(InputError) as caught:
        fga.write_jag3d(network, tmp_path / "no")
    text = str(caught.value)
    for said in ("a name with ' '", "reference point in a free network", "held in x alone",
                 "without coordinates", "check points", "a stated unknown", "held or weighted",
                 "a vertical angle", "distance meter 'meter'"):  # fmt: skip
        assert said in text, said
    assert not (tmp_path / "no").exists()
    coarse = fga.Network("coarse")
    coarse.add_point("A", (0, 0, 0))
    coarse.add_point("B", (10, 0, 0))
    coarse.add(SlopeDistance("A", "B", 10.0, sigma=1.5))
    with pytest.raises(InputError, match="takes it for a length"):
        fga.write_jag3d(coarse, tmp_path / "no")


# -- damage ---------------------------------------------------------------------------------------


def test_damaged_projects_are_refused_or_read(tmp_path):
    text, data = database(site())
    judge(fga.read_jag3d, {"site.script": script(site()).encode()}, "site.script",
          tmp_path / "memory", seed=1, count=100)  # fmt: skip
    judge(fga.read_jag3d, {"site.script": text.encode(), "site.data": data}, "site.script",
          tmp_path / "cached", seed=2, count=100)  # fmt: skip


def test_damaged_flat_files_are_refused_or_read(tmp_path):
    files = {name: text.encode() for name, text in FLAT.items()}
    judge(lambda p: fga.read_jag3d(p.parent), files, "zenith.txt", tmp_path, seed=3, count=200)
