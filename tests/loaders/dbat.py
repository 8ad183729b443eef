"""Projects of the Damped Bundle Adjustment Toolbox (DBAT): networks from their text files.

Pixel coordinates have their origin in the upper left corner and y down; here they become mm
in the camera's unit, y up, so that DBAT's principal point (px, py) is x0 = px, y0 = −py.
The lens models of DBAT by number: 1 (Brown, measured → ideal, no affinity), 3 (affinity
before), 4 (affinity after), −1 (Brown, ideal → measured).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

import numpy as np

from factorgraph_adj.models.lens import BrownForwardLens, BrownLens, Lens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ControlPoint, PhotoPosition
from factorgraph_adj.types import Array

CAMERA = "camera"
RADIAL, DECENTRING = ("k1", "k2", "k3"), ("p1", "p2")
INTERIOR = ("c", "x0", "y0", *RADIAL, *DECENTRING)
LENS: dict[int, Lens] = {
    1: BrownLens(),
    3: BrownLens(affine="before"),
    4: BrownLens(affine="after"),
    -1: BrownForwardLens(),
}
"""Lens models by DBAT's number; the affinity of model 1 is held at zero."""
CALIBRATED = {1: INTERIOR, 3: (*INTERIOR, "b1"), 4: (*INTERIOR, "b1"), -1: INTERIOR}
"""What DBAT estimates with "all": no shear."""

ImageRow = tuple[str, str, float, float, float]
"""Photo, point, column and row (pixels), standard deviation (pixels)."""


@dataclass(frozen=True)
class Sensor:
    """The camera as its XML describes it."""

    pixel: float
    """Height of a pixel, mm, from the height of the sensor; its width differs by b1."""

    def image(self, column: Array, row: Array) -> Array:
        """Return image coordinates (n, 2), mm, y up."""
        return self.pixel * np.stack([column, -row], 1)


def read_sxb(folder: Path, *, camera_positions: bool = False) -> Network:
    """Return the aerial block, no approximate values for photos and tie points.

    Args:
        folder: where it lies.
        camera_positions: the variant ``sxb_eo``: every control point is used, every image
            point has σ = 1 px, the projection centres of photos 1 to 4 are observed
            (σ = 0.05 m), and the principal distance is PhotoModeler's, 0.2 µm shorter.
            Without it, 351 and 410 are check points, and points measured by hand have
            σ = 0.5 px.
    """
    network = Network("Strasbourg")
    values = {}
    if camera_positions:
        export = folder / "prague2016/pmexports/wsmart-with-orient-pmexport.txt"
        values["c"] = float(export.read_text().splitlines()[3].split()[0])
    sensor = _sensor(folder / "sxb.xml", into=network, model=3, values=values)
    check = () if camera_positions else ("351", "410")
    for fields in _table(folder / "reference/sxb-control.txt"):
        name, xyz = fields[0], tuple(map(float, fields[2:5]))
        if name in check:
            network.add_point(name, check=xyz)
            continue
        network.add_point(name, xyz)
        network.add(ControlPoint(name, xyz, sigma=tuple(map(float, fields[5:8]))))
    for fields in _table(folder / "images/images.txt"):
        network.add_photo(fields[0], CAMERA)
    by_hand = 1.0 if camera_positions else 0.5
    rows = [
        (photo, point, float(x), float(y), sigma)
        for file, sigma in (("markpts.txt", by_hand), ("smartpts.txt", 1.0))
        for point, photo, x, y in _table(folder / "measurements" / file)
    ]
    _add_image_points(network, sensor, rows)
    if camera_positions:
        photo_of = {Path(path).name: ident for ident, path in _table(folder / "images/images.txt")}
        for label, x, y, z, sigma in _table(folder / "prague2016/ref/fake-camera-positions.txt"):
            at = (float(x), float(y), float(z))
            network.add(PhotoPosition(photo_of[label], at, sigma=(float(sigma),) * 3))
    return network


def read_camcal(
    folder: Path, *, model: int = 3, control: Literal["fixed", "weighted"] = "fixed"
) -> Network:
    """Return the calibration of a camera, no approximate values but the nominal focal length."""
    network = Network("camera calibration")
    free = CALIBRATED[model]
    sensor = _sensor(folder / "camcaldemo.xml", into=network, model=model, free=free)
    for fields in _table(folder / f"reference/camcal-{control}.txt"):
        name, xyz = fields[0], tuple(map(float, fields[2:5]))
        network.add_point(name, xyz, fixed="xyz" if control == "fixed" else "")
        if control == "weighted":
            network.add(ControlPoint(name, xyz, sigma=(float(fields[5]),) * 3))
    for fields in _table(folder / "images/images.txt"):
        network.add_photo(fields[0], CAMERA)
    rows = [
        (photo, point, float(x), float(y), float(sigma))
        for photo, point, x, y, sigma in _table(folder / "measurements/markpts.txt")
    ]
    _add_image_points(network, sensor, rows)
    return network


def read_camcal_export(folder: Path, case: str, *, control: bool = True) -> Network:
    """Return a PhotoModeler export of the calibration, with the values it exports as start.

    Args:
        folder: where it lies.
        case: what follows ``camcal-pmexport`` in its name: "", "5", "-missing-obs", "-1ray".
        control: whether points 1001 to 1004 are held.
    """
    network = Network(f"camera calibration {case}".strip())
    xml = folder / "camcaldemo.xml"
    sensor = _sensor(xml, into=network, model=3, free=CALIBRATED[3])
    text = (folder / f"dbat/pmexports/camcal-pmexport{case}.txt").read_text()
    blocks = [[line.split() for line in b.splitlines()] for b in text.split("\n\n") if b.strip()]
    blocks = [[fields for fields in block if fields] for block in blocks]
    for block in blocks:
        # photo, X, Y, Z, κ, φ, ω follow a line that ends with the name of the picture
        for before, fields in itertools.pairwise(block):
            if before[-1].endswith(".JPG"):
                x, y, z, kappa, phi, omega = map(float, fields[1:7])
                network.add_photo(
                    str(int(fields[0]) + 1),
                    CAMERA,
                    position=(x, y, z),
                    omega_phi_kappa=np.deg2rad([omega, phi, kappa]).tolist(),
                )
    # four tables at the end: points, measurements, and two on who sees what
    points, measured = blocks[-4:-2]
    for name, x, y, z, *_ in points:
        held = control and name in ("1001", "1002", "1003", "1004")
        network.add_point(name, (float(x), float(y), float(z)), fixed="xyz" if held else "")
    rows = [
        (str(int(photo) + 1), point, float(x), float(y), float(sigma))
        for photo, point, x, y, sigma, _ in measured
        if point in network.points
    ]
    _add_image_points(network, sensor, rows)
    return network


def read_roma(
    folder: Path,
    *,
    calibrated: Sequence[str] = ("c", "x0", "y0", "k1", "k2"),
    values: Mapping[str, float] | None = None,
) -> Network:
    """Return the block of 60 photos with DBAT's datum: photo 1 and Y of photo 19 held.

    Args:
        folder: where it lies.
        calibrated: which calibration parameters are unknown.
        values: calibration that differs from the camera's file.
    """
    network = Network("Roma")
    xml = folder / "cameras/EOS5DMarkII.xml"
    sensor = _sensor(xml, into=network, model=3, free=calibrated, values=values)
    for fields in _table(folder / "prior/initial_eo.txt"):
        x, y, z, *angles = map(float, fields[1:7])
        network.add_photo(
            fields[0],
            CAMERA,
            position=(x, y, z),
            omega_phi_kappa=np.deg2rad(angles).tolist(),
            fixed={"1": (True,) * 6, "19": (False,) * 4 + (True, False)}.get(fields[0], False),
        )
    rows = [
        (photo, point, float(x), float(y), 1.0)
        for photo, point, x, y in _table(folder / "measurements/markpts.txt")
    ]
    _add_image_points(network, sensor, rows)
    return network


def _sensor(
    xml: Path,
    *,
    into: Network,
    model: int,
    free: Sequence[str] = (),
    values: Mapping[str, float] | None = None,
) -> Sensor:
    """Add the camera of an XML file; absent values are DBAT's defaults."""
    camera = ElementTree.parse(xml).getroot().find(".//camera")
    assert camera is not None

    def numbers(tag: str) -> list[float]:
        text = camera.findtext(tag)
        return [] if text is None else [float(v) for v in text.split(",") if v != "auto"]

    columns, lines = numbers("image")
    height = numbers("sensor")[-1]
    pixel = height / lines
    px, py = numbers("pp") or (columns * pixel / 2, height / 2)
    start = {"c": (numbers("cc") or numbers("focal"))[0], "x0": px, "y0": -py}
    start |= dict(zip(RADIAL, numbers("K"), strict=False))
    start |= dict(zip(DECENTRING, numbers("P"), strict=False))
    into.add_camera(CAMERA, LENS[model], start | dict(values or {}), free=free, unit="mm")
    return Sensor(pixel)


def _add_image_points(network: Network, sensor: Sensor, rows: Sequence[ImageRow]) -> None:
    """Add image points, and the points among them that the network does not have yet."""
    for _, point, *_ in rows:
        if point not in network.points:
            network.add_point(point)
    by_photo: dict[str, list[ImageRow]] = {}
    for row in rows:
        by_photo.setdefault(row[0], []).append(row)
    for photo, group in by_photo.items():
        column, line, sigma = np.array([r[2:] for r in group]).T
        network.add_image_points(
            photo,
            [r[1] for r in group],
            sensor.image(column, line),
            sigma=np.stack([sigma, sigma], 1) * sensor.pixel,
        )


def _table(path: Path) -> Iterator[list[str]]:
    """Iterate over the rows of a table with commas and comments (#)."""
    for line in path.read_text().splitlines():
        if line.strip() and not line.startswith("#"):
            yield [field.strip() for field in line.split(",")]


# -- what others found -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Printed:
    """A printed number and half of its last digit."""

    value: float
    half: float

    @staticmethod
    def fixed(text: str) -> Printed:
        """Read a number with a fixed count of decimals."""
        decimals = len(text.partition(".")[2])
        return Printed(float(text), 0.5 * 10.0**-decimals)

    @staticmethod
    def significant(text: str, digits: int) -> Printed:
        """Read a number with ``digits`` significant digits (%g drops zeros at the end)."""
        value = float(text)
        exponent = 0 if value == 0 else int(np.floor(np.log10(abs(value))))
        return Printed(value, 0.5 * 10.0 ** (exponent - digits + 1))


@dataclass(frozen=True)
class Report:
    """What a DBAT report prints."""

    sigma0: Printed
    """Standard deviation of unit weight."""
    last_error: Printed
    """√vᵀPv at the end."""
    redundancy: int
    n_unknowns: int
    n_observations: int
    calibration: dict[str, tuple[Printed, Printed | None]]
    """Value and standard deviation by DBAT's label, which begins with "K1", "px" and so on."""
    photos: dict[str, dict[str, tuple[Printed, Printed | None]]]
    """Omega, Phi, Kappa (degrees), Xc, Yc, Zc with standard deviations by number of photo."""
    points: dict[str, tuple[list[Printed], list[Printed]]]
    """Adjusted X, Y, Z and standard deviations of control and check points."""


def read_report(path: Path) -> Report:
    """Return what a report prints; standard deviations there are a posteriori."""
    lines = [line.strip() for line in path.read_text().splitlines()]

    def after(label: str) -> str:
        return next(line[len(label) :].strip() for line in lines if line.startswith(label))

    calibration: dict[str, tuple[Printed, Printed | None]] = {}
    photos: dict[str, dict[str, tuple[Printed, Printed | None]]] = {}
    points: dict[str, tuple[list[Printed], list[Printed]]] = {}
    part = "calibration"
    photo = ""
    for i, line in enumerate(lines):
        if line.startswith("Photo ") and line.lower().endswith(".jpg"):
            part, photo = "photo", line.split()[1].rstrip(":")
            photos[photo] = {}
        if line == "Quality":
            part = "quality"
        if line.endswith(":") and i + 1 < len(lines) and lines[i + 1].startswith("Value:"):
            value = lines[i + 1].split()[1]
            follows = lines[i + 2].split()
            sigma = Printed.significant(follows[1], 3) if follows[0] == "Deviation:" else None
            label = line.rstrip(":").split(" - ")[0]
            if part == "calibration":
                calibration[label] = (Printed.significant(value, 6), sigma)
            elif part == "photo":
                photos[photo][label] = (Printed.fixed(value), sigma)
        if line == "Posterior":
            for row in lines[i + 2 :]:
                fields = [f.strip() for f in row.split(",")]
                if len(fields) < 9:
                    break
                points[fields[0]] = (
                    [Printed.fixed(f) for f in fields[1:4]],
                    [Printed.significant(f, 3) for f in fields[4:7]],
                )
    return Report(
        Printed.significant(after("Sigma0:"), 6),
        Printed.significant(after("Last error:"), 6),
        int(after("Redundancy")),
        int(after("Number of params:").split()[0]),
        int(after("Number of observations:").split()[0]),
        calibration,
        photos,
        points,
    )


def read_reliability(folder: Path) -> tuple[list[tuple[str, str, str]], Array]:
    """Return photo, point and component of each row of ``reference_reliability.csv``, and figures.

    An independent computation: v/σ, redundancy number, w a priori, w a posteriori, ∇/σ and δ̄, with
    δ0 = 4.132. It numbers its image points in the order of the files of measurements; control
    coordinates (photo "") follow in the order of the control file, without check points.
    """
    images: list[tuple[str, str]] = []
    if (folder / "sxb.xml").exists():
        for file in ("markpts.txt", "smartpts.txt"):
            images += [(f[1], f[0]) for f in _table(folder / "measurements" / file)]
        control = [f[0] for f in _table(folder / "reference/sxb-control.txt")]
        control = [name for name in control if name not in ("351", "410")]
    else:
        images = [(f[0], f[1]) for f in _table(folder / "measurements/markpts.txt")]
        control = []
    of_row = [(*both, axis) for both in images for axis in "xy"]
    of_row += [("", name, axis) for name in control for axis in "XYZ"]
    rows = list(_table(folder / "reference_reliability.csv"))[1:]
    for (photo, _, axis), row in zip(of_row, rows, strict=True):
        assert row[1] == ("img" if photo else "ctrl") and row[4] == axis
    return of_row, np.array([[float(v) for v in row[5:]] for row in rows])
