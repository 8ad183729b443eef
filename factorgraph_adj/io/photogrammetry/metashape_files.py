"""Files of Metashape and PhotoScan: ZIP archives, the chunk and its frame, tie points (PLY).

Three layouts exist. A ``.psz`` is a ZIP archive with one ``doc.xml`` and the tie points as PLY
files beside it. A ``.psx`` is a small XML file that points to ``NAME.files/project.zip``, whose
``doc.xml`` points to one archive for each chunk, that to one for each frame, and that to one with
the tie points. An exported ``.xml`` is a chunk alone.
"""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ...errors import InputError, Problem, known
from ...files import inside, opened, refuse_growth, unpacked
from ..format_options import option_text
from ..xml_files import Element, parse_xml, read_xml

MAX_HEADER_BYTES = 10_000
"""Largest number of bytes of a header."""
DOCUMENT_NAME = "doc.xml"
PROPERTY_TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
"""Types of properties by their names in a header."""
BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}


@dataclass(frozen=True)
class ZipArchive:
    """A ZIP archive."""

    path: Path
    """The file."""
    _unpacked: dict[str, int] = field(default_factory=dict, compare=False, repr=False)
    """Sizes of the files inside that have been read, bytes."""

    def where(self, member: str) -> str:
        """Return the name of a file inside, for messages."""
        return f"{self.path.name}/{member}"

    def names(self) -> list[str]:
        """Return the names of the files inside.

        Raises:
            InputError: the file is no ZIP archive.
        """
        try:
            with opened(self.path) as stream, zipfile.ZipFile(stream) as archive:
                return archive.namelist()
        except (OSError, zipfile.BadZipFile, ValueError, NotImplementedError) as error:
            raise InputError(Problem(f"is no ZIP archive: {error}", str(self.path))) from None

    def read(self, member: str) -> bytes:
        """Return the content of a file inside.

        Raises:
            InputError: the file is no ZIP archive, has no such member, or the member is damaged;
                or it, or all members read so far, are larger than `refuse_growth` allows.
        """
        where = self.where(member)
        try:
            with opened(self.path) as stream, zipfile.ZipFile(stream) as archive:
                size = archive.getinfo(member)
                whole = self.path.stat().st_size
                stored = min(size.compress_size, whole)
                refuse_growth(size.file_size, stored, where)
                self._unpacked[member] = size.file_size  # many small files fill the memory too
                refuse_growth(sum(self._unpacked.values()), whole, self.path.name)
                with archive.open(member) as inner:
                    return unpacked(inner, stored, where)
        except KeyError:
            raise InputError(Problem("the archive has no such file", where)) from None
        except (
            OSError,
            EOFError,
            ValueError,
            RuntimeError,
            NotImplementedError,
            OverflowError,
            zipfile.BadZipFile,
            zlib.error,
        ) as error:
            raise InputError(Problem(f"is damaged, cannot be unpacked: {error}", where)) from None


@dataclass(frozen=True)
class ElementPlace:
    """An element and the file that contains it."""

    element: Element
    """The element."""
    file: str
    """Name of the file in messages."""
    archive: ZipArchive | None = None
    """Archive that holds the files beside it; None for an exported file."""

    def where(self, element: Element) -> str:
        """Return file:line of an element of this file."""
        return f"{self.file}:{element.line}"

    def read(self, element: Element) -> tuple[bytes, str]:
        """Return content and name of the file that an element names by its path.

        Raises:
            InputError: the element names no file, or the file is missing or damaged.
        """
        name = element.attributes.get("path")
        if name is None or self.archive is None:
            what = f"<{element.tag}> names no file that is at hand: read the project, no export"
            raise InputError(Problem(what, self.where(element)))
        return self.archive.read(name), self.archive.where(name)

    def follow(self, element: Element) -> ElementPlace:
        """Return the element itself, or the root of the archive that it names by its path.

        Raises:
            InputError: the archive is missing or damaged.
        """
        link = element.attributes.get("path")
        if link is None or self.archive is None or not link.lower().endswith(".zip"):
            return ElementPlace(element, self.file, self.archive)
        found = inside(self.archive.path.parent, link, self.where(element))
        if not found.exists():
            raise InputError(Problem(f"the file {link} is missing", self.where(element)))
        return _document(found)


@dataclass(frozen=True)
class MetashapeChunk:
    """The parts of a chunk."""

    chunk: ElementPlace
    """Sensors, cameras, markers, reference system, transformation."""
    frame: ElementPlace | None
    """Photos, and locations of markers in photos; None in files that have none."""
    ties: ElementPlace | None
    """Tie points and their projections; None in files that have none."""
    version: str
    """Version of the document."""


def open_chunk(path: Path, wanted: str | int | None) -> MetashapeChunk:
    """Open a chunk of a project or of an exported file.

    Args:
        path: a .psz, .psx or .xml file.
        wanted: label or number of the chunk; None: the only one, or the active one.

    Raises:
        InputError: the file is none of Metashape's, is damaged, or the chunk does not exist.
    """
    suffix = path.suffix.lower()
    place = _document(path) if suffix == ".psz" else ElementPlace(read_xml(path), path.name)
    root = place.element
    if root.tag != "document":
        what = f"has the element <{root.tag}> where Metashape writes <document>"
        raise InputError(Problem(what, place.where(root)))
    version = root.attributes.get("version", "")
    if suffix == ".psx":
        place = _project(path, place)
    chunk = _chunk(place, wanted)
    frame = _frame(chunk)
    return MetashapeChunk(chunk, frame, None if frame is None else _ties(frame), version)


def _document(path: Path) -> ElementPlace:
    """Return the document of an archive."""
    archive = ZipArchive(path)
    where = archive.where(DOCUMENT_NAME)
    return ElementPlace(parse_xml(archive.read(DOCUMENT_NAME), where), where, archive)


def _project(path: Path, place: ElementPlace) -> ElementPlace:
    """Return the document that a .psx file points to."""
    link = place.element.attributes.get("path") or "{projectname}.files/project.zip"
    name = link.replace("{projectname}", path.stem)
    where = place.where(place.element)
    found = inside(path.parent, name, where)
    if not found.exists():
        what = f"the folder of the project is missing: {name}; copy it together with the .psx"
        raise InputError(Problem(what, where))
    return _document(found)


def _chunk(place: ElementPlace, wanted: str | int | None) -> ElementPlace:
    """Return the chunk that is asked for."""
    root = place.element
    listed = root.first("chunks")
    found = [place.follow(c) for c in (listed or root).all("chunk")]
    numbers = [c.attributes.get("id", "0") for c in (listed or root).all("chunk")]
    labels = [c.element.attributes.get("label", "") for c in found]
    if wanted is None and len(found) > 1 and listed is not None:
        active = listed.attributes.get("active_id")
        wanted = None if active is None else int(active) if active.isdigit() else active
    if wanted is None:
        fitting = list(range(len(found)))
    elif isinstance(wanted, str):
        fitting = [i for i, label in enumerate(labels) if label == wanted]
    else:
        fitting = [i for i, n in enumerate(numbers) if n == str(wanted)]
    if len(fitting) == 1:
        return found[fitting[0]]
    if not found:
        raise InputError(Problem("has no chunk", place.where(root)))
    valid = known([f"{label!r} ({n})" for label, n in zip(labels, numbers, strict=True)])
    what = "has several chunks" if wanted is None else f"has no single chunk {wanted!r}"
    raise InputError(
        Problem(
            f"{what}; choose one with {option_text('chunk', 'NAME')}; valid: {valid}", place.file
        )
    )


def _frame(chunk: ElementPlace) -> ElementPlace | None:
    """Return the only frame of a chunk."""
    frames = chunk.element.first("frames")
    found = [] if frames is None else list(frames.all("frame"))
    if len(found) > 1:
        what = f"the chunk has {len(found)} frames (epochs); read one: delete the others"
        raise InputError(Problem(what, chunk.where(found[1])))
    return chunk.follow(found[0]) if found else None


def _ties(frame: ElementPlace) -> ElementPlace | None:
    """Return the element that lists projections of tie points; dense clouds have none."""
    for tag in ("tie_points", "point_cloud"):
        for element in frame.element.all(tag):
            place = frame.follow(element)
            if place.element.first("projections") is not None:
                return place
    return None


def read_ply_vertices(content: bytes, where: str) -> dict[str, npt.NDArray[np.generic]]:
    """Return the columns of the first element, by property, (n,) each.

    Args:
        content: the file.
        where: its name in messages.

    Raises:
        InputError: the file is no PLY file, has a list where numbers are expected, or is cut.
    """

    def refuse(what: str) -> InputError:
        return InputError(Problem(what, where))

    end = content.find(b"end_header", 0, MAX_HEADER_BYTES)
    if not content.startswith(b"ply") or end < 0:
        raise refuse("is no PLY file: it must begin with 'ply' and have a line end_header")
    start = content.find(b"\n", end) + 1
    lines = [line.split() for line in content[:end].decode("latin-1").splitlines()]
    order, count = "", -1
    properties: list[tuple[str, str]] = []
    elements = 0
    for words in lines:
        if words[:1] == ["format"] and len(words) == 3 and words[1] in BYTE_ORDERS:
            order = words[1]
        elif words[:1] == ["element"]:
            elements += 1
            if elements == 1 and len(words) == 3 and words[2].isascii() and words[2].isdigit():
                count = int(words[2][:18])
        elif words[:1] == ["property"] and elements == 1:
            if len(words) != 3 or words[1] not in PROPERTY_TYPES or words[2] in dict(properties):
                raise refuse(f"property {' '.join(words[1:])!r} is none of a table of numbers")
            properties.append((words[2], PROPERTY_TYPES[words[1]]))
    if not order or count < 0 or not properties or not start:
        raise refuse("has no complete header: format, element vertex, properties, end_header")
    if order == "ascii":
        return _ascii_columns(content[start:], properties, count, where)
    kind = np.dtype([(name, BYTE_ORDERS[order] + t) for name, t in properties])
    if len(content) - start < count * kind.itemsize:
        what = f"is cut: {count} vertices of {kind.itemsize} bytes, {len(content) - start} bytes"
        raise refuse(what)
    table = np.frombuffer(content, kind, count, start)
    return {name: table[name] for name, _ in properties}


def _ascii_columns(
    body: bytes, properties: list[tuple[str, str]], count: int, where: str
) -> dict[str, npt.NDArray[np.generic]]:
    words = body.split()
    if len(words) < count * len(properties):
        what = f"is cut: {count} vertices of {len(properties)} numbers, {len(words)} numbers"
        raise InputError(Problem(what, where))
    try:
        table = np.array([float(w) for w in words[: count * len(properties)]])
    except ValueError as error:
        raise InputError(Problem(f"is not a table of numbers: {error}", where)) from None
    table = table.reshape(count, len(properties))
    return {name: table[:, i] for i, (name, _) in enumerate(properties)}
