"""Blocks and pose graphs with known truth whose adjustment begins far from the minimum.

Every sort is a way in which start values are wrong in practice. Image blocks have 6 to 9 photos
with 1000 px of principal distance, 100 m above a relief of ± 15 m, and 40 to 60 points, five of
which are control; half of the photos are oblique. Pose graphs are parts of those that come with
the gtsam wheel.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import gtsam
import numpy as np

from factorgraph_adj.graph.equations import Equations, compile_network
from factorgraph_adj.graph.observation_selection import without
from factorgraph_adj.graph.variables import State
from factorgraph_adj.io.photogrammetry.bundler import read_bal
from factorgraph_adj.models.lens import NoDistortion, NormalisedLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import (
    ControlPoint,
    PhotoPosition,
    RelativePosition,
    RelativeRotation,
)
from factorgraph_adj.rotation import TURN_ABOUT_X as TURN
from factorgraph_adj.rotation import exp_rotation, log_rotation
from factorgraph_adj.solve.estimates import network_with_values
from factorgraph_adj.types import Array
from tests.support.places import data_dir

HEIGHT = 100.0
"""Flying height, metres."""
CALIBRATION = {"c": 1000.0, "k1": -0.05, "k2": 0.01}
HALF_FORMAT = 700.0
SIGMA_PX, SIGMA_CONTROL, SIGMA_GNSS = 0.5, 0.02, 0.1
CAMERA = "camera"
WRONG = "15 % wrong pixels"
WRONG_PIXELS = 0.15
"""Share of image points that are anywhere in the format."""
RIGHT = 6.0
"""Residual, in standard deviations, that an image point which is not wrong does not exceed."""
BAL = "problem-49-7776-pre-shrink-1800.txt"
LEAST_OF_PHOTO = 12
"""Smallest number of points of a photo in a part of that block."""
WHEEL = Path(gtsam.__file__).parent / "Data"
SPHERE, PLANE = "sphere2500.txt", "w100.graph"
"""Pose graphs of the wheel: a sphere of 2500 poses, and 100 poses in a plane."""


def turned(rng: np.random.Generator, degrees: float) -> Array:
    """Return a rotation (3, 3) by an angle about a random axis."""
    axis = rng.normal(size=3)
    return np.asarray(exp_rotation(np.radians(degrees) * axis / np.linalg.norm(axis)))


def true_block(
    rng: np.random.Generator, *, gnss: bool = True, wrong: float = 0.0, control: int = 5
) -> Network:
    """Return a block with its true values and measured image points, control and positions."""
    photos, points = int(rng.integers(6, 10)), int(rng.integers(40, 61))
    network = Network("block with a poor start")
    network.add_camera(CAMERA, NormalisedLens(), CALIBRATION, free=CALIBRATION, unit="px")
    x = rng.uniform(-1, 1, (points, 3)) * [0.9 * HEIGHT, 0.7 * HEIGHT, 0.15 * HEIGHT]
    names = [f"P{i}" for i in range(points)]
    columns = (photos + 1) // 2
    rays = np.zeros(points, dtype=int)
    images = []
    for i in range(photos):
        row, column = divmod(i, columns)
        at = HEIGHT * np.array([0.35 * (column - (columns - 1) / 2), 0.5 * (row - 0.5), 1.0])
        at += rng.normal(0.0, 0.03 * HEIGHT, 3)
        down = np.diag([1.0, -1.0, -1.0]) @ turned(rng, 3.0 if i % 2 else 20.0)
        network.add_photo(f"F{i}", CAMERA, position=at, rotation=down)
        ray = (x - at) @ down
        t = ray[:, :2] / ray[:, 2:]
        r2 = np.sum(t * t, axis=1, keepdims=True)
        c, k1, k2 = CALIBRATION.values()
        image = c * (1.0 + k1 * r2 + k2 * r2 * r2) * t * [1.0, -1.0]
        seen = (np.abs(image) < HALF_FORMAT).all(axis=1) & (ray[:, 2] > 0)
        images.append((image + rng.normal(0.0, SIGMA_PX, image.shape), seen))
        rays += seen
    used = rays >= 3
    for name, at in zip(np.array(names)[used], x[used], strict=True):
        network.add_point(str(name), at)
    for i, (image, seen) in enumerate(images):
        rows = np.flatnonzero(seen & used)
        gross = rng.random(len(rows)) < wrong
        image[rows[gross]] = rng.uniform(-HALF_FORMAT, HALF_FORMAT, (int(gross.sum()), 2))
        network.add_image_points(f"F{i}", [names[k] for k in rows], image[rows], sigma=SIGMA_PX)
        if gnss:
            at = np.array(network.photos[f"F{i}"].position)
            noisy = tuple((at + rng.normal(0.0, SIGMA_GNSS, 3)).tolist())
            network.add(PhotoPosition(f"F{i}", noisy, sigma=(SIGMA_GNSS,) * 3))
    for k in rng.choice(np.flatnonzero(used), control, replace=False).tolist():
        at = tuple((x[k] + rng.normal(0.0, SIGMA_CONTROL, 3)).tolist())
        network.add(ControlPoint(names[k], at, sigma=(SIGMA_CONTROL,) * 3))
    return network


def _moved(network: Network, change: Callable[[Equations, State], State]) -> Network:
    """Return a network with changed start values."""
    equations = compile_network(network)
    state = change(equations, equations.unknowns.start())
    return network_with_values(network, equations.unknowns, state)


def _by_similarity(network: Network, scale: float, rotation: Array, shift: Array) -> Network:
    """Return a network whose photos and points are moved by a similarity about its middle."""

    def change(_: Equations, state: State) -> State:
        middle = state["point"].mean(axis=0)
        pose = state["pose"].copy()
        pose[:, :9] = (rotation @ pose[:, :9].reshape(-1, 3, 3)).reshape(-1, 9)
        pose[:, 9:] = scale * (pose[:, 9:] - middle) @ rotation.T + middle + shift
        point = scale * (state["point"] - middle) @ rotation.T + middle + shift
        return {**state, "pose": pose, "point": point}

    return _moved(network, change)


def _noisy(network: Network, rng: np.random.Generator, degrees: float, share: float) -> Network:
    """Return a network with noise on attitudes, and on places relative to the depth of points."""

    def change(_: Equations, state: State) -> State:
        middle = np.median(state["point"], axis=0)
        depth = float(np.median(np.linalg.norm(state["pose"][:, 9:] - middle, axis=1)))
        pose = state["pose"].copy()
        turns = np.array([turned(rng, degrees * rng.normal()) for _ in pose])
        pose[:, :9] = (pose[:, :9].reshape(-1, 3, 3) @ turns).reshape(-1, 9)
        pose[:, 9:] += rng.normal(0.0, share * depth, pose[:, 9:].shape)
        point = state["point"] + rng.normal(0.0, share * depth, state["point"].shape)
        return {**state, "pose": pose, "point": point}

    return _moved(network, change)


# -- sorts ----------------------------------------------------------------------------------------


def moved_by_similarity(rng: np.random.Generator) -> Network:
    """Return a block whose photos and points are turned anyhow and scaled by 0.01 to 100."""
    block = true_block(rng, gnss=bool(rng.random() < 0.5))
    scale = 10.0 ** rng.uniform(-2.0, 2.0)
    return _by_similarity(block, scale, turned(rng, rng.uniform(0.0, 180.0)), np.zeros(3))


def shifted(rng: np.random.Generator) -> Network:
    """Return a block that is shifted by ten flying heights in a random direction."""
    way = rng.normal(size=3)
    block = true_block(rng, gnss=bool(rng.random() < 0.5))
    return _by_similarity(block, 1.0, np.eye(3), 10.0 * HEIGHT * way / np.linalg.norm(way))


def wrong_pixels(rng: np.random.Generator) -> Network:
    """Return a block of whose image points 15 % are anywhere, with starts 2° and 3 % off."""
    return _noisy(true_block(rng, wrong=WRONG_PIXELS), rng, 2.0, 0.03)


def wrong_principal_distance(rng: np.random.Generator) -> Network:
    """Return a block whose principal distance starts at half, or one and a half times, its size."""
    block = _noisy(true_block(rng, gnss=bool(rng.random() < 0.5)), rng, 1.0, 0.01)
    camera = block.cameras[CAMERA]
    c = float(rng.choice([0.5, 1.5])) * CALIBRATION["c"]
    block.cameras[CAMERA] = replace(camera, values=(c, *camera.values[1:]))
    return block


def noisy_poses(rng: np.random.Generator) -> Network:
    """Return a block whose attitudes start 30°, and whose places 20 % of the depth, off."""
    return _noisy(true_block(rng, gnss=bool(rng.random() < 0.5)), rng, 30.0, 0.2)


def weak_control(rng: np.random.Generator) -> Network:
    """Return a block that a few metres of GNSS alone place, turned by 40° and half as large."""
    block = true_block(rng, gnss=False, control=0)
    for name, photo in block.photos.items():
        at = np.array(photo.position) + rng.normal(0.0, 5.0, 3)
        block.add(PhotoPosition(name, tuple(at.tolist()), sigma=(5.0, 5.0, 10.0)))
    return _by_similarity(block, 0.5, turned(rng, 40.0), rng.normal(0.0, 10.0, 3))


@cache
def _ladybug() -> Network:
    return read_bal(data_dir("bal") / BAL)


def part_of_bal(rng: np.random.Generator) -> Network:
    """Return 6 to 9 photos of Ladybug 49 that share many points, as they start there.

    Every photo has at least `LEAST_OF_PHOTO` of the points, and every point at least three rays.
    """
    whole = _ladybug()
    table = compile_network(whole)
    block = next(b for b in table.blocks if b.kind == "image")
    poses, points = table.unknowns["pose"].names, table.unknowns["point"].names
    photo, point = block.variables[0][1], block.variables[2][1]
    seen = np.zeros((len(poses), len(points)), dtype=bool)
    seen[photo, point] = True
    while True:
        chosen = [int(rng.integers(len(poses)))]
        for _ in range(int(rng.integers(5, 9))):
            shared = np.sum(seen & (seen[chosen].sum(axis=0) > 0), axis=1)
            shared[chosen] = -1
            chosen.append(int(np.argmax(shared)))
        kept = np.flatnonzero(seen[chosen].sum(axis=0) >= 3)
        kept = np.sort(rng.permutation(kept)[:60])
        if seen[np.ix_(chosen, kept)].sum(axis=1).min() >= LEAST_OF_PHOTO and np.all(
            seen[np.ix_(chosen, kept)].sum(axis=0) >= 3
        ):
            break
    out = Network(f"{BAL}: photos {sorted(chosen)}", datum="free")
    start = table.unknowns.start()
    for k in kept.tolist():
        out.add_point(points[k], start["point"][k])
    for number in sorted(chosen):
        name = poses[number]
        old = dict(zip(NormalisedLens().names, whole.cameras[name].values, strict=True))
        out.add_camera(name, NormalisedLens(), old, free=("c", "k1", "k2"), unit="px")
        pose = start["pose"][number]
        out.add_photo(name, name, position=pose[9:], rotation=pose[:9].reshape(3, 3))
        on = (photo == number) & np.isin(point, kept)
        names = [points[k] for k in point[on].tolist()]
        out.add_image_points(name, names, block.observed[on], sigma=1.0)
    return out


@cache
def _edges(file: str) -> tuple[tuple[int, int, Array, Array], ...]:
    """Return the relative poses of a graph of the wheel: numbers, rotation (3, 3), base (3,)."""
    graph, _ = gtsam.load3D(str(WHEEL / file)) if file == SPHERE else (None, None)
    out = []
    if graph is not None:
        for k in range(graph.size()):
            factor = graph.at(k)
            pose = factor.measured()
            a, b = factor.keys()
            out.append((int(a), int(b), pose.rotation().matrix(), np.array(pose.translation())))
        return tuple(out)
    for line in (WHEEL / file).read_text().splitlines():
        words = line.split()
        if words[:1] == ["EDGE2"]:
            a, b = int(words[1]), int(words[2])
            x, y, turn = map(float, words[3:6])
            out.append((a, b, exp_rotation(np.array([0.0, 0.0, turn])), np.array([x, y, 0.0])))
    return tuple(out)


def pose_graph(
    rng: np.random.Generator, *, poses: int = 0, file: str = "", noise: float | None = None
) -> Network:
    """Return a part of a pose graph of the wheel, without initial values.

    Args:
        rng: draws what is not given.
        poses: number of poses, beginning at one and going on to those that edges join.
        file: name of the graph.
        noise: additional noise of the rotations, radians; ten times as much of the bases, metres.
    """
    file = file or str(rng.choice([SPHERE, PLANE]))
    edges = _edges(file)
    poses = poses or int(rng.integers(20, 41))
    noise = float(rng.choice([0.0, 0.05, 0.1])) if noise is None else noise
    near: dict[int, set[int]] = {}
    for a, b, _, _ in edges:
        near.setdefault(a, set()).add(b)
        near.setdefault(b, set()).add(a)
    first = int(rng.choice(sorted(near)))
    inside, waiting = {first}, [first]
    while waiting and len(inside) < poses:
        for other in sorted(near[waiting.pop(0)] - inside)[: poses - len(inside)]:
            inside.add(other)
            waiting.append(other)
    network = Network(f"{poses} poses of {file}")
    network.add_camera(CAMERA, NoDistortion(), {"c": 1.0})
    for k in sorted(inside):
        if k == first:
            network.add_photo(str(k), CAMERA, position=(0, 0, 0), rotation=np.eye(3), fixed=True)
        else:
            network.add_photo(str(k), CAMERA)
    for a, b, rotation, base in edges:
        if a not in inside or b not in inside:
            continue
        turn = rotation @ exp_rotation(noise * rng.normal(size=3))
        way = base + 10.0 * noise * rng.normal(size=3)
        w = log_rotation((TURN @ turn @ TURN)[None])[0]
        network.add(RelativeRotation(str(a), str(b), tuple(w.tolist()), sigma=(0.05,) * 3))
        t = tuple((TURN @ way).tolist())
        network.add(RelativePosition(str(a), str(b), t, sigma=(0.1,) * 3))
    return network


def large_pose_graph(rng: np.random.Generator) -> Network:
    """Return 300 to 400 poses of the sphere."""
    return pose_graph(rng, poses=int(rng.integers(300, 401)), file=SPHERE)


def whole_pose_graph(rng: np.random.Generator) -> Network:
    """Return all 2500 poses of the sphere, as they come or with additional noise."""
    return pose_graph(rng, poses=2500, file=SPHERE)


SORTS: Mapping[str, tuple[int, Callable[[np.random.Generator], Network]]] = {
    "similarity of 0.01 to 100, any turn": (80, moved_by_similarity),
    "shift of ten flying heights": (40, shifted),
    WRONG: (80, wrong_pixels),
    "principal distance off by half": (80, wrong_principal_distance),
    "poses with 30° and 20 % noise": (80, noisy_poses),
    "weak control, 40° and half as large": (40, weak_control),
    "parts of BAL Ladybug 49": (60, part_of_bal),
    "pose graphs without initial values": (40, pose_graph),
    "pose graphs of 300 to 400 poses": (6, large_pose_graph),
    "pose graphs of 2500 poses": (2, whole_pose_graph),
}
"""Numbers of blocks in the benchmark, and what draws them, by sort."""


def poor_start(sort: str, number: int) -> Network:
    """Return one block of a sort; the same number gives the same block."""
    return SORTS[sort][1](_random(sort, number))


def _random(sort: str, number: int) -> np.random.Generator:
    return np.random.default_rng([list(SORTS).index(sort), number])


def right_pixels(number: int) -> Network:
    """Return a block of `WRONG` with its true values, without the image points that are wrong.

    Points with fewer than two of the others leave too.
    """
    block = true_block(_random(WRONG, number), wrong=WRONG_PIXELS)
    equations = compile_network(block)
    misses = equations.residuals(equations.unknowns.start())
    images = next(b for b in equations.blocks if b.lens is not None)
    fit = np.abs(misses[images.rows]).reshape(-1, 2).max(axis=1) < RIGHT
    table = equations.unknowns["point"]
    rays = np.bincount(images.variables[2][1][fit], minlength=len(table.names))
    gone = [f for f, right in zip(images.ids, fit, strict=True) if not right]
    return without(block, gone, points=[n for n, k in zip(table.names, rays, strict=True) if k < 2])
