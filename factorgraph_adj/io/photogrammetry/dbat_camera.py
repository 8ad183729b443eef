"""Cameras of DBAT: the element <camera> with its lens model, and what a script sets or estimates.

Image coordinates are millimetres of a sensor whose pixels are square and as high as its height
divided by the number of lines, x right and y up from the upper left corner. Lens models by
DBAT's number: 1 (Brown, measured → ideal), 3 (with an affinity before), 4 (with an affinity
after), −1 (Brown, ideal → measured). The aspect is that of pixels, width by height: b1 is
1 − aspect.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

from ...models.lens import BrownForwardLens, BrownLens, Lens
from ...network.network import Network
from ..source import Problems, is_unread
from ..xml_files import Element

LENS_BY_MODEL: dict[int, Lens] = {
    1: BrownLens(residuals="ideal"),
    3: BrownLens(affine="before", residuals="ideal"),
    4: BrownLens(affine="after", residuals="ideal"),
    -1: BrownForwardLens(),
}
"""Lens models by DBAT's number."""
AFFINITY_MODELS = (3, 4)
"""Models whose affinity may be unknown."""
RADIAL_PARAMETERS, DECENTRING_PARAMETERS = ("k1", "k2", "k3"), ("p1", "p2")
CAMERA_ELEMENTS = (
    *("id", "name", "unit", "sensor", "image", "aspect", "focal", "model", "nK", "nP", "cc", "pp"),
    *("K", "P", "skew", "all", "calibrated", "calibration_info", "c"),
)
"""Elements of a camera; those of the calibration's history are not read."""
CAMERA_UNITS = ("mm",)
NUMBER_PLACEHOLDERS = ("auto", "focal", "default")
"""Words that may replace numbers."""

ParameterValues: TypeAlias = dict[str, float]


@dataclass
class DbatCamera:
    """A camera of DBAT."""

    name: str
    """Its name."""
    where: str
    """File and line."""
    model: int = 3
    """Lens model by DBAT's number."""
    pixel: float = 0.0
    """Height of a pixel, mm."""
    size: tuple[float, float] = (0.0, 0.0)
    """Columns and lines."""
    focal: float | None = None
    """Nominal focal length, mm."""
    loaded: ParameterValues = field(default_factory=dict)
    """Calibration that the file states, our names."""
    values: ParameterValues = field(default_factory=dict)
    """Calibration with which an adjustment starts, our names."""
    free: set[str] = field(default_factory=set)
    """Unknown parameters, our names."""
    counts: tuple[int, int] = (3, 2)
    """Numbers of radial and decentring parameters."""

    @property
    def default(self) -> ParameterValues:
        """Calibration by default: the focal length, the middle of the sensor, no distortion."""
        w, h = self.size
        out = {"x0": 0.5 * w * self.pixel, "y0": -0.5 * h * self.pixel, "b1": 0.0, "b2": 0.0}
        out |= dict.fromkeys((*RADIAL_PARAMETERS, *DECENTRING_PARAMETERS), 0.0)
        return out | ({} if self.focal is None else {"c": self.focal})

    def parameters(self, tag: str) -> tuple[str, ...] | None:
        """Return our names of the parameters that a word of DBAT represents; None: no such word."""
        radial, decentring = (
            RADIAL_PARAMETERS[: self.counts[0]],
            DECENTRING_PARAMETERS[: self.counts[1]],
        )
        affinity = ("b1", "b2") if self.model in AFFINITY_MODELS else ()
        words = {
            "all": ("c", "x0", "y0", *radial, *decentring, *affinity),
            "cc": ("c",),
            "pp": ("x0", "y0"),
            "px": ("x0",),
            "py": ("y0",),
            "K": radial,
            "P": decentring,
            "aspect": ("b1",),
            "skew": ("b2",),
        }
        for i, name in enumerate(RADIAL_PARAMETERS, 1):
            words[f"K{i}"] = (name,)
        words |= {"P1": DECENTRING_PARAMETERS, "P2": DECENTRING_PARAMETERS}
        return words.get(tag)

    def add_to(self, network: Network, problems: Problems) -> None:
        """Add the camera to a network."""
        lens = LENS_BY_MODEL[self.model]
        values = {n: v for n, v in self.values.items() if n in lens.names}
        lost = [n for n, v in self.values.items() if v and n not in lens.names]
        if lost:
            what = f"lens model {self.model} has no {', '.join(lost)}; valid: model 3 or 4"
            problems.wrong(what, self.where)
        if "c" not in values:
            problems.wrong("the camera has neither <cc> nor <focal>", self.where)
            return
        with problems.collect(self.where):
            network.add_camera(
                self.name,
                lens,
                values,
                free=[n for n in lens.names if n in self.free],
                unit="mm",
                format=(self.size[0] * self.pixel, self.size[1] * self.pixel),
                origin="upper left",
                y_down_in_files=True,
            )


def read_dbat_camera(
    element: Element, file: str, problems: Problems, model: int | None
) -> tuple[str, DbatCamera] | None:
    """Read the element ``<camera>``; return id and camera, None after a problem.

    Args:
        element: the element.
        file: name of its file.
        problems: where problems go.
        model: lens model that takes the place of the stated one.
    """
    n = problems.count
    found = {c.tag: c for c in element.children}
    where = f"{file}:{element.line}"
    for tag, child in found.items():
        if tag not in CAMERA_ELEMENTS:
            what = f"unknown element <{tag}> of a camera; valid: {', '.join(CAMERA_ELEMENTS)}"
            problems.wrong(what, f"{file}:{child.line}")

    def numbers(tag: str) -> list[float]:
        child = found.get(tag)
        if child is None:
            return []
        texts = [t.strip() for t in child.text.split(",") if t.strip()]
        kept = [t for t in texts if t not in NUMBER_PLACEHOLDERS]
        got = problems.field(kept, f"<{tag}>", f"{file}:{child.line}").numbers(len(kept))
        return [] if is_unread(got) else list(got)

    def words(tag: str) -> str:
        return found[tag].text.strip() if tag in found else ""

    unit = words("unit") or "mm"
    if unit not in CAMERA_UNITS:
        problems.wrong(f"unit {unit!r} of a camera; valid: {', '.join(CAMERA_UNITS)}", where)
    image, sensor = numbers("image"), numbers("sensor")
    if len(image) != 2 or not min(image) > 0:
        problems.wrong("a camera needs <image>: columns, lines", where)
    if not sensor or not min(sensor) > 0:
        problems.wrong("a camera needs <sensor>: width or auto, height", where)
    chosen = model
    if chosen is None:
        chosen = int((numbers("model") or [3])[0])
    if chosen not in LENS_BY_MODEL:
        valid = ", ".join(map(str, LENS_BY_MODEL))
        problems.wrong(f"lens model {chosen} cannot be read; valid: {valid}", where)
    if problems.count > n:
        return None
    name = words("name") or words("id") or "camera"
    camera = DbatCamera(name, where, chosen, sensor[-1] / image[1], (image[0], image[1]))
    focal = numbers("focal")
    camera.focal = focal[0] if focal else None
    camera.counts = (_count(numbers("nK"), 3), _count(numbers("nP"), 2))
    camera.loaded = _stated_values(camera, numbers, words, sensor)
    camera.values = dict(camera.default) | camera.loaded
    return (words("id") or "1", camera) if problems.count == n else None


def _count(given: Sequence[float], most: int) -> int:
    return min(most, int(given[0])) if given and given[0] >= 0 else most


def _stated_values(
    camera: DbatCamera,
    numbers: Callable[[str], list[float]],
    words: Callable[[str], str],
    sensor: Sequence[float],
) -> ParameterValues:
    """Return what the elements of a camera state, by our names."""
    out: ParameterValues = {}
    if words("all") == "default":
        out = dict(camera.default)
    if words("cc") == "focal" and camera.focal is not None:
        out["c"] = camera.focal
    elif words("cc"):
        out["c"] = numbers("cc")[0] if numbers("cc") else 0.0
    if words("pp") and words("pp") != "default":
        px, py, *_ = [*numbers("pp"), 0.0, 0.0]
        out |= {"x0": px, "y0": -py}
    out |= dict(zip(RADIAL_PARAMETERS, numbers("K"), strict=False))
    out |= dict(zip(DECENTRING_PARAMETERS, numbers("P"), strict=False))
    if words("aspect") == "auto":
        if len(sensor) == 2:
            out["b1"] = 1.0 - (sensor[0] / camera.size[0]) / camera.pixel
    elif words("aspect"):
        out["b1"] = 1.0 - (numbers("aspect") or [1.0])[0]
    if numbers("skew"):
        out["b2"] = numbers("skew")[0]
    return out


def set_initial_values(
    cameras: Mapping[str, DbatCamera], element: Element, file: str, problems: Problems
) -> None:
    """Apply ``<set_initial_values><io>`` of a script to all cameras."""
    steps = [(c.tag, c.text.strip(), c.line) for c in element.children]
    if not steps and element.text.strip():
        steps = [("all", element.text.strip(), element.line)]
    for tag, said, line in steps:
        where = f"{file}:{line}"
        if tag == "c":
            continue
        for camera in cameras.values():
            names = camera.parameters(tag)
            if tag == "all":
                names = ("c", "x0", "y0", "b1", "b2", *RADIAL_PARAMETERS, *DECENTRING_PARAMETERS)
            if names is None:
                problems.wrong(f"unknown parameter <{tag}> of a camera", where)
                break
            if said in ("loaded", "default", "focal"):
                source = camera.loaded if said == "loaded" else camera.default
                camera.values |= {
                    n: source.get(n, camera.default.get(n, 0.0))
                    for n in names
                    if n in source or n in camera.default
                }
                continue
            texts = [t for t in said.split(",") if t.strip()]
            given = problems.field(texts, f"<{tag}>", where).numbers(len(names))
            if is_unread(given):
                break
            sign = {"pp": (1.0, -1.0), "py": (-1.0,)}.get(tag, (1.0,) * len(names))
            new = dict(zip(names, (s * v for s, v in zip(sign, given, strict=True)), strict=True))
            if tag == "aspect":
                new = {"b1": 1.0 - given[0]}
            camera.values |= new


def set_estimated_parameters(
    cameras: Mapping[str, DbatCamera], element: Element, file: str, problems: Problems
) -> None:
    """Apply ``<set_bundle_estimate_params><io>`` of a script to all cameras.

    Radial parameters are unknown in sequence: K2 implies K1, and not K2 implies not K3.
    """
    steps = [(c.tag, c.text.strip(), c.line) for c in element.children]
    if not steps:
        steps = [("all", element.text.strip(), element.line)]
    for tag, said, line in steps:
        where = f"{file}:{line}"
        if tag == "c":
            continue
        if said not in ("true", "false"):
            problems.wrong(f"<{tag}> must be true or false, not {said!r}", where)
            continue
        for camera in cameras.values():
            names = camera.parameters(tag)
            if names is None:
                problems.wrong(f"unknown parameter <{tag}> of a camera", where)
                break
            if len(names) == 1 and names[0] in RADIAL_PARAMETERS:
                i = RADIAL_PARAMETERS.index(names[0])
                names = RADIAL_PARAMETERS[: i + 1] if said == "true" else RADIAL_PARAMETERS[i:]
            camera.free = camera.free | set(names) if said == "true" else camera.free - set(names)
