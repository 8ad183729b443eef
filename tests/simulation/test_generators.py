"""Every generator makes a network that adjusts; every disturbance does what it says."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import stats

import factorgraph_adj as fga
from examples.published_blocks.industry_1981 import simulate_industry_block
from examples.published_blocks.spec_parts import (
    Aerial1986,
    CloseRange1986,
    IndustryBlock,
    IspBlock,
)
from factorgraph_adj.frames import LocalFrame, TopocentricFrame
from factorgraph_adj.models.unknown_registry import UNKNOWNS
from factorgraph_adj.observations import KINDS, ControlPoint, Direction, HeightDifference
from factorgraph_adj.simulation.disturbances import (
    DROPPED,
    GROSS,
    DropOut,
    Errors,
    GrossError,
    add_gross_errors,
    readings_of,
)
from factorgraph_adj.simulation.generate.control import Control
from factorgraph_adj.simulation.generate.flight_observations import Gnss, Lake, Statoscope
from factorgraph_adj.simulation.generate.metrology import Shapes, Trackers
from factorgraph_adj.simulation.generate.photo_blocks import Aerial, CloseRange, CrossStrips
from factorgraph_adj.simulation.generate.rigs_and_models import IndependentModels, Rig
from factorgraph_adj.simulation.generate.scene import (
    Camera,
    Part,
    Scene,
    corners,
    nearest_lines,
    perimeter,
    round_lines,
    spread,
)
from factorgraph_adj.simulation.generate.terrestrial_additions import (
    Additions,
    Astronomic,
    Azimuths,
    Directions,
    DistanceMeter,
    Distances,
    HeightDifferences,
    TotalStation,
    VerticalAngles,
)
from factorgraph_adj.simulation.generate.terrestrial_networks import (
    LevellingLoops,
    Monitoring,
    Traverse,
    TriangulationGrid,
)
from factorgraph_adj.simulation.measurement import SimulatedNetwork
from factorgraph_adj.simulation.parameters import kinds_of
from factorgraph_adj.simulation.planned_values import undetermined_points
from factorgraph_adj.simulation.spec import Approximate, Earth, Spec, design, simulate
from factorgraph_adj.simulation.systematic_errors import (
    AffineFilm,
    LensDistortion,
    Refraction,
    TapeCalibration,
)

CONFIDENCE = 0.999
NEARLY = Approximate(points=0.1, centres=0.1, attitudes_deg=0.2)
MICROMETRE, PPM = 1e-3, 1e-6
SMALL = Aerial(strips=2, photos_per_strip=5, points_per_photo=25)
GROSS_OF_20_SIGMA = GrossError(count=3, times_sigma=20.0)
SEEDS = range(4)
"""Generators are judged by four simulations together. The image points of all of them share a
stream of noise: the one of seed 1 is rare, 3.5 σ in the first 600 rows."""
OWN_DATUM = (IndustryBlock, Aerial1986, CloseRange1986)

GENERATORS = {
    "aerial": (Aerial(),),
    "von Gruber": (Aerial(points="von_gruber"),),
    "random points": (Aerial(points="random"),),
    "side overlap alone": (Aerial(forward_overlap=0.3, side_overlap=0.6, strips=4),),
    "around": (CloseRange(),),
    "over": (CloseRange(arrangement="over", points="surface"),),
    "hidden": (CloseRange(points="random", hidden=0.3),),
    "models": (SMALL, IndependentModels()),
    "triplets without projection centres": (
        SMALL,
        IndependentModels(photos=3, shared=2, centres=False),
    ),
    "traverse": (Traverse(),),
    "loop": (Traverse(shape="loop", heights="levelled", both_ways=False),),
    "grid": (TriangulationGrid(),),
    "directions": (TriangulationGrid(observe="directions", heights="none"),),
    "trilateration": (TriangulationGrid(observe="distances", heights="levelled"),),
    "levelling": (LevellingLoops(),),
    "monitoring": (Monitoring(),),
    "trackers": (Trackers(),),
    "levelled scanners": (Trackers(level=True, sigma_angle_arcsec=5.0, hidden=0.0),),
    "shapes": (Shapes(measured_mm=0.5),),
    "shapes on photos": (Shapes(), CloseRange(of_parts=(0,), points="none", photos=12)),
    "GNSS, INS and a cross strip": (SMALL, CrossStrips(), Gnss(shift_mm=50.0, without=0.2)),
    "statoscope and lake": (SMALL, Statoscope(slope=0.5), Lake()),
    "rig": (SMALL, Rig(members=2)),
    "isp": (IspBlock(),),
    "industry": (IndustryBlock(),),
    "aerial 1986": (Aerial1986(distances=60, height_differences=32),),
    "close range 1986": (CloseRange1986(distances=10, height_differences=5),),
    "photos of a monitoring network": (
        Monitoring(),
        CloseRange(of_parts=(0,), points="none", distance=45.0, height=12.0),
    ),
    "photos of an object in one": (
        Monitoring(),
        CloseRange(prefix="c", of_parts=(0,), distance=45.0, height=12.0, size=(20.0, 20.0, 9.0)),
    ),
    "all additions": (
        SMALL,
        Distances(),
        HeightDifferences(between="nearest"),
        Directions(count=12),
        Azimuths(count=4),
        VerticalAngles(count=4),
        Astronomic(count=3),
    ),
}


def adjusted(spec: Spec, *, seed: int | None = None) -> tuple[SimulatedNetwork, fga.Solution]:
    simulated = simulate(spec, seed=seed)
    return simulated, fga.adjust(simulated.network)


def accepted(vtpv: float, redundancy: int) -> bool:
    """Return whether vᵀPv is within the bounds of χ²."""
    tail = (1 - CONFIDENCE) / 2
    low, high = stats.chi2.ppf(tail, redundancy), stats.chi2.isf(tail, redundancy)
    return bool(low < vtpv < high)


LONG = pytest.mark.slow(
    "generators of rigs, models and whole blocks; short tests take the other twenty-one"
)
LONG_ONES = {
    *("rig", "models", "triplets without projection centres", "aerial 1986", "all additions"),
    *("industry", "photos of a monitoring network", "photos of an object in one"),
    "shapes on photos",
}

# -- generators -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=LONG if n in LONG_ONES else ()) for n in GENERATORS]
)
def test_a_generator_makes_a_network_that_is_determined_and_fits_its_weights(name: str) -> None:
    parts = GENERATORS[name]
    spec = Spec(
        parts=parts,
        control=None if isinstance(parts[0], OWN_DATUM) else Control(),
        earth=Earth(frame="topocentric" if name == "all additions" else "local"),
        approximate=NEARLY,
    )
    vtpv, redundancy = 0.0, 0
    for seed in SEEDS:
        simulated, solution = adjusted(spec, seed=seed)
        assert solution.converged
        assert solution.datum_defect == 0
        vtpv, redundancy = vtpv + solution.vtpv, redundancy + solution.redundancy
        off = [
            (solution.point(p.name) - simulated.truth.points[p.name])[~np.array(p.fixed)]
            / solution.standard_deviations(p.name)[~np.array(p.fixed)]
            for p in simulated.network.points.values()
        ]
        assert np.abs(np.concatenate(off)).max() < 5.0
    assert redundancy > 0
    assert accepted(vtpv, redundancy)


@pytest.mark.parametrize("name", ["trackers", "levelled scanners", "models", "GNSS, INS and a cross strip", "rig"])  # fmt: skip  # noqa: E501
@LONG
def test_an_adjustment_finds_again_what_it_is_not_told(name: str) -> None:
    """Frames, mounts and drifts without values: the minimum is that which begins at true ones."""
    parts, close = GENERATORS[name], replace(NEARLY, points=0.05)
    told, untold = (
        adjusted(Spec(parts=parts, control=Control(), approximate=replace(close, restart=r)))[1]
        for r in (False, True)
    )
    assert untold.vtpv == pytest.approx(told.vtpv, rel=1e-5)


def test_every_kind_of_part_is_among_the_generators_tested() -> None:
    tested = {part.kind for parts in GENERATORS.values() for part in parts}
    assert set(kinds_of(Part)) == tested
    assert set(kinds_of(Additions)) < tested


@pytest.mark.parametrize("points", ["grid", "von_gruber", "random"])
def test_every_point_of_an_aerial_block_has_two_rays(points: str) -> None:
    network = design(Spec(parts=(Aerial(points=points),)))  # type: ignore[arg-type]
    _, point, _, _ = network.images.columns()
    assert np.bincount(point, minlength=len(network.points)).min() >= 2


def test_an_aerial_block_has_the_overlap_and_the_scale_asked_for() -> None:
    block = Aerial(forward_overlap=0.8, side_overlap=0.3, scale=2000.0, camera=Camera(c_mm=100.0))
    assert block.height == pytest.approx(200.0)
    assert block.base == pytest.approx([0.2 * 460.0, 0.7 * 460.0])
    photos = design(Spec(parts=(block,))).photos
    at = {name: np.array(f.position) for name, f in photos.items()}
    assert at["1/2"] - at["1/1"] == pytest.approx([92.0, 0.0, 0.0], abs=5 * 2**0.5 * 0.03 * 92)
    assert at["2/1"] - at["1/1"] == pytest.approx([0.0, 322.0, 0.0], abs=5 * 2**0.5 * 0.03 * 92)


def test_the_points_of_a_photo_are_as_many_as_asked_for() -> None:
    block = Aerial(points_per_photo=60, strips=3, photos_per_strip=8, forward_overlap=0.7)
    network = design(Spec(parts=(block,)))
    photo, _, _, _ = network.images.columns()
    in_photo = np.bincount(photo).reshape(3, 8)[:, 1:-1]
    assert in_photo.mean() == pytest.approx(60, rel=0.1)


def test_the_isp_block_has_25_photos_with_9_points() -> None:
    """Nine; twelve in the second photo from either end, which sees its neighbour's column too."""
    network = design(Spec(parts=(IspBlock(),)))
    photo, point, _, _ = network.images.columns()
    assert np.bincount(photo).reshape(5, 5).tolist() == [[9, 12, 9, 12, 9]] * 5
    assert len(network.points) == 77
    assert np.bincount(point).min() == 2


def test_the_industry_block_of_a_spec_is_that_of_its_own_simulation() -> None:
    spec = Spec(
        parts=(IndustryBlock(photos=4, distances=60),),
        approximate=Approximate(0.1, 0.3, 1.0),
    )
    ours, theirs = simulate(spec, seed=5), simulate_industry_block(5, photos=4, distances=60)
    for a, b in zip(ours.network.images.columns(), theirs.network.images.columns(), strict=True):
        assert np.array_equal(a, b)
    assert ours.network.observations == theirs.network.observations
    assert [p.coordinates for p in ours.network.points.values()] == [
        p.coordinates for p in theirs.network.points.values()
    ]


def test_photos_of_another_part_see_its_points_and_no_others() -> None:
    parts = GENERATORS["photos of a monitoring network"]
    network = design(Spec(parts=parts))
    assert len(network.points) == 20
    targets = {p.point for p in network.image_points()}
    assert {f"M{i}" for i in range(1, 17)} <= targets


def test_a_target_is_sighted_from_two_pillars_at_least() -> None:
    network = design(Spec(parts=(Monitoring(pillars=3, targets=30),)))
    for i in range(1, 31):
        stations = {o.names()[0] for o in network.observations.values() if o.names()[1] == f"M{i}"}
        assert len(stations) >= 2


# -- patterns -------------------------------------------------------------------------------------


def grid(columns: int, rows: int) -> np.ndarray:
    return np.array([(x, y) for x in range(columns) for y in range(rows)], dtype=float)


@pytest.mark.parametrize(("columns", "rows"), [(5, 5), (8, 4), (3, 9), (2, 2)])
def test_the_perimeter_of_a_grid_is_its_edge_in_order(columns: int, rows: int) -> None:
    xy = grid(columns, rows)
    ring = perimeter(xy)
    edge = (xy[:, 0] % (columns - 1) == 0) | (xy[:, 1] % (rows - 1) == 0)
    assert sorted(ring) == np.flatnonzero(edge).tolist()
    steps = np.diff(xy[[*ring, ring[0]]], axis=0)
    assert np.all(np.linalg.norm(steps, axis=1) == 1.0)


def test_corners_are_the_corners_and_spread_points_keep_apart() -> None:
    xy = grid(5, 5)
    at = corners(xy)
    assert sorted(map(tuple, xy[at])) == [(0, 0), (0, 4), (4, 0), (4, 4)]
    five = spread(xy, 5, at)
    assert {tuple(p) for p in xy[five]} == {(0, 0), (0, 4), (4, 0), (4, 4), (2, 2)}


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 6, 9, 12])
def test_lines_round_a_ring_are_at_most_every_pair_once(n: int) -> None:
    """The diagonals of an even ring among them, which are half as many as its places."""
    every = round_lines(n, 100)
    assert len(every) == len({frozenset(line) for line in every}) == n * (n - 1) // 2
    assert not any(i == j for i, j in every)


@pytest.mark.parametrize("count", [0, 1, 6, 12, 20, 24])
def test_lines_round_a_ring_are_as_many_as_asked_for_and_all_different(count: int) -> None:
    lines = round_lines(12, count)
    assert len({frozenset(line) for line in lines}) == count
    if count <= 12:
        assert all((j - i) % 12 == 1 for i, j in lines)
    if count == 6:
        assert {i for i, _ in lines} == {0, 2, 4, 6, 8, 10}


def test_nearest_lines_join_every_point_first() -> None:
    xyz = np.array([[0.0, 0, 0], [1, 0, 0], [2.5, 0, 0], [9, 0, 0], [0, 1.2, 0]])
    lines = nearest_lines(xyz, 5)
    assert {*lines[:4]} == {(0, 1), (0, 4), (1, 2), (2, 3)}
    assert lines[4] == (1, 4)


@pytest.mark.parametrize(
    ("control", "horizontal", "vertical"),
    [
        (Control(), 4, 4),
        (Control("full", "none"), 49, 0),
        (Control("corners", "perimeter"), 4, 24),
        (Control("perimeter", "full", horizontal_count=8, vertical_count=14), 8, 14),
        (Control("named", "named", horizontal_points=("G1",), vertical_points=("G2",)), 1, 1),
    ],
)
@pytest.mark.parametrize("sigma_mm", [0.0, 5.0])
def test_control_is_given_by_pattern_and_held_or_weighted(
    control: Control, horizontal: int, vertical: int, sigma_mm: float
) -> None:
    part = TriangulationGrid(columns=7, rows=7)
    control = replace(control, sigma_horizontal_mm=sigma_mm, sigma_vertical_mm=sigma_mm)
    network = design(Spec(parts=(part,), control=control))
    if sigma_mm:
        given = [o for o in network.observations.values() if isinstance(o, ControlPoint)]
        axes = [o.axes for o in given]
        assert {s for o in given for s in o.sigma or ()} == {5e-3}
        assert not any(any(p.fixed) for p in network.points.values())
    else:
        axes = ["".join(a for a, f in zip("xyz", p.fixed, strict=True) if f)
                for p in network.points.values()]  # fmt: skip
    assert sum("xy" in a for a in axes) == horizontal
    assert sum("z" in a for a in axes) == vertical


# -- streams of random numbers --------------------------------------------------------------------


def test_geometry_has_no_stream_of_random_numbers_that_errors_have() -> None:
    """Neither noise, approximate values, weighted unknowns, gross errors nor drop-outs."""
    seed = 5
    errors = [(seed, kind) for kind in range(len(KINDS) + 1 + len(UNKNOWNS))]
    errors += [(seed, tag, i) for tag in (GROSS, DROPPED) for i in range(20)]
    first = [np.random.default_rng(words).random() for words in errors]
    for number in range(20):
        scene = Scene(fga.Network(), seed, number=number)
        first += [scene.rng(stream).random() for stream in (0, 1, 2, *range(100, 110))]
    assert len(set(first)) == len(first)


def test_the_geometry_of_a_part_does_not_go_with_the_noise_of_its_readings() -> None:
    """Of 3 × 40 pairs: |correlation| of independent numbers is below 0.3 to 99.9 %."""
    part = Aerial(strips=2, photos_per_strip=3, points_per_photo=12, camera=Camera(c_mm=100.0))
    meter = DistanceMeter(sigma_mm=1.0, ppm=0.0)
    spec = Spec(parts=(part, Distances(between="nearest", count=3, distance_meter=meter)))
    scatter, noise = [], []
    for seed in range(40):
        varied = spec.varied({"seed": seed})
        plan, read = design(varied), simulate(varied).network
        at = np.array(plan.photos["1/1"].position) - [0.0, 0.0, part.height]
        scatter.append(at / (0.03 * part.base[0]))
        noise.append([o.value - plan.observations[i].value for i, o in read.observations.items()])
    together = np.corrcoef(np.ravel(scatter), np.ravel(noise))[0, 1]
    assert abs(together) < 0.3


# -- disturbances ---------------------------------------------------------------------------------


def differences(spec: Spec, errors: Errors) -> dict[tuple[str, str], float]:
    """Return what errors add to each reading of a spec."""
    without, with_ = (simulate(replace(spec, errors=e), seed=2).network for e in (Errors(), errors))
    return {
        r: value(with_, r) - value(without, r)
        for r in readings_of(without)
        if value(with_, r) != value(without, r)
    }


def value(network: fga.Network, reading: tuple[str, str]) -> float:
    ident, component = reading
    if ident in network.observations:
        return float(np.atleast_1d(network.observations[ident].value)[0])  # type: ignore[attr-defined]
    return float(_images(network)[ident]["xy".index(component)])


@cache
def _images(network: fga.Network) -> dict[str, tuple[float, float]]:
    return {f"{p.photo}/{p.point}": (p.x, p.y) for p in network.image_points()}


def test_without_noise_an_adjustment_finds_what_is_true() -> None:
    spec = Spec(
        parts=GENERATORS["photos of a monitoring network"],
        control=Control(),
        errors=Errors(noise=False),
        approximate=NEARLY,
    )
    simulated, solution = adjusted(spec)
    assert solution.vtpv < 1e-6
    for name, true in simulated.truth.points.items():
        assert solution.point(name) == pytest.approx(true, abs=1e-7)


def test_a_gross_error_stands_in_its_reading_and_nowhere_else() -> None:
    spec = Spec(parts=(SMALL, Distances(distance_meter=DistanceMeter(sigma_mm=2.0, ppm=0.0))))
    network = design(spec)
    image = next(iter(network.image_points()))
    ident = f"{image.photo}/{image.point}"
    gross = (
        GrossError(ids=(ident,), component="y", size=0.1),
        GrossError(ids=("3",), times_sigma=-20.0),
    )
    found = differences(spec, Errors(gross=gross))
    assert set(found) == {(ident, "y"), ("3", "")}
    assert found[ident, "y"] == pytest.approx(0.1, abs=1e-12)
    assert found["3", ""] == pytest.approx(-20 * 2e-3, abs=1e-9)
    recorded = simulate(replace(spec, errors=Errors(gross=gross)), seed=2).gross_errors
    assert recorded == pytest.approx(found, abs=1e-9)


@pytest.mark.parametrize("frame", [LocalFrame(), TopocentricFrame(0.8, 0.1, 400.0)])
@pytest.mark.parametrize("axes", ["enu", "u", "en"])
def test_a_gross_error_moves_a_point_known_in_e_n_u_along_its_axis(
    axes: str, frame: LocalFrame | TopocentricFrame
) -> None:
    network = fga.Network(frame=frame)
    network.add_point("P", (10.0, 20.0, 30.0))
    given = ControlPoint("P", (10.0, 20.0, 30.0), axes=axes, sigma=(0.01,) * len(axes), id="P")
    network.add(given)
    component = axes[-1] if len(axes) > 1 else ""
    gross = GrossError(ids=("P",), component=component, times_sigma=10.0)
    sizes = add_gross_errors(network, Errors(gross=(gross,)), seed=1)
    assert sizes == {("P", component): pytest.approx(0.1)}
    moved = np.subtract(network.observations["P"].value, given.value)  # type: ignore[attr-defined]
    enu = frame.basis(np.array([given.value]), np.zeros((1, 2))).enu[0]
    assert enu @ moved == pytest.approx(0.1 * np.eye(3)["enu".index(axes[-1])], abs=1e-12)


def test_gross_errors_of_photos_alone_are_multiples_of_their_standard_deviation() -> None:
    spec = Spec(parts=(SMALL,), control=Control(), errors=Errors(gross=(GROSS_OF_20_SIGMA,)))
    sizes = simulate(spec).gross_errors
    assert np.abs(list(sizes.values())) == pytest.approx([0.1] * 3)


def test_drawn_gross_errors_are_as_many_and_of_the_kind_asked_for() -> None:
    spec = Spec(parts=(SMALL, Distances()))
    gross = GrossError(count=5, observations="slope_distance", times_sigma=30.0)
    found = differences(spec, Errors(gross=(gross,)))
    assert len(found) == 5
    assert all(component == "" for _, component in found)
    assert len({np.sign(v) for v in found.values()}) == 2
    images = differences(spec, Errors(gross=(GrossError(count=7, component="x", observations="image", size=0.1),)))  # fmt: skip  # noqa: E501
    assert len(images) == 7
    assert {component for _, component in images} == {"x"}


def test_the_size_of_a_gross_error_is_found_from_its_prediction() -> None:
    """A distance 50 mm too long: what the others predict for it differs by that, to 4 σ."""
    spec = Spec(
        parts=(TriangulationGrid(),),
        control=Control(),
        errors=Errors(gross=(GrossError(count=1, observations="slope_distance", size=0.05),)),
    )
    simulated = simulate(spec, seed=3)
    ((ident, _), size), = simulated.gross_errors.items()  # fmt: skip
    solution = fga.adjust(fga.without(simulated.network, [ident]))
    prediction = fga.predict(solution, simulated.network, ids=[ident])
    # Innovation: computed − observed.
    assert abs(prediction.innovation[0] + size) < 4 * prediction.sigma[0]
    assert prediction.sigma[0] < 0.1 * abs(size)


def test_the_scale_and_zero_constant_of_a_tape_are_estimated() -> None:
    tape = DistanceMeter("tape", sigma_mm=1.0, ppm=0.0, unknown=("scale", "zero"))
    spec = Spec(
        parts=(TriangulationGrid(instrument=TotalStation(distance_meter=tape)),),
        control=Control(),
        errors=Errors(systematic=(TapeCalibration(ppm=30.0, zero_mm=-8.0),)),
        approximate=NEARLY,
    )
    simulated, solution = adjusted(spec, seed=1)
    assert simulated.network.distance_meters["tape"].values == (0.0, 0.0)
    assert simulated.truth.distance_meters["tape"].values == pytest.approx((30e-6, -8e-3))
    estimate = solution.distance_meter("tape")
    assert estimate["scale"] == pytest.approx(30 * PPM, abs=4 * estimate.sigma("scale"))
    assert estimate.sigma("scale") < 3 * PPM
    assert estimate["zero"] == pytest.approx(-8e-3, abs=4 * estimate.sigma("zero"))
    assert accepted(solution.vtpv, solution.redundancy)


def test_the_scale_of_a_tape_without_a_name_stays_in_its_distances() -> None:
    spec = Spec(parts=(TriangulationGrid(),))
    found = differences(spec, Errors(systematic=(TapeCalibration(ppm=100.0),)))
    network = simulate(spec, seed=2).network
    distances = {i: o for i, o in network.observations.items() if o.kind == "slope_distance"}
    assert {ident for ident, _ in found} == set(distances)
    for ident, o in distances.items():
        # 100 ppm of the true length; the standard deviation depends on that alone.
        assert found[ident, ""] == pytest.approx(o.value * 100 * PPM, rel=1e-4)
    disturbed = simulate(
        replace(spec, errors=Errors(systematic=(TapeCalibration(ppm=100.0),))), seed=2
    ).network
    assert not disturbed.distance_meters
    assert all(getattr(o, "instrument", None) is None for o in disturbed.observations.values())


@pytest.mark.parametrize("unknown", [False, True])
def test_refraction_is_read_with_its_true_coefficient_and_given_with_the_assumed(
    unknown: bool,
) -> None:
    """As an unknown it is found within 4 σ; held it spoils the fit of zenith angles."""
    spec = Spec(
        parts=(TriangulationGrid(spacing=2000.0, relief=200.0),),
        earth=Earth(curvature=True, refraction=0.13, refraction_unknown=unknown),
        control=Control("corners", "full"),
        errors=Errors(systematic=(Refraction(0.3),)),
    )
    simulated, solution = adjusted(spec, seed=1)
    assert simulated.network.refractions[""].values == (0.13,)
    assert simulated.truth.refractions[""].values == pytest.approx((0.43,))
    assert accepted(solution.vtpv, solution.redundancy) == unknown
    if unknown:
        estimate = solution.refraction()
        assert estimate.sigma("kappa") < 0.05
        assert estimate["kappa"] == pytest.approx(0.43, abs=4 * estimate.sigma("kappa"))


DISTORTION = LensDistortion(coefficients_um=(0.0, 12.0, -30.0), radius_mm=10.0)
CALIBRATED = CloseRange(photos=12, count=80, camera=replace(CloseRange().camera, lens="brown"))


def test_the_distortion_of_a_lens_is_added_along_the_radius() -> None:
    camera = replace(CALIBRATED.camera, x0_mm=0.5)
    found = differences(
        Spec(parts=(replace(CALIBRATED, camera=camera),)), Errors(systematic=(DISTORTION,))
    )
    network = simulate(Spec(parts=(replace(CALIBRATED, camera=camera),)), seed=2).network
    for p in list(network.image_points())[::20]:
        ident = f"{p.photo}/{p.point}"
        d = np.array([found[ident, "x"], found[ident, "y"]])
        at = np.array([p.x - 0.5, p.y])
        r = np.linalg.norm(at)
        t = r / 10.0
        # To the noise of the place where it is read, 2 µm of some mm.
        assert d @ at / r == pytest.approx((12 * t**3 - 30 * t**5) * MICROMETRE, abs=1e-9)
        assert d[0] * at[1] - d[1] * at[0] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("error", [DISTORTION, AffineFilm(scale_um=15.0, edge_mm=18.0)])
def test_errors_of_lens_and_film_are_about_the_true_principal_point(
    error: LensDistortion | AffineFilm,
) -> None:
    """That of a weighted camera is drawn, here 1 mm off, which changes no reading."""
    weighted = replace(CALIBRATED.camera, free=("x0", "y0"), sigma={"x0": 1.0, "y0": 1.0})
    spec, held = (
        Spec(parts=(replace(CALIBRATED, camera=c),)) for c in (weighted, CALIBRATED.camera)
    )
    assert differences(spec, Errors(systematic=(error,))) == pytest.approx(
        differences(held, Errors(systematic=(error,))), abs=1e-12
    )


def test_a_tabulated_curve_goes_through_its_points_and_is_level_beyond() -> None:
    curve = LensDistortion(radii_mm=(50.0, 80.0, 110.0), distortion_um=(4.0, 9.0, -9.0)).curve
    at = np.array([0.0, 50.0, 80.0, 110.0, 150.0])
    assert curve(at) == pytest.approx(np.array([0, 4, 9, -9, -9]) * MICROMETRE)
    assert curve(np.linspace(0, 80, 50)).max() <= 9 * MICROMETRE * (1 + 1e-12)


@pytest.mark.parametrize("calibrated", [False, True])
def test_the_distortion_of_a_lens_is_found_by_self_calibration(calibrated: bool) -> None:
    """Brown's corrections are the negative of the distortion, 18 µm at 10 mm."""
    free = ("k1", "k2") if calibrated else ()
    spec = Spec(
        parts=(replace(CALIBRATED, camera=replace(CALIBRATED.camera, free=free)),),
        control=Control("full", "full"),
        errors=Errors(systematic=(DISTORTION,)),
    )
    _, solution = adjusted(spec, seed=1)
    assert accepted(solution.vtpv, solution.redundancy) == calibrated
    if calibrated:
        estimate = solution.calibration(CALIBRATED.camera.name)
        k1, k2 = -12.0 * MICROMETRE / 10.0**3, 30.0 * MICROMETRE / 10.0**5
        # The corrections are functions of the distorted radius: a difference of second order.
        assert estimate["k1"] == pytest.approx(k1, abs=4 * estimate.sigma("k1") + 0.01 * abs(k1))
        assert estimate["k2"] == pytest.approx(k2, abs=4 * estimate.sigma("k2") + 0.01 * abs(k2))
        assert estimate.sigma("k1") < 0.2 * abs(k1)


def test_affine_deformation_is_found_as_affinity_and_shear() -> None:
    """15 µm and −9 µm at 18 mm, scale and shear: b1 and b2 are their negatives."""
    camera = replace(CALIBRATED.camera, lens="affine", free=("b1", "b2"))
    film = AffineFilm(scale_um=15.0, shear_um=-9.0, edge_mm=18.0)
    spec = Spec(
        parts=(replace(CALIBRATED, camera=camera),),
        control=Control("full", "full"),
        errors=Errors(systematic=(film,)),
    )
    _, solution = adjusted(spec, seed=1)
    assert accepted(solution.vtpv, solution.redundancy)
    estimate = solution.calibration(camera.name)
    for name, true in (("b1", -15.0), ("b2", 9.0)):
        b = true * MICROMETRE / 18.0
        assert estimate.sigma(name) < 0.1 * abs(b)
        assert estimate[name] == pytest.approx(b, abs=4 * estimate.sigma(name) + 0.01 * abs(b))


def test_observations_drop_out_with_their_probability_but_not_those_with_gross_errors() -> None:
    spec = Spec(
        parts=(Aerial(), Distances(count=20)),
        control=Control(),
        errors=Errors(
            gross=(GrossError(count=30, observations="image", size=0.1),),
            drop_outs=(DropOut(0.25, observations="image"),),
        ),
    )
    simulated = simulate(spec, seed=1)
    n = design(spec).n_image_points
    lost = len(simulated.dropped)
    held = len({ident for ident, _ in simulated.gross_errors})
    tail = (1 - CONFIDENCE) / 2
    low, high = stats.binom.ppf([tail, 1 - tail], n - held, 0.25)
    assert low <= lost <= high
    assert not set(simulated.dropped) & {ident for ident, _ in simulated.gross_errors}
    assert sum(o.kind == "slope_distance" for o in simulated.network.observations.values()) == 20


def test_points_that_lose_all_but_one_ray_go_with_it() -> None:
    """What is left adjusts."""
    spec = Spec(
        parts=(Aerial(),),
        control=Control("perimeter", "perimeter"),
        errors=Errors(drop_outs=(DropOut(0.35),)),
    )
    simulated, solution = adjusted(spec, seed=1)
    _, point, _, _ = simulated.network.images.columns()
    rays = np.bincount(point, minlength=len(simulated.network.points))
    free = [not any(p.fixed) for p in simulated.network.points.values()]
    assert rays[free].min() >= 2
    assert len(simulated.network.points) < len(simulated.truth.points)
    assert solution.converged


@pytest.mark.parametrize(
    "control",
    [
        Control("corners", "full"),
        Control("perimeter", "full", sigma_horizontal_mm=5.0, sigma_vertical_mm=5.0),
    ],
    ids=["held", "weighted"],
)
@pytest.mark.parametrize("probability", [0.1, 0.3])
def test_a_known_height_alone_does_not_keep_a_point(control: Control, probability: float) -> None:
    """With a ray it does: two image coordinates for X and Y."""
    spec = Spec(parts=(SMALL,), control=control, errors=Errors(drop_outs=(DropOut(probability),)))
    single = 0
    for seed in range(6):
        simulated, solution = adjusted(spec, seed=seed)
        assert solution.converged
        network = simulated.network
        rays = np.bincount(network.images.columns()[1], minlength=len(network.points))
        known = {o.point for o in network.observations.values() if "x" in o.axes}  # type: ignore[attr-defined]
        bare = [n for n, k in zip(network.points, rays.tolist(), strict=True) if k == 0]
        assert all(n in known or network.points[n].fixed[0] for n in bare)
        single += np.count_nonzero(rays == 1)
    assert single > 0


def test_points_that_only_a_lost_point_determined_go_too() -> None:
    """A levelling line: without the first difference, none of the others says anything."""
    network = fga.Network()
    for i, fixed in enumerate(("xyz", "xy", "xy")):
        network.add_point(f"P{i}", (100.0 * i, 0.0, 0.0), fixed=fixed)
    network.add_point("Q", (0.0, 50.0, 0.0))
    network.add(HeightDifference("P0", "P1", 0.0, sigma=1e-3, id="a"))
    network.add(HeightDifference("P1", "Q", 0.0, sigma=1e-3, id="b"))
    assert undetermined_points(network) == ["P2", "Q"]
    left = fga.without(network, (), points=["P2", "Q"])
    assert undetermined_points(left) == []
    assert undetermined_points(fga.without(left, ["a"])) == ["P1"]


@pytest.mark.parametrize(
    ("sights", "lost"),
    [
        ([("A", "P"), ("B", "P")], ["P"]),
        ([("A", "P"), ("A", "B"), ("B", "P")], ["P"]),
        ([("A", "P"), ("A", "B"), ("B", "P"), ("B", "A")], []),
        ([("P", "A"), ("P", "B")], ["P"]),
        ([("P", "A"), ("P", "B"), ("P", "C")], []),
    ],
)
def test_the_orientation_of_a_set_takes_up_one_of_its_directions(
    sights: list[tuple[str, str]], lost: list[str]
) -> None:
    network = fga.Network()
    for name, xy in {"A": (0, 0), "B": (90, 10), "C": (20, 80), "P": (60, 70)}.items():
        network.add_point(name, (*xy, 0.0), fixed="z" if name == "P" else "xyz")
    network.add(*(Direction(a, b, 0.0, sigma=1e-5) for a, b in sights))
    assert undetermined_points(network) == lost


def test_gross_errors_are_those_of_readings_that_are_left() -> None:
    """A point that loses all rays but one takes a gross error of that with it."""
    gross = GrossError(count=40, observations="image", size=0.1)
    spec = Spec(parts=(SMALL,), errors=Errors(gross=(gross,), drop_outs=(DropOut(0.6),)))
    simulated = simulate(spec, seed=1)
    assert 0 < len(simulated.gross_errors) < 40
    assert set(simulated.gross_errors) <= set(readings_of(simulated.network))


def test_approximate_values_are_off_by_as_much_as_asked_for() -> None:
    spec = Spec(parts=(Aerial(),), approximate=Approximate(points=0.5, centres=2.0))
    simulated = simulate(spec, seed=1)
    off = [
        np.array(p.coordinates) - simulated.truth.points[p.name]
        for p in simulated.network.points.values()
    ]
    assert np.std(off) == pytest.approx(0.5, rel=0.15)
    centres = [
        np.subtract(f.position, simulated.truth.photos[f.name].position)
        for f in simulated.network.photos.values()
    ]
    assert np.std(centres) == pytest.approx(2.0, rel=0.35)
