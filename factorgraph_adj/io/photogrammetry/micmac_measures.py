"""Ground control of MMVII (MesGCP-….xml) and its measurements in images (MesIm-….xml).

Source: MicMac (GitHub: micmacIGN/micmac), MMVII/src/Sensors/Measures.cpp (cMes1Gnd3D, cMesIm1Pt):
Sigma2 are variances, xx xy xz yy yz zz of points (metres²), xx xy yy of measurements (pixels²).
A point without them is free: its coordinates are approximate.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ...errors import InputError, Problem
from ...network.network import Network
from ...observations import ControlPoint
from ..xml_tree import Element
from .micmac_mmvii import OPTIONAL, contents, text_of
from .reading import ImagePoints, Reading

CONTROL = "MesGCP*.xml"
"""Pattern of the files of ground control of a folder."""
MEASURES = "MesIm-*.xml"
"""Pattern of the files of measurements of a folder, one for each image."""


def files_of(path: Path, pattern: str) -> list[Path]:
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


def _entries(element: Element, file: str, reading: Reading) -> Iterator[Element]:
    measures = element.first("Measures")
    if measures is None:
        reading.wrong("has no <Measures>", f"{file}:{element.line}")
        return
    number = measures.first("Nb")
    found = list(measures.all("el"))
    if number is not None and text_of(number) != str(len(found)):
        what = f"<Nb> is {text_of(number)[:40]!r}, but there are {len(found)} measures <el>"
        reading.wrong(what, f"{file}:{number.line}")
    yield from found


def _numbers(
    element: Element, tag: str, size: int, file: str, reading: Reading
) -> tuple[float, ...] | None:
    child = element.first(tag)
    line = element.line if child is None else child.line
    return reading.numbers(text_of(child).split(), size, f"<{tag}>", f"{file}:{line}")


def add_control(path: Path, network: Network, reading: Reading, factor: float) -> None:
    """Add the points of ground control of a file or a folder.

    Points of zero variances are held; those without variances have approximate coordinates.

    Args:
        path: a file MesGCP-….xml, or a folder of them.
        network: the network.
        reading: where problems go.
        factor: factor of the standard deviations.
    """
    for file in files_of(path, CONTROL):
        with reading.at(file.name):
            _control_of(file, network, reading, factor)


def _control_of(file: Path, network: Network, reading: Reading, factor: float) -> None:
    points = contents(file, "SetGCP", "Measures")
    for entry in _entries(points, file.name, reading):
        where = f"{file.name}:{entry.line}"
        name = text_of(entry.first("Name"))
        at = _numbers(entry, "Pt", 3, file.name, reading)
        tag = next((t for t in ("Sigma2", OPTIONAL + "Sigma2") if entry.first(t) is not None), None)
        given = None if tag is None else _numbers(entry, tag, 6, file.name, reading)
        if at is None or (tag is not None and given is None):
            continue
        with reading.at(where):
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
                reading.wrong(what, where)
                continue
            network.add_point(name, at)
            if xy or xz or yz:
                network.add(ControlPoint(name, at, covariance=matrix, source=where))
            else:
                sigma = (xx**0.5, yy**0.5, zz**0.5)
                network.add(ControlPoint(name, at, sigma=sigma, source=where))


def add_measures(
    path: Path, network: Network, images: ImagePoints, reading: Reading, factor: float
) -> None:
    """Gather the measurements in images of a file or a folder, and add points that are new.

    Args:
        path: a file MesIm-….xml, or a folder of them.
        network: the network.
        images: where the measurements go.
        reading: where problems go.
        factor: factor of the standard deviations.
    """
    whole = not reading.problems
    for file in files_of(path, MEASURES):
        with reading.at(file.name):
            _measures_of(file, network, images, reading, factor, whole)


def _measures_of(
    file: Path,
    network: Network,
    images: ImagePoints,
    reading: Reading,
    factor: float,
    whole: bool,
) -> None:
    """Gather the measurements of an image; ``whole``: all orientations of the folder are read."""
    image = contents(file, "SetMesIm", "Measures")
    named = image.first("NameIm")
    photo = text_of(named)
    if photo not in network.photos:
        if whole:
            what = f"image {photo[:80]!r} has no orientation; its measurements need one"
            reading.wrong(what, f"{file.name}:{(named or image).line}")
        return
    for entry in _entries(image, file.name, reading):
        where = f"{file.name}:{entry.line}"
        name = text_of(entry.first("Name"))
        xy = _numbers(entry, "Pt", 2, file.name, reading)
        variances = _numbers(entry, "Sigma2", 3, file.name, reading)
        if xy is None or variances is None:
            continue
        xx, mixed, yy = variances
        if mixed or min(xx, yy) <= 0:
            what = "<Sigma2> must have positive variances xx, yy and the covariance xy 0"
            reading.wrong(what, where)
            continue
        if name not in network.points:
            with reading.at(where):
                network.add_point(name)
        sigma = (factor * xx**0.5, factor * yy**0.5)
        images.add(photo, name, (xy[0] + 0.5, -xy[1] - 0.5), sigma, where)
