"""Which photos can have a motion, and what is said of the motion of a photo."""

from __future__ import annotations

from dataclasses import replace

import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.models.lens import BrownForwardLens
from factorgraph_adj.network.additions import add_entities
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ImagePoint, PhotoShift, PhotoTurn
from factorgraph_adj.validate.preliminary_checks import preliminary

FORMAT, READOUT = (36.0, 24.0), 0.03


def photos(readout: float | None = READOUT) -> Network:
    """Return a network with the photos F0, F1, F2."""
    network = Network("strip")
    network.add_camera("camera", BrownForwardLens(), {"c": 30.0}, format=FORMAT, readout=readout)
    for i in range(3):
        network.add_photo(f"F{i}", "camera", position=(40 * i, 0, 80), omega_phi_kappa=(0, 0, 0))
    return network


def test_a_camera_without_readout_time_has_no_photos_that_move() -> None:
    network = photos(None)
    reason = r"photo 'F1'.*camera 'camera' has no readout time.*state readout and format"
    with pytest.raises(fga.InputError, match=reason):
        network.set_unknown("photo_motion", "F1")
    assert not network.of_kind("photo_motion")


def test_nor_has_a_finished_one() -> None:
    moving, network = photos(), photos(None)
    moving.set_unknown("photo_motion", "F1")
    problems = add_entities(network, points=(), photos=(), cameras=(), unknowns=moving.parameters)
    assert len(problems) == 1
    assert "camera 'camera' has no readout time" in problems[0].what
    assert "'F1'" in problems[0].where


def test_motions_arrive_with_their_photos() -> None:
    moving, network = photos(), Network()
    moving.set_unknown("photo_motion", "F1", (1.0, 2.0, 3.0, 0.1, 0.2, 0.3))
    parts = (moving.photos.values(), moving.cameras.values())
    problems = add_entities(
        network,
        points=(),
        photos=list(parts[0]),
        cameras=list(parts[1]),
        unknowns=moving.parameters,
    )
    assert not problems
    assert network.of_kind("photo_motion") == moving.of_kind("photo_motion")


def test_a_camera_that_loses_its_readout_time_is_noticed() -> None:
    network = photos()
    network.set_unknown("photo_motion", "F1")
    network.add_point("P", (0.0, 0.0, 0.0))
    network.add(ImagePoint("F1", "P", 1.0, 2.0, sigma=0.01))
    compile_network(network)
    network.cameras["camera"] = replace(network.cameras["camera"], readout=None)
    with pytest.raises(fga.InputError, match=r"photo 'F1'.*no readout time"):
        compile_network(network)


@pytest.mark.parametrize("kind", [PhotoShift, PhotoTurn])
def test_what_is_said_of_a_motion_needs_a_photo_that_moves(
    kind: type[PhotoShift] | type[PhotoTurn],
) -> None:
    network = photos()
    said = kind("F1", "F0", "F2", interval=8.0, sigma=(1.0, 1.0, 1.0))
    with pytest.raises(fga.InputError, match=r"unknown motion of photo 'F1'.*photo_motions\.csv"):
        network.add(said)
    with pytest.raises(fga.InputError, match="unknown photo 'F9'"):
        network.add(replace(said, moving_photo="F9"))
    assert not network.observations
    network.set_unknown("photo_motion", "F1")
    network.add(said)
    assert len(network.observations) == 1


@pytest.mark.parametrize("readout", [0.03, 1.0])
def test_intervals_without_a_true_readout_time_are_doubted(readout: float) -> None:
    network = photos()
    network.cameras["camera"] = replace(network.cameras["camera"], readout=readout)
    network.add_strip_motions({"F0": 0.0, "F1": 4.0}, sigma_velocity=1.0, sigma_rate=0.1)
    doubts = [f for f in preliminary(network) if "stands for an unknown one" in f.what]
    assert len(doubts) == (readout == 1.0)
    assert all(len(f.ids) == 4 for f in doubts)


def test_a_motion_is_between_two_photos() -> None:
    with pytest.raises(fga.InputError, match="before and after are the same"):
        PhotoShift("F1", "F0", "F0", interval=8.0, sigma=(1.0, 1.0, 1.0))


def test_photos_of_joined_networks_keep_their_motions() -> None:
    """Also where the name of a photo looks like a station and a set that gets another name."""
    networks = []
    for label in ("one", "two"):
        network = Network(label)
        network.add_camera("camera", BrownForwardLens(), {"c": 30.0}, format=FORMAT, readout=0.03)
        for name in ("A", "B", "C"):
            network.add_point(name, (float(ord(name)), 1.0, 2.0))
        for target in ("B", "C"):
            network.add(fga.Direction("A", target, 1.0, set="1", sigma=1e-5))
        networks.append(network)
    second = networks[1]
    second.add_photo("A/1", "camera", position=(0, 0, 80), omega_phi_kappa=(0, 0, 0))
    second.add_photo("F", "camera", position=(40, 0, 80), omega_phi_kappa=(0, 0, 0))
    second.set_unknown("photo_motion", "A/1", (1.0, 2.0, 3.0, 0.1, 0.2, 0.3))
    second.add_shape("edge", "line", origin=(0.0, 0.0, 0.0))
    second.add(fga.ImageLine("A/1", "edge", 1.0, 2.0, sigma=0.01))
    second.add(PhotoShift("A/1", "A/1", "F", interval=4.0, sigma=(1.0, 1.0, 1.0)))
    joined = fga.join(networks)
    assert joined.of_kind("photo_motion") == second.of_kind("photo_motion")
    kinds = {o.kind: o for o in joined.observations.values()}
    assert kinds["image_line"].photo == kinds["photo_shift"].moving_photo == "A/1"  # type: ignore[attr-defined]
    compile_network(joined)


def test_motions_of_a_strip_are_tied_to_the_neighbours_in_time() -> None:
    network = photos()
    network.set_unknown("photo_motion", "F2", fixed=("rx_t", "ry_t", "rz_t"))
    times = {"F2": 9.0, "F0": 1.0, "F1": 4.0}
    ids = network.add_strip_motions(times, sigma_velocity=0.5, sigma_rate=(0.1, 0.2, 0.3))
    ties = [network.observations[i] for i in ids]
    assert [(o.moving_photo, o.before, o.after, o.interval) for o in ties[::2]] == [  # type: ignore[attr-defined]
        ("F0", "F0", "F1", 3.0),
        ("F1", "F0", "F2", 8.0),
        ("F2", "F1", "F2", 5.0),
    ]
    assert [o.kind for o in ties] == ["photo_shift", "photo_turn"] * 3
    assert ties[2].sigma == (4.0, 4.0, 4.0)  # type: ignore[attr-defined]
    assert ties[3].sigma == pytest.approx((0.8, 1.6, 2.4))  # type: ignore[attr-defined]
    stated = network.of_kind("photo_motion")
    assert [any(stated[f].fixed) for f in times] == [True, False, False]


@pytest.mark.parametrize(
    ("times", "said"),
    [
        ({"F0": 0.0}, "two photos or more, not 1"),
        ({"F0": 0.0, "F7": 1.0, "F8": 2.0}, "unknown photo 'F7'(.|\n)*unknown photo 'F8'"),
        ({"F0": 0.0, "F1": float("nan")}, r"photo 'F1': its time must be a finite number"),
        ({"F0": 1.0, "F1": 1.0}, r"photo 'F0': has the time of photo 'F1', 1\.0 s"),
    ],
)
def test_a_strip_has_photos_of_different_times(times: dict[str, float], said: str) -> None:
    network = photos()
    with pytest.raises(fga.InputError, match=said):
        network.add_strip_motions(times, sigma_velocity=1.0, sigma_rate=0.1)
    assert not network.observations
    assert not network.of_kind("photo_motion")


def test_a_strip_needs_readout_times_and_standard_deviations() -> None:
    times = {"F0": 0.0, "F1": 1.0}
    with pytest.raises(fga.InputError, match=r"'F0'.*no readout time(.|\n)*'F1'.*no readout time"):
        photos(None).add_strip_motions(times, sigma_velocity=1.0, sigma_rate=0.1)
    with pytest.raises(fga.InputError, match="sigma_rate"):
        photos().add_strip_motions(times, sigma_velocity=1.0, sigma_rate=0.0)
