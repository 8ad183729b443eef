"""A network with every kind of observation, unknown and lens model, in every frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from factorgraph_adj import observations as o
from factorgraph_adj.entities import ORIGINS
from factorgraph_adj.frames import GeocentricFrame, LocalFrame, TopocentricFrame
from factorgraph_adj.models import lens
from factorgraph_adj.models.film_lens import FilmLens
from factorgraph_adj.models.lens_registry import LENSES
from factorgraph_adj.models.orthogonal_lens import OrthogonalLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.stochastic_model import StandardDeviation
from tests.networks.every_kind import add_examples

TABLE = {
    "pixel": 0.015,
    "radii": (0.0, 10.0, 20.0 + 1 / 3),
    "radial": ((0.0, 1e-3 / 3, -2e-3),) * 2,
    "tangential": ((0.0, 1e-3, 2e-3), (0.0, -1e-3 / 3, 0.0)),
    "directions": (1 / 3, 2.0),
    "between": "linear",
}
"""Options of a lens with a table of distortions."""
FRAMES = {
    "topocentric": TopocentricFrame(0.83, 0.2, 432.1, "Bessel1841", 6_400_000.0),
    "geocentric": GeocentricFrame("WGS84"),
    "local": LocalFrame(),
    "curved": LocalFrame(True, 6_380_000.0, (1.1, -2.2, 1 / 3), "se"),
}


def everything(frame_name: str) -> Network:
    """Return a network with every kind of observation, unknown and lens model."""
    frame = FRAMES[frame_name]
    local = isinstance(frame, LocalFrame)
    rng = np.random.default_rng(1)
    n = Network('all "kinds", in \\ one ü', frame=frame, datum="free")
    n.add_point("A", rng.normal(size=3) * 50, fixed="z", sigma=(0.01, 0.02, np.inf))
    n.add_point("B, 2", rng.normal(size=3) * 50, datum=True, check=(1.1, np.nan, 3.3))
    n.add_point("#C", (np.nan, 1 / 3, np.nan))
    n.add_point('"D"', fixed="")
    for i, model in enumerate(LENSES.values()):
        options = {"reference_radius": 50.3} if model is lens.HarmonicLens else {}
        options |= {"zero_radius": 17.7} if model is lens.BalancedLens else {}
        options |= {"affine": "after"} if model is lens.BrownLens else {}
        options |= {"image_base": 92.3} if issubclass(model, OrthogonalLens) else {}
        options |= TABLE if model is FilmLens else {}
        n.add_camera(
            f"camera {i}",
            model(**options),
            {"c": 100.1 + 1 / 3, "x0": 1e-17, "y0": -0.3, **dict.fromkeys(model.given, 0.0)},
            free=["c"],
            sigma={"x0": 0.01},
            unit="px" if i % 2 else "mm",
            per_photo=i == 2,
            format=(36.1 + 1 / 3, 24.0) if i % 3 else None,
            origin=ORIGINS[i % 3],
            readout=0.03 if i in (1, 4) else None,
            readout_towards="left" if i == 4 else "down",
        )
    n.add_photo(
        "f1",
        "camera 0",
        position=(1, 2, 3),
        omega_phi_kappa=(0.1, 0.2, 0.3),
        fixed=(False, False, False, True, False, False),
    )
    u, _, vt = np.linalg.svd(rng.normal(size=(3, 3)))
    n.add_photo(
        "f2",
        "camera 1",
        position=(1 / 3, 2, 3),
        rotation=u @ vt * np.linalg.det(u @ vt),
        sigma_position=(0.1, 0.2, np.inf),
        sigma_attitude=0.001,
    )
    n.add_photo("f3", "camera 2")
    n.add_photo("f4", "camera 3", position=(0, 0, 9), omega_phi_kappa=(0, 0, -1), fixed=True)
    n.add_photo("scan", f"camera {[*LENSES].index('film')}")
    n.set_orientation("A", set="2", value=1.234, sigma=0.01)
    n.set_orientation("#C", value=-2.0, fixed=True)
    n.set_refraction(value=0.13, sigma=0.05)
    n.set_refraction("north", fixed=True)
    n.set_vertical("A", xi=1e-5, eta=-2e-5, sigma=(1e-6, 2e-6))
    n.set_vertical('"D"', fixed=True)
    n.set_vertical("#C")
    n.set_distance_meter("EDM", scale=1e-6, zero=0.0013, sigma_zero=0.001, free=["scale"])
    n.set_distance_meter("tape", sigma_scale=1 / 3e6)
    n.add_frame("model, 1", free=("rx", "ry", "rz", "x", "y", "z"), sigma={"ln_scale": 1e-5 / 3})
    n.add_frame("tripod", free=["rz"], sigma={"rx": 1e-5, "ry": 2e-5}, origin="A", level=True)
    n.set_polynomial("strip, 1", plan=3, values={"a2": 1 / 3, "z_x": -1e-3}, sigma={"z_xxy": 0.1})
    n.set_model_deformation("film ü", free=["x_xy"], sigma={"affinity": 1 / 3}, values={"y": 0.1})
    n.add_frame("wall", free=["rz", "x"], values={"rz": -1 / 3, "z": 0.1}, origin=(1 / 3, 2, 3e6))
    n.set_mount("imu, 1", free=["rx", "z"], values={"ry": 1 / 3}, sigma={"x": 1 / 3})
    n.set_drift("strip", free=["x", "z_t"], sigma={"y_tt": 1e-3 / 3})
    n.set_attitude_drift("strip", free=["rx"], values={"rz_t": 1e-3 / 7}, sigma={"ry": 1e-4})
    n.set_shutter("shutter", error=1 / 300, sigma=0.01)
    n.set_mount("clino", free=("rx", "ry"), values={"rz": 1 / 3}, sigma={"x": 0.01})
    n.set_level("lake, 1", 371.1 + 1 / 3, sigma=0.02)
    n.set_level("pond")
    n.set_profile("7", values={"height_t": 1 / 3}, sigma={"height": 3.0, "scale": 0.01 / 3})
    n.set_profile("8", free=("height", "height_tt"))
    n.set_gyro("gyro 1", sigma=1e-5, value=1 / 3e3)
    n.set_gyro("gyro 2")
    n.set_unknown("heading", "A", (1 / 3,), sigma=1e-3)
    n.set_refractive_index("water, 1", 4 / 3.1, sigma=1e-3 / 3)
    n.set_refractive_index("oil", fixed=True)
    n.set_port(
        *("port, 1",),
        distance=0.1 / 3,
        thickness=0.01,
        slopes=(1e-3 / 3, -0.01),
        free=["distance"],
        sigma={"slope_x": 1e-3 / 7, "thickness": 1e-4},
    )
    n.set_unknown("heading", "#C", (4.5,))
    per_part = StandardDeviation(0.002, ppm=2.0, centring_target=0.001)
    turned = StandardDeviation(1e-5, centring_instrument=0.001, centring_target=0.002)
    n.add(
        o.SlopeDistance("A", "B, 2", 12.3456, sigma=per_part, instrument="EDM", target_height=1.5),
        o.HorizontalDistance("A", "B, 2", 12.3, sigma=0.003),
        o.VerticalAngle("A", "#C", 0.1, sigma=1e-5, refraction="north"),
        o.ZenithAngle("A", "#C", 1.4, sigma=turned, instrument_height=1 / 3),
        o.Direction("A", '"D"', 1 / 3, sigma=1e-5, set="2"),
        o.Direction("B, 2", '"D"', 0.2, sigma=2e-5),
        o.Azimuth("A", '"D"', 6.1, sigma=3e-5),
        o.HorizontalAngle("A", '"D"', "#C", 2.2, sigma=turned, target2_height=1.1),
        o.HeightDifference("A", '"D"', 0.7, sigma=StandardDeviation(per_sqrt_km=1e-3)),
        o.HeightDifference("A", "#C", -0.0, sigma=1e-3, length_km=0.33),
        o.GnssVector("A", '"D"', (1, 2, 1 / 3), covariance=np.diag([1e-6, 2e-6, 3e-6]) + 1e-8),
        o.GnssVector("A", "B, 2", (1, 2, 3), sigma=(0.01, 0.01, 0.02), target_height=1.2),
        o.GnssPosition('"D"', (1, 2, 3.0), sigma=(0.01, 0.02, 0.03), id="antenna 7"),
        o.ControlPoint('"D"', (3.0,), axes="z", sigma=(0.01,)),
        o.ControlPoint(
            '"D"', (3.0, 1.0), axes="zx", covariance=np.array([[2e-4, 1e-5], [1e-5, 1e-4]])
        ),
        o.ControlPoint('"D"', (3.0, 1.0, 2.0), axes="nu", sigma=(0.01, 0.02)),
        o.FrameCoordinate("model, 1", "A", (1, 2, 1 / 3), covariance=np.diag([1e-6, 2e-6, 3.1])),
        o.FrameVector("model, 1", "A", "B, 2", (1, 2, 1 / 3), sigma=(0.1, 0.2, 1 / 3)),
        o.FrameCoordinate("model, 1", None, (1, 1 / 3), axes="zx", photo="f1", sigma=(0.1, 0.2)),
        o.FrameCoordinate("tripod", '"D"', (1, 2, 1 / 3), sigma=(1e-3, 2e-3, 3e-3)),
        o.FrameCoordinate("wall", "#C", (1 / 3,), axes="x", sigma=(1e-3,)),
        o.FrameCoordinate(
            "wall", "#C", (1 / 3,), axes="y", sigma=(1e-3,), deformation="film ü", base=1 / 3
        ),
        o.StripCoordinate("strip, 1", "A", (1, 1 / 3, 2), along=1 / 3, across=-2, sigma=(1, 2, 3)),
        o.StripCoordinate(
            "strip, 1", "B, 2", (1, 1 / 3), axes="yx", along=0, across=1, covariance=np.diag([1, 2])
        ),
        o.FrameDirection("tripod", '"D"', 1 / 3, sigma=1e-5 / 3),
        o.FrameZenith("tripod", "#C", 1 / 3, sigma=1e-5, face=1),
        o.FrameDistance("model, 1", "A", 31 / 3, sigma=per_part, instrument="EDM"),
        o.PhotoPosition("f1", (1, 2, 3.0), sigma=(0.01, 0.02, 0.03), lever_arm=(0.1, 0, -0.2)),
        o.PhotoPosition(
            *("f2", (1 / 3, 2.0)),
            axes="zx",
            sigma=(0.01, 0.02),
            mount="imu, 1",
            drift="strip",
            time=-1 / 3,
            shutter="shutter",
            velocity=(60.1, 0.0, -1 / 3),
        ),
        o.PhotoAttitude("f1", (0.1, 0.2, 1 / 3), sigma=(1e-5, 2e-5, 3e-5), about="body"),
        o.NavigationAttitude(
            *("f2", (0.1, 0.2, 1 / 3)),
            covariance=np.diag([1e-10, 2e-10, 3e-10]) + 1e-11,
            mount="imu, 1",
            drift="strip",
            time=1 / 7,
        ),
        o.PhotoAngle("f1", -1 / 3, angle="pitch", sigma=1e-4 / 3, mount="imu, 1"),
        o.PhotoRange("A", "f1", 33.3, sigma=0.1, instrument="EDM", lever_arm=(0.1, 0, 1 / 3)),
        o.PhotoBase("f1", "f2", 1 / 3, sigma=0.1, mount="imu, 1"),
        o.RelativeRotation(
            *("f1", "f2", (0.1, -0.2, 1 / 3)),
            mount="imu, 1",
            covariance=np.diag([1e-6, 2e-6, 3e-6]) + 1e-7,
        ),
        o.RelativePosition(
            "f1", "f2", (1, 2, 1 / 3), sigma=(0.01, 0.01, 0.02), instrument="EDM", mount="imu, 1"
        ),
        o.AntennaVector("f1", (1, 2, 1 / 3), sigma=(0.01, 0.01, 0.02), lever_arm=(1, 2, 0.1)),
    )
    seen = np.array((1 / 3, -2, -5)) / np.linalg.norm((1 / 3, -2, -5))
    n.add(
        o.ProfileHeight("A", 312.1, sigma=0.3),
        o.ProfileHeight(None, 2512.1, photo="f1", sigma=0.3, profile="7", time=-1 / 3),
        o.ProfileHeight(
            None, 1.0, photo="f2", sigma=0.3, profile="8", mount="clino", lever_arm=(0.1, 0, 1 / 3)
        ),
        o.LevelHeight("A", "lake, 1", sigma=0.1),
        o.LevelHeight("#C", "pond", -1.1, sigma=0.1, slope=1e-3 / 3, along=-31.0, geoid=0.01 / 3),
        o.PhotoTilt("f1", (0.1, -1 / 3), sigma=(1e-3, 2e-3), mount="clino"),
        o.PhotoTilt("f2", (0.1,), axes="y", sigma=(1e-3,)),
        o.PhotoTilt("f2", (0.1, 0.2), covariance=np.array([[2e-6, 1e-7], [1e-7, 1e-6]])),
        o.PhotoSight("f1", (0.36, -0.48, 0.8), tuple(seen.tolist()), sigma=(1e-3, 1e-3)),
        o.PhotoSight("f1", (1, 0, 0), (0, 0, -1), (1e-9 / 3,), axes="x", sigma=(1e-3,)),
        o.GyroAzimuth("A", '"D"', 6.1, sigma=turned, gyro="gyro 1", target_height=1.3),
        o.GyroAzimuth("A", "#C", 1 / 3, sigma=1e-5),
        o.BodyVector("f1", "#C", (0.1, -1 / 3, 2.0), sigma=(0.1, 0.2, 0.3)),
        o.PlanarVector("A", "#C", (0.1, -1 / 3), sigma=(0.1, 0.2)),
        o.PlanarVector("#C", "A", (1.0, 2.0), covariance=np.array([[2e-6, 1e-7], [1e-7, 1e-6]])),
        o.HeadingDifference("A", "#C", -1 / 3, sigma=1e-3),
    )
    turned_by = np.diag([1e-10, 2e-10, 3e-10]) + 1e-11
    n.add(
        o.RelativeRotation("f1", "f2", (0.1, -1 / 3, 2.0), covariance=turned_by),
        o.RelativeRotation("f1", "f3", (0.0, 0.0, 1e-9 / 3), sigma=(1e-8,) * 3, mount="clino"),
        o.RelativePosition("f2", "f1", (1, 2, 1 / 3), sigma=(0.1, 0.2, 0.3), instrument="EDM"),
        o.RelativePosition("f1", "f3", (0.0, 0.0, 1e-9 / 3), sigma=(1e-6,) * 3, mount="clino"),
    )
    if not local:
        n.add(
            o.AstronomicLatitude("A", 0.83, sigma=1e-6, id="Φ"),
            o.AstronomicLongitude("A", 0.2, sigma=1e-6),
        )
    root = rng.normal(size=(7, 7))
    cluster = (
        o.GnssVector("A", "B, 2", (1, 2, 3.1), sigma=(1, 1, 1.0)),
        o.GnssPosition('"D"', (1, 2, 3.0), sigma=(1.0, 1, 1)),
        o.SlopeDistance("A", '"D"', 3.3, sigma=1.0),
    )
    n.add(o.Correlated(cluster, root @ root.T * 1e-6))
    n.add_shape("tank", "cylinder", origin=(1.0, 2.0, 1 / 3))
    n.add_shape("bend", "torus", origin=(1.0, 2.0, 1 / 3))
    n.add_shape("hopper", "cone", origin=(1.0, 2.0, 1 / 3), values={"x": 1 / 3})
    n.set_size("target", 1 / 3, sigma=0.01)
    n.add(
        o.OnCylinder("tank", "A", 1 / 3000, sigma=0.002, radius="target"),
        o.OnTorus("bend", "A", sigma=0.002, condition=True),
        o.OnCone("hopper", '"D"', sigma=0.002),
        o.OnPlane("wall", "A", sigma=1 / 3000),
        o.OnLine("wall", "#C", sigma=(0.001, 0.002)),
        o.OnCircle("tank", "A", (1 / 3, 0.0), covariance=np.diag([1e-6, 2e-6]), height="target"),
        o.OnSphere("bend", "A", sigma=0.002, radius="target"),
        o.OnParaboloid("bend", "A", sigma=0.002, focal="target"),
        o.EqualDistance("A", "B, 2", "#C", "A", 1 / 3, sigma=0.01, ratio=1 / 3),
        o.EqualHeightDifference("A", "B, 2", "#C", '"D"', sigma=0.01, condition=True),
        o.RightAngle("A", "B, 2", "#C", sigma=1e-4),
        o.PointDirection("A", "B, 2", 1 / 3, 0.2, -0.0, sigma=1e-4),
        o.CoordinateDifference("A", "#C", (1 / 3,), axes="y", sigma=0.01),
        o.CoordinateDifference("A", "#C", (1, 2, 3), horizon=True, sigma=(0.01, 0.02, 0.03)),
        o.ParallelAxes("tank", "hopper", covariance=np.diag([1e-8, 2e-8])),
        o.AxisAngle("tank", "hopper", sigma=1e-4),
        o.PlaneDistance("wall", "hopper", 1 / 3, sigma=1e-3),
        o.ImageLine("f1", "wall", 1 / 3, -2.0, sigma=0.005),
        o.FiducialMark("scan", "F 1", (1 / 3, 2), film_x=-113.0, film_y=1 / 3, sigma=(0.1, 0.2)),
        o.FiducialMark(
            "scan", "#2", (1 / 3, 2), film_x=0, film_y=7, covariance=np.diag([0.1, 0.2]) + 0.01
        ),
        o.ImageThroughLevel(
            "f1", "B, 2", (1 / 3, -2.0), sigma=0.005, level="pond", medium="water, 1"
        ),
        o.ImageThroughLevel(
            *("f2", "B, 2", (1 / 3, -2.0)),
            covariance=np.array([[2e-6, 1e-7], [1e-7, 1e-6]]),
            level="lake, 1",
            medium="oil",
            geoid=1 / 3,
        ),
        o.ImageThroughPlane(
            "f1", "#C", (1 / 3, -2.0), sigma=(0.005, 0.1 / 3), plane="wall", medium="water, 1"
        ),
        o.ImageThroughPort(
            "f2", "#C", (0.0, 1 / 3), sigma=0.1 / 3, port="port, 1", medium="water, 1", id="p"
        ),
    )
    n.add_image_points("f2", ['"D"', "A"], [[1.5, -2.25], [1 / 3, 7]], sigma=0.5)
    n.add_image_points("f1", ['"D"', "A"], [[1.5, 0.0], [1 / 3, 7]], sigma=[[0.003, 0.004]] * 2)
    n.add(o.ImagePoint("f3", "A", 1, -2, sigma=0.3, correlation=-1 / 3, id="own"))
    both = [o.ImagePoint("f3", name, 2, 1 / 3, sigma=0.3) for name in ("B, 2", "#C")]
    joint = 0.04 * (np.eye(4) + 1 / 3)
    n.add(o.Correlated((replace(both[0], id="first"), both[1]), joint))
    _add_alignment(n)
    add_examples(n, ("A", "B, 2", "#C", '"D"'), ("f1", "f2"))
    return n


def _add_alignment(n: Network) -> None:
    """Add readings of planes, plumb lines, wires, water and inclinometers."""
    n.set_size("sag, 1", 1 / 3, sigma=0.01)
    wire = {"sag": "sag, 1", "length": 20 / 3, "sigma": (1e-5, 2e-5)}
    n.add(
        o.PlaneOffset("wall", "A", 1 / 3, sigma=1e-3),
        o.PlumbOffset("wall", '"D"', 1 / 3, sigma=1e-3),
        o.LineOffset("A", '"D"', "#C", 1 / 3, sigma=1e-3),
        o.SightPlaneOffset("A", '"D"', 1 / 3, horizontal=2 / 3, set="2", sigma=1e-3),
        o.SightOffset("A", '"D"', 1 / 3, horizontal=2 / 3, zenith=4 / 3, set="2", sigma=1e-3),
        o.RadialOffset("A", 1 / 3, bearing=2 / 3, reference_x=7 / 3, reference_y=1, sigma=1e-3),
        o.HydrostaticReading("A", "pond", 1 / 3, mount="imu, 1", side=-1, sigma=1e-5),
        o.WireReading("wall", "A", (1 / 3, 2.0), mount="imu, 1", **wire),
        o.WireReadingOnBody("wall", "A", (1 / 3, 2.0), body="model, 1", **wire),
        o.FrameInclination("model, 1", "A", 1 / 3, sigma=1e-5),
        o.FrameRoll("model, 1", "A", 1 / 3, mount="imu, 1", sigma=1e-5),
        o.UnitVector("model, 1", "A", '"D"', (1 / 3, 0.25), sigma=(1e-5, 2e-5)),
    )
