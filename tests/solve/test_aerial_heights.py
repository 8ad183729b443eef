"""Statoscope, profile recorder, lakes, horizon camera and star tracker of a simulated block."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import stats

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.rotation import TURN_ABOUT_X, log_rotation
from factorgraph_adj.simulation.measurement import measure
from tests.networks.aerial_heights import SIGMA_TILT, Aerial, errors, plan_of, unknown_values
from tests.support.studies import cases

SHIFT_AND_SLOPE = ("height", "height_t")
EVERYTHING = Aerial(
    statoscope=SHIFT_AND_SLOPE,
    lake=True,
    recorder=SHIFT_AND_SLOPE,
    tilts=("rx", "ry"),
    sights=("rx", "ry", "rz"),
)
FEW = 12


@cache
def plan(aerial: Aerial) -> fga.Network:
    return plan_of(aerial)


def adjusted(aerial: Aerial, seed: int) -> fga.Solution:
    solution = fga.adjust(unknown_values(measure(plan(aerial), seed=seed)))
    assert solution.converged
    return solution


def trials(aerial: Aerial, seeds: range) -> dict[str, np.ndarray]:
    """Return the errors of levels, profiles and mounts in units of σ, by their names."""
    found: dict[str, list[float]] = {}
    for seed in seeds:
        solution = adjusted(aerial, seed)
        for kind in ("profile", "level", "mount"):
            for name, error in errors(solution, plan(aerial), kind).items():
                found.setdefault(name, []).append(error)
    return {name: np.array(e) for name, e in found.items()}


SEEDS = cases([FEW, 200], [FEW])


@pytest.mark.parametrize("seeds", SEEDS)
def test_profiles_levels_and_mounts_come_back_within_their_sigma(seeds: int) -> None:
    """98.8 % of them within 2.5 σ; the bound of a few seeds is that of all at 10⁻⁴."""
    found = trials(EVERYTHING, range(seeds))
    assert len(found) == 6 + 2 + 1 + 2 + 3
    inside = {name: int(np.sum(np.abs(e) < 2.5)) for name, e in found.items()}
    least = stats.binom(seeds, 2 * stats.norm.cdf(2.5) - 1).ppf(1e-4)
    assert min(inside.values()) >= (least if seeds == FEW else 0.95 * seeds), inside
    z = np.array([*found.values()])
    assert 0.8 < np.sqrt(np.mean(z**2)) < 1.2


def test_redundancy_numbers_add_up_to_the_redundancy() -> None:
    solution = adjusted(EVERYTHING, 1)
    rel = fga.reliability(solution)
    assert rel.redundancy_numbers.sum() == pytest.approx(solution.redundancy, abs=1e-6)
    parts = rel.redundancy_numbers + rel.e1 + rel.e2 + rel.e12
    assert np.allclose(parts, 1.0, atol=1e-6)


# -- gross errors ---------------------------------------------------------------------------------


def with_error(network: fga.Network, ident: str, error: float) -> None:
    """Put an error on a reading, on its first component."""
    found = network.observations[ident]
    value = found.value
    value = (value[0] + error, *value[1:]) if isinstance(value, tuple) else value + error
    network.observations[ident] = replace(found, value=value)


def row_of(rel: fga.quality.reliability.Reliability, ident: str) -> int:
    """Return the row of the first component of an observation."""
    components = rel.solution.network.observations[ident].component_names()
    return rel.row(ident, components[0] or None)


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
@pytest.mark.parametrize("ident", ["statoscope 12", "tilt 12", "sun 01"])
def test_the_smallest_detectable_error_has_the_test_value_of_its_power(ident: str) -> None:
    """With it, w follows the normal distribution about δ0, so that 80 of 100 are found."""
    rel = fga.reliability(adjusted(EVERYTHING, 0))
    wrong = float(rel.mdb[row_of(rel, ident)])
    found = []
    for seed in range(FEW):
        network = unknown_values(measure(plan(EVERYTHING), seed=seed))
        with_error(network, ident, wrong)
        told = fga.reliability(fga.adjust(network))
        found.append(abs(float(told.w[row_of(told, ident)])))
    # The mean of twelve values of the normal distribution about δ0 with σ = 1.
    assert np.mean(found) == pytest.approx(rel.delta0, abs=3.3 / np.sqrt(FEW))


def test_wrong_readings_of_every_kind_are_found_by_snooping() -> None:
    """Each is twice what is found in 80 of 100 cases."""
    network = unknown_values(measure(plan(EVERYTHING), seed=3))
    rel = fga.reliability(fga.adjust(network))
    planted = {}
    for name in ("statoscope 12", "shore", "recorder", "tilt 21", "sun 04"):
        idents = [i for i in network.observations if i.startswith(name)]
        ident = min(idents, key=lambda i: rel.mdb[row_of(rel, i)])
        planted[ident] = 2.0 * float(rel.mdb[row_of(rel, ident)])
        with_error(network, ident, planted[ident])
    found = fga.snoop(network)
    rejected = {r.id: r for r in found.rejected}
    assert planted.keys() <= rejected.keys()
    assert len(rejected) <= len(planted) + 3
    for ident, error in planted.items():
        assert abs(rejected[ident].final_error - error) < 4 * rejected[ident].final_sigma


# -- what is not determined -----------------------------------------------------------------------


def test_a_statoscope_with_shift_and_slope_alone_leaves_the_height_of_the_block_open() -> None:
    block = Aerial(control="plan", statoscope=SHIFT_AND_SLOPE)
    with pytest.raises(fga.DatumError, match="shift in z"):
        fga.adjust(measure(plan(block), seed=1))


def one_strip(free: tuple[str, ...], *, third: bool = False) -> fga.Network:
    """Return a strip flown in a straight line, with two control points in a line across it.

    Args:
        free: free components of the profile.
        third: whether there is a third control point, at the end of the strip.
    """
    network = plan(Aerial(strips=1, control="none", statoscope=free)).copy()
    network.datum = "given"
    for i, name in enumerate(sorted(network.photos)):
        at = (900.0 * i, 0.0, 1500.0)
        network.photos[name] = replace(network.photos[name], position=at)
        ident = f"statoscope {name}"
        network.observations[ident] = replace(
            network.observations[ident], time=0.9 * (i - 2), lever_arm=(0.0, 0.0, 0.0)
        )
    near = sorted(network.points.values(), key=lambda p: abs(p.coordinates[0] - 1800.0))[:9]
    ends = sorted(near, key=lambda p: p.coordinates[1])
    last = max(network.points.values(), key=lambda p: p.coordinates[0])
    for p in (ends[0], ends[-1], *([last] if third else [])):
        at = p.coordinates if p is last else (1800.0, p.coordinates[1], 10.0)
        network.points[p.name] = replace(p, coordinates=at)
        network.add(o.ControlPoint(p.name, at, sigma=(0.1,) * 3))
    return measure(network, seed=1)


def test_a_slope_of_its_own_leaves_the_tilt_of_a_strip_open_by_name() -> None:
    """Turned about the line of its control, the strip rises as its profile does."""
    with pytest.raises(fga.DatumError) as error:
        fga.adjust(one_strip(SHIFT_AND_SLOPE))
    assert "the network is not determined: 1 defect" in str(error.value)
    assert "with them moves height profile 'strip 0' (height_t)" in str(error.value)
    assert fga.adjust(one_strip(("height",))).converged
    assert fga.adjust(one_strip(SHIFT_AND_SLOPE, third=True)).converged


def test_control_at_the_ends_of_the_strips_determines_shift_and_slope() -> None:
    solution = adjusted(Aerial(statoscope=SHIFT_AND_SLOPE), 1)
    for name in ("strip 0", "strip 1", "strip 2"):
        shift, slope = solution.unknown("profile", name).sigmas[:2]
        assert shift < 0.3
        assert slope < 0.2


def test_a_free_lake_is_no_datum_of_heights() -> None:
    block = Aerial(control="plan", lake=True)
    with pytest.raises(fga.DatumError, match="shift in z"):
        fga.adjust(measure(plan(block), seed=1))
    assert adjusted(replace(block, gauge=0.05), 1).converged


def test_a_lake_makes_heights_of_a_profile_recorder_absolute() -> None:
    """The classical combination: no height but that of the lake, and the profile crosses it."""
    without = Aerial(control="plan", recorder=SHIFT_AND_SLOPE)
    with pytest.raises(fga.DatumError, match="shift in z"):
        fga.adjust(measure(plan(without), seed=1))
    together = replace(without, lake=True, gauge=0.05)
    solution = adjusted(together, 4)
    found = errors(solution, plan(together), "profile")
    assert max(map(abs, found.values())) < 3.0
    e = solution.unknown("profile", "recorder")
    assert e.sigmas[0] < 0.1
    # The recorder holds the block up where the lake does not reach.
    alone = adjusted(Aerial(control="plan", lake=True, gauge=0.05), 4)
    name = next(i for i in solution.network.observations if i.startswith("recorder"))
    point = solution.network.observations[name].point
    assert solution.standard_deviations(point)[2] < 0.9 * alone.standard_deviations(point)[2]


def test_slopes_known_from_the_wind_replace_control_of_height() -> None:
    """Weighted slopes of 0.1 m/km: the block needs one height of each strip, not two."""
    block = Aerial(control="plan", statoscope=("height",), lake=True, gauge=0.05)
    network = measure(plan(block), seed=1)
    for name in network.profiles:
        network.set_profile(name, sigma={"height_t": 0.1})
    free = network.copy()
    for name in free.profiles:
        free.set_profile(name, free=SHIFT_AND_SLOPE)
    known, unknown = fga.adjust(network), fga.adjust(free)
    for name in network.profiles:
        assert known.unknown("profile", name).sigmas[1] < 0.1
        assert known.unknown("profile", name).sigmas[1] < unknown.unknown("profile", name).sigmas[1]


# -- attitudes ------------------------------------------------------------------------------------


def test_two_tilts_and_a_bearing_are_the_full_attitude() -> None:
    """To first order in the errors, which are 10⁻⁴ rad: a bearing is one component of a sight."""
    rng = np.random.default_rng(1)
    base = plan(Aerial(strips=2, photos=3, control="none"))
    true = {n: p.rotation for n, p in base.photos.items()}
    full, single = base.copy(), base.copy()
    for network in (full, single):
        network.datum = "given"
        for name, p in network.photos.items():
            network.photos[name] = replace(p, sigma_position=(0.05,) * 3)
    turns = {name: rng.normal(0.0, SIGMA_TILT, 3) for name in true}
    for name, turn in turns.items():
        given = true[name] @ _turned(turn)
        full.photos[name] = replace(full.photos[name], rotation=given, sigma_attitude=SIGMA_TILT)
        up, north = (TURN_ABOUT_X @ given.T @ e for e in ((0, 0, 1.0), (0, 1.0, 0)))
        tilts = (float(np.arctan2(up[0], up[2])), float(np.arctan2(up[1], up[2])))
        sigma = (SIGMA_TILT,) * 2
        seen = tuple((north / np.linalg.norm(north)).tolist())
        # The component of the direction to the north that is level: the other one is a tilt.
        level = ("x", "y")[int(abs(seen[0]) > abs(seen[1]))]
        single.add(
            o.PhotoTilt(name, tilts, sigma=sigma),
            o.PhotoSight(name, (0, 1.0, 0), seen, axes=level, sigma=(SIGMA_TILT,)),
        )
    a, b = (fga.adjust(measure_images(n)) for n in (full, single))
    for name in true:
        one, other = (s.as_network().photos[name] for s in (a, b))
        off = log_rotation((one.rotation.T @ other.rotation)[None])[0]
        spread = np.sqrt(np.diag(a.variable_covariance(("pose", name))))
        assert np.all(np.abs(off) < 0.05 * spread[:3])
        other_spread = np.sqrt(np.diag(b.variable_covariance(("pose", name))))
        assert other_spread == pytest.approx(spread, rel=0.05)


def _turned(turn: np.ndarray) -> np.ndarray:
    from factorgraph_adj.rotation import exp_rotation

    return exp_rotation(turn)


def measure_images(network: fga.Network) -> fga.Network:
    """Return the network with images of its true values; all else stays as it is."""
    out = network.copy()
    out.images = measure(plan(Aerial(strips=2, photos=3, control="none")), seed=5).images
    return out
