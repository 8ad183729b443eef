"""Ground control and positions of photos from lists, for networks of photos in a frame.

A list of ground control is gcp_list.txt of ODM, or ground_control_points.json of OpenSfM; positions
are those of `coordinate_lists`. A block without a frame of its own, such as a model of COLMAP, gets
a topocentric frame in the middle of what the lists have.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ...entities import Point
from ...errors import InputError, Problem
from ...frames import TopocentricFrame
from ...models.similarity import Similarity
from ...network.network import Network
from ...observations import ControlPoint, Observation, PhotoPosition
from ...types import Array
from ..format_options import option_text
from ..source import LeftOutReason, Problems
from .block_source import MARKS_WITHOUT_PHOTO
from .colmap_reference import ControlMark, PositionPrior, similarity_of_points
from .coordinate_lists import (
    LOST_POSITIONS,
    POSITIONS_WITHOUT_PHOTO,
    ListedSystem,
    PositionList,
    list_system,
    read_positions,
)
from .opensfm_elements import GroundControlPoint, read_gcp_list

UNSEEN_CONTROL = LeftOutReason("control points", "no image of the model shows them")
POSITIONS_WITHOUT_HEIGHT = LeftOutReason("positions", "they have no height")


def add_ground(
    network: Network,
    frame: TopocentricFrame,
    listed: ListedSystem,
    point: GroundControlPoint,
    sigma: tuple[float, float],
) -> None:
    """Add a ground control point or check point; a height of NaN is unknown.

    Raises:
        InputError: its place is none in the system, or far from the frame (`ListedSystem.place`).
    """
    if point.xyz is None:
        network.add_point(point.name)
        return
    x, y, height = point.xyz
    known = not np.isnan(height)
    at = listed.place(frame, (x, y, height if known else frame.height))
    if point.check:
        network.add_point(point.name, check=at if known else (*at[:2], np.nan))
        return
    network.add_point(point.name, at)
    enu = frame.basis(np.array([at]), np.zeros((1, 2))).enu[0]
    if known:
        covariance = enu.T @ np.diag(np.square([sigma[0], sigma[0], sigma[1]])) @ enu
        covariance = 0.5 * (covariance + covariance.T)
        o = ControlPoint(point.name, at, covariance=covariance, source=point.where)
    else:
        plan = (sigma[0], sigma[0])
        o = ControlPoint(point.name, at, axes="en", sigma=plan, source=point.where)
    network.add(o)


@dataclass
class BlockReference:
    """Ground control and positions of photos in the frame of a block."""

    frame: TopocentricFrame
    """The frame."""
    control: dict[str, Point] = field(default_factory=dict)
    """Control and check points by name."""
    observations: list[Observation] = field(default_factory=list)
    """Their observed coordinates."""
    marks: list[ControlMark] = field(default_factory=list)
    """Their image coordinates."""
    priors: list[PositionPrior] = field(default_factory=list)
    """Positions of photos."""
    listed_control: ListedSystem | None = None
    """System and order of the list of ground control; None: there is none."""
    listed_positions: ListedSystem | None = None
    """The same of the list of positions."""

    def refuse_exchanged_order(self, block: Array, listed: Array) -> None:
        """Refuse lists whose places fit a block with x and y exchanged only.

        Args:
            block: places in the block, of photos with positions first, then of control, (n, 3).
            listed: the same places in the frame, (n, 3).

        Raises:
            InputError: `ListedSystem.problem_of_order` of both lists.
        """
        first = len(self.priors)
        parts = (
            (self.listed_positions, slice(None, first)),
            (self.listed_control, slice(first, None)),
        )
        problems = [
            Problem(what, of.where)
            for of, rows in parts
            if of is not None
            and (what := of.problem_of_order(self.frame, block[rows], listed[rows]))
        ]
        if problems:
            raise InputError(problems)

    def refuse_places_apart(self, block: Array, listed: Array) -> None:
        """Refuse places that are far from the others in their lists, but not in the block.

        Args:
            block: places in the block, of photos with positions first, then of control, (n, 3).
            listed: the same places in the frame, (n, 3).

        Raises:
            InputError: names the positions, or the distance of all positions from the control.
        """
        first = len(self.priors)
        if not first:
            return
        if first < len(block):
            there, here = (_distance_of_parts(x, first) for x in (listed, block))
            if there[1] > MIN_RATIO_APART * max(here[1], 1.0):
                away = f"positions of photos lie {there[0] / 1e3:.3g} km from the control points"
                raise InputError(
                    Problem(
                        f"{away}, {there[1]:.0f} times the extent of both (in the model "
                        f"{here[1]:.2g} times); valid: the same area, each list in the system "
                        "and zone that it names",
                        getattr(self.listed_positions, "where", ""),
                    )
                )
        there, here = (
            np.linalg.norm(x[:first] - np.median(x[:first], axis=0), axis=1)
            for x in (listed, block)
        )
        usual = [np.median(d) for d in (there, here)]
        if not min(usual) > 0:
            return
        far = there / usual[0] > MIN_RATIO_APART * np.maximum(here / usual[1], 1.0)
        problems = [
            Problem(
                f"position of image {prior.photo!r} lies {d / 1e3:.3g} km from the middle of the "
                "positions, where the model has it among the others",
                prior.where,
            )
            for prior, d, bad in zip(self.priors, there, far, strict=True)
            if bad
        ]
        if problems:
            raise InputError(problems)


MIN_RATIO_APART = 20.0
"""How many times farther places must be from others in a list than in the block, in extents."""


def _distance_of_parts(x: Array, first: int) -> tuple[float, float]:
    """Return the distance between the medians of two parts, and its ratio to their extent."""
    parts = x[:first], x[first:]
    middles = [np.median(part, axis=0) for part in parts]
    spread = np.concatenate([part - m for part, m in zip(parts, middles, strict=True)])
    extent = float(np.median(np.linalg.norm(spread, axis=1)))
    distance = float(np.linalg.norm(middles[0] - middles[1]))
    return distance, distance / extent if extent > 0 else 0.0


def read_block_reference(
    gcp: str | Path | None,
    positions: str | Path | None,
    images: Iterable[str],
    problems: Problems,
    *,
    sigma_gcp: tuple[float, float],
    sigma_gcp_px: float,
    sigma_positions: tuple[float, float] | None,
    positions_system: str | None,
) -> BlockReference:
    """Return ground control and positions of the photos of a block.

    Args:
        gcp: list of ground control; None: none.
        positions: list of positions; None: none.
        images: names of the photos; the name of the file alone finds one, too.
        problems: gets what is wrong and what is left out.
        sigma_gcp: standard deviations of ground control, horizontal and vertical, metres.
        sigma_gcp_px: standard deviation of its image coordinates, pixels.
        sigma_positions: those of positions for which the file states no σ, horizontal and
            vertical, metres.
        positions_system: reference system of a table that states none.

    Raises:
        InputError: a list cannot be read, or has no coordinates.
    """
    known = _ImageNames(images)
    ground = None if gcp is None else read_gcp_list(Path(gcp), problems)
    listed = None
    if positions is not None:
        listed = read_positions(Path(positions), problems, system=positions_system)
    problems.raise_all()
    if ground is not None:
        where = ground.where
        system = problems.attempt(where, list_system, ground.system)
        places = [p.xyz for p in ground.points if p.xyz is not None]
    else:
        assert listed is not None
        where, system = listed.listed.where, listed.listed.system
        places = [p.xyz for p in listed.positions]
    problems.raise_all()
    assert system is not None
    at = np.array(places).reshape(-1, 3)
    heights = at[np.isfinite(at[:, 2]), 2]
    at[np.isnan(at[:, 2]), 2] = heights.mean() if len(heights) else 0.0
    if not len(at):
        problems.wrong("has no coordinates", where)
        problems.raise_all()
    frame = problems.attempt(where, system.frame, at)
    problems.raise_all()
    assert frame is not None
    out = BlockReference(frame)
    if ground is not None:
        out.listed_control = ListedSystem(system, ground.order, Path(str(gcp)).name)
        _add_control(out, ground.points, known, problems, sigma_gcp, sigma_gcp_px)
    if listed is not None:
        out.listed_positions = listed.listed
        out.priors = listed_priors(listed, frame, known.names, problems, sigma_positions)
    problems.raise_all()
    return out


NUMBER_OF_IMAGE = re.compile(r".*_(\d{4,})(?:_[A-Za-z]+)?")
"""Name of an image of DJI without its suffix: …_0007, …_0007_V."""


class _ImageNames:
    """Names of the images of a block, which are found by their files, too."""

    def __init__(self, images: Iterable[str]) -> None:
        self.names = dict.fromkeys(images)
        self.by_file: dict[str, list[str]] = {}
        for name in self.names:
            self.by_file.setdefault(Path(name).name, []).append(name)

    def find(self, name: str) -> str | None:
        """Return the image of a name; None if there is none, or several."""
        if name in self.names:
            return name
        found = self.by_file.get(Path(name).name, [])
        return found[0] if len(found) == 1 else None

    def of_number(self, number: str) -> str | None:
        """Return the image whose file has a number; None if there is none, or several."""
        found = self._by_number.get(int(number), [])
        return found[0] if len(found) == 1 else None

    @cached_property
    def _by_number(self) -> dict[int, list[str]]:
        out: dict[int, list[str]] = {}
        for name in self.names:
            if found := NUMBER_OF_IMAGE.fullmatch(Path(name).stem):
                out.setdefault(int(found[1]), []).append(name)
        return out


def _add_control(
    out: BlockReference,
    points: Iterable[GroundControlPoint],
    images: _ImageNames,
    problems: Problems,
    sigma: tuple[float, float],
    sigma_px: float,
) -> None:
    """Add control points that images of the block show."""
    network, listed = Network(frame=out.frame), out.listed_control
    assert listed is not None
    for point in points:
        marks = []
        for photo, x, y, normalised, where in point.marks:
            image = images.find(photo)
            if normalised:
                problems.wrong("normalised image coordinates need cameras of OpenSfM", where)
            elif image is None:
                problems.leave_out(MARKS_WITHOUT_PHOTO, photo, where)
            else:
                # ODM counts pixels from the centre of the first one, COLMAP from its corner.
                marks.append(ControlMark(image, point.name, x + 0.5, y + 0.5, sigma_px, where))
        if not marks:
            problems.leave_out(UNSEEN_CONTROL, point.name, point.where)
            continue
        twice = [m for i, m in enumerate(marks) if m.photo in {n.photo for n in marks[:i]}]
        for mark in twice:
            what = f"control point {point.name!r} is measured twice in image {mark.photo!r}"
            problems.wrong(what, mark.where)
        with problems.collect(point.where):
            add_ground(network, out.frame, listed, point, sigma)
            out.marks += marks
    out.control = dict(network.points)
    out.observations = list(network.observations.values())


def listed_priors(
    listed: PositionList,
    frame: TopocentricFrame,
    images: Iterable[str],
    problems: Problems,
    sigma: tuple[float, float] | None,
) -> list[PositionPrior]:
    """Return the listed positions of the images of a block, in its frame.

    Args:
        listed: the list.
        frame: frame of the block.
        images: names of the images; the name of the file alone finds one, too.
        problems: gets what is wrong and what is left out.
        sigma: standard deviations of positions for which the file states no σ, horizontal and
            vertical, metres.
    """
    images = list(images)
    known, out = _ImageNames(images), dict[str, PositionPrior]()
    # A list of all photos of a flight has more than the model; a list whose photos have other
    # names than those of the model leaves images of it without a position.
    find = known.of_number if listed.by_number else known.find
    listed_images = {find(position.photo) for position in listed.positions}
    complete = listed_images.issuperset(images)
    without_photo = POSITIONS_WITHOUT_PHOTO if complete else LOST_POSITIONS
    for position in listed.positions:
        image, where = find(position.photo), position.where
        found = position.sigma
        if found is None and sigma is not None:
            found = sigma[0], sigma[0], sigma[1]
        if image is None:
            problems.leave_out(without_photo, position.photo, where)
        elif np.isnan(position.xyz[2]):
            problems.leave_out(POSITIONS_WITHOUT_HEIGHT, position.photo, where)
        elif image in out:
            problems.wrong(f"second position of image {image!r}", where)
        elif found is None:
            option = option_text("sigma_positions", ("horizontal", "vertical"))
            why = f" ({position.why_no_sigma})" if position.why_no_sigma else ""
            what = f"has no accuracy{why}; valid: {option}, metres"
            problems.wrong(what, where)
        else:
            with problems.collect(where):
                at = listed.listed.place(frame, position.xyz)
                out[image] = PositionPrior(image, at, found, (0.0, 0.0, 0.0), where)
    return list(out.values())


def place_by_positions(
    network: Network,
    positions: str | Path | None,
    *,
    sigma: tuple[float, float] | None,
    system: str | None,
) -> Network:
    """Return a free block of photos in the frame of listed positions of them, which are observed.

    The frame is topocentric, in the middle of the positions; a similarity carries points and poses
    over, for start values.

    Args:
        network: the block, as a reader has made it, in coordinates of its own.
        positions: list of positions; None: the network is returned as it is.
        sigma: standard deviations of positions for which the file states no σ, horizontal and
            vertical, metres.
        system: reference system of a table of positions that states none.

    Raises:
        InputError: the list cannot be read, or does not determine the similarity.
    """
    if positions is None:
        if sigma is not None or system is not None:
            raise InputError("sigma_positions and positions_system belong to positions=…")
        return network
    problems = Problems()
    listed = read_positions(Path(positions), problems, system=system)
    problems.raise_all()
    at = np.array([p.xyz for p in listed.positions]).reshape(-1, 3)
    at = at[np.isfinite(at).all(axis=1)]
    if not len(at):
        problems.wrong("has no position with a height", listed.listed.where)
        problems.raise_all()
    frame = problems.attempt(listed.listed.where, listed.listed.system.frame, at)
    problems.raise_all()
    assert frame is not None
    priors = listed_priors(listed, frame, network.photos, problems, sigma)
    problems.raise_all()
    centres = np.array([network.photos[p.photo].position for p in priors]).reshape(-1, 3)
    to = np.array([p.xyz for p in priors]).reshape(-1, 3)
    if what := listed.listed.problem_of_order(frame, centres, to):
        problems.wrong(what, listed.listed.where)
        problems.raise_all()
    moved = similarity_or_problem(centres, to, listed.listed.where)
    out = _carried_over(network, moved, frame)
    out.add(*(PhotoPosition(p.photo, p.xyz, sigma=p.sigma, source=p.where) for p in priors))
    problems.finish(out)
    return out


def similarity_or_problem(block: Array, to: Array, where: str) -> Similarity:
    """Return the similarity that carries a block over to places.

    Raises:
        InputError: the places do not determine it.
    """
    found = similarity_of_points(block, to)
    if found is None:
        what = (
            f"control points and positions of photos give {len(block)} places, which do not carry "
            "the model over to their system; valid: three or more, not on a line, each of a "
            "photo, of a 3-D point, or of a control point with marks in two images"
        )
        raise InputError(Problem(what, where))
    return found


def _carried_over(network: Network, moved: Similarity, frame: TopocentricFrame) -> Network:
    """Move points and photos of a block without observed coordinates into a frame."""
    network.frame, network.datum = frame, "given"
    for name, point in network.points.items():
        at = moved.of(np.array(point.coordinates)[None])[0]
        network.points[name] = replace(point, coordinates=_three(at))
    for name, photo in network.photos.items():
        assert photo.position is not None and photo.rotation is not None
        centre = moved.of(np.array(photo.position)[None])[0]
        turned = moved.rotation @ photo.rotation
        network.photos[name] = replace(photo, position=_three(centre), rotation=turned)
    return network


def _three(at: Sequence[float] | Array) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in at)
    return x, y, z
