"""Rigs: equal to exact mounts, from any start; what nothing determines; odometry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from factorgraph_adj import DatumError, InputError, Network, adjust, reliability
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.models.unknown_registry import UNKNOWNS
from factorgraph_adj.network.composite_unknowns import RIGID
from factorgraph_adj.observations import PhotoPosition, RelativePosition, RelativeRotation
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.simulation.measurement import measure
from tests.networks.aerial_rig import aerial_rig
from tests.networks.exact_rig import adjust_exactly
from tests.networks.odometry import ZERO, odometry
from tests.networks.rigs import MOUNTS, PARTS, on_mount, rig

LONG = pytest.mark.slow("rigs of all kinds with exact mounts; short tests adjust the plainest")

EXACTLY = {RIGID: 1e-5, (1e-8, 1e-7): 1e-6}
"""Largest difference from exact mounts, in σ, by play. Projection centres have σ = 0.4 mm here: the
squares of 1 µm / 0.4 mm and 0.1 µm / 0.4 mm are 6e-6 and 6e-8."""
TIES = ("relative_rotation", "relative_position")


def measured(network: Network, seed: int = 1) -> Network:
    """Return the network with errors of its images only: mounts are exactly rigid."""
    out = measure(network, seed=seed)
    out.observations = {
        i: replace(o, value=ZERO) if o.kind in TIES else o  # type: ignore[call-arg]
        for i, o in out.observations.items()
    }
    return out


@LONG
@pytest.mark.parametrize("play", EXACTLY)
@pytest.mark.parametrize("free", [PARTS, (), ("rx", "ry", "rz"), ("rz", "x")])
def test_rigid_ties_equal_exact_mounts(free: tuple[str, ...], play: tuple[float, float]) -> None:
    network = measured(rig(6, free=free, play=play))
    exact, found = adjust_exactly(network), adjust(network, tolerance=1e-8)
    unknowns = found.equations.unknowns
    compared = 0
    for kind, number in unknowns.active():
        columns = unknowns.columns(kind, number)
        own = np.isin(columns, exact.kept)
        if not own.any():
            continue
        a, b = (s[kind][number][None] for s in (exact.state, found.state))
        off = UNKNOWNS[kind].local(a, b)[0][own]
        place = np.searchsorted(exact.kept, columns[own])
        sigma = np.sqrt(np.diag(exact.cofactors)[place])
        assert np.abs(off / sigma).max() < EXACTLY[play]
        covariance = found.variable_covariance((kind, unknowns[kind].names[number]))
        ratio = np.sqrt(np.diag(covariance))[own] / sigma
        assert np.allclose(ratio, 1.0, rtol=0, atol=EXACTLY[play])
        compared += int(own.sum())
    assert compared == len(exact.kept)
    assert found.redundancy == exact.redundancy
    assert found.vtpv == pytest.approx(exact.vtpv, rel=1e-6)


def test_observations_and_unknowns_of_ties_are_counted_and_cancel() -> None:
    network = measured(rig(4, free=()))
    s = adjust(network)
    members = 3 * 4
    rays = 2 * network.n_image_points
    free_points = sum(not p.held for p in network.points.values())
    assert s.n_observations == rays + 6 * members
    assert s.n_unknowns == 6 * (4 + members) + 3 * free_points
    r = reliability(s)
    assert float(r.redundancy_numbers.sum()) == pytest.approx(s.redundancy, abs=1e-5)
    ties = np.array([k in TIES for k in s.observations.kinds])
    assert np.abs(r.redundancy_numbers[ties]).max() < 1e-4


def off_start(network: Network, by: float) -> Network:
    """Return a rig with carriers and mounts off by some radians and metres, all on their ties."""
    rng = np.random.default_rng(3)
    out = network.copy()
    for name, p in network.mounts.items():
        out.mounts[name] = replace(p, values=tuple(np.array(p.values) + by * rng.normal(size=6)))
    for name, f in network.photos.items():
        if " " in name:
            continue
        assert f.rotation is not None
        assert f.position is not None
        rotation = f.rotation @ exp_rotation(by * rng.normal(size=3))
        centre = np.array(f.position) + 4 * by * rng.normal(size=3)
        out.photos[name] = replace(f, rotation=rotation, position=tuple(centre))
        for mount in network.mounts:
            turned, at = on_mount(rotation, centre, out.mounts[mount].values)
            member = f"{name} {mount}"
            out.photos[member] = replace(out.photos[member], rotation=turned, position=tuple(at))
    return out


@pytest.mark.parametrize("by", [0.001, 0.01, 0.05])
def test_a_rigid_rig_converges_as_fast_as_photos_do(by: float) -> None:
    """Without members that follow their carriers 0.01 took 61 iterations, and 0.05 never ended."""
    network = measured(rig(6))
    s = adjust(off_start(network, by))
    assert s.converged
    assert s.iterations <= 7
    assert s.vtpv == pytest.approx(adjust(network).vtpv, rel=1e-7)


def test_a_rig_that_is_not_quite_rigid_lies_between_rigid_and_apart() -> None:
    def sigma(play: tuple[float, float]) -> float:
        network = measured(rig(6, play=play, free=()))
        return float(adjust(network).unknown("pose", "E2").sigmas[3])

    rigid, loose, free = sigma((1e-8, 1e-7)), sigma((3e-4, 1e-3)), sigma((1.0, 100.0))
    assert rigid < 0.99 * loose
    assert loose < 0.99 * free


# -- datum and weak configurations ----------------------------------------------------------------


def without_datum(network: Network) -> Network:
    """Return the network without control and positions."""
    out = network.copy()
    gone = ("control", "photo_position")
    out.observations = {i: o for i, o in out.observations.items() if o.kind not in gone}
    return out


def without_images(network: Network, of: Callable[[str], bool]) -> Network:
    """Return the network without the image points of some photos."""
    out, photos = network.copy(), list(network.photos)
    out.image_mask(np.array([not of(photos[f]) for f in network.images.columns()[0]]))
    return out


@LONG
def test_calibrated_mounts_give_the_scale_and_free_ones_do_not() -> None:
    for free, missing in (((), 6), (("rx", "ry", "rz"), 6), (PARTS, 7)):
        network = without_datum(measured(aerial_rig(free=free)))
        with pytest.raises(DatumError, match=f"datum defect {missing}: missing shift") as found:
            adjust(network)
        assert ("scale" in str(found.value)) == (missing == 7)
        assert found.value.defect == missing
        network.datum = "free"
        s = adjust(network)
        assert s.converged
        assert s.datum_defect == missing


def test_a_free_network_of_a_rig_has_the_inner_constraints_of_its_points() -> None:
    network = without_datum(measured(aerial_rig()))
    network.datum = "free"
    s = adjust(network)
    found = np.array([s.point(n) for n in network.points])
    moved = found - np.array([p.coordinates for p in network.points.values()])
    middle = found - found.mean(axis=0)
    assert np.abs(moved.sum(axis=0)).max() < 1e-6
    assert abs(float(np.sum(moved * middle))) < 1e-4
    assert np.abs(np.cross(middle, moved).sum(axis=0)).max() < 1e-4


def test_what_all_mounts_share_is_named_where_no_member_is_held() -> None:
    network = without_images(measured(aerial_rig()), lambda f: " " not in f)
    network = without_datum(network)
    for name in list(network.points)[:6]:
        network.points[name] = replace(network.points[name], fixed=(True,) * 3)
    with pytest.raises(DatumError, match="hold one mount, that of a reference member") as found:
        adjust(network)
    assert found.value.defect == 6
    assert {n for k, n in found.value.unknowns if k == "mount"} == {"forward", "left", "right"}
    held = network.mounts["left"]
    network.mounts["left"] = replace(held, fixed=(True,) * 6)
    assert adjust(network).converged


def test_a_free_mount_of_a_member_without_images_is_named() -> None:
    network = measured(rig(4, held_points=30))
    network = without_images(network, lambda f: f.endswith("back"))
    with pytest.raises(DatumError, match="mount 'back' is not determined") as found:
        adjust(network)
    assert found.value.defect == 6
    assert all("back" in n for _, n in found.value.unknowns)


def test_several_rigs_with_mounts_of_their_own_stand_in_one_network() -> None:
    """Two rigs share the mount of one member; each has another of its own."""
    network = measured(two_rigs())
    s = adjust(network)
    assert s.converged
    for name, values in TWO.items():
        e = s.unknown("mount", name)
        assert (np.abs(e.values - values) < 3.5 * e.sigmas).all()
    assert s.unknown("mount", "left").sigmas[0] < s.unknown("mount", "right").sigmas[0]


TWO = {n: MOUNTS[n] for n in ("left", "right")} | {"second right": (0.0, -1.5, 0.1, 0.3, 0.0, 0.1)}


def two_rigs() -> Network:
    """Return one network of two rigs that look at the same targets."""
    return rig(8, mounts=TWO, members=("left", "right"), second={"right": "second right"})


# -- odometry -------------------------------------------------------------------------------------


def test_a_closed_path_adjusts_its_misclosure() -> None:
    network = measure(odometry(), seed=4)
    s = adjust(network)
    assert s.redundancy == 6 * 2
    assert s.converged
    open_path = adjust(measure(odometry(closures=0), seed=4))
    assert open_path.redundancy == 0
    middle = [x.unknown("pose", "F6").sigmas for x in (s, open_path)]
    assert (middle[0] < middle[1]).all()


def test_the_scale_of_an_odometer_follows_from_positions() -> None:
    network = measure(odometry(scale=-0.35), seed=4)
    s = adjust(network)
    e = s.unknown("edm", "odometer")
    assert abs(e.values[0] + 0.35) < 3 * e.sigmas[0]
    assert e.sigmas[0] < 1e-3


def test_odometry_without_positions_has_all_defects_but_scale() -> None:
    network = odometry()
    network.photos["F0"] = replace(network.photos["F0"], fixed=(False,) * 6)
    with pytest.raises(DatumError, match="datum defect 6") as found:
        adjust(network)
    assert "scale" not in str(found.value)


def shots(n: int) -> Network:
    """Return photos that are not turned, the first one's attitude given, as in the source."""
    network = Network("analytic")
    network.add_camera("cam1", NoDistortion(), {"c": 1.0})
    for i in range(1, n + 1):
        given = {"sigma_attitude": 1e-3} if i == 1 else {}
        at = (0.1 * i, 0.2 * i, 0.0)
        network.add_photo(f"{i}", "cam1", position=at, rotation=np.eye(3), **given)
    network.set_distance_meter("1234", scale=0.0, free=["scale"])
    return network


def motion(network: Network, a: str, b: str, t: tuple[float, float, float]) -> None:
    """Add a relative motion without a turn: X_b − X_a = −t in the scale of the reconstruction."""
    base = (-t[0], t[1], t[2])  # x right, y up, z backwards
    network.add(
        RelativeRotation(a, b, ZERO, sigma=(1.0,) * 3),
        RelativePosition(a, b, base, sigma=(1.0,) * 3, instrument="1234"),
    )


def test_the_closed_forms_of_opensfm() -> None:
    """test_pair and test_four_cams_single_reconstruction (OpenSfM, test_bundle.py, BSD-2)."""
    network = shots(2)
    motion(network, "1", "2", (-1.0, 0.0, 0.0))
    network.add(PhotoPosition("1", (0.0, 0.0, 0.0), sigma=(1.0,) * 3))
    network.add(PhotoPosition("2", (2.0, 0.0, 0.0), sigma=(1.0,) * 3))
    s = adjust(network)
    assert np.allclose(s.state["pose"][:, 9:], [[0, 0, 0], [2, 0, 0]], rtol=0, atol=1e-6)
    assert 1.0 + s.unknown("edm", "1234").values[0] == pytest.approx(0.5, abs=1e-6)

    network = shots(4)
    for number, t in (("2", (-1.0, 0.0, 0.0)), ("3", (0.0, -1.0, 0.0)), ("4", (0.0, 0.0, -1.0))):
        motion(network, "1", number, t)
    for number, at in (("1", (0.0, 0.0, 0.0)), ("2", (2.0, 0.0, 0.0)), ("3", (0.0, 2.0, 0.0))):
        network.add(PhotoPosition(number, at, sigma=(1.0,) * 3))
    s = adjust(network)
    expected = [[0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 2]]
    assert np.allclose(s.state["pose"][:, 9:], expected, rtol=0, atol=1e-6)


# -- bad input ------------------------------------------------------------------------------------


def test_bad_members_are_refused_by_name() -> None:
    network = rig(2)
    for given, message in (
        ({"carrier": "E9", "mount": "left"}, "unknown carrier 'E9'; photos: E0"),
        ({"carrier": "E0", "mount": "lefd"}, "unknown mount 'lefd'; known: left, right, back"),
        ({"carrier": "new", "mount": "left"}, "cannot be its own carrier"),
        ({"carrier": "E0"}, "carrier and mount are given together"),
        ({"carrier": "E0", "mount": "left", "play": (0.0, 1.0)}, "two standard deviations > 0"),
    ):
        with pytest.raises(InputError, match=message):
            network.add_photo("new", "camera", **given)  # type: ignore[arg-type]
        assert "new" not in network.photos
    with pytest.raises(InputError, match="a relative pose joins two photos"):
        RelativePosition("E0", "E0", ZERO, sigma=(1.0,) * 3)
    with pytest.raises(InputError, match="value must have 3 components"):
        RelativeRotation("E0", "E1", (3.0, 3.0), sigma=(1.0,) * 3)  # type: ignore[arg-type]
