"""Ground control and positions of photos from lists, for networks of photos in a frame.

A list of ground control is gcp_list.txt of ODM, or ground_control_points.json of OpenSfM; positions
are those of `coordinate_lists`. A block without a frame of its own, such as a model of COLMAP, gets
a topocentric frame in the middle of what the lists have.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...entities import Point
from ...errors import InputError, Problem
from ...frames import TopocentricFrame
from ...network.network import Network
from ...observations import ControlPoint, Observation
from ..source import LeftOutReason, Problems
from .block_source import MARKS_WITHOUT_PHOTO
from .colmap_reference import ControlMark, PositionPrior
from .coordinate_lists import (
    LOST_POSITIONS,
    POSITIONS_WITHOUT_PHOTO,
    ListSystem,
    PositionList,
    list_system,
    read_positions,
)
from .opensfm_elements import GroundControlPoint, read_gcp_list

MAX_CONTROL_DISTANCE_M = 100e3
"""Largest level distance of ground control from the origin of a reconstruction, metres."""
UNSEEN_CONTROL = LeftOutReason("control points", "no image of the model shows them")
POSITIONS_WITHOUT_HEIGHT = LeftOutReason("positions", "they have no height")


def add_ground(
    network: Network,
    frame: TopocentricFrame,
    system: ListSystem,
    point: GroundControlPoint,
    sigma: tuple[float, float],
) -> None:
    """Add a ground control point or check point; a height of NaN is unknown."""
    if point.xyz is None:
        network.add_point(point.name)
        return
    x, y, height = point.xyz
    known = not np.isnan(height)
    at = tuple(system.place(frame, (x, y, height if known else frame.height)).tolist())
    if np.hypot(at[0], at[1]) > MAX_CONTROL_DISTANCE_M:
        away = np.linalg.norm(at) / 1e3
        origin = f"{np.rad2deg(frame.latitude):g}°, {np.rad2deg(frame.longitude):g}°"
        what = f"lies {away:.0f} km from latitude, longitude {origin} of the frame"
        need = "longitude or easting comes first, and the first line of the list names the zone"
        raise InputError(
            Problem(f"{what}; valid: up to {MAX_CONTROL_DISTANCE_M / 1e3:.0f} km; {need}")
        )
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
        sigma_positions: those of positions without accuracies, horizontal and vertical, metres.
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
        where, system = Path(str(positions)).name, listed.system
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
        _add_control(out, ground.points, system, known, problems, sigma_gcp, sigma_gcp_px)
    if listed is not None:
        out.priors = listed_priors(listed, frame, known.names, problems, sigma_positions)
    problems.raise_all()
    return out


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


def _add_control(
    out: BlockReference,
    points: Iterable[GroundControlPoint],
    system: ListSystem,
    images: _ImageNames,
    problems: Problems,
    sigma: tuple[float, float],
    sigma_px: float,
) -> None:
    """Add control points that images of the block show."""
    network = Network(frame=out.frame)
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
            add_ground(network, out.frame, system, point, sigma)
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
        sigma: standard deviations of positions without accuracies, horizontal and vertical, metres.
    """
    images = list(images)
    known, out = _ImageNames(images), dict[str, PositionPrior]()
    # A list of all photos of a flight has more than the model; a list whose photos have other
    # names than those of the model leaves images of it without a position.
    listed_images = {known.find(position.photo) for position in listed.positions}
    complete = listed_images.issuperset(images)
    without_photo = POSITIONS_WITHOUT_PHOTO if complete else LOST_POSITIONS
    for position in listed.positions:
        image, where = known.find(position.photo), position.where
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
            what = "has no accuracy; valid: sigma_positions=(horizontal, vertical), metres"
            problems.wrong(what, where)
        else:
            with problems.collect(where):
                x, y, z = listed.system.place(frame, position.xyz).tolist()
                out[image] = PositionPrior(image, (x, y, z), found, (0.0, 0.0, 0.0), where)
    return list(out.values())
