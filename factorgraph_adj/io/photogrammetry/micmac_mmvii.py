"""Reader of MMVII, the second MicMac: orientations, calibrations, control, MesIm; no tie points.

A folder has ``Ori-PerspCentral-IMAGE.xml`` for each image and the calibrations that they name.
Older files begin with ``<MMVII_Serialization>``; newer ones have it as ``<Type>`` beside
``<Data>``. Texts are quoted. With the ray p in the axes of the camera (x right, y down, z ahead):

    pixel = PP + F (u + u (K1 r² + K2 r⁴ + K3 r⁶)
                    + (p1 (r² + 2x²) + 2 p2 x y + b1 x + b2 y,  2 p1 x y + p2 (r² + 2y²)))

of u = (x, y), r = |u|: p / p_z for the projection Stenope, θ (p_x, p_y) / ρ for FE_EquiDist, and
(atan2(p_x, p_z), asin(p_y / |p|)) for EquiRect. The axes AxeI, AxeJ, AxeK are the columns of the
rotation from the camera to the object. Whole pixels are the centres of pixels.

Source: MicMac (GitHub: micmacIGN/micmac), MMVII/src: Sensors/cCentralPerspCam.cpp,
Sensors/cSensorCamPC.cpp, SymbDerGen/Formulas_CamStenope.h (cMMVIIUnivDist).

Ground control (MesGCP-….xml) and its measurements in images (MesIm-….xml):
MMVII/src/Sensors/Measures.cpp (cMes1Gnd3D, cMesIm1Pt). Sigma2 are variances, xx xy xz yy yz zz of
points (metres²), xx xy yy of measurements (pixels²). A point without them is free: its coordinates
are approximate.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...errors import InputError, Problem
from ...files import read_bytes
from ...models.lens import Lens, NormalisedLens
from ...models.normalised_lens import FraserNormalisedLens
from ...models.ray_lens import EquirectangularLens, FisheyeLens
from ...network.network import Network
from ...observations import ControlPoint
from ..source import Problems, is_unread
from ..xml_files import Element, parse_xml
from .block_source import ImagePoints, add_pixel_camera, rotation_and_scale, whole_number

PREFIX = "Ori-PerspCentral-"
"""Beginning of the names of MMVII's poses of frame cameras."""
CALIBRATION_PREFIX = "Calib-PerspCentral-"
"""Beginning of the names of calibrations, which names of cameras leave out."""
SERIALIZATION = "MMVII_Serialization"
"""Type of MMVII's files."""
OPTIONAL_PREFIX = "__Opt__"
"""Beginning of the names of elements that may be absent; it was ``Opt:`` in older files."""
CONTROL_PATTERN = "MesGCP*.xml"
"""Pattern of the files of ground control of a folder."""
MEASURES_PATTERN = "MesIm-*.xml"
"""Pattern of the files of measurements of a folder, one for each image."""
_DECENTRING = {"p1": ("p1", 1.0), "p2": ("p2", -1.0)}
_RADIAL = {f"K{i}": (f"k{i}", 1.0) for i in (1, 2, 3)}


@dataclass(frozen=True)
class MmviiProjection:
    """A projection of MMVII and the lens model that is the same function."""

    lens: Lens
    """The lens model; Stenope without an affinity is `NormalisedLens`."""
    coefficients: dict[str, tuple[str, float]]
    """Parameter and sign of the coefficients of MMVII that may be other than zero."""


MMVII_PROJECTIONS = {
    "Stenope": MmviiProjection(
        FraserNormalisedLens(), _RADIAL | _DECENTRING | {"b1": ("b1", 1.0), "b2": ("b2", -1.0)}
    ),
    "FE_EquiDist": MmviiProjection(FisheyeLens(), _RADIAL | {"K4": ("k4", 1.0)} | _DECENTRING),
    "EquiRect": MmviiProjection(EquirectangularLens(), {}),
}
"""Projections by their names in files; y points down in MMVII and up here."""


def unquoted_text(element: Element | None) -> str:
    """Return the text of an element without its quotes; empty if there is no element."""
    text = "" if element is None else element.text.strip()
    if len(text) > 1 and text[0] == text[-1] == '"':
        return re.sub(r"\\(.)", r"\1", text[1:-1])
    return text


def mmvii_contents(path: Path, tag: str, known: str) -> Element:
    """Return the element of a file of MMVII that has what is read.

    Args:
        path: the file.
        tag: name of the element, which old files leave out around poses and calibrations.
        known: name of an element in it that every file has.

    Raises:
        InputError: the file is no XML, or no such file of MMVII.
    """
    content = read_bytes(path)
    for begin in (b"<", b"</"):  # a prefix that no name space binds, in files of 2022
        content = content.replace(begin + b"Opt:", begin + OPTIONAL_PREFIX.encode())
    root = parse_xml(content, path.name)
    where = f"{path.name}:{root.line}"
    data: Element | None = root
    if root.tag != SERIALIZATION:
        kind = root.first("Type")
        if unquoted_text(kind) != SERIALIZATION:
            what = f"is no file of MMVII; valid: <Type> or root {SERIALIZATION}"
            raise InputError(Problem(what, where if kind is None else f"{path.name}:{kind.line}"))
        version = root.first("Version")
        if version is not None and not unquoted_text(version).startswith("0."):
            what = f"version {unquoted_text(version)[:40]!r} of MMVII cannot be read; valid: 0.…"
            raise InputError(Problem(what, f"{path.name}:{version.line}"))
        data = root.first("Data")
    inner = None if data is None else data.first(tag) or data
    if inner is None or inner.first(known) is None:
        raise InputError(Problem(f"has no <{tag}> with <{known}>", where))
    return inner


@dataclass
class MmviiOrientations:
    """The orientations of a folder while they are read."""

    folder: Path
    """The folder."""
    network: Network
    """Network to which cameras and photos are added."""
    problems: Problems
    """Where problems go."""
    free: tuple[str, ...]
    """Names of the unknown parameters of the cameras."""
    cameras: dict[str, str | None] = field(default_factory=dict)
    """Names of the cameras by those of their calibrations; None after a problem."""

    def read(self) -> None:
        """Add all photos and their cameras."""
        for file in sorted(self.folder.glob("Ori-*.xml")):
            if not file.name.startswith(PREFIX):
                what = f"is a sensor of another kind; valid: {PREFIX}….xml"
                self.problems.wrong(what, f"{file.name}:1")
                continue
            try:
                self._photo(file)
            except InputError as error:
                self.problems.extend(error.problems)

    def _photo(self, file: Path) -> None:
        pose = mmvii_contents(file, "CameraPose", "NameImage")
        at = f"{file.name}:{pose.line}"
        image = pose.first("NameImage")
        name = unquoted_text(image)
        if file.name != f"{PREFIX}{name}.xml":
            line = pose.line if image is None else image.line
            what = f"is the pose of image {name[:80]!r}; valid: that of the name of the file"
            raise InputError(Problem(what, f"{file.name}:{line}"))
        camera = self._camera(pose, file)
        centre = self._three(pose, "Center", file)
        matrix = pose.first("RotMatrix")
        if matrix is None:
            raise InputError(Problem("has no rotation matrix <RotMatrix>", at))
        axes = [self._three(matrix, tag, file) for tag in ("AxeI", "AxeJ", "AxeK")]
        if camera is None or is_unread(centre, *axes):
            return
        split = rotation_and_scale(np.transpose(np.array(axes, dtype=float)))
        if split is None or abs(split[1] - 1) > 1e-3:
            what = "<RotMatrix> is no rotation matrix"
            raise InputError(Problem(what, f"{file.name}:{matrix.line}"))
        with self.problems.collect(at):
            self.network.add_photo(name, camera, position=centre, rotation=split[0])

    def _three(self, element: Element, tag: str, file: Path) -> tuple[float, ...]:
        child = element.first(tag)
        line = element.line if child is None else child.line
        return self.problems.field(unquoted_text(child), f"<{tag}>", f"{file.name}:{line}").numbers(
            3
        )

    def _camera(self, pose: Element, file: Path) -> str | None:
        """Return the name of the camera of an image; None if it has problems."""
        link = pose.first("NameInternalCalib")
        key = unquoted_text(link)
        line = pose.line if link is None else link.line
        if key in self.cameras:
            return self.cameras[key]
        path = self.folder / f"{key}.xml"
        if not key or Path(key).name != key or not path.is_file():
            what = f"the calibration {key[:80] + '.xml'!r} is no file of this folder"
            raise InputError(Problem(what, f"{file.name}:{line}"))
        self.cameras[key] = None
        calibration = mmvii_contents(path, "InternalCalibration", "PerfectProj")
        named = calibration.first("Name")
        if unquoted_text(named) != key:
            line = calibration.line if named is None else named.line
            what = f"<Name> is {unquoted_text(named)[:80]!r}; valid: {key!r}, as the file is named"
            raise InputError(Problem(what, f"{path.name}:{line}"))
        name = key.removeprefix(CALIBRATION_PREFIX) or key
        before = self.problems.count
        MmviiCalibration(calibration, path.name, self.problems).into(self.network, name, self.free)
        if self.problems.count == before:
            self.cameras[key] = name
        return self.cameras[key]


@dataclass
class MmviiCalibration:
    """A calibration while it is read."""

    element: Element
    """Element of its contents."""
    file: str
    """Name of the file in messages."""
    problems: Problems
    """Where problems go."""

    def _at(self, element: Element | None) -> str:
        return f"{self.file}:{(element or self.element).line}"

    def _child(self, parent: Element | None, tag: str) -> Element | None:
        """Return a child, and report where there is none."""
        child = None if parent is None else parent.first(tag)
        if child is None and parent is not None:
            self.problems.wrong(f"<{parent.tag}> has no <{tag}>", self._at(parent))
        return child

    def into(self, network: Network, name: str, free: tuple[str, ...]) -> None:
        """Add the camera to a network, or report its problems."""
        frame = self._child(self._child(self.element, "PixelFrame"), "NbPix")
        perfect = self._child(self.element, "PerfectProj")
        focal, middle = self._child(perfect, "F"), self._child(perfect, "PP")
        said = self._child(self.element, "Projection")
        if frame is None or focal is None or middle is None or said is None:
            return
        size = self.problems.field(unquoted_text(frame), "<NbPix>", self._at(frame)).numbers(2)
        c = self.problems.field(unquoted_text(focal), "<F>", self._at(focal)).number(above=0.0)
        pp = self.problems.field(unquoted_text(middle), "<PP>", self._at(middle)).numbers(2)
        projection = MMVII_PROJECTIONS.get(unquoted_text(said))
        if projection is None:
            what = f"projection {unquoted_text(said)[:40]!r} cannot be read; valid: "
            self.problems.wrong(what + ", ".join(MMVII_PROJECTIONS), self._at(said))
            return
        values = self._distortion(projection, unquoted_text(said))
        if is_unread(size, c, pp) or values is None:
            return
        values |= {"c": c, "x0": pp[0] + 0.5, "y0": -pp[1] - 0.5}
        lens, sides = projection.lens, (size[0], size[1])
        affinity = [n for n in ("b1", "b2") if values.get(n) or n in free]
        if isinstance(lens, FraserNormalisedLens) and not affinity:
            lens = NormalisedLens()
            values = {n: v for n, v in values.items() if n in lens.names}
        with self.problems.collect(self._at(self.element)):
            add_pixel_camera(network, name, lens, values, size=sides, free=free)

    def _distortion(self, projection: MmviiProjection, said: str) -> dict[str, float] | None:
        """Return the parameters of the distortion, y up; None after a problem."""
        auxiliary = self._child(self.element, "Auxiliary")
        stated = self._child(auxiliary, "Degree")
        if auxiliary is None or stated is None:
            return None
        degree = [whole_number(t) for t in unquoted_text(stated).split()]
        if len(degree) != 3 or any(d is None or d > 20 for d in degree):
            what = (
                f"<Degree> is {unquoted_text(stated)[:40]!r}; valid: three whole numbers up to 20"
            )
            self.problems.wrong(what, self._at(stated))
            return None
        mode = auxiliary.first("IsFraserMode")
        if mode is not None and unquoted_text(mode) != "1":
            what = f"<IsFraserMode> {unquoted_text(mode)[:40]!r} cannot be read; valid: 1"
            self.problems.wrong(what, self._at(mode))
            return None
        return self._coefficients(projection, said, [d or 0 for d in degree], stated)

    def _coefficients(
        self, projection: MmviiProjection, said: str, degree: list[int], stated: Element
    ) -> dict[str, float] | None:
        before = self.problems.count
        missing = {
            **{f"K{i}": "Radial" for i in range(1, degree[0] + 1)},
            **{f"p{i}": "Decentric" for i in range(1, 2 * degree[1] + 1)},
            **({"b1": "Polynomial", "b2": "Polynomial"} if degree[2] else {}),
        }
        values: dict[str, float] = {}
        distortion = self.element.first("Distorsion")
        for part in [] if distortion is None else distortion.children:
            for entry in part.children:
                tag, where = entry.tag, self._at(entry)
                value = self.problems.field(unquoted_text(entry), f"<{tag[:40]}>", where).number()
                monomial = part.tag == "Polynomial" and re.fullmatch(r"[xy]_\d+_\d+", tag)
                if missing.pop(tag, None) != part.tag and not (monomial and degree[2] > 1):
                    what = f"<{tag[:40]}> is given twice or lies beyond <Degree> "
                    self.problems.wrong(what + " ".join(map(str, degree)), where)
                elif tag in projection.coefficients:
                    ours, sign = projection.coefficients[tag]
                    values[ours] = sign * (0.0 if is_unread(value) else value)
                elif value:
                    valid = ", ".join(projection.coefficients) or "none"
                    what = f"the coefficient <{tag}> of projection {said} cannot be read unless it "
                    self.problems.wrong(f"{what}is 0; coefficients that can: {valid}", where)
        if missing:
            what = f"<Degree> {' '.join(map(str, degree))} needs <{', '.join(missing)}>"
            self.problems.wrong(what, self._at(distortion or stated))
        return None if self.problems.count > before else values


def matching_files(path: Path, pattern: str) -> list[Path]:
    """Return the files of a folder that have a pattern, or the file.

    Raises:
        InputError: the folder has none.
    """
    if not path.is_dir():
        return [path]
    found = sorted(path.glob(pattern))
    if not found:
        raise InputError(Problem(f"has no file {pattern.replace('*', '…')}", str(path)))
    return found


def _entries(element: Element, file: str, problems: Problems) -> Iterator[Element]:
    measures = element.first("Measures")
    if measures is None:
        problems.wrong("has no <Measures>", f"{file}:{element.line}")
        return
    number = measures.first("Nb")
    found = list(measures.all("el"))
    if number is not None and unquoted_text(number) != str(len(found)):
        what = f"<Nb> is {unquoted_text(number)[:40]!r}, but there are {len(found)} measures <el>"
        problems.wrong(what, f"{file}:{number.line}")
    yield from found


def _numbers(
    element: Element, tag: str, size: int, file: str, problems: Problems
) -> tuple[float, ...]:
    child = element.first(tag)
    line = element.line if child is None else child.line
    return problems.field(unquoted_text(child), f"<{tag}>", f"{file}:{line}").numbers(size)


def add_control(path: Path, network: Network, problems: Problems, factor: float) -> None:
    """Add the points of ground control of a file or a folder.

    Points of zero variances are held; those without variances have approximate coordinates.

    Args:
        path: a file MesGCP-….xml, or a folder of them.
        network: the network.
        problems: where problems go.
        factor: factor of the standard deviations.
    """
    for file in matching_files(path, CONTROL_PATTERN):
        with problems.collect(file.name):
            _control_of(file, network, problems, factor)


def _control_of(file: Path, network: Network, problems: Problems, factor: float) -> None:
    points = mmvii_contents(file, "SetGCP", "Measures")
    for entry in _entries(points, file.name, problems):
        where = f"{file.name}:{entry.line}"
        name = unquoted_text(entry.first("Name"))
        at = _numbers(entry, "Pt", 3, file.name, problems)
        tag = next(
            (t for t in ("Sigma2", OPTIONAL_PREFIX + "Sigma2") if entry.first(t) is not None), None
        )
        given = None if tag is None else _numbers(entry, tag, 6, file.name, problems)
        if is_unread(at) or (given is not None and is_unread(given)):
            continue
        with problems.collect(where):
            if given is None:
                network.add_point(name, at)
                continue
            if not any(given):
                network.add_point(name, at, fixed="xyz")
                continue
            xx, xy, xz, yy, yz, zz = (factor * factor * v for v in given)
            matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            if min(xx, yy, zz) <= 0 or np.linalg.eigvalsh(matrix)[0] <= 0:
                what = f"<{tag}> is no matrix of variances; valid: positive ones, or all 0 to hold"
                problems.wrong(what, where)
                continue
            network.add_point(name, at)
            if xy or xz or yz:
                network.add(ControlPoint(name, at, covariance=matrix, source=where))
            else:
                sigma = (xx**0.5, yy**0.5, zz**0.5)
                network.add(ControlPoint(name, at, sigma=sigma, source=where))


def add_measures(
    path: Path, network: Network, images: ImagePoints, problems: Problems, factor: float
) -> None:
    """Gather the measurements in images of a file or a folder, and add points that are new.

    Args:
        path: a file MesIm-….xml, or a folder of them.
        network: the network.
        images: where the measurements go.
        problems: where problems go.
        factor: factor of the standard deviations.
    """
    whole = not problems.count
    for file in matching_files(path, MEASURES_PATTERN):
        with problems.collect(file.name):
            _measures_of(file, network, images, problems, factor, whole)


def _measures_of(
    file: Path,
    network: Network,
    images: ImagePoints,
    problems: Problems,
    factor: float,
    whole: bool,
) -> None:
    """Gather the measurements of an image; ``whole``: all orientations of the folder are read."""
    image = mmvii_contents(file, "SetMesIm", "Measures")
    named = image.first("NameIm")
    photo = unquoted_text(named)
    if photo not in network.photos:
        if whole:
            what = f"image {photo[:80]!r} has no orientation; its measurements need one"
            problems.wrong(what, f"{file.name}:{(named or image).line}")
        return
    for entry in _entries(image, file.name, problems):
        where = f"{file.name}:{entry.line}"
        name = unquoted_text(entry.first("Name"))
        xy = _numbers(entry, "Pt", 2, file.name, problems)
        variances = _numbers(entry, "Sigma2", 3, file.name, problems)
        if is_unread(xy, variances):
            continue
        xx, mixed, yy = variances
        if mixed or min(xx, yy) <= 0:
            what = "<Sigma2> must have positive variances xx, yy and the covariance xy 0"
            problems.wrong(what, where)
            continue
        if name not in network.points:
            with problems.collect(where):
                network.add_point(name)
        sigma = (factor * xx**0.5, factor * yy**0.5)
        images.add(photo, name, (xy[0] + 0.5, -xy[1] - 0.5), sigma, where)
