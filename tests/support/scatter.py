"""Does the covariance say how estimates scatter? Seeded repetitions of every kind.

Of each network the errors e = x̂ − x of all unknowns are whitened with the covariance of the plan,
z = L⁻¹e, Q = LLᵀ: if it is right, Σzzᵀ is that of unit normal vectors in every element, and vᵀPv
follows χ²_r. Every bound is two-sided at `CONFIDENCE` for the family of figures that a test looks
at (Bonferroni); the seeds are fixed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import count

import numpy as np
from scipy import stats

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.models.film_lens import TRANSFORMATIONS, FilmLens
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.models.rpc_lens import BIAS
from factorgraph_adj.models.shapes import SHAPES
from factorgraph_adj.models.unknown_registry import VariableKind
from factorgraph_adj.rotation import TURN_ABOUT_X, exp_rotation
from factorgraph_adj.simulation.measurement import look_at, measure
from factorgraph_adj.types import Array, Mask
from tests.networks import alignment, on_shapes
from tests.networks.bent_strips import bent_strips
from tests.networks.deformed_models import deformed_block
from tests.networks.instruments import room_of
from tests.networks.microscope import microscope
from tests.networks.moving_targets import missile, radar
from tests.networks.odometry import odometry
from tests.networks.random_more import MARKS
from tests.networks.rigs import rig
from tests.networks.rolling_drone import INTERVAL, flown
from tests.networks.satellites import satellites
from tests.networks.small_block import CENTRES, FOCAL, SIGMA_MM, box
from tests.networks.small_block import plan as mixed
from tests.networks.small_flight import EVERY, OFFSETS, TILTED, TURNS, Plan, plan_of
from tests.networks.three_frames import three_frames
from tests.support.arrivals import between
from tests.support.joint_images import jointly_measured

FEW = 30
"""Repetitions of the short tests."""
WRONG = 1 / 3
"""Relative error of a variance that many repetitions must show: it follows how many they are."""
CONFIDENCE = 0.999
ARCSEC = np.pi / 180 / 3600
MM = 1e-3
CONTROL = {"A": (0.0, 0.0, 10.0), "B": (90.0, 5.0, 22.0), "C": (80.0, 95.0, 15.0)}
CONTROL["D"] = (-10.0, 85.0, 28.0)
NEW = {"P": (40.0, 35.0, 19.0), "Q": (55.0, 60.0, 12.0), "R": (20.0, 62.0, 16.0)}
SIGHT = {"instrument_height": 1.5, "target_height": 1.3}


def field(held: str = "") -> fga.Network:
    """Return four control points and three new ones, some of whose coordinates are held."""
    network = fga.Network("field")
    for name, at in CONTROL.items():
        network.add_point(name, at, fixed="xyz")
    for name, at in NEW.items():
        network.add_point(name, at, fixed=held)
    return network


def pairs() -> list[tuple[str, str]]:
    """Return all lines with a new point at one end or both."""
    return [(a, b) for a in (*CONTROL, *NEW) for b in NEW if a != b]


def slope_distances() -> fga.Network:
    network = field()
    network.set_distance_meter("tape", free=("scale", "zero"))
    sigma = fga.StandardDeviation(2 * MM, ppm=20.0, centring_target=MM)
    for a, b in pairs():
        network.add(o.SlopeDistance(a, b, 1.0, sigma=sigma, instrument="tape", **SIGHT))
    return network


def horizontal_distances() -> fga.Network:
    network = field("z")
    for a, b in pairs():
        network.add(o.HorizontalDistance(a, b, 1.0, sigma=3 * MM, **SIGHT))
    return network


def directions() -> fga.Network:
    network = field("z")
    for a in (*CONTROL, *NEW):
        network.set_orientation(a, value=1.0)
        for b in (*CONTROL, *NEW):
            if a != b:
                network.add(o.Direction(a, b, 0.0, sigma=10 * ARCSEC, **SIGHT))
    return network


def azimuths() -> fga.Network:
    network = field("z")
    for a, b in pairs():
        network.add(o.Azimuth(a, b, 0.0, sigma=10 * ARCSEC, **SIGHT))
    return network


def angles() -> fga.Network:
    network = field("z")
    for a, b in pairs():
        for c in CONTROL:
            if c not in (a, b):
                network.add(o.HorizontalAngle(a, b, c, 1.0, sigma=10 * ARCSEC))
    return network


def zenith_angles(kind: type[o.VerticalAngle]) -> Callable[[], fga.Network]:
    def make() -> fga.Network:
        network = field("xy")
        network.set_refraction(value=0.13)
        far = (2500.0, 1800.0, 140.0)
        network.add_point("far", far, fixed="xyz")
        for a, b in (*pairs(), ("far", "P"), ("A", "far"), ("B", "far"), ("R", "far")):
            network.add(kind(a, b, 1.5, sigma=2 * ARCSEC, **SIGHT))
        return network

    return make


def height_differences() -> fga.Network:
    network = field("xy")
    for a, b in pairs():
        network.add(o.HeightDifference(a, b, 0.0, sigma=MM))
    return network


def correlated(seed: int) -> Array:
    """Return a covariance (3, 3), some millimetres."""
    root = np.random.default_rng(seed).normal(size=(3, 3))
    return (3 * MM) ** 2 * (root @ root.T + np.eye(3))


def gnss_vectors() -> fga.Network:
    network = field()
    for i, (a, b) in enumerate(pairs()):
        network.add(o.GnssVector(a, b, (0.0, 0.0, 0.0), covariance=correlated(i), **SIGHT))
    return network


def vectors_of_another_datum() -> fga.Network:
    """GNSS vectors in a frame with free turns and scale."""
    network = field()
    turned = ("rx", "ry", "rz", "ln_scale")
    network.add_frame("GNSS", free=turned, values=dict.fromkeys(turned, 0.0))
    for i, (a, b) in enumerate(pairs()):
        network.add(o.FrameVector("GNSS", a, b, (0.0, 0.0, 0.0), covariance=correlated(i)))
    return network


def positions(kind: type[o.ControlPoint]) -> Callable[[], fga.Network]:
    def make() -> fga.Network:
        network = field()
        for i in range(3):
            for name in NEW:
                network.add(kind(name, (0.0, 0.0, 0.0), covariance=correlated(i)))
        return network

    return make


def astronomy(kind: type[o.AstronomicLatitude]) -> Callable[[], fga.Network]:
    """Deflections of the vertical from latitudes or longitudes, and from what theodolites read."""

    def make() -> fga.Network:
        network = fga.Network("vertical", frame=fga.TopocentricFrame(0.8, 0.2, 300.0))
        for name, at in CONTROL.items():
            network.add_point(name, at, fixed="xyz")
            network.set_vertical(name, xi=5 * ARCSEC, eta=-3 * ARCSEC)
            network.set_orientation(name, value=0.4)
        for a in CONTROL:
            network.add(*(kind(a, 0.0, sigma=2 * ARCSEC) for _ in range(2)))
            for b in CONTROL:
                if a != b:
                    network.add(o.ZenithAngle(a, b, 1.5, sigma=3 * ARCSEC))
                    network.add(o.Direction(a, b, 0.0, sigma=3 * ARCSEC))
        return network

    return make


def correlated_directions() -> fga.Network:
    """Angles of sets reduced to their first direction: correlated groups."""
    network = field("z")
    rng = np.random.default_rng(4)
    for a in (*CONTROL, *NEW):
        others = [b for b in (*CONTROL, *NEW) if b != a]
        members = tuple(
            o.HorizontalAngle(a, others[0], b, 1.0, sigma=1.0, id=f"{a}/{b}") for b in others[1:]
        )
        root = rng.normal(size=(len(members), len(members)))
        covariance = (8 * ARCSEC) ** 2 * (np.eye(len(members)) + 0.5 * root @ root.T)
        network.add(o.Correlated(members, covariance))
    return network


def photos(*, positions: bool = False) -> Callable[[], fga.Network]:
    """Four convergent photos with self-calibration, control in corners or by antennas."""

    def make() -> fga.Network:
        network = fga.Network("photos")
        for i, (name, at) in enumerate(box().items()):
            held = not positions and i in (0, 4, 7, 11)
            network.add_point(name, at, fixed="xyz" if held else "")
        values = {"c": FOCAL, "k1": 1e-4}
        network.add_camera("D3", BrownLens(), values, free=("c", "x0", "y0", "k1"))
        for i, centre in enumerate(CENTRES):
            rotation = look_at(np.array(centre), np.array([0.0, 0.0, 1.0]))
            turned = rotation @ exp_rotation(np.array([0.0, 0.0, 1.5 * i]))
            network.add_photo(f"F{i}", "D3", position=centre, rotation=turned)
            if positions:
                arm = (0.1, -0.2, 0.05)
                at = (0.0, 0.0, 0.0)
                network.add(o.PhotoPosition(f"F{i}", at, covariance=correlated(i), lever_arm=arm))
            for point in network.points:
                network.add(o.ImagePoint(f"F{i}", point, 0.0, 0.0, sigma=SIGMA_MM))
        return network

    return make


def water_tank() -> fga.Network:
    """A box half under water, of unknown index and level, whose surface and wall photos see.

    The level is tied to marks on the shore. The surface is the level for two photos, and for the
    others a plane with the marks on it.
    """
    network = photos()()
    under = [p.name for p in network.points.values() if p.coordinates[2] < WATER]
    network.set_refractive_index("water", 1.34)
    network.set_level("water", WATER)
    network.add_shape("surface", "plane", values={"z": WATER}, origin=(0.0, 0.0, 0.0))
    for i, (x, y) in enumerate(((-4.0, -3.0), (4.0, -3.0), (0.0, 4.0), (3.0, 3.5))):
        network.add_point(f"shore {i}", (x, y, WATER))
        network.add(o.LevelHeight(f"shore {i}", "water", sigma=1 * MM))
        network.add(o.OnPlane("surface", f"shore {i}", sigma=1 * MM))
        for photo in network.photos:
            network.add(o.ImagePoint(photo, f"shore {i}", 0.0, 0.0, sigma=SIGMA_MM))
    first, second, *others = network.photos
    network.refract_images(medium="water", level="water", points=under, photos=(first, second))
    network.refract_images(medium="water", plane="surface", points=under, photos=others)
    return network


def diving_camera() -> fga.Network:
    """A camera with a flat port of unknown place under water, calibrated in air."""
    network = photos()()
    network.cameras["D3"] = replace(network.cameras["D3"], fixed=(True,) * 10)
    # Without its weight a few networks of a hundred would take the window to the projection centre.
    free, sigma = ("slope_x", "slope_y", "distance"), {"thickness": 0.1 * MM, "distance": 0.02}
    network.set_port("dome", distance=0.12, thickness=0.02, free=free, sigma=sigma)
    network.set_refractive_index("sea", 1.34, sigma=1e-3)
    network.refract_images(medium="sea", port="dome")
    return network


WATER = 1.2
"""Height of the water surface, metres."""


def frames() -> fga.Network:
    """Three frames of a room, with a scale, levelled, and with its origin at a point."""
    return fga.adjust(three_frames()).as_network()


def edges() -> fga.Network:
    """Edges of a building in three photos, without a point."""
    return fga.adjust(on_shapes.edges()).as_network()


RELATIONS = (
    "equal_distance",
    "equal_height_difference",
    "right_angle",
    "point_direction",
    "coordinate_difference",
    "parallel_axes",
    "axis_angle",
    "plane_distance",
)


def rigs() -> fga.Network:
    """A rig of three cameras with free mounts, not quite rigid."""
    return rig(4, members=("left", "right"), held_points=32, play=(2e-4, 1e-3))


def profile_heights() -> fga.Network:
    """A statoscope on four photos, and a barometer whose scale is unknown at points."""
    network = photos()()
    network.set_profile("statoscope", free=("height", "height_t"))
    network.set_profile("barometer", sigma={"scale": 0.01})
    network.set_mount("arm", sigma={"z": 5 * MM})
    for i, photo in enumerate(network.photos):
        more = {
            "profile": "statoscope",
            "time": i - 1.5,
            "lever_arm": (0.1, 0.2, 0.3),
            "mount": "arm",
        }
        network.add(o.ProfileHeight(None, 0.0, photo=photo, sigma=5 * MM, **more))
    for point in network.points:
        network.add(o.ProfileHeight(point, 0.0, profile="barometer", sigma=5 * MM))
    return network


def level_heights() -> fga.Network:
    """Levelled heights and two water surfaces, one of them with a gauge."""
    network = height_differences()
    network.set_level("lake", 15.0)
    network.set_level("river", 12.0, sigma=2 * MM)
    for i, point in enumerate((*CONTROL, *NEW)):
        network.add(o.LevelHeight(point, "lake", sigma=3 * MM))
        network.add(o.LevelHeight(point, "river", sigma=2 * MM, slope=1e-3, along=40.0 * i))
    return network


def tilts_and_sights(kind: type[fga.Observation]) -> Callable[[], fga.Network]:
    """Photos with an instrument on the camera, whose mount is found with them."""

    def make() -> fga.Network:
        network = photos()()
        network.set_mount("instrument", free=("rx", "ry", "rz"), values={"rx": 1.2, "rz": -0.3})
        body = (0.36, -0.48, 0.8)
        covariance = ARCSEC**2 * np.array([[400.0, 90.0], [90.0, 225.0]])
        for photo, f in network.photos.items():
            more = {"mount": "instrument", "covariance": covariance}
            network.add(o.PhotoTilt(photo, (0.0, 0.0), **more))
            # A direction that was read with some error, which is part of the simulated value.
            assert f.rotation is not None
            by_mount = exp_rotation(np.array([1.2, 0.0, -0.3])).T @ TURN_ABOUT_X
            seen = by_mount @ f.rotation.T @ body
            for at in (seen, (0.6, 0.8, 0.0)) if kind is o.PhotoSight else ():
                seen = tuple((np.array(at) / np.linalg.norm(at)).tolist())
                network.add(o.PhotoSight(photo, body, seen, **more))
        return network

    return make


def flight(plan: Plan) -> Callable[[], fga.Network]:
    """A photo flight of few photos, with true values."""

    def make() -> fga.Network:
        return plan_of(replace(plan, points=3, relief=60.0))

    return make


def gyro_azimuths() -> fga.Network:
    """Two gyrotheodolites, one of them tested before."""
    network = field("z")
    network.set_gyro("old", 0.4)
    network.set_gyro("new", 0.001, sigma=10 * ARCSEC)
    for i, (a, b) in enumerate(pairs()):
        gyro = "new" if i % 2 else "old"
        network.add(o.GyroAzimuth(a, b, 0.0, sigma=10 * ARCSEC, gyro=gyro, **SIGHT))
    return network


def instruments(*which: str, constants: bool = False) -> Callable[[], fga.Network]:
    """Instruments in a room, each in a frame of its own."""

    def make() -> fga.Network:
        return fga.adjust(room_of(3, which, points=6, held=4, constants=constants)).as_network()

    return make


def correlated_image_points() -> fga.Network:
    """Four photos whose image coordinates are correlated, in most points strongly."""
    network = photos()()
    network.images.rho = [np.linspace(-0.9, 0.95, network.n_image_points)]
    return network


def joint_image_points() -> fga.Network:
    """Four photos; the image points of three of them err together."""
    return jointly_measured(photos()(), ["F0", "F1", "F2"])


def on_the_ellipsoid() -> fga.Network:
    """Distances, azimuths and heights that refer to the ellipsoid or to a geoid, of one field."""
    network = fga.Network("ellipsoid", frame=fga.TopocentricFrame(0.8, 0.2, 300.0))
    for name, at in CONTROL.items():
        network.add_point(name, at, fixed="xyz")
    for name, at in NEW.items():
        network.add_point(name, at)
    network.set_distance_meter("tape", free=("scale", "zero"))
    geoid = {"station_surface": 48.1, "target_surface": 47.9}
    for a, b in pairs():
        more = {"sigma": 3 * MM, "instrument": "tape"}
        network.add(
            o.EllipsoidDistance(a, b, 1.0, **more, **geoid),
            o.EllipsoidDistance(a, b, 1.0, **more, line="chord"),
            o.MeanHeightDistance(a, b, 1.0, **more, **SIGHT),
            o.GeodeticAzimuth(a, b, 0.0, sigma=20 * ARCSEC, **SIGHT),
            o.EllipsoidHeightDifference(a, b, 0.0, sigma=2 * MM, **geoid, **SIGHT),
        )
    network.add(*(o.EllipsoidHeight(p, 0.0, sigma=4 * MM, surface=48.0) for p in NEW))
    return network


def vehicles() -> fga.Network:
    """A vehicle at every point: vectors in its axes, and its turns."""
    network = field("z")
    for i, a in enumerate((*CONTROL, *NEW)):
        network.set_unknown("heading", a, (0.7 * i,))
    covariance = correlated(5)[:2, :2]
    for a, b in pairs():
        network.add(
            o.PlanarVector(a, b, (0.0, 0.0), covariance=covariance),
            o.HeadingDifference(a, b, 0.0, sigma=20 * ARCSEC),
        )
    return network


def bodies() -> fga.Network:
    """Four photos whose bodies also carry a sensor that sees the points in their axes."""
    network = photos()()
    for i, photo in enumerate(network.photos):
        for point in network.points:
            network.add(o.BodyVector(photo, point, (0.0, 0.0, 0.0), covariance=correlated(i)))
    return network


def moving_photos() -> fga.Network:
    """A strip of a rolling shutter; the motion of the second photo is tied to its neighbours."""
    network = flown(3, 1, 60)
    tie = ("F1", "F0", "F2", (0.0, 0.0, 0.0))
    network.add(
        o.PhotoShift(*tie, sigma=(0.5, 0.5, 0.5), interval=2.0 * INTERVAL),
        o.PhotoTurn(*tie, sigma=(0.02, 0.02, 0.02), interval=2.0 * INTERVAL),
    )
    return network


def on_an_orbit() -> fga.Network:
    """Photos of an orbit about a small body, whose GM is unknown too."""
    network = photos()()
    times = {f: 8.0 * i for i, f in enumerate(network.photos)}
    orbit = {"x": 40.0, "y": 20.0, "z": 300.0, "x_t": 2.0, "y_t": -1.0, "z_t": 0.3, "x_tt": 0.01}
    network.add_arc("orbit", times, sigma=0.02, gm=2e3, spin=1e-3, power=2, values=orbit)
    network.set_unknown(
        "arc",
        "orbit",
        network.of_kind("arc")["orbit"].values,
        fixed=("gm", "spin"),
        sigma={f"{a}_tt": 1e-3 for a in "xyz"},
    )
    return network


def scans() -> fga.Network:
    """Four photos on film, each with an affine interior orientation by eight marks."""
    network = photos()()
    values = {"c": FOCAL, "x0": 50.0, "y0": -30.0, "m": 0.01, "r": 0.1}
    del network.cameras["D3"]
    network.add_camera(
        "D3", FilmLens(pixel=0.5), values, free=TRANSFORMATIONS["affine"], per_photo=True
    )
    for i, photo in enumerate(network.photos):
        for number, (x, y) in enumerate(MARKS):
            film = {"film_x": 6.0 * x, "film_y": 6.0 * y}
            at = (0.0, 0.0)
            covariance = 2 * (SIGMA_MM / MM) ** 2 * correlated(i)[:2, :2]
            more = {"covariance": covariance, **film}
            network.add(o.FiducialMark(photo, f"{number}", at, **more))
    return network


NETWORKS: dict[str, Callable[[], fga.Network]] = {
    "slope_distance": slope_distances,
    "horizontal_distance": horizontal_distances,
    "vertical_angle": zenith_angles(o.VerticalAngle),
    "zenith_angle": zenith_angles(o.ZenithAngle),
    "direction": directions,
    "azimuth": azimuths,
    "horizontal_angle": angles,
    "height_difference": height_differences,
    "astronomic_latitude": astronomy(o.AstronomicLatitude),
    "astronomic_longitude": astronomy(o.AstronomicLongitude),
    "gnss_vector": gnss_vectors,
    "control": positions(o.ControlPoint),
    "gnss_position": positions(o.GnssPosition),
    "photo_position": photos(positions=True),
    "image": photos(),
    "frame_coordinate": frames,
    "frame_vector": vectors_of_another_datum,
    "photo_attitude": flight(
        Plan(exposures=3, strips=1, mount=EVERY, control=2, turning=("rz_t",), drift=("x_t",))
    ),
    "navigation_attitude": flight(
        Plan(TILTED, 1, 3, attitudes=o.NavigationAttitude, mount=TURNS, control=2, shutter=True)
    ),
    "photo_angle": flight(Plan(TILTED, 1, 3, attitudes=None, extra=("photo_angle",))),
    "photo_range": flight(Plan(TILTED, 1, 3, mount=OFFSETS, extra=("photo_range",))),
    "photo_base": flight(Plan(TILTED, 1, 3, drift=("x_t",), extra=("photo_base",))),
    "antenna_vector": flight(Plan(TILTED, 1, 3, attitudes=None, extra=("antenna_vector",))),
    **{f"on_{shape}": partial(on_shapes.plan, shape) for shape in SHAPES},
    **dict.fromkeys(RELATIONS, on_shapes.room),
    "image_line": edges,
    **dict.fromkeys(("image_through_level", "image_through_plane"), water_tank),
    "image_through_port": diving_camera,
    **dict.fromkeys(
        (
            *("plane_offset", "plumb_offset", "line_offset"),
            *("sight_plane_offset", "sight_offset", "radial_offset"),
        ),
        alignment.offsets,
    ),
    **dict.fromkeys(("wire_reading", "hydrostatic_reading"), alignment.tunnel),
    **dict.fromkeys(
        ("wire_reading_on_body", "frame_inclination", "frame_roll", "unit_vector"), alignment.body
    ),
    "relative_rotation": rigs,
    "relative_position": lambda: odometry(6, scale=0.05),
    "frame_coordinate, deformed": deformed_block,
    "strip_coordinate": bent_strips,
    "profile_height": profile_heights,
    "level_height": level_heights,
    "photo_tilt": tilts_and_sights(o.PhotoTilt),
    "photo_sight": tilts_and_sights(o.PhotoSight),
    "gyro_azimuth": gyro_azimuths,
    "frame_direction": instruments("theodolite", "levelled theodolite"),
    "frame_zenith": instruments("theodolite", "on a pillar, tilted", "tracker"),
    "frame_distance": instruments("levelled scanner", "tracker", constants=True),
    **dict.fromkeys(
        (
            *("ellipsoid_distance", "mean_height_distance", "geodetic_azimuth"),
            *("ellipsoid_height", "ellipsoid_height_difference"),
        ),
        on_the_ellipsoid,
    ),
    **dict.fromkeys(("planar_vector", "heading_difference"), vehicles),
    "body_vector": bodies,
    "photo_on_arc": on_an_orbit,
    "fiducial_mark": scans,
    **dict.fromkeys(("photo_shift", "photo_turn"), moving_photos),
    "correlated": correlated_directions,
    "moved_point": missile,
    **dict.fromkeys(("radar_range", "radar_squint"), radar),
    "image, parallel projection": microscope,
    "image, rational polynomials": lambda: satellites(free=BIAS, placed=True)[0],
    "image, correlated": correlated_image_points,
    "image, jointly": joint_image_points,
    "mixed": mixed,
}
"""A network for each kind of observation, one with correlated groups, and a mixed one."""
DISTINCT = list({make: name for name, make in NETWORKS.items()}.values())
"""Names of networks that differ."""


@dataclass(frozen=True)
class Scatter:
    """What the repetitions came to."""

    whitened: Array
    """z = L⁻¹(x̂ − x), (repetitions, unknowns)."""
    vtpv: Array
    """(repetitions,)."""
    redundancy: int


class Trials:
    """Repetitions of a network, each of which is measured and adjusted once."""

    def __init__(self, name: str) -> None:
        self.plan = NETWORKS[name]()
        self.true = fga.adjust(measure(self.plan, seed=0, noise=False))
        unknowns = self.true.equations.unknowns
        self.variables = [(k, unknowns[k].names[i]) for k, i in unknowns.active()]
        self.free = np.concatenate([_free(self.true, v) for v in self.variables])
        self.errors: list[Array] = []
        self.vtpv: list[float] = []

    def scatter(self, repetitions: int) -> Scatter:
        """Return what the first repetitions come to."""
        for seed in range(len(self.errors), repetitions):
            found = fga.adjust(measure(self.plan, seed=seed), start=self.true)
            assert found.converged, seed
            errors = [between(found, self.true, *v) for v in self.variables]
            self.errors.append(np.concatenate(errors)[self.free])
            self.vtpv.append(found.vtpv)
        covariance = self.true.variable_covariance
        q = np.block([[covariance(a, b) for b in self.variables] for a in self.variables])
        root = np.linalg.cholesky(q[np.ix_(self.free, self.free)])
        z = np.linalg.solve(root, np.array(self.errors[:repetitions]).T).T
        return Scatter(z, np.array(self.vtpv[:repetitions]), self.true.redundancy)


trials = cache(Trials)


def few(name: str) -> Scatter:
    """Measure and adjust a network a few times."""
    return trials(name).scatter(FEW)


def many(name: str) -> Scatter:
    """Measure and adjust a network as often as needed to see a variance that is `WRONG`."""
    made = trials(name)
    unknowns = np.count_nonzero(made.free)
    enough = next(n for n in count(FEW, 5) if bounds(stats.chi2(n), unknowns)[1] < (1 + WRONG) * n)
    return made.scatter(enough)


def _free(solution: fga.Solution, variable: tuple[VariableKind, str]) -> Mask:
    return np.diag(solution.variable_covariance(variable)) > 0


def bounds(distribution: stats.rv_frozen, figures: int) -> tuple[float, float]:
    """Return between which values each of some figures lies."""
    tail = (1 - CONFIDENCE) / 2 / figures
    return float(distribution.ppf(tail)), float(distribution.isf(tail))


def assert_estimates_scatter_as_their_covariance_says(found: Scatter) -> None:
    """Compare Σzzᵀ and Σz with those of unit normal vectors."""
    z = found.whitened
    n, u = z.shape
    squares = z.T @ z
    variances = np.diag(squares)
    low, high = bounds(stats.chi2(n), u)
    assert low < variances.min()
    assert variances.max() < high
    low, high = bounds(stats.chi2(n * u), 1)
    assert low < float(variances.sum()) < high
    # Sums and differences of two, divided by √2, are normal with variance 1 too.
    i, j = np.triu_indices(u, 1)
    middle, product = 0.5 * (variances[i] + variances[j]), squares[i, j]
    both = np.concatenate([middle + product, middle - product])
    low, high = bounds(stats.chi2(n), len(both))
    assert low < both.min()
    assert both.max() < high
    _, most = bounds(stats.norm(scale=np.sqrt(n)), u)
    assert np.abs(z.sum(axis=0)).max() < most  # and there is no bias


def assert_the_variance_of_unit_weight_follows_its_distribution(found: Scatter) -> None:
    """Compare vᵀPv with χ²."""
    r = found.redundancy
    low, high = bounds(stats.chi2(r * len(found.vtpv)), 1)
    assert low < float(found.vtpv.sum()) < high
    assert stats.kstest(found.vtpv, stats.chi2(r).cdf).pvalue > 1 - CONFIDENCE
