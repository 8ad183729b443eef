"""ROS bags: messages become positions, coordinates in frames, and values of the air."""

import math
import time
from threading import Event

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.frames import GeocentricFrame
from factorgraph_adj.instruments import Instrument, read_instruments
from factorgraph_adj.instruments.gnss_positions import AntennaPosition
from factorgraph_adj.instruments.health import Health
from factorgraph_adj.instruments.readings import ReceivedLine, SensorValues
from factorgraph_adj.instruments.ros_bags import Ros, RosbagSource, rosbag_source

rosbag2 = pytest.importorskip("rosbags.rosbag2")
rosbag1 = pytest.importorskip("rosbags.rosbag1")
from rosbags.typesys import Stores, get_typestore  # noqa: E402

STORE = get_typestore(Stores.ROS2_JAZZY)
BEGIN = 1_780_308_000


def of(name, *values, store=STORE):
    return store.types[name.replace("/", "/msg/")](*values)


def header(seconds=0.0, frame="map", *, store=STORE):
    nanoseconds = round(1e9 * (BEGIN + seconds)) if seconds is not None else 0
    at = of("builtin_interfaces/Time", *divmod(nanoseconds, 10**9), store=store)
    names = (frame,) if store is STORE else (0, at, frame)
    return of("std_msgs/Header", *((at, *names) if store is STORE else names), store=store)


def nav_sat(seconds, status=2, kind=2, height=560.0, latitude=47.4):
    covariance = np.diag([1e-4, 2e-4, 4e-4]).ravel()
    fix = of("sensor_msgs/NavSatStatus", status, 1)
    return of(
        "sensor_msgs/NavSatFix", header(seconds), fix, latitude, 12.0, height, covariance, kind
    )


def vector(x, y, z, kind="Point"):
    return of(f"geometry_msgs/{kind}", x, y, z)


def pose(x, y, z):
    return of("geometry_msgs/Pose", vector(x, y, z), of("geometry_msgs/Quaternion", 0, 0, 0, 1))


def pose_with_covariance(x, y, z, sigma=0.002):
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = sigma**2 * np.eye(3)
    return of("geometry_msgs/PoseWithCovariance", pose(x, y, z), covariance.ravel())


def odometry(child="prism"):
    twist = of(
        "geometry_msgs/TwistWithCovariance",
        of("geometry_msgs/Twist", vector(0, 0, 0, "Vector3"), vector(0, 0, 0, "Vector3")),
        np.zeros(36),
    )
    return of("nav_msgs/Odometry", header(3), child, pose_with_covariance(4, 5, 6), twist)


def transforms(*children):
    rotation = of("geometry_msgs/Quaternion", 0, 0, 0, 1)
    found = [
        of(
            "geometry_msgs/TransformStamped",
            header(4),
            child,
            of("geometry_msgs/Transform", vector(7, 8, 9, "Vector3"), rotation),
        )
        for child in children
    ]
    return of("tf2_msgs/TFMessage", found)


MESSAGES = [
    ("/tracker/A", of("geometry_msgs/PointStamped", header(1, "tracker"), vector(1, 2, 3))),
    ("/robot", of("geometry_msgs/PoseStamped", header(2), pose(3, 2, 1))),
    ("/odom", odometry()),
    ("/tf", transforms("prism", "wheel")),
    ("/t", of("sensor_msgs/Temperature", header(5), 20.0, 0.0)),
    ("/p", of("sensor_msgs/FluidPressure", header(5), 95000.0, 0.0)),
    ("/h", of("sensor_msgs/RelativeHumidity", header(5), 0.5, 0.0)),
    ("/text", of("std_msgs/String", "hello")),
]


def write(path, messages, *, plugin="SQLITE3", compression=None):
    writer = rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin[plugin])
    if compression:
        writer.set_compression(rosbag2.CompressionMode[compression], rosbag2.CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for i, (topic, message) in enumerate(messages):
            if topic not in connections:
                connections[topic] = writer.add_connection(
                    topic, message.__msgtype__, typestore=STORE
                )
            data = STORE.serialize_cdr(message, message.__msgtype__)
            writer.write(connections[topic], (BEGIN + 100 + i) * 10**9, data)
    return path


def lines(path, topics=()):
    health = Health("bag")
    found = list(RosbagSource(path, topics).lines(Event(), health))
    return found, health


def readings(found, **options):
    grammar = Ros(**{"sigma_point_mm": 1.0, "children": ["prism"], **options})
    return [r for line in found for r in grammar.read(line)]


@pytest.mark.parametrize(
    ("plugin", "compression"),
    [("SQLITE3", None), ("MCAP", None), ("SQLITE3", "MESSAGE"), ("SQLITE3", "FILE")],
)
def test_messages_of_bags_become_readings(tmp_path, plugin, compression):
    path = write(tmp_path / "bag", MESSAGES, plugin=plugin, compression=compression)
    found, health = lines(path)
    assert health.counts["refused"] == 0
    assert [line.channel for line in found] == [topic for topic, _ in MESSAGES]
    *points, temperature, pressure, humidity = readings(found)
    coordinates = [(o.kind, o.frame, o.point, o.value) for r in points for o in r.observations]
    assert coordinates == [
        ("frame_coordinate", "tracker", "/tracker/A", (1.0, 2.0, 3.0)),
        ("frame_coordinate", "map", "/robot", (3.0, 2.0, 1.0)),
        ("frame_coordinate", "map", "prism", (4.0, 5.0, 6.0)),
        ("frame_coordinate", "map", "prism", (7.0, 8.0, 9.0)),
    ]
    sigma = [math.sqrt(o.covariance[0, 0]) for r in points for o in r.observations]
    assert sigma == pytest.approx([1e-3, 1e-3, 2e-3, 1e-3])  # odometry states its own
    assert [r.stamped - BEGIN for r in points] == pytest.approx([1, 2, 3, 4], abs=1e-6)
    values = {}
    for r in (temperature, pressure, humidity):
        assert isinstance(r, SensorValues)
        values |= r.values
    expected = {"temperature": 293.15, "pressure": 95000.0, "humidity": 0.5}
    assert values == pytest.approx(expected)


def test_coordinates_may_be_those_of_the_network(tmp_path):
    found, _ = lines(write(tmp_path / "bag", MESSAGES[:1]))
    (reading,) = readings(found, coordinates="network", sigma_point_mm=[1, 2, 3])
    (o,) = reading.observations
    assert (o.kind, o.point, o.axes) == ("control", "/tracker/A", "xyz")
    np.testing.assert_allclose(o.covariance, np.diag([1e-6, 4e-6, 9e-6]))


def test_positions_are_averaged(tmp_path):
    messages = [("/gnss/fix", nav_sat(float(i))) for i in range(61)]
    messages += [("/gnss/fix", nav_sat(61.0, status=-1, latitude=math.nan))]
    found, _ = lines(write(tmp_path / "bag", messages))
    grammar = Ros(positions=read_positions(least_quality="float", correlation_time=0.0))
    (reading,) = [r for line in found for r in grammar.read(line)]
    assert isinstance(reading, AntennaPosition)
    assert (reading.point, reading.stamped - BEGIN) == ("/gnss/fix", 29.5)
    np.testing.assert_allclose(reading.fix.covariance, np.diag([1e-4, 2e-4, 4e-4]) / 60, rtol=1e-9)
    assert np.degrees(reading.fix.position[:2]) == pytest.approx([47.4, 12.0])


def read_positions(**options):
    from factorgraph_adj.instruments.gnss_positions import PositionOptions

    return PositionOptions(**options)


def test_a_bag_of_ros_1_is_read(tmp_path):
    store = get_typestore(Stores.ROS1_NOETIC)
    name = "geometry_msgs/msg/PointStamped"
    head = store.types["std_msgs/msg/Header"](
        seq=1,
        stamp=store.types["builtin_interfaces/msg/Time"](BEGIN, 0),
        frame_id="tracker",
    )
    message = store.types[name](head, store.types["geometry_msgs/msg/Point"](1.0, 2.0, 3.0))
    path = tmp_path / "one.bag"
    with rosbag1.Writer(path) as writer:
        connection = writer.add_connection("/A", name, typestore=store)
        writer.write(connection, BEGIN * 10**9, store.serialize_ros1(message, name))
    found, _ = lines(path)
    (reading,) = readings(found)
    assert reading.observations[0].value == (1.0, 2.0, 3.0)
    assert reading.stamped == BEGIN


def test_a_header_without_a_time_has_that_of_the_record(tmp_path):
    message = of("geometry_msgs/PointStamped", header(None), vector(1, 2, 3))
    found, _ = lines(write(tmp_path / "bag", [("/A", message)]))
    (reading,) = readings(found)
    assert reading.stamped == BEGIN + 100


def test_a_file_of_mcap_is_a_bag(tmp_path):
    path = write(tmp_path / "bag", MESSAGES, plugin="MCAP")
    (file,) = path.glob("*.mcap")
    assert len(readings(lines(file)[0])) == len(readings(lines(path)[0])) == 7


def test_topics_may_be_chosen(tmp_path):
    path = write(tmp_path / "bag", MESSAGES)
    found, health = lines(path, ("/t", "/none"))
    assert [line.channel for line in found] == ["/t"]
    assert "has no topic '/none'" in health.problem


@pytest.mark.parametrize(
    ("message", "options", "what"),
    [
        (nav_sat(0.0, height=math.nan), {}, "finite"),
        (nav_sat(0.0, latitude=91.0), {}, "no place"),
        (nav_sat(0.0, status=7), {}, "status 7"),
        (nav_sat(0.0, kind=0), {"positions": read_positions(least_quality="float")}, "sigma_mm"),
        (MESSAGES[0][1], {"sigma_point_mm": None}, "sigma_point_mm"),
        (of("geometry_msgs/PointStamped", header(1, ""), vector(1, 2, 3)), {}, "frame_id is empty"),
        (of("geometry_msgs/PointStamped", header(1), vector(1, math.inf, 3)), {}, "finite"),
        (odometry(child=""), {}, "child_frame_id"),
        (
            of(
                "geometry_msgs/PoseWithCovarianceStamped",
                header(1),
                of("geometry_msgs/PoseWithCovariance", pose(1, 2, 3), -np.eye(6).ravel()),
            ),
            {},
            "positive definite",
        ),
    ],
)
def test_messages_that_are_no_readings_are_refused(tmp_path, message, options, what):
    found, _ = lines(write(tmp_path / "bag", [("/A", message)]))
    with pytest.raises(InputError, match=what):
        readings(found, **options)


def test_what_is_no_bag_is_told(tmp_path):
    (tmp_path / "x").mkdir()
    for path in (tmp_path / "x", tmp_path / "missing", tmp_path / "y.bag"):
        (tmp_path / "y.bag").write_bytes(b"no bag")
        found, health = lines(path)
        assert found == [] and "is no bag" in health.problem


def test_a_damaged_bag_is_told(tmp_path):
    path = write(tmp_path / "bag", MESSAGES * 50, plugin="MCAP")
    (file,) = path.glob("*.mcap")
    whole = file.read_bytes()
    for cut in (len(whole) // 2, len(whole) - 20):
        file.write_bytes(whole[:cut])
        _, health = lines(path)
        assert health.counts["refused"] >= 1


def test_options_and_addresses_are_checked(tmp_path):
    assert rosbag_source("bag?topics=/a,/b", tmp_path).topics == ("/a", "/b")
    for rest, what in (("", "path"), ("bag?topic=/a", "did you mean 'topics'")):
        with pytest.raises(InputError, match=what):
            rosbag_source(rest)
    for options, what in (
        ({"coordinates": "map"}, "coordinates must be"),
        ({"sigma_point_mm": [1, 2]}, "or three"),
        ({"sigma_point_mm": 0}, "above zero"),
    ):
        with pytest.raises(InputError, match=what):
            Ros(**options)
    with pytest.raises(InputError, match="rosbag:"):
        Ros().read(ReceivedLine(b"x", time.time(), 1))


def test_a_bag_is_an_instrument_of_a_site(tmp_path):
    write(tmp_path / "bag", [("/A", nav_sat(float(i))) for i in range(4)])
    table = {
        "name": "robot",
        "network": "dam",
        "source": "rosbag:bag",
        "grammar": "ros",
        "average": 0,
        "least_quality": "float",
        "rename": {"/A": "G1"},
    }
    (settings,) = read_instruments([table], where="site.toml", folder=tmp_path)
    network = fga.Network("dam", frame=GeocentricFrame())
    instrument = Instrument(settings, network=network)
    posted = []
    instrument.run(posted.append, Event())
    assert [p.time - BEGIN for p in posted] == [0.0, 1.0, 2.0, 3.0]
    assert {p.record["observations"][0]["point"] for p in posted} == {"G1"}
    assert len({p.request for p in posted}) == 4
