"""Files of a project in the Open Photogrammetry Format (OPF): items and their resources."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote, urlparse

from ...files import inside
from ..json_tree import Node, parse_json
from ..text import read_text

JSON = "application/opf-{}+json"
"""Format of a resource by the name of what it holds."""
GLTF = "model/gltf+json"
EXTENSION = "application/ext-"
"""Beginning of the formats of vendors, which are not read."""
BUFFER = "application/gltf-buffer+bin"
"""Format of the tables of a glTF file, which names them itself."""
VERSION = "1"
"""Version of the format that is read, without what follows the point."""
ITEMS = (
    *("camera_list", "input_cameras", "projected_input_cameras", "input_control_points"),
    *("projected_control_points", "constraints", "scene_reference_frame", "calibration"),
)
"""Items that are read; others are products, or belong to vendors (ext_…)."""
PRODUCTS = ("point_cloud",)
"""Items of products, which are not read."""


@dataclass(frozen=True)
class OpfProject:
    """A project: its JSON resources by what they hold, and the glTF files of its calibration."""

    path: Path
    """The file of the project."""
    root: Node
    """Its root."""
    resources: dict[str, Node]
    """Roots of JSON resources by what they hold: ``calibrated-cameras`` …"""
    clouds: tuple[Path, ...]
    """glTF files of tie points."""

    def need(self, name: str) -> Node:
        """Return a resource.

        Raises:
            InputError: the project has none.
        """
        if name not in self.resources:
            raise self.root.need("items").fail(f"the project has no {name}")
        return self.resources[name]

    def list(self, name: str, key: str) -> Iterator[Node]:
        """Iterate over the elements of a list of a resource; nothing where either is absent."""
        found = self.resources.get(name)
        inner = None if found is None else found.get(key)
        return iter(()) if inner is None else inner.list()


def open_project(path: Path) -> OpfProject:
    """Open a project.

    Raises:
        InputError: a file is missing, is not JSON, or is none of the format.
    """
    root = _document(path, "project")
    resources: dict[str, Node] = {}
    clouds: list[Path] = []
    for item in root.need("items").list():
        kind = item.need("type").text()
        if kind not in ITEMS:
            if kind not in PRODUCTS and not kind.startswith("ext_"):
                valid = ", ".join((*ITEMS, *PRODUCTS, "ext_…"))
                what = f"unknown type {kind[:40]!r} of an item; valid: {valid}"
                raise item.need("type").fail(what)
            continue
        for resource in item.need("resources").list():
            form = resource.need("format").text()
            name = form.removeprefix("application/opf-").removesuffix("+json")
            if form == GLTF and kind == "calibration":
                clouds.append(_file(path.parent, resource.need("uri")))
            elif form == JSON.format(name):
                if name in resources:
                    raise resource.fail(f"the project has {name} twice; valid: one calibration")
                resources[name] = _document(_file(path.parent, resource.need("uri")), name)
            elif form not in (GLTF, BUFFER) and not form.startswith(EXTENSION):
                what = f"format {form!r} of {kind} is not read; valid: {JSON.format('…')}, {GLTF}"
                raise resource.need("format").fail(what)
    return OpfProject(path, root, resources, tuple(clouds))


def _file(folder: Path, node: Node) -> Path:
    """Return the path of a resource by its relative address."""
    address = urlparse(node.text())
    if address.scheme or address.netloc:
        raise node.fail(f"address {node.text()!r} must be a path relative to the project")
    found = inside(folder, unquote(address.path), node.where)
    if not found.is_file():
        raise node.fail(f"there is no file {node.text()!r} beside the project")
    return found


def _document(path: Path, name: str) -> Node:
    root = parse_json(read_text(path), path.name)
    form = root.need("format").text()
    if form != JSON.format(name):
        raise root.fail(f"has format {form!r}; valid: {JSON.format(name)}")
    version = root.need("version").text()
    if version.split(".")[0] != VERSION:
        raise root.need("version").fail(f"version {version} cannot be read; valid: {VERSION}.x")
    return root


def file_name(uri: str) -> str:
    """Return the name of an image by its address, with its page: ``a.tif#page=1``."""
    address = urlparse(uri.replace("\\", "/"))
    name = unquote(address.path).rsplit("/", 1)[-1]
    return f"{name}#{address.fragment}" if address.fragment else name
