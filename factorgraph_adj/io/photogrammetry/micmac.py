"""Reader of MicMac: a folder of orientations with calibrations, ground control, measurements.

A folder ``Ori-NAME`` has ``Orientation-IMAGE.xml`` for each image and ``AutoCal….xml`` for each
camera. The distortion corrects measured pixels (convention DistM2C), y down, about a centre C:

    ideal = m + (m − C) (c1 r² + c2 r⁴ + c3 r⁶) + (P1 (r² + 2x²) + 2 P2 x y + b1 x + b2 y,
            P2 (r² + 2y²) + 2 P1 x y),  (x, y) = m − C,    ideal = PP + F (X/Z, Y/Z)

Rotations are those from the camera (x right, y down, z ahead) to the object. Pixels count from the
centre of the first one, so that half a pixel is added. Folders of MMVII, the second MicMac, are
read by `micmac_mmvii`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...errors import InputError, Problem
from ...models.normalised_lens import CentredBrownLens
from ...network.network import Network
from ...observations import ControlPoint
from ...types import Array
from ..format_reader import NetworkReader, Reader
from ..source import Problems, is_unread
from ..xml_files import Element, read_xml
from . import micmac_mmvii
from .block_source import ImagePoints, add_pixel_camera, rotation_and_scale

DISTORTION_CONVENTION = "eConvApero_DistM2C"
"""The convention that is read; it is MicMac's own."""
ORI_PREFIX = "Orientation-"


def read_micmac(
    path: str | Path,
    *,
    control: str | Path | None = None,
    measures: str | Path | None = None,
    calibration: Sequence[str] = (),
    sigma_px: float = 1.0,
    sigma_control: float = 1.0,
) -> Network:
    """Read orientations of MicMac or MMVII with ground control.

    Tie points of MicMac lie in binary files of pairs, which are not read: the network has the
    points of the files of ground control. Measured points without coordinates are points of
    unknown place.

    Args:
        path: the folder Ori-NAME, or one Orientation-….xml in it; of MMVII, a folder with
            Ori-PerspCentral-….xml, or one of these.
        control: file of coordinates (DicoAppuisFlottant), metres; of MMVII, MesGCP-….xml or a
            folder of them.
        measures: file of image measurements (SetOfMesureAppuisFlottants); of MMVII, MesIm-….xml
            or a folder of them, one for each image.
        calibration: unknown parameters of the cameras, of c, x0, y0, k1, k2, k3, p1, p2, b1, b2,
            xd, yd (MMVII: without xd, yd); the files do not say what is unknown.
        sigma_px: standard deviation of image measurements, pixels; the files have none. Of MMVII,
            the factor of the standard deviations of its files.
        sigma_control: factor of the Incertitude of control points, which gives metres; of MMVII,
            of the square roots of Sigma2.

    Raises:
        InputError: a file is missing or has problems, each with file and line.
    """
    for name, value in (("sigma_px", sigma_px), ("sigma_control", sigma_control)):
        if not value > 0:
            raise InputError(f"{name} must be greater than zero, not {value}")
    source = Path(path)
    folder = source if source.is_dir() else source.parent
    problems = Problems()
    network = Network(folder.name)
    images = ImagePoints(problems)
    if _is_mmvii_folder(source):
        micmac_mmvii.MmviiOrientations(folder, network, problems, tuple(calibration)).read()
        if control is not None:
            micmac_mmvii.add_control(Path(control), network, problems, sigma_control)
        if measures is not None:
            micmac_mmvii.add_measures(Path(measures), network, images, problems, sigma_px)
    else:
        _Orientations(folder, network, problems, tuple(calibration)).read()
        if control is not None:
            _control(Path(control), network, problems, sigma_control)
        if measures is not None:
            _measures(Path(measures), network, images, problems, sigma_px)
    images.into(network)
    problems.finish(network)
    if not network.observations:
        network.datum = "free"
    return network


def is_micmac(path: Path) -> bool:
    """Tell whether a path is a folder of orientations of MicMac or MMVII, or one of its files."""
    if path.is_dir():
        return any(any(path.glob(p + "*.xml")) for p in (ORI_PREFIX, micmac_mmvii.PREFIX))
    return path.name.startswith((ORI_PREFIX, micmac_mmvii.PREFIX))


def _is_mmvii_folder(source: Path) -> bool:
    """Tell whether a folder or a file of it has orientations of MMVII.

    Raises:
        InputError: a folder has those of both.
    """
    if not source.is_dir():
        return source.name.startswith(micmac_mmvii.PREFIX)
    second = any(source.glob(micmac_mmvii.PREFIX + "*.xml"))
    if second and any(source.glob(ORI_PREFIX + "*.xml")):
        what = f"has orientations of MicMac, {ORI_PREFIX}….xml, and of MMVII, {micmac_mmvii.PREFIX}"
        raise InputError(Problem(what + "….xml; name one file of the wanted kind", str(source)))
    return second


def _words(element: Element | None) -> list[str]:
    return [] if element is None else element.text.split()


def _element_with_tag(root: Element, tag: str) -> Element | None:
    """Return the element of a name: the root, or a child of the root."""
    return root if root.tag == tag else root.first(tag)


@dataclass
class _Orientations:
    """The orientations of a folder while they are read."""

    folder: Path
    network: Network
    problems: Problems
    free: tuple[str, ...]
    cameras: dict[str, str] = field(default_factory=dict)
    """Names of cameras by the names of their files."""

    def read(self) -> None:
        """Add all photos and their cameras."""
        files = sorted(self.folder.glob(ORI_PREFIX + "*.xml"))
        if not files:
            what = f"has no file {ORI_PREFIX}….xml or {micmac_mmvii.PREFIX}….xml; name a folder of "
            what += "orientations, Ori-…"
            raise InputError(Problem(what, str(self.folder)))
        for file in files:
            try:
                self._photo(file)
            except InputError as error:
                # A calibration is read with each of its photos: its problems count once.
                told = self.problems.problems
                told += [p for p in error.problems if p not in told]

    def _photo(self, file: Path) -> None:
        root = read_xml(file)
        element = _element_with_tag(root, "OrientationConique")
        where = f"{file.name}:{root.line}"
        if element is None:
            raise InputError(Problem("has no <OrientationConique>", where))
        projection = element.first("TypeProj")
        if projection is not None and projection.text.strip() != "eProjStenope":
            said = projection.text.strip()
            what = f"projection {said!r} cannot be read; valid: eProjStenope"
            raise InputError(Problem(what, f"{file.name}:{projection.line}"))
        affine = element.first("OrIntImaM2C")
        if affine is not None:
            texts = [t for c in affine.children for t in c.text.split()]
            if self.problems.field(texts, "<OrIntImaM2C>", where).numbers(6) != (0, 0, 1, 0, 0, 1):
                what = "an interior orientation OrIntImaM2C of each image cannot be read"
                raise InputError(Problem(what, f"{file.name}:{affine.line}"))
        parts = ("ConvOri", "Externe")
        conventions = [c for part in parts for c in self._conventions(element, part)]
        if any(c != DISTORTION_CONVENTION for c in conventions):
            said = ", ".join(conventions)
            what = f"convention {said} cannot be read; valid: {DISTORTION_CONVENTION}"
            raise InputError(Problem(what, where))
        camera = self._camera(element, file)
        outer = element.first("Externe")
        if outer is None:
            raise InputError(Problem("has no <Externe>", where))
        at_outer = f"{file.name}:{outer.line}"
        centre = self.problems.field(_words(outer.first("Centre")), "<Centre>", at_outer).numbers(3)
        offset = outer.first("OffsetCentre")
        shift = (0.0, 0.0, 0.0)
        if offset is not None:
            found = self.problems.field(_words(offset), "<OffsetCentre>", at_outer).numbers(3)
            shift = shift if is_unread(found) else (found[0], found[1], found[2])
        matrix = self._rotation(outer, file)
        if camera is None or is_unread(centre) or matrix is None:
            return
        at = [a + b for a, b in zip(centre, shift, strict=True)]
        name = file.name.removeprefix(ORI_PREFIX).removesuffix(".xml")
        with self.problems.collect(where):
            self.network.add_photo(name, camera, position=at, rotation=matrix)

    def _conventions(self, element: Element, part: str) -> list[str]:
        inner = element.first(part)
        found = None if inner is None else inner.first("KnownConv")
        return [] if found is None else [found.text.strip()]

    def _rotation(self, outer: Element, file: Path) -> Array | None:
        where = f"{file.name}:{outer.line}"
        coded = outer.first("ParamRotation")
        matrix = None if coded is None else coded.first("CodageMatr")
        if matrix is None:
            raise InputError(Problem("has no rotation matrix <CodageMatr>", where))
        where = f"{file.name}:{matrix.line}"
        rows = [
            self.problems.field(_words(matrix.first(tag)), f"<{tag}>", where).numbers(3)
            for tag in ("L1", "L2", "L3")
        ]
        if is_unread(*rows):
            return None
        split = rotation_and_scale(np.array(rows))
        if split is None or abs(split[1] - 1) > 1e-3:
            raise InputError(Problem("<CodageMatr> is no rotation matrix", where))
        return np.asarray(split[0])

    def _camera(self, element: Element, file: Path) -> str | None:
        """Return the name of the camera of an image, None if it has problems."""
        inner = element.first("Interne")
        if inner is not None:
            key, where, calibrated = file.name, file.name, inner
        else:
            link = element.first("FileInterne")
            if link is None or not link.text.strip():
                what = "has neither <Interne> nor <FileInterne>"
                raise InputError(Problem(what, f"{file.name}:{element.line}"))
            key = link.text.strip().replace("\\", "/").rsplit("/", 1)[-1]
            if key in self.cameras:
                return self.cameras[key] if self.cameras[key] in self.network.cameras else None
            where = key
            if not (self.folder / key).is_file():
                what = f"the calibration {key!r} is no file of this folder"
                raise InputError(Problem(what, f"{file.name}:{link.line}"))
            root = read_xml(self.folder / key)
            found = _element_with_tag(root, "CalibrationInternConique")
            if found is None:
                what = "has no <CalibrationInternConique>"
                raise InputError(Problem(what, f"{key}:{root.line}"))
            calibrated = found
        stem = key.removesuffix(".xml")
        name = stem.removeprefix("AutoCal_").removeprefix("AutoCal") or stem or "camera"
        self.cameras[key] = name
        self._calibration(name, calibrated, f"{where}:{calibrated.line}")
        return name if name in self.network.cameras else None

    def _calibration(self, name: str, element: Element, where: str) -> None:
        convention = element.first("KnownConv")
        if convention is not None and convention.text.strip() != DISTORTION_CONVENTION:
            said = convention.text.strip()
            what = f"convention {said!r} cannot be read; valid: {DISTORTION_CONVENTION}"
            raise InputError(Problem(what, where))
        for tag in ("OrIntGlob", "CorrectionRefractionAPosteriori", "ParamAF"):
            if element.first(tag) is not None:
                raise InputError(Problem(f"<{tag}> cannot be read", where))
        problems = self.problems
        pp = problems.field(_words(element.first("PP")), "<PP>", where).numbers(2)
        size = problems.field(_words(element.first("SzIm")), "<SzIm>", where).numbers(2)
        focal = element.first("F")
        text = None if focal is None else focal.text.strip()
        c = problems.field(text, "<F>", where).number(above=0.0)
        distortion = _distortion(element, problems, where)
        if is_unread(pp, size, c) or distortion is None:
            return
        values, centre = distortion
        values |= {"c": c, "x0": pp[0] + 0.5, "y0": -pp[1] - 0.5}
        if centre is not None:
            values |= {"xd": centre[0] - pp[0], "yd": -(centre[1] - pp[1])}
        sides = (size[0], size[1])
        lens = CentredBrownLens(residuals="ideal")
        with problems.collect(where):
            add_pixel_camera(self.network, name, lens, values, size=sides, free=self.free)


def _distortion(
    element: Element, problems: Problems, where: str
) -> tuple[dict[str, float], tuple[float, ...] | None] | None:
    """Return parameters, y up, and the centre, y down; None after a problem."""
    models = [m for d in element.all("CalibDistortion") for m in d.children]
    if len(models) != 1:
        problems.wrong(f"has {len(models)} distortions; valid: one", where)
        return None
    model = models[0]
    if model.tag == "ModNoDist":
        return {}, None
    radial = model if model.tag == "ModRad" else model.first("RadialePart")
    if model.tag not in ("ModRad", "ModPhgrStd") or radial is None:
        what = f"distortion <{model.tag}> cannot be read; valid: ModNoDist, ModRad, ModPhgrStd"
        problems.wrong(what, where)
        return None
    centre = problems.field(_words(radial.first("CDist")), "<CDist>", where).numbers(2)
    texts = [c.text.strip() for c in radial.all("CoeffDist")]
    found = problems.field(texts, "<CoeffDist>", where).numbers(len(texts))
    if is_unread(centre, found):
        return None
    if any(found[3:]):
        problems.wrong("has more than three radial coefficients; valid: k1, k2, k3", where)
        return None
    values = dict(zip(("k1", "k2", "k3"), found, strict=False))
    for tag, ours, sign in (("P1", "p1", 1), ("P2", "p2", -1), ("b1", "b1", 1), ("b2", "b2", -1)):
        child = model.first(tag) if model is not radial else None
        if child is not None:
            value = problems.field(child.text.strip(), f"<{tag}>", where).number()
            values[ours] = sign * (0.0 if is_unread(value) else value)
    return values, centre


def _control(path: Path, network: Network, problems: Problems, factor: float) -> None:
    """Add control points with their uncertainties; those of zero or less are check points."""
    root = read_xml(path)
    dictionary = _element_with_tag(root, "DicoAppuisFlottant")
    if dictionary is None:
        problems.wrong("has no <DicoAppuisFlottant>", f"{path.name}:{root.line}")
        return
    for entry in dictionary.all("OneAppuisDAF"):
        where = f"{path.name}:{entry.line}"
        named = entry.first("NamePt")
        name = "" if named is None else named.text.strip()
        at = problems.field(_words(entry.first("Pt")), "<Pt>", where).numbers(3)
        given = entry.first("Incertitude")
        texts = ["1", "1", "1"] if given is None else _words(given)
        sigma = problems.field(texts, "<Incertitude>", where).numbers(3)
        if is_unread(at, sigma):
            continue
        with problems.collect(where):
            if min(sigma) <= 0:
                network.add_point(name, check=at)
                continue
            network.add_point(name, at)
            scaled = tuple(factor * s for s in sigma)
            network.add(ControlPoint(name, at, sigma=scaled, source=where))


def _measures(
    path: Path, network: Network, images: ImagePoints, problems: Problems, sigma: float
) -> None:
    """Gather image measurements, and add the points among them that are new."""
    root = read_xml(path)
    whole = _element_with_tag(root, "SetOfMesureAppuisFlottants")
    if whole is None:
        problems.wrong("has no <SetOfMesureAppuisFlottants>", f"{path.name}:{root.line}")
        return
    oriented = not problems.count
    for image in whole.all("MesureAppuiFlottant1Im"):
        named = image.first("NameIm")
        photo = "" if named is None else named.text.strip()
        if photo not in network.photos:
            if oriented:
                what = f"image {photo!r} has no orientation; its measurements need one"
                problems.wrong(what, f"{path.name}:{image.line}")
            continue
        for entry in image.all("OneMesureAF1I"):
            where = f"{path.name}:{entry.line}"
            point = entry.first("NamePt")
            name = "" if point is None else point.text.strip()
            xy = problems.field(_words(entry.first("PtIm")), "<PtIm>", where).numbers(2)
            if is_unread(xy):
                continue
            if name not in network.points:
                with problems.collect(where):
                    network.add_point(name)
            images.add(photo, name, (xy[0] + 0.5, -xy[1] - 0.5), (sigma,), where)


READER = Reader(
    "micmac",
    (".xml",),
    "orientations of MicMac and MMVII",
    NetworkReader(read_micmac),
    folders=True,
    recognises=is_micmac,
)
