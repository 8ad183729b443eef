"""Parts with GNSS and INS, statoscopes, lakes, shapes, rigs and cross strips: truth comes back.

Each part is read from TOML; adjustments of blocks begin without the values of free unknowns. Two
hundred seeds of each spec, run once: 98.5 to 99.4 % of the components within 2.5 σ, 98.8 % are
expected; σ0 between 0.993 and 1.003; every adjustment converged.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from scipy import stats

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.models.positions import heights
from factorgraph_adj.models.unknown_registry import UNKNOWNS
from factorgraph_adj.observations import PhotoPosition, ProfileHeight
from factorgraph_adj.simulation.disturbances import DropOut, Errors
from factorgraph_adj.simulation.generate.control import Control
from factorgraph_adj.simulation.generate.flight_observations import Gnss, Lake, Statoscope
from factorgraph_adj.simulation.generate.metrology import Shapes
from factorgraph_adj.simulation.generate.photo_blocks import Aerial, CrossStrips
from factorgraph_adj.simulation.generate.rigs_and_models import IndependentModels, Rig
from factorgraph_adj.simulation.measurement import SimulatedNetwork
from factorgraph_adj.simulation.spec import Earth, Spec, design, read_spec, simulate

SEEDS, WITHIN, SHARE = range(1, 5), 2.5, 0.95
BLOCK = """
[[parts]]
kind = "aerial"
strips = 2
photos_per_strip = 5
points_per_photo = 16
[control]
[approximate]
points = 0.1
centres = 0.1
attitudes_deg = 0.2
restart = true
"""
SPECS = {
    "GNSS and INS with shift, drift, turn, a late shutter and losses": BLOCK
    + """
[[parts]]
kind = "gnss"
shift_mm = 100
drift_mm_s = 2
turn_deg = 0.01
turn_rate_deg_s = 2e-4
time_error_ms = 8
without = 0.2
""",
    "GNSS and navigation angles, free drifts, given boresight, cross strip": BLOCK
    + """
[[parts]]
kind = "cross_strips"
[[parts]]
kind = "gnss"
angles = "roll_pitch_heading"
boresight_deg = [0.3, -0.2, 0.5]
shift_mm = 100
drift_mm_s = 2
drifts = "free"
""",
    "GNSS with an unknown arm": BLOCK
    + """
[[parts]]
kind = "gnss"
observe = "positions"
sigma_horizontal_mm = 10
arm = [0.4, -0.3, 0.2]
""",
    "GNSS with a weighted arm": BLOCK
    + """
[[parts]]
kind = "gnss"
mount = "weighted"
arm_sigma_mm = 50
""",
    "statoscope and lake": BLOCK
    + """
[[parts]]
kind = "statoscope"
slope = 1.0
lever_arm = [0.3, -0.2, 0.6]
without = 0.2
[[parts]]
kind = "lake"
height = 3.0
""",
    "weighted profiles and water": BLOCK
    + """
[[parts]]
kind = "statoscope"
slope = 1.0
bend = 0.5
scale_ppm = 500
profiles = "weighted"
[[parts]]
kind = "lake"
level = "weighted"
level_sigma = 0.05
middle = [0.2, 0.8]
""",
    "rig over a terrain": BLOCK
    + """
[[parts]]
kind = "rig"
""",
    "rig that is not quite rigid": BLOCK
    + """
[[parts]]
kind = "rig"
members = 2
play_deg = 0.01
play_mm = 2
mounts = "weighted"
""",
    "rig around an object": """
[[parts]]
kind = "close_range"
[[parts]]
kind = "rig"
members = 2
tilt_deg = 10
camera = {name = "side", c_mm = 28, format_mm = [36, 24], sigma_um = 2}
[control]
[approximate]
points = 0.01
centres = 0.01
attitudes_deg = 0.2
restart = true
""",
    "shapes": """
[[parts]]
kind = "shapes"
shapes = ["plane", "line", "circle", "cylinder", "sphere"]
measured_mm = 0.5
""",
    "shapes on photos": """
[[parts]]
kind = "shapes"
tolerance_mm = 0.2
[[parts]]
kind = "close_range"
of_parts = [0]
points = "none"
photos = 12
[control]
""",
}


def errors(simulated: SimulatedNetwork, solution: fga.Solution) -> Iterator[float]:
    """Return the errors of all unknowns that parts state, not held, in units of their σ."""
    for kind, given in simulated.truth.parameters.items():
        record, table = UNKNOWNS[kind], solution.equations.unknowns[kind]
        for name, p in given.items():
            number, n = table.number[name], len(p.values)
            true = record.store(np.array([p.values]))
            off = record.local(true, solution.state[kind][number][None])[0, :n]
            free = ~np.array(p.fixed)
            yield from (off[free] / solution.unknown(kind, name).sigmas[free]).tolist()


@pytest.mark.slow("whole flights; short tests of parts take small blocks")
@pytest.mark.parametrize("name", SPECS)
def test_what_parts_state_comes_back(name: str) -> None:
    spec, off = read_spec(SPECS[name]), []
    for seed in SEEDS:
        simulated = simulate(spec, seed=seed)
        solution = fga.adjust(simulated.network)
        assert solution.converged
        off += list(errors(simulated, solution))
    assert len(off) >= 2 * len(SEEDS)
    assert np.mean(np.abs(off) < WITHIN) >= SHARE


BLOCK_PARTS = (Aerial(strips=2, photos_per_strip=5, points_per_photo=16),)


def test_free_unknowns_restart_from_nothing_and_reach_the_same_minimum() -> None:
    """Axes may point the other way, which distances from cylinders and spheres do not notice."""
    spec = read_spec(SPECS["shapes"]).varied({"parts.0.shapes": ("cylinder", "sphere")})
    again = spec.varied({"approximate.restart": True})
    assert np.isnan(simulate(again).network.frames["cylinder 1"].values[0])
    assert np.isnan(simulate(again).network.sizes["sphere 2"].values[0])
    a, b = (fga.adjust(simulate(s, seed=3).network) for s in (spec, again))
    assert a.vtpv == pytest.approx(b.vtpv, rel=1e-6)
    for name in ("cylinder 1", "sphere 2"):
        radius = a.unknown("size", name)
        assert b.unknown("size", name).values == pytest.approx(radius.values, abs=1e-7)


def test_shapes_that_are_found_again_fit_their_weights() -> None:
    """A plane that points the other way reads the errors with the other sign: another drawing."""
    spec = read_spec(SPECS["shapes"]).varied({"approximate.restart": True})
    found = [fga.adjust(simulate(spec, seed=s).network) for s in SEEDS]
    vtpv, redundancy = (sum(getattr(f, n) for f in found) for n in ("vtpv", "redundancy"))
    low, high = stats.chi2.ppf([0.0005, 0.9995], redundancy)
    assert low < vtpv < high


def test_truth_keeps_what_was_drawn_and_the_network_does_not() -> None:
    spec = read_spec(SPECS["GNSS and INS with shift, drift, turn, a late shutter and losses"])
    simulated = simulate(spec)
    assert simulated.truth.parameters["shutter"]["shutter"].values == (0.008,)
    assert simulated.network.shutters["shutter"].values == (0.0,)
    assert any(simulated.truth.parameters["mount"]["platform"].values[:3])
    assert not any(simulated.network.mounts["platform"].values)


def test_weighted_drifts_are_drawn_about_their_true_values() -> None:
    """Given minus true over σ is standard normal, for 40 seeds of 12 components: to 4 σ."""
    given = Gnss(shift_mm=100.0, observe="positions", drift_mm_s=2.0)
    spec = Spec(parts=(*BLOCK_PARTS, given))
    z = []
    for seed in range(40):
        simulated = simulate(spec, seed=seed)
        for name, p in simulated.network.drifts.items():
            true = simulated.truth.parameters["drift"][name].values
            acting = ~np.array(p.fixed)
            z += (np.subtract(p.values, true)[acting] / np.array(p.sigma)[acting]).tolist()
    assert len(z) == 480
    assert np.mean(z) == pytest.approx(0.0, abs=4 / 480**0.5)
    assert np.std(z) == pytest.approx(1.0, abs=4 / 960**0.5)


def test_time_counts_in_the_direction_of_flight() -> None:
    """Strip 2 is flown back: its photo 2/5 is the first, and its velocity points to −X."""
    parts = (Aerial(strips=2, photos_per_strip=5), Gnss(time_error_ms=5.0, speed=50.0))
    network = design(Spec(parts=parts))
    at: dict[str, PhotoPosition] = {
        o.photo: o for o in network.observations.values() if isinstance(o, PhotoPosition)
    }
    for order, sign in (([f"1/{i}" for i in range(1, 6)], 1), ([f"2/{i}" for i in range(5, 0, -1)], -1)):  # fmt: skip  # noqa: E501
        times = [at[n].time for n in order]
        assert np.all(np.diff(times) > 0)
        assert sum(times) == pytest.approx(0.0, abs=1e-9)
        base = np.diff([network.photos[n].position[0] for n in order])  # type: ignore[index]
        assert sign * base == pytest.approx(50.0 * np.diff(times), rel=0.01)
        assert at[order[0]].velocity == pytest.approx((sign * 50.0, 0.0, 0.0), abs=3.0)


def test_a_share_of_the_photos_of_each_strip_has_no_readings() -> None:
    parts = (Aerial(strips=3, photos_per_strip=8), Gnss(without=0.25), Statoscope(without=0.5))
    network = design(Spec(parts=parts))
    kinds = [o.kind for o in network.observations.values()]
    assert kinds.count("photo_position") == kinds.count("photo_attitude") == 18
    read = [o.photo for o in network.observations.values() if isinstance(o, ProfileHeight)]
    assert sorted(n[0] for n in read if n is not None) == ["1"] * 4 + ["2"] * 4 + ["3"] * 4


@pytest.mark.parametrize("frame", ["local", "topocentric"])
def test_shore_points_have_the_height_of_the_water(frame: str) -> None:
    earth = Earth(frame=frame, curvature=frame == "local")  # type: ignore[arg-type]
    network = design(Spec(parts=(*BLOCK_PARTS, Lake(height=4.0, count=6)), earth=earth))
    shore = [o.names()[0] for o in network.observations.values() if o.kind == "level_height"]
    x = np.array([network.points[n].coordinates for n in shore])
    assert len(shore) == 6
    assert heights(network.frame, x)[0] == pytest.approx([4.0] * 6, abs=1e-9)
    for o in network.observations.values():
        assert o.value == pytest.approx(0.0, abs=1e-9)  # type: ignore[attr-defined]


def test_points_lie_on_their_shapes() -> None:
    shapes = Shapes(shapes=("plane", "line", "circle", "cylinder", "sphere"), tilt_deg=40.0)
    network = design(Spec(parts=(shapes,)))
    read = [np.max(np.abs(o.value)) for o in network.observations.values()]  # type: ignore[attr-defined]
    assert len(read) == 5 * shapes.count
    assert max(read) < 1e-12


def test_photos_of_a_rig_have_no_readings_of_their_own_and_keep_their_mounts() -> None:
    """GNSS belongs to the carriers, and drop-outs take no mount away."""
    lost = Errors(drop_outs=(DropOut(0.3),))
    parts = (*BLOCK_PARTS, Rig(members=2), Gnss())
    network = simulate(Spec(parts=parts, errors=lost, control=Control())).network
    kinds = [o.kind for o in network.observations.values()]
    members = sum("member" in n for n in network.photos)
    assert members > 10
    assert kinds.count("relative_rotation") == kinds.count("relative_position") == members
    assert all("member" not in o.photos()[0] for o in network.observations.values()
               if o.kind == "photo_position")  # fmt: skip


def test_members_look_where_they_are_tilted() -> None:
    rig = Rig(members=4, tilt_deg=30.0, turn_deg=1e-6)
    network = design(Spec(parts=(Aerial(strips=1, tilt_deg=0.0), rig)))
    for i, (x, y) in enumerate([(1, 0), (0, 1), (-1, 0), (0, -1)]):
        r = network.photos[f"1/3 member {i + 1}"].rotation
        assert r is not None
        view = np.array([0.5 * x, 0.5 * y, -np.cos(np.pi / 6)])
        assert r[:, 2] == pytest.approx(view, abs=1e-6)


def test_a_cross_strip_flies_across_and_takes_its_height_from_the_block() -> None:
    network = design(Spec(parts=(*BLOCK_PARTS, CrossStrips(strips=2, tilt_deg=0.0))))
    crossing = {n: p for n, p in network.photos.items() if n.startswith("x")}
    heights_flown = [p.position[2] for n, p in network.photos.items() if n not in crossing]  # type: ignore[index]
    at = np.array([p.position for p in crossing.values()])
    assert at[:, 2].mean() == pytest.approx(np.mean(heights_flown), abs=20.0)
    first = at[[n.startswith("x1") for n in crossing]]
    assert np.all(np.diff(first[:, 1]) > 0)
    assert np.ptp(first[:, 0]) < 0.2 * np.ptp(first[:, 1])
    x_axis = crossing["x1/1"].rotation[:, 0]  # type: ignore[index]
    assert x_axis == pytest.approx([0.0, 1.0, 0.0], abs=1e-9)


def test_models_in_the_place_of_photos_keep_the_positions_of_their_centres() -> None:
    parts = (
        *BLOCK_PARTS,
        Gnss(observe="positions", lever_arm=(0.0, 0.0, 0.0)),
        IndependentModels(),
    )
    solution = fga.adjust(simulate(Spec(parts=parts, control=Control())).network)
    assert solution.converged
    low, high = stats.chi2.ppf([0.0005, 0.9995], solution.redundancy)
    assert low < solution.vtpv < high


BAD = {
    "mount is unknown": ("gnss", "mount = 'open'", "parts.1.mount", "valid: free"),
    "weighted without a weight": (
        "gnss",
        "mount = 'weighted'\narm = [0, 0, 1]",
        "parts.1.arm_sigma_mm",
        "above 0",
    ),
    "a late shutter without positions": (
        "gnss",
        "observe = 'attitudes'\ntime_error_ms = 3",
        "parts.1.time_error_ms",
        "positions",
    ),
    "no photo left": ("gnss", "without = 0.99", "parts.1.without", "no photo"),
    "one photo and a free drift": (
        "gnss",
        "without = 0.8\ndrifts = 'free'\ndrift_mm_s = 1",
        "parts.1.without",
        "'strip 1' one photo",
    ),
    "no photos in the part": ("gnss", "parts = [4]", "parts.1.parts", "no earlier part 4"),
    "too few photos for a profile": (
        "statoscope",
        "without = 0.8\nslope = 1",
        "parts.1.without",
        "1 photos for 2",
    ),
    "share of photos above one": ("statoscope", "without = 1.5", "parts.1.without", "< 1"),
    "a shore of one point": ("lake", "count = 1", "parts.1.count", "2 or more"),
    "a lake with too many points": ("lake", "count = 5000", "parts.1.count", "up to that"),
    "a middle outside": ("lake", "middle = [0.5, 1.5]", "parts.1.middle.1", "≤ 1"),
    "an unknown shape": ("shapes", "shapes = ['cone']", "parts.1.shapes.0", "valid: plane"),
    "no shapes": ("shapes", "shapes = []", "parts.1.shapes", "one or more"),
    "too few points": ("shapes", "count = 4", "parts.1.count", "≥ 7"),
    "members that see nothing": ("rig", "tilt_deg = 80", "parts.1.tilt_deg", "smaller tilt"),
    "members in one place": ("rig", "tilt_deg = 0\nradius = 0", "parts.1.tilt_deg", "one place"),
    "cross strips too low": ("cross_strips", "height = 20", "parts.1.height", "fly higher"),
    "an unknown key": ("cross_strips", "overlap = 0.6", "parts.1.overlap", "forward_overlap"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_part_is_named(name: str) -> None:
    kind, keys, where, what = BAD[name]
    block = "[[parts]]\nkind = 'aerial'\nstrips = 2\nphotos_per_strip = 5\n"
    with pytest.raises(InputError) as error:
        design(read_spec(f"{block}[[parts]]\nkind = '{kind}'\n{keys}\n"))
    (problem,) = error.value.problems
    assert problem.where.endswith(where)
    assert what in problem.what


@pytest.mark.parametrize("part", [Gnss(time_error_ms=1.0), Statoscope(), Lake(), Shapes(), Rig()])
def test_a_part_that_is_there_twice_needs_another_name(part) -> None:
    with pytest.raises(InputError, match="exist"):
        design(Spec(parts=(*BLOCK_PARTS, part, part)))


def test_gnss_needs_photos() -> None:
    with pytest.raises(InputError, match="no photos"):
        design(Spec(parts=(Shapes(), Gnss())))
