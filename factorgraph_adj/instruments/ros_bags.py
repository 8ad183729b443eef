"""Bags of ROS 2 and ROS 1: messages of robots and trackers become readings.

``source = "rosbag:PATH[?topics=/a,/b]"`` reads a bag from its beginning to its end: a folder of
ROS 2 (sqlite3 or MCAP, also compressed by zstd), an ``.mcap`` file or a ``.bag`` of ROS 1, with the
definitions of messages that the bag holds, or those of ROS 2 Jazzy. ``grammar = "ros"`` reads:

===================================  ==========================================================
message                              reading
===================================  ==========================================================
sensor_msgs/NavSatFix                position of an antenna, see `gnss_positions`; mark: the topic
geometry_msgs/PointStamped           coordinates of the point named by the topic
geometry_msgs/PoseStamped,           the position in the pose, as a point named by the topic
PoseWithCovarianceStamped
nav_msgs/Odometry                    the position in the pose, as the point ``child_frame_id``
tf2_msgs/TFMessage                   the translation of each child frame that ``children`` names,
                                     as a point
sensor_msgs/Temperature,             ``temperature``, ``pressure``, ``humidity`` of a sensor
FluidPressure, RelativeHumidity
===================================  ==========================================================

Points and marks are renamed by [instrument.rename]. Coordinates are a ``frame_coordinate`` in the
frame ``header.frame_id``, which the network has as a frame, such as that of a tracker; with
``coordinates = "network"`` they are a ``control`` point in the axes of the network. They are those
of a point that stands still, as each point of an epoch has one place. σ is the covariance of the
message, if it has one, or ``sigma_point_mm``. The quality of NavSatFix cannot tell fixed
ambiguities from float ones: status 2 (ground-based augmentation), which drivers write for both,
counts as ``float``, 1 as ``differential``, 0 as ``single``; state ``least_quality`` accordingly.
Its coordinates are WGS 84, its altitude is above the ellipsoid.

Times are those of headers, and the time of the record where a header has none. They are UTC
whatever the rules for clocks are, since a bag is read later.

Not read, and counted as lines without a reading: attitudes and velocities, sensor_msgs/Imu, images,
point clouds, laser scans, and every other message. Whole trajectories as poses of photos: write
them as TUM and read that file.

Sources: definitions of common_interfaces, github.com/ros2/common_interfaces (Apache-2.0);
REP 103 and 105 for units and frames. Tested on bags of rosbags' own writer (sqlite3, MCAP, ROS 1).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Any, ClassVar, Literal, get_args
from urllib.parse import parse_qsl

import numpy as np

from ..atmosphere import ZERO_CELSIUS
from ..errors import InputError, known
from ..observations import ControlPoint, FrameCoordinate, Observation
from ..types import Array
from .gnss_fixes import GnssFix, Quality
from .gnss_positions import USUAL_POSITIONS, PositionOptions, PositionSeries
from .grammars import GrammarRecord
from .health import Health
from .readings import Observed, Reading, ReceivedLine, SensorValues

NAV_SAT_QUALITY: dict[int, Quality] = {-1: "none", 0: "single", 1: "differential", 2: "float"}
"""Quality by the status of NavSatFix."""
CoordinatesChoice = Literal["frame", "network"]


@dataclass(frozen=True)
class RosMessage:
    """A message of a bag."""

    type: str
    """Its type without ``/msg``: ``sensor_msgs/NavSatFix``."""
    message: Any
    """Its fields as attributes."""
    recorded: float
    """Time of the record, seconds since 1970 UTC."""


@dataclass
class RosbagSource:
    """A bag, read once."""

    keeps_lines: ClassVar[bool] = True
    path: Path
    topics: tuple[str, ...] = ()
    """Topics that are read; none: all."""

    def lines(self, stop: Event, health: Health) -> Iterator[ReceivedLine | None]:
        """Yield the messages in the order of their records; what is no bag is told.

        Raises:
            InputError: the extra is not installed.
        """
        try:
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore
        except ImportError:
            raise InputError(
                'ROS bags need rosbags: pip install "factorgraph_adj[instruments]"'
            ) from None
        usual = get_typestore(Stores.ROS2_JAZZY)
        try:
            reader = AnyReader([self.path], default_typestore=usual)
            reader.open()
        except Exception as error:  # readers of bags raise whatever their storage does
            health.tell("refused", f"{self.path.name} is no bag: {error}", time.time())
            return
        health.count("connections")
        health.set_state("receiving")
        try:
            chosen = [c for c in reader.connections if not self.topics or c.topic in self.topics]
            there = {c.topic for c in reader.connections}
            for topic in self.topics:
                if topic not in there:
                    what = f"{self.path.name} has no topic {topic!r}; known: {known(there)}"
                    health.tell("refused", what, time.time())
            if chosen:
                yield from self._messages(reader, chosen, stop, health)
        except Exception as error:  # a damaged bag
            health.tell("refused", f"{self.path.name} ends early: {error}", time.time())
        finally:
            reader.close()

    def _messages(
        self, reader: Any, connections: list[Any], stop: Event, health: Health
    ) -> Iterator[ReceivedLine]:
        found = reader.messages(connections=connections)
        for number, (connection, stamp, raw) in enumerate(found, 1):
            if stop.is_set():
                return
            of, content = connection.msgtype.replace("/msg/", "/"), None
            if of in READERS:
                try:
                    message = reader.deserialize(raw, connection.msgtype)
                except Exception as error:  # so do decoders
                    what = f"message {number} of {connection.topic}: {of}: {error}"
                    health.tell("refused", what, time.time())
                    continue
                content = RosMessage(of, message, 1e-9 * stamp)
            yield ReceivedLine(
                f"{connection.topic} {of} {stamp} ".encode() + bytes(raw),
                time.time(),
                number,
                place=f"message {number}",
                channel=connection.topic,
                content=content,
            )


def rosbag_source(rest: str, folder: Path = Path()) -> RosbagSource:
    """Return the source of ``source = "rosbag:…"`` by what stands after the colon.

    Raises:
        InputError: the path is missing, or a setting is unknown.
    """
    path, _, query = rest.partition("?")
    given = dict(parse_qsl(query))
    topics = given.pop("topics", "")
    if given:
        key = next(iter(given))
        raise InputError(f"unknown setting {key!r}; valid: {known(['topics'], meant=key)}")
    if not path:
        raise InputError("the path of the bag is missing: rosbag:PATH")
    return RosbagSource(folder / path, tuple(t for t in topics.split(",") if t))


class Ros:
    """Grammar of messages of ROS."""

    def __init__(
        self,
        *,
        coordinates: CoordinatesChoice = "frame",
        sigma_point_mm: float | list[float] | None = None,
        children: list[str] | None = None,
        positions: PositionOptions = USUAL_POSITIONS,
    ) -> None:
        """Take the options of [[instrument]].

        Args:
            coordinates: ``frame``: coordinates are in the frame of the header; ``network``: in the
                axes of the network.
            sigma_point_mm: σ of x, y, z of coordinates that state none: one number or three.
            children: child frames of TF that are points.
            positions: of NavSatFix, see `gnss_positions`.

        Raises:
            InputError: an option is wrong.
        """
        if coordinates not in get_args(CoordinatesChoice):
            valid = known(get_args(CoordinatesChoice))
            raise InputError(f"coordinates must be one of {valid}, not {coordinates!r}")
        try:
            sigma = None if sigma_point_mm is None else np.broadcast_to(sigma_point_mm, (3,))
            self.sigma = None if sigma is None else 1e-3 * np.asarray(sigma, dtype=float)
        except (TypeError, ValueError):
            self.sigma = np.zeros(3)
        if self.sigma is not None and not (self.sigma > 0.0).all():
            raise InputError("sigma_point_mm must be one number above zero, or three: x, y, z")
        self.coordinates = coordinates
        self.children = frozenset(children or ())
        self.positions = positions
        self._series: dict[str, PositionSeries] = {}

    def read(self, line: ReceivedLine) -> Sequence[Reading]:
        """Return the readings of a message.

        Raises:
            InputError: the line is no message of ROS, or its values are no readings.
        """
        if line.content is None and line.channel and line.place:
            return []  # a type that is not read
        if not isinstance(line.content, RosMessage):
            raise InputError("no message of ROS: this grammar needs source = 'rosbag:…'")
        return READERS[line.content.type](self, line.channel, line.content)

    # -- messages -------------------------------------------------------------------------------

    def _nav_sat(self, topic: str, content: RosMessage) -> list[Reading]:
        m, at = content.message, _time(content)
        status = int(m.status.status)
        if status not in NAV_SAT_QUALITY:
            raise InputError(f"status {status} of NavSatFix; valid: {known(NAV_SAT_QUALITY)}")
        name = self.positions.point or topic
        series = self._series.setdefault(topic, PositionSeries(self.positions, name))
        if NAV_SAT_QUALITY[status] == "none":
            return series.readings([GnssFix(at, None)])
        latitude, longitude, height = _numbers(m.latitude, m.longitude, m.altitude)
        if abs(latitude) > 90.0 or abs(longitude) > 180.0:
            raise InputError(f"latitude {latitude:g}, longitude {longitude:g} are no place")
        covariance = None
        if int(m.position_covariance_type) != 0:
            covariance = _covariance(np.reshape(m.position_covariance, (3, 3)))
        place = (math.radians(latitude), math.radians(longitude), height)
        fix = GnssFix(at, place, quality=NAV_SAT_QUALITY[status], covariance=covariance)
        return series.readings([fix])

    def _point(self, topic: str, content: RosMessage) -> list[Reading]:
        m = content.message
        return [self._coordinates(m.header.frame_id, topic, m.point, None, _time(content))]

    def _pose(self, topic: str, content: RosMessage) -> list[Reading]:
        m = content.message
        return [self._coordinates(m.header.frame_id, topic, m.pose.position, None, _time(content))]

    def _pose_with_covariance(self, topic: str, content: RosMessage) -> list[Reading]:
        m = content.message
        at, place, covariance = _time(content), m.pose.pose.position, m.pose.covariance
        return [self._coordinates(m.header.frame_id, topic, place, covariance, at)]

    def _odometry(self, topic: str, content: RosMessage) -> list[Reading]:
        m = content.message
        if not m.child_frame_id:
            raise InputError("child_frame_id of Odometry is empty: the point has no name")
        at, place, covariance = _time(content), m.pose.pose.position, m.pose.covariance
        return [self._coordinates(m.header.frame_id, m.child_frame_id, place, covariance, at)]

    def _transforms(self, topic: str, content: RosMessage) -> list[Reading]:
        out: list[Reading] = []
        for t in content.message.transforms:
            if t.child_frame_id in self.children:
                at, place = _stamp(t.header) or content.recorded, t.transform.translation
                out.append(self._coordinates(t.header.frame_id, t.child_frame_id, place, None, at))
        return out

    def _air(self, name: str, value: float, content: RosMessage) -> list[Reading]:
        (found,) = _numbers(value)
        at = _time(content)
        values = {name: found}
        return [SensorValues(values=values, stamped=at, in_utc=True, identity=f"{at:.6f}")]

    def _coordinates(
        self, frame: str, point: str, place: Any, covariance: Any, at: float
    ) -> Observed:
        """Return the coordinates of a point."""
        xyz = _numbers(place.x, place.y, place.z)
        found = None
        if covariance is not None and np.any(covariance):
            found = _covariance(np.reshape(covariance, (6, 6))[:3, :3])
        if found is None and self.sigma is not None:
            found = np.diag(np.square(self.sigma))
        if found is None:
            raise InputError("the message has no standard deviation: state sigma_point_mm")
        o: Observation
        if self.coordinates == "network":
            o = ControlPoint(point, xyz, covariance=found)
        else:
            if not frame:
                raise InputError("header.frame_id is empty: the coordinates have no frame")
            o = FrameCoordinate(frame, point, xyz, covariance=found)
        return Observed(observations=(o,), stamped=at, in_utc=True, identity=f"{at:.6f}")


READERS: Mapping[str, Callable[[Ros, str, RosMessage], list[Reading]]] = {
    "sensor_msgs/NavSatFix": Ros._nav_sat,
    "geometry_msgs/PointStamped": Ros._point,
    "geometry_msgs/PoseStamped": Ros._pose,
    "geometry_msgs/PoseWithCovarianceStamped": Ros._pose_with_covariance,
    "nav_msgs/Odometry": Ros._odometry,
    "tf2_msgs/TFMessage": Ros._transforms,
    "sensor_msgs/Temperature": lambda g, _, c: g._air(
        "temperature", c.message.temperature + ZERO_CELSIUS, c
    ),
    "sensor_msgs/FluidPressure": lambda g, _, c: g._air("pressure", c.message.fluid_pressure, c),
    "sensor_msgs/RelativeHumidity": lambda g, _, c: g._air(
        "humidity", c.message.relative_humidity, c
    ),
}
"""What reads a type of messages."""


def _stamp(header: Any) -> float:
    """Return the time of a header, seconds since 1970; 0: it has none."""
    return float(header.stamp.sec) + 1e-9 * float(header.stamp.nanosec)


def _time(content: RosMessage) -> float:
    """Return the time of a message: that of its header, or of its record."""
    return _stamp(content.message.header) or content.recorded


def _numbers(*values: float) -> tuple[float, ...]:
    """Return numbers that are finite.

    Raises:
        InputError: one is not.
    """
    out = tuple(float(v) for v in values)
    if not all(map(math.isfinite, out)):
        raise InputError(f"values must be finite, not {', '.join(f'{v:g}' for v in out)}")
    return out


def _covariance(matrix: Array) -> Array:
    """Return a covariance, m².

    Raises:
        InputError: it is not positive definite.
    """
    found = np.asarray(matrix, dtype=float)
    if not np.isfinite(found).all() or not np.allclose(found, found.T):
        raise InputError("the covariance is not symmetric, or not finite")
    if np.linalg.eigvalsh(found)[0] <= 0.0:
        raise InputError("the covariance is not positive definite")
    return np.asarray(0.5 * (found + found.T))


GRAMMAR = GrammarRecord(
    "ros", "messages of ROS bags: NavSatFix, points, poses, odometry, TF, values of the air", Ros
)
