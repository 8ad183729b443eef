"""Doubts about places in frames, before any adjustment."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

import factorgraph_adj as fga
from factorgraph_adj import FrameCoordinate, LocalFrame, Network, preliminary
from factorgraph_adj.graph.equations import compile_rows
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.simulation.generate.control import Control
from factorgraph_adj.simulation.generate.photo_blocks import Aerial
from factorgraph_adj.simulation.spec import Spec, simulate
from factorgraph_adj.triangulation.independent_models import as_models
from factorgraph_adj.validate.common_places import PlaceSystem, common_places
from factorgraph_adj.validate.network_structure import check
from tests.networks.every_kind import FRAMES
from tests.networks.frames import network_of_frames
from tests.networks.instruments import room_of
from tests.networks.three_frames import HELD, SIGMA, room, three_frames, true_coordinates


def told(network: Network) -> list[str]:
    return [str(f) for f in preliminary(network)]


def changed(network: Network, frame: str, point: str, **new: object) -> Network:
    """Change the observation of a point in a frame."""
    for ident, o in network.observations.items():
        if (o.frame, o.point) == (frame, point):
            network.observations[ident] = replace(o, **new)
    return network


def value(network: Network, frame: str, point: str) -> np.ndarray:
    return np.array(
        next(o.value for o in network.observations.values() if (o.frame, o.point) == (frame, point))
    )


def mirrored(network: Network, frame: str) -> Network:
    """Exchange x and y of a frame."""
    for name in room():
        x, y, z = value(network, frame, name)
        changed(network, frame, name, value=(y, x, z))
    return network


def test_without_errors_nothing_is_told() -> None:
    """In 40 networks with 9 comparisons and about 25 places each, α = 0.1 % of a comparison."""
    assert sum(len(told(three_frames(seed))) for seed in range(40)) <= 1


@pytest.mark.parametrize("frame", ["scan", "model", "station"])
def test_a_mirrored_frame_is_named_against_given_coordinates(frame) -> None:
    (found,) = told(mirrored(three_frames(), frame))
    assert found.startswith(f"the places of frame {frame!r} fit those of ")
    assert found.endswith(
        "its axes are left-handed; exchange x and y, or change the sign of one axis"
    )


def test_without_given_coordinates_the_frame_that_mirrors_both_others_is_named() -> None:
    network = mirrored(three_frames(), "model")
    for name, point in network.points.items():
        network.points[name] = replace(point, coordinates=(np.nan,) * 3, fixed=(False,) * 3)
    (found,) = told(network)
    assert found.startswith(
        "the places of frame 'model' fit those of frame 'scan', frame 'station'"
    )


def test_places_in_one_plane_tell_of_no_mirror() -> None:
    network = three_frames()
    flat = {n: np.array((*x[:2], 0.0)) for n, x in room().items()}
    for name, x in flat.items():
        if name in HELD:
            network.points[name] = replace(network.points[name], coordinates=tuple(x))
        for frame in ("scan", "model", "station"):
            changed(network, frame, name, value=tuple(true_coordinates(frame, x).tolist()))
    assert told(mirrored(network, "scan")) == []


def test_a_gross_error_is_named_with_its_size_in_the_unit_of_the_frame() -> None:
    network = three_frames()
    off = value(network, "scan", "P4") + np.array((0.0, 0.05, 0.0))
    (found,) = told(changed(network, "scan", "P4", value=tuple(off)))
    assert found.startswith(
        "point 'P4' in frame 'scan' does not fit beside frame 'model', frame 'station'"
    )
    size = float(found.split(": ")[1].split(" mm")[0])
    assert size == pytest.approx(50.0, abs=5e3 * SIGMA)


def test_two_names_exchanged_are_an_exchange() -> None:
    network = three_frames()
    first, second = value(network, "station", "P5"), value(network, "station", "P7")
    changed(network, "station", "P5", value=tuple(second))
    changed(network, "station", "P7", value=tuple(first))
    (found,) = told(network)
    assert found.startswith("point 'P5' and point 'P7' are exchanged in frame 'station'")


def test_an_exchange_and_a_wrong_place_are_both_told() -> None:
    network = three_frames()
    first, second = value(network, "station", "P5"), value(network, "station", "P7")
    changed(network, "station", "P5", value=tuple(second))
    changed(network, "station", "P7", value=tuple(first))
    off = value(network, "scan", "P4") + np.array((0.0, 0.05, 0.0))
    changed(network, "scan", "P4", value=tuple(off))
    found = told(network)
    assert len(found) == 2
    assert any("'P5' and point 'P7' are exchanged in frame 'station'" in f for f in found)
    assert any("point 'P4' in frame 'scan' does not fit" in f for f in found)


def test_the_test_of_a_place_has_the_size_that_its_distribution_says() -> None:
    """v S⁻¹ v of every place follows χ² with three degrees of freedom: its mean is 3."""
    rng = np.random.default_rng(4)
    x = rng.uniform(0, 10, (7, 3))
    turn = exp_rotation(np.array([[0.3, -1.0, 2.0]]))[0]
    keys, values = np.arange(7), []
    for _ in range(400):
        a = PlaceSystem(
            "a", keys, x + 0.003 * rng.normal(size=(7, 3)), np.full(7, 0.003), False, np.nan
        )
        b = (5.0 * x @ turn.T) + 1.0 + 0.01 * rng.normal(size=(7, 3))
        pair = common_places(a, PlaceSystem("b", keys, b, np.full(7, 0.01), False, 0.0))
        assert pair is not None
        values.append(pair.fitted().tests()[1])
    # 2800 values with the variance 6, of which those of one network are correlated.
    assert np.mean(values) == pytest.approx(3.0, abs=0.25)


def test_the_error_of_a_place_is_what_was_made() -> None:
    rng = np.random.default_rng(4)
    x = rng.uniform(0, 10, (6, 3))
    off = x.copy()
    off[2] += (0.1, -0.2, 0.05)
    keys = np.arange(6)
    sigma = np.full(6, 0.01)
    pair = common_places(
        PlaceSystem("a", keys, x, sigma, False, 0.0), PlaceSystem("b", keys, off, sigma, False, 0.0)
    )
    assert pair is not None
    error, _, freedom = pair.fitted().tests()
    # The linear form leaves out the square of the turn that the error makes, 0.02².
    assert error[2] == pytest.approx((0.1, -0.2, 0.05), abs=1e-3)
    assert (freedom == 3).all()


def chain(twist: float = 0.0, stretch: float = 1.0) -> Network:
    """Return three frames; each pair has three places of its own in common.

    Args:
        twist: by how much the places that the third and the first have in common are turned.
        stretch: and stretched, in the third frame.
    """
    rng = np.random.default_rng(2)
    network = Network("chain")
    turn = exp_rotation(np.array([[0.0, 0.0, twist]]))[0]
    for name in "ABC":
        network.add_frame(name, free=["rx", "ry", "rz", "x", "y", "z", "ln_scale"])
    for pair in ("AB", "BC", "CA"):
        for i, x in enumerate(rng.uniform(0, 10, (3, 3))):
            network.add_point(f"{pair}{i}")
            for frame in pair:
                wrong = pair == "CA" and frame == "C"
                q = stretch * turn @ x if wrong else x
                value = tuple((q + 0.001 * rng.normal(size=3)).tolist())
                network.add(FrameCoordinate(frame, f"{pair}{i}", value, sigma=(0.001,) * 3))
    return network


def test_a_loop_of_frames_that_closes_is_not_told() -> None:
    assert told(chain()) == []


def test_the_turns_of_a_loop_that_do_not_close_are_told() -> None:
    (found,) = told(chain(twist=0.01))
    assert found.startswith("the turns of the loop of frame ")
    size = float(found.split("close: ")[1].split(" mgon")[0])
    assert size == pytest.approx(0.01 / (np.pi / 200e3), rel=0.1)


def test_the_scales_of_a_loop_that_do_not_close_are_told() -> None:
    (found,) = told(chain(stretch=1.01))
    assert found.startswith("the scales of the loop of frame ")
    size = float(found.split("close: ")[1].split(" ppm")[0])
    assert abs(size) == pytest.approx(1e4, rel=0.1)


def test_an_origin_far_from_the_places_is_told_with_a_better_one() -> None:
    network = three_frames()
    del network.frames["scan"]
    network.add_frame("scan", origin=(4_500_000.0, 5_400_000.0, 300.0))
    (found,) = told(network)
    assert found.startswith("the origin of frame 'scan' is far from its places")
    assert "its offset and its rotation are hardly separable" in found
    middle = np.mean([x for n, x in room().items() if n in HELD], axis=0)
    assert found.endswith(" ".join(f"{v:.0f}" for v in middle))


def test_left_handed_axes_of_the_network_are_told_for_frames_that_are_not_level() -> None:
    network = three_frames()
    left = Network("left", frame=LocalFrame(axes="ne"))
    for p in network.points.values():
        y, x, z = p.coordinates
        left.add_point(p.name, None if np.isnan(x) else (x, y, z))
    left.parameters = network.parameters
    left.observations = network.observations
    (found,) = told(left)
    assert found.startswith("the axes of the network are left-handed, and frames are not level: ")


# -- counts ---------------------------------------------------------------------------------------


def reduced(keep: dict[str, str]) -> Network:
    """Return the network with some of the points in each frame, by the digits of their names."""
    network = three_frames()
    network.observations = {
        i: o
        for i, o in network.observations.items()
        if o.point[1:] in keep.get(o.frame, "01234567")
    }
    return network


def of_frames(network: Network) -> list[str]:
    return [str(p) for p in check(network) if str(p).startswith("frame ")]


def test_a_frame_with_too_few_common_places_is_named_with_them() -> None:
    assert of_frames(reduced({"model": "05"})) == [
        "frame 'model': only 2 of its 2 places are common with the rest of the network (P0, P5), "
        "and its 7 unknowns need 3 that do not lie in one line: observe more of them from "
        "elsewhere, or hold some of its components"
    ]


def test_what_only_this_frame_saw_does_not_count() -> None:
    network = reduced({"model": "015"})
    network.observations = {
        i: o for i, o in network.observations.items() if o.point != "P5" or o.frame == "model"
    }
    (found,) = of_frames(network)
    assert "only 2 of its 3 places are common with the rest of the network (P0, P1)" in found


def test_a_level_frame_needs_two_places_and_its_station_is_one() -> None:
    assert of_frames(reduced({"station": "04"})) == []
    network = reduced({"station": "4"})
    (found,) = of_frames(network)
    assert found.startswith("frame 'station': only 1 of its 2 places")
    network.points["T"] = replace(
        network.points["T"], coordinates=(10.0, 5.0, 1.5), fixed=(True,) * 3
    )
    assert of_frames(network) == []


def test_in_a_free_network_one_frame_may_be_all() -> None:
    network = Network("scan alone", datum="free")
    network.add_frame("scan")
    for name, x in room().items():
        network.add_point(name)
        network.add(FrameCoordinate("scan", name, tuple(x.tolist()), sigma=(0.001,) * 3))
    assert of_frames(network) == []
    assert compile_rows(network).n_rows == 24


def test_a_frame_that_nothing_observes_is_named() -> None:
    network = three_frames()
    network.add_frame("idle")
    (found,) = of_frames(network)
    assert found.startswith("frame 'idle': it is unknown, but no observation depends on it")


def test_held_points_that_frames_see_hold_the_datum() -> None:
    network = three_frames()
    del network.frames["station"]
    del network.points["T"]
    network.point_number = {n: i for i, n in enumerate(network.points)}
    network.observations = {
        i: o for i, o in network.observations.items() if o.frame == "scan" and o.point in HELD
    }
    del network.frames["model"]
    assert [p for p in check(network) if "datum" in str(p)] == []


# -- sights ---------------------------------------------------------------------------------------


def test_a_target_confused_in_one_scan_is_told_before_the_adjustment() -> None:
    """P3 of the second tracker is P5: what all others say about P3 does not fit to it."""
    network = room_of(50, ["tracker"] * 3, points=12)
    assert not fga.preliminary(network)
    ids = {(o.kind, o.frame, o.point): i for i, o in network.observations.items()}
    for kind in ("frame_direction", "frame_zenith", "frame_distance"):
        wrong, other = (ids[kind, "tracker 1", p] for p in ("P3", "P5"))
        value = network.observations[other].value
        network.observations[wrong] = replace(network.observations[wrong], value=value)
    (finding,) = fga.preliminary(network)
    assert str(finding).startswith("point 'P3' in frame 'tracker 1' does not fit beside")


def test_places_of_right_sights_fit_in_most_seeds() -> None:
    told = sum(bool(fga.preliminary(room_of(s, ["scanner"] * 3, points=9))) for s in range(30))
    assert told <= 2


@pytest.mark.parametrize("frame_name", FRAMES)
def test_plans_are_compared_with_given_coordinates_in_their_horizon(frame_name) -> None:
    """Of the X and Y of a geocentric frame a plan says nothing."""
    network = network_of_frames(3, ("plan", "levelled scan"), frame_name=frame_name)
    network.datum = "given"
    for name, point in network.points.items():
        network.points[name] = replace(point, fixed=(True,) * 3)
    assert not told(network)
    x, y = value(network, "plan", "P2")
    (found,) = told(changed(network, "plan", "P2", value=(x + 0.1, y)))
    assert found.startswith("point 'P2' in frame 'plan' does not fit")


def test_a_frame_without_values_has_no_sights_to_judge() -> None:
    """Its place and rotation are found; zeros in their place are no geometry."""
    network = room_of(1, ("tracker", "scanner"), held=4)
    for name, frame in network.frames.items():
        network.frames[name] = replace(frame, values=(np.nan,) * 6 + (0.0,))
    assert list(check(network)) == []


def test_a_wrong_point_of_a_model_is_named_with_its_error_probability() -> None:
    """Relatively oriented models with joint covariances (Bouloucos), before the adjustment."""
    spec = Spec(
        parts=(Aerial(strips=2, photos_per_strip=4, relief=20.0, points_per_photo=20),),
        control=Control(),
        seed=7,
    )
    models = as_models(simulate(spec).network).network
    assert told(models) == []
    off = value(models, "1/2-1/3", "10") + np.array((0.0, 0.0, 1.0))
    (found,) = preliminary(changed(models, "1/2-1/3", "10", value=tuple(off)))
    assert found.what.startswith("point '10' in frame '1/1-1/2' and frame '1/2-1/3'")
    assert found.freedom == 3 and found.statistic > chi2.ppf(0.999, 3)
    assert found.probability == pytest.approx(chi2.sf(found.statistic, 3), rel=1e-9)
    shown = str(found)
    assert f"with 3 degrees of freedom, by chance {found.probability:.0e})" in shown


def test_loops_have_statistics_of_turns_and_scales() -> None:
    (turns,) = preliminary(chain(twist=0.01))
    (scales,) = preliminary(chain(stretch=1.01))
    assert (turns.freedom, scales.freedom) == (3, 1)
    for found in (turns, scales):
        limit = chi2.isf(0.001, found.freedom)
        assert (found.size / found.tolerance) ** 2 == pytest.approx(found.statistic / limit)
        assert 0.0 <= found.probability < 0.001
