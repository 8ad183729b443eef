"""Reader of DBAT scripts and their tables: cameras, control, photos, prior poses, marks, datum.

Columns of the tables are named by the script. Pixels count from the upper left corner, y down.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...errors import InputError, Problem, known
from ...files import inside
from ...network.network import Network
from ...observations import ControlPoint, PhotoAngle, PhotoPosition
from ...units import ANGLE
from ..format_reader import NetworkReader, Reader
from ..source import LeftOutReason, Problems, is_unread
from ..text_files import file_beginning, read_text
from ..xml_files import Element, read_xml
from .block_source import ImagePoints, filled_lines
from .dbat_camera import DbatCamera, read_dbat_camera, set_estimated_parameters, set_initial_values

FILTERED_POINTS = LeftOutReason("points", "a <filter> of the file leaves them out")

CONTROL_COLUMNS = ("id", "label", "ignored", "x", "y", "z", "sx", "sy", "sz", "sxy", "sxyz")
IMAGE_TABLE_COLUMNS = ("id", "cam", "label", "path", "ignored")
MARK_TABLE_COLUMNS = ("id", "im", "ignored", "x", "y", "sx", "sy", "sxy")
PRIOR_TABLE_COLUMNS = (
    *("id", "ignored", "x", "y", "z", "sx", "sy", "sz", "sxy", "sxyz"),
    *("omega", "phi", "kappa", "so", "sp", "sk", "sang"),
)
"""Columns that the tables may have."""
DBAT_ANGLE_UNITS = {"radian": 1.0, "degrees": ANGLE["deg"], "gon": ANGLE["gon"]}
FILE_ELEMENTS = ("c", "file")
DBAT_CHILDREN = {
    "document": ("c", "meta", "input", "operations", "output"),
    "input": ("c", "ctrl_pts", "check_pts", "images", "prior_eo", "image_pts", "cameras"),
    "ctrl_pts": (*FILE_ELEMENTS, "filter"),
    "check_pts": (*FILE_ELEMENTS, "filter"),
    "images": FILE_ELEMENTS,
    "prior_eo": FILE_ELEMENTS,
    "image_pts": FILE_ELEMENTS,
    "cameras": (*FILE_ELEMENTS, "camera"),
    "file": (),
    "filter": (),
    "operations": ("c", "operation"),
}
"""Elements that may be in another one; comments <c> may be in any."""
DBAT_ATTRIBUTES = {
    "document": ("dbat_script_version",),
    "input": ("base_dir",),
    "images": ("image_base_dir",),
    "file": ("format", "units", "sxy", "sx", "sy"),
    "filter": ("id",),
    "operation": ("min_rays", "max_op"),
    "set_datum": ("ref_cam", "ref_base"),
}
"""Attributes that an element may have; those of operations that need none have no effect."""
NESTED_ELEMENTS = (
    *("operation", "set_initial_values", "set_bundle_estimate_params"),
    *("io", "eo", "op", "camera"),
)
"""Elements whose children are checked where they are read; others have texts alone."""
UNREAD_ELEMENTS = ("c", "meta", "output", "calibration_info")
HARMLESS = ("check_ray_count", "spatial_resection", "forward_intersection", "bundle_adjustment")
"""Operations that an adjustment does by itself."""


@dataclass(frozen=True)
class DbatRow:
    """A row of a table."""

    where: str
    """File and line."""
    fields: Mapping[str, str]
    """Texts by column."""


def read_dbat(
    path: str | Path, *, model: int | None = None, base: str | Path | None = None
) -> Network:
    """Read the input of a DBAT script and what it estimates.

    Points and photos have the numbers that the tables give them as names. Control points with
    standard deviations are observed, those without are held; check points are compared. Prior
    exterior orientations are approximate, and observed where they have standard deviations. The
    datum ``depend`` holds one photo and one component of another, as DBAT chooses it. The
    operations check_ray_count, spatial_resection, forward_intersection and bundle_adjustment are
    what an adjustment does by itself; comments, the section meta and the output are not read.

    Args:
        path: the script.
        model: lens model that takes the place of that of the cameras: 1, 3, 4 or −1.
        base: folder of the tables where the script's base_dir is another one.

    Raises:
        InputError: a file is missing or has problems, each with file and line.
    """
    source = Path(path)
    root = read_xml(source)
    if root.tag != "document" or "dbat_script_version" not in root.attributes:
        what = "is no script of DBAT: <document dbat_script_version=…> is missing"
        raise InputError(Problem(what, f"{source.name}:{root.line}"))
    return _Script(source, root, Problems(), None if base is None else Path(base)).network(model)


def is_dbat(path: Path) -> bool:
    """Tell whether an XML file is a script of DBAT."""
    return b"dbat_script_version" in file_beginning(path)


@dataclass
class _Script:
    """A script while it is read."""

    path: Path
    root: Element
    problems: Problems
    base: Path | None
    cameras: dict[str, DbatCamera] = field(default_factory=dict)

    def where(self, element: Element) -> str:
        return f"{self.path.name}:{element.line}"

    def network(self, model: int | None) -> Network:
        """Return the network."""
        self._refuse_strange(self.root)
        given = self.root.first("input")
        if given is None:
            raise InputError(Problem("has no section <input>", self.where(self.root)))
        self.folder = self._folder(given)
        meta = self.root.first("meta")
        title = None if meta is None else meta.first("name")
        network = Network(self.path.stem if title is None else title.text.strip())
        self._read_cameras(given, model)
        prior = self._prior(given)
        held = self._operations(prior)
        for camera in self.cameras.values():
            camera.add_to(network, self.problems)
        self._control(given, network)
        self._photos(given, network, prior, held)
        images = ImagePoints(self.problems)
        self._image_points(given, network, images)
        images.into(network)
        self.problems.finish(network)
        return network

    def _refuse_strange(self, element: Element) -> None:
        """Note elements and attributes in places that are not allowed."""
        attributes = DBAT_ATTRIBUTES.get(element.tag, ())
        for name in element.attributes:
            if name not in attributes:
                valid = known(attributes, meant=name)
                what = f"<{element.tag}> has no attribute {name[:40]!r}; valid: {valid}"
                self.problems.wrong(what, self.where(element))
        valid_tags = DBAT_CHILDREN.get(element.tag, None if element.tag in NESTED_ELEMENTS else ())
        for child in element.children:
            if valid_tags is not None and child.tag not in valid_tags:
                valid = known(valid_tags, meant=child.tag)
                what = f"unknown element <{child.tag}> of <{element.tag}>; valid: {valid}"
                self.problems.wrong(what, self.where(child))
            elif child.tag not in UNREAD_ELEMENTS:
                self._refuse_strange(child)

    # -- files ------------------------------------------------------------------------------

    def _folder(self, given: Element) -> Path:
        """Return the folder of the tables."""
        if self.base is not None:
            return self.base
        said = given.attributes.get("base_dir", "$HERE").replace("\\", "/")
        if said == "$HERE" or said.startswith("$HERE/"):
            rest = said.removeprefix("$HERE").strip("/")
            return inside(self.path.parent, rest, self.where(given)) if rest else self.path.parent
        what = f"base_dir {said!r} is not the folder of the script ($HERE); state it with base="
        raise InputError(Problem(what, self.where(given)))

    def _rows(self, element: Element, valid: Sequence[str]) -> Iterator[DbatRow]:
        """Yield the rows of the table that an element ``<file>`` names."""
        where = self.where(element)
        columns = [c.strip() for c in element.attributes.get("format", "").split(",")]
        wrong = [c for c in columns if c not in valid]
        named = [c for c in columns if c != "ignored"]
        if wrong or len(set(named)) < len(named):
            what = f"format {element.attributes.get('format')!r}; valid: {', '.join(valid)}"
            self.problems.wrong(what, where)
            return
        with self.problems.collect(where):
            table = inside(self.folder, element.text.strip(), where)
            for number, line in filled_lines(read_text(table)):
                if line.lstrip().startswith("#"):
                    continue
                cells = [c.strip() for c in line.split(",")]
                place = f"{table.name}:{number}"
                if len(cells) != len(columns):
                    what = (
                        f"has {len(cells)} cells, the format {len(columns)}: {', '.join(columns)}"
                    )
                    self.problems.wrong(what, place)
                    continue
                yield DbatRow(place, dict(zip(columns, cells, strict=True)))

    def _name(self, row: DbatRow, column: str = "id") -> str:
        """Return a number as a name: without zeros before it."""
        text = row.fields.get(column, "")
        if not text:
            self.problems.wrong(f"has no {column}", row.where)
        return str(int(text)) if text.isascii() and text.isdigit() and len(text) < 19 else text

    def _triple(self, row: DbatRow) -> tuple[tuple[float, float, float], list[float]] | None:
        """Return x, y, z and their standard deviations, 0 where none is given."""
        texts = [row.fields.get(a) for a in "xyz"]
        found = self.problems.field(texts, "x, y, z", row.where).numbers(3)
        sigma = [0.0, 0.0, 0.0]
        for key, axes in (("sxyz", "xyz"), ("sxy", "xy"), ("sx", "x"), ("sy", "y"), ("sz", "z")):
            if key in row.fields:
                s = self.problems.field(row.fields[key], key, row.where).number()
                for a in axes:
                    sigma["xyz".index(a)] = 0.0 if is_unread(s) else s
        if min(sigma) < 0:
            self.problems.wrong("standard deviations must not be negative", row.where)
            return None
        return None if is_unread(found) else ((found[0], found[1], found[2]), sigma)

    # -- input --------------------------------------------------------------------------------

    def _read_cameras(self, given: Element, model: int | None) -> None:
        listed = given.first("cameras")
        if listed is None:
            self.problems.wrong("has no <cameras>", self.where(given))
            return
        file, inner = self.path.name, listed
        link = listed.first("file")
        if link is not None:
            where = self.where(link)
            with self.problems.collect(where):
                target = inside(self.folder, link.text.strip(), where)
                root = read_xml(target)
                file, inner = target.name, root.first("cameras") or root
        for element in inner.all("camera"):
            found = read_dbat_camera(element, file, self.problems, model)
            if found is None:
                continue
            ident, camera = found
            if ident in self.cameras:
                self.problems.wrong(f"camera {ident!r} is defined twice", camera.where)
            elif any(camera.name == c.name for c in self.cameras.values()):
                camera.name = f"{camera.name} ({ident})"
            self.cameras[ident] = camera
        if not self.cameras and not self.problems.count:
            self.problems.wrong("has no <camera>", self.where(listed))

    def _control(self, given: Element, network: Network) -> None:
        """Add control and check points."""
        for tag in ("ctrl_pts", "check_pts"):
            for section in given.all(tag):
                for row in self._selected(section):
                    name, found = self._name(row), self._triple(row)
                    if found is None:
                        continue
                    at, sigma = found
                    with self.problems.collect(row.where):
                        if tag == "check_pts":
                            network.add_point(name, check=at)
                            continue
                        held = "".join(a for a, s in zip("xyz", sigma, strict=True) if not s)
                        network.add_point(name, at, fixed=held)
                        free = [i for i in range(3) if sigma[i]]
                        if free:
                            o = ControlPoint(
                                name,
                                tuple(at[i] for i in free),
                                axes="".join("xyz"[i] for i in free),
                                sigma=tuple(sigma[i] for i in free),
                                source=row.where,
                            )
                            network.add(o)

    def _selected(self, section: Element) -> list[DbatRow]:
        """Return the rows of a section of points that its filters leave."""
        rows = [r for f in section.all("file") for r in self._rows(f, CONTROL_COLUMNS)]
        for rule in section.all("filter"):
            chosen = {t.strip() for t in rule.attributes.get("id", "").split(",")}
            word = rule.text.strip()
            if word not in ("keep", "remove"):
                what = f"a filter must be keep or remove, not {word!r}"
                self.problems.wrong(what, self.where(rule))
            kept = [r for r in rows if (self._name(r) in chosen) == (word == "keep")]
            for row in rows:
                if row not in kept:
                    self.problems.leave_out(FILTERED_POINTS, self._name(row), row.where)
            rows = kept
        return rows

    def _prior(self, given: Element) -> dict[str, DbatRow]:
        """Return the rows of prior orientations by photo; fields of angles are in radians."""
        out: dict[str, DbatRow] = {}
        section = given.first("prior_eo")
        for element in () if section is None else section.all("file"):
            unit = element.attributes.get("units")
            if unit not in (None, *DBAT_ANGLE_UNITS):
                what = f"unknown units {unit!r}; valid: {', '.join(DBAT_ANGLE_UNITS)}"
                self.problems.wrong(what, self.where(element))
                continue
            self.angle = DBAT_ANGLE_UNITS.get(unit or "")
            for row in self._rows(element, PRIOR_TABLE_COLUMNS):
                if "omega" in row.fields and self.angle is None:
                    self.problems.wrong("angles need the attribute units", self.where(element))
                    break
                name = self._name(row)
                if name in out:
                    self.problems.wrong(f"photo {name!r} has two orientations", row.where)
                out[name] = row
        return out

    angle: float | None = None

    def _photos(
        self,
        given: Element,
        network: Network,
        prior: Mapping[str, DbatRow],
        held: Mapping[str, tuple[bool, ...]],
    ) -> None:
        """Add the photos with their prior orientations."""
        section = given.first("images")
        if section is None:
            self.problems.wrong("has no <images>", self.where(given))
            return
        first = next(iter(self.cameras), "")
        for element in section.all("file"):
            for row in self._rows(element, IMAGE_TABLE_COLUMNS):
                name = self._name(row)
                ident = self._name(row, "cam") if "cam" in row.fields else first
                camera = self.cameras.get(ident)
                if camera is None:
                    valid = ", ".join(self.cameras)
                    self.problems.wrong(f"unknown camera {ident!r}; known: {valid}", row.where)
                    continue
                if camera.name not in network.cameras:
                    continue
                with self.problems.collect(row.where):
                    self._photo(network, name, camera.name, prior.get(name), held.get(name))

    def _photo(
        self,
        network: Network,
        name: str,
        camera: str,
        row: DbatRow | None,
        held: tuple[bool, ...] | None,
    ) -> None:
        found = None if row is None else self._triple(row)
        if row is None or found is None:
            network.add_photo(name, camera, fixed=held or False)
            return
        at, sigma = found
        angles = None
        if "omega" in row.fields:
            texts = [row.fields.get(a) for a in ("omega", "phi", "kappa")]
            got = self.problems.field(texts, "omega, phi, kappa", row.where).numbers(3)
            angles = None if is_unread(got) else [v * (self.angle or 1.0) for v in got]
        network.add_photo(name, camera, position=at, omega_phi_kappa=angles, fixed=held or False)
        if held and all(held):
            return
        if any(sigma):
            if not all(sigma):
                self.problems.wrong("a position needs all of sx, sy, sz, or none", row.where)
                return
            network.add(PhotoPosition(name, at, sigma=tuple(sigma), source=row.where))
        keys = {"omega": ("so", "sang"), "phi": ("sp", "sang"), "kappa": ("sk", "sang")}
        for i, (angle, both) in enumerate(keys.items()):
            key = next((k for k in both if k in row.fields), None)
            if key is None or angles is None:
                continue
            s = self.problems.field(row.fields[key], key, row.where).number(above=0.0)
            if not is_unread(s):
                size = s * (self.angle or 1.0)
                value = angles[i]
                network.add(PhotoAngle(name, value, angle=angle, sigma=size, source=row.where))

    def _image_points(self, given: Element, network: Network, images: ImagePoints) -> None:
        """Gather image points, and add the points among them that are new."""
        section = given.first("image_pts")
        if section is None:
            self.problems.wrong("has no <image_pts>", self.where(given))
            return
        for element in section.all("file"):
            whole: dict[str, float] = {}
            for key in ("sxy", "sx", "sy"):
                if key in element.attributes:
                    text = element.attributes[key]
                    s = self.problems.field(text, key, self.where(element)).number(above=0.0)
                    whole[key] = 1.0 if is_unread(s) else s
            for row in self._rows(element, MARK_TABLE_COLUMNS):
                self._image_point(network, images, row, whole)

    def _image_point(
        self, network: Network, images: ImagePoints, row: DbatRow, whole: Mapping[str, float]
    ) -> None:
        photo, point = self._name(row, "im"), self._name(row)
        keys = [k for k in ("x", "y", "sxy", "sx", "sy") if k in row.fields]
        found = self.problems.field([row.fields[k] for k in keys], "row", row.where).numbers(
            len(keys)
        )
        if is_unread(found):
            return
        said = dict(zip(keys, found, strict=True)) | dict(whole)
        if "x" not in said or "y" not in said:
            self.problems.wrong("has no x or no y", row.where)
            return
        sigma = [said.get(k, said.get("sxy", 0.0)) for k in ("sx", "sy")]
        if not min(sigma) > 0:
            what = "has no standard deviation > 0: state sxy in the format or as an attribute"
            self.problems.wrong(what, row.where)
            return
        if photo not in network.photos:
            self.problems.wrong(f"unknown photo {photo!r}", row.where)
            return
        if point not in network.points:
            with self.problems.collect(row.where):
                network.add_point(point)
        pixel = next(
            c.pixel for c in self.cameras.values() if c.name == network.photos[photo].camera
        )
        xy = (said["x"] * pixel, -said["y"] * pixel)
        images.add(photo, point, xy, [s * pixel for s in sigma], row.where)

    # -- operations -----------------------------------------------------------------------------

    def _operations(self, prior: Mapping[str, DbatRow]) -> dict[str, tuple[bool, ...]]:
        """Apply the operations to cameras; return what is held of photos."""
        held: dict[str, tuple[bool, ...]] = {}
        section = self.root.first("operations")
        for operation in () if section is None else section.all("operation"):
            if not operation.children:
                if operation.text.strip() not in HARMLESS:
                    what = f"unknown operation {operation.text.strip()!r}; valid: "
                    valid = "set_initial_values, set_bundle_estimate_params, set_datum"
                    self.problems.wrong(what + ", ".join((*HARMLESS, valid)), self.where(operation))
                continue
            for step in operation.children:
                if step.tag == "set_datum":
                    held |= self._datum(step, prior)
                elif step.tag in ("set_initial_values", "set_bundle_estimate_params"):
                    self._settings(step)
                elif step.tag != "c":
                    self.problems.wrong(f"unknown operation <{step.tag}>", self.where(step))
        return held

    def _settings(self, step: Element) -> None:
        initial = step.tag == "set_initial_values"
        for part in step.children:
            where = self.where(part)
            if part.tag == "io":
                change = set_initial_values if initial else set_estimated_parameters
                change(self.cameras, part, self.path.name, self.problems)
            elif part.tag in ("eo", "op"):
                said = [(c.tag, c.text.strip()) for c in part.children if c.tag != "c"]
                said = said or [("all", part.text.strip())]
                valid = ("loaded", "default") if initial else ("true", "default")
                for tag, word in said:
                    if tag != "all" or word not in valid:
                        what = f"<{tag}>{word}</{tag}> of <{part.tag}> cannot be read; valid: "
                        self.problems.wrong(what + f"<all> {' or '.join(valid)}", where)
            elif part.tag != "c":
                self.problems.wrong(f"unknown element <{part.tag}>", where)

    def _datum(self, step: Element, prior: Mapping[str, DbatRow]) -> dict[str, tuple[bool, ...]]:
        """Return what the datum ``depend`` holds: a photo, and the largest offset from it."""
        where = self.where(step)
        if step.text.strip() != "depend":
            self.problems.wrong(f"unknown datum {step.text.strip()!r}; valid: depend", where)
            return {}
        reference, base = (step.attributes.get(k, "") for k in ("ref_cam", "ref_base"))
        if reference not in prior or base not in ("longest", "x", "y", "z"):
            what = "depend needs ref_cam, a photo of prior_eo, and ref_base: longest, x, y or z"
            self.problems.wrong(what, where)
            return {}
        names = list(prior)
        found = [self._triple(row) for row in prior.values()]
        places = np.array([(np.nan,) * 3 if f is None else f[0] for f in found])
        offset = places - places[names.index(reference)]
        axes = [0, 1, 2] if base == "longest" else ["xyz".index(base)]
        if np.isnan(offset).any():
            return {}
        photo, axis = divmod(int(np.argmax(offset[:, axes])), len(axes))
        if names[photo] == reference:
            self.problems.wrong("no photo lies ahead of the reference photo along an axis", where)
            return {}
        component = tuple(i == 3 + axes[axis] for i in range(6))
        return {reference: (True,) * 6, names[photo]: component}


READER = Reader("dbat", (".xml",), "script of DBAT", NetworkReader(read_dbat), recognises=is_dbat)
