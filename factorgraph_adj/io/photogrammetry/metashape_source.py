"""Files of Metashape and PhotoScan: the chunk, its frame and its tie points, wherever they lie.

Three layouts exist. A ``.psz`` is a ZIP archive with one ``doc.xml`` and the tie points as PLY
files beside it. A ``.psx`` is a small XML file that points to ``NAME.files/project.zip``, whose
``doc.xml`` points to one archive for each chunk, that to one for each frame, and that to one with
the tie points. An exported ``.xml`` is a chunk alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ...errors import InputError, Problem, known
from ...files import inside
from ..xml_tree import Element, parse_xml, read_xml
from .archive import Archive

DOCUMENT = "doc.xml"


@dataclass(frozen=True)
class Place:
    """An element and the file that it stands in."""

    element: Element
    """The element."""
    file: str
    """Name of the file in messages."""
    archive: Archive | None = None
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

    def follow(self, element: Element) -> Place:
        """Return the element itself, or the root of the archive that it names by its path.

        Raises:
            InputError: the archive is missing or damaged.
        """
        link = element.attributes.get("path")
        if link is None or self.archive is None or not link.lower().endswith(".zip"):
            return Place(element, self.file, self.archive)
        found = inside(self.archive.path.parent, link, self.where(element))
        if not found.exists():
            raise InputError(Problem(f"the file {link} is missing", self.where(element)))
        return _document(found)


@dataclass(frozen=True)
class Chunk:
    """The parts of a chunk."""

    chunk: Place
    """Sensors, cameras, markers, reference system, transformation."""
    frame: Place | None
    """Photos, and locations of markers in photos; None in files that have none."""
    ties: Place | None
    """Tie points and their projections; None in files that have none."""
    version: str
    """Version of the document."""


def open_chunk(path: Path, wanted: str | int | None) -> Chunk:
    """Open a chunk of a project or of an exported file.

    Args:
        path: a .psz, .psx or .xml file.
        wanted: label or number of the chunk; None: the only one, or the active one.

    Raises:
        InputError: the file is none of Metashape's, is damaged, or the chunk does not exist.
    """
    suffix = path.suffix.lower()
    place = _document(path) if suffix == ".psz" else Place(read_xml(path), path.name)
    root = place.element
    if root.tag != "document":
        what = f"has the element <{root.tag}> where Metashape writes <document>"
        raise InputError(Problem(what, place.where(root)))
    version = root.attributes.get("version", "")
    if suffix == ".psx":
        place = _project(path, place)
    chunk = _chunk(place, wanted)
    frame = _frame(chunk)
    return Chunk(chunk, frame, None if frame is None else _ties(frame), version)


def _document(path: Path) -> Place:
    """Return the document of an archive."""
    archive = Archive(path)
    where = archive.where(DOCUMENT)
    return Place(parse_xml(archive.read(DOCUMENT), where), where, archive)


def _project(path: Path, place: Place) -> Place:
    """Return the document that a .psx file points to."""
    link = place.element.attributes.get("path") or "{projectname}.files/project.zip"
    name = link.replace("{projectname}", path.stem)
    where = place.where(place.element)
    found = inside(path.parent, name, where)
    if not found.exists():
        what = f"the folder of the project is missing: {name}; copy it together with the .psx"
        raise InputError(Problem(what, where))
    return _document(found)


def _chunk(place: Place, wanted: str | int | None) -> Place:
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
    raise InputError(Problem(f"{what}; choose one with chunk=; valid: {valid}", place.file))


def _frame(chunk: Place) -> Place | None:
    """Return the only frame of a chunk."""
    frames = chunk.element.first("frames")
    found = [] if frames is None else list(frames.all("frame"))
    if len(found) > 1:
        what = f"the chunk has {len(found)} frames (epochs); read one: delete the others"
        raise InputError(Problem(what, chunk.where(found[1])))
    return chunk.follow(found[0]) if found else None


def _ties(frame: Place) -> Place | None:
    """Return the element that lists projections of tie points; dense clouds have none."""
    for tag in ("tie_points", "point_cloud"):
        for element in frame.element.all(tag):
            place = frame.follow(element)
            if place.element.first("projections") is not None:
                return place
    return None
