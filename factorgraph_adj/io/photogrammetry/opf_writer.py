"""Writer of the Open Photogrammetry Format (OPF): cameras, poses, control, marks, constraints."""

from __future__ import annotations

import json
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from ...errors import InputError, Problem, taking
from ...frames import LocalFrame
from ...models.lens import Lens, NormalisedLens
from ...network.network import Network
from ...observations import ControlPoint, PhotoPosition, PointDirection, SlopeDistance
from ...rotation import omega_phi_kappa
from ..file_transaction import write_files
from ..format_limits import Refusals, calibration_values, pixel_format
from .opf_files import JSON_FORMAT
from .rolling_shutters import ALONG_ROWS

OPF_LOCAL_WKT = (
    'ENGCRS["Local coordinates",EDATUM["Local datum"],CS[Cartesian,3],'
    'AXIS["(X)",east,ORDER[1]],AXIS["(Y)",north,ORDER[2]],AXIS["(Z)",up,ORDER[3]],'
    'LENGTHUNIT["metre",1.0]]'
)
"""The local system of the network in WKT."""
ITEM_NAMESPACE = uuid.UUID("0b2f7a9e-5f0e-4c7b-9a55-6f1f7c1f6d10")
"""Namespace of the ids of items, which are the same for the same network."""
CAPTURE_TIME = "1970-01-01T00:00:00"
"""Time of captures, which the format demands and a network does not have."""
ITEM_SOURCES: dict[str, tuple[str, ...]] = {
    "camera_list": (),
    "scene_reference_frame": (),
    "input_cameras": ("camera_list",),
    "projected_input_cameras": ("input_cameras", "scene_reference_frame"),
    "input_control_points": ("camera_list",),
    "projected_control_points": ("input_control_points", "scene_reference_frame"),
    "constraints": ("input_control_points",),
    "calibration": ("input_cameras", "projected_input_cameras", "scene_reference_frame"),
}
"""Items, and those that they refer to."""
_SENSOR_DEFAULTS: dict[str, Any] = {
    "bands": [{"weight": 1.0}],
    "pixel_size_um": 1.0,
    "shutter_type": "global",
}
"""What the format demands of a sensor and a network does not have."""


@taking(Network)
def write_opf(network: Network, path: str | Path) -> None:
    """Write a network as a project of the Open Photogrammetry Format.

    The processing system is that of the network, a local one in metres. Control points become
    ground control points, other points manual tie points with their marks; the standard deviation
    of an image point, in pixels, is the accuracy of its mark. Observed projection centres become
    positions of captures, slope distances scale constraints, and directions between points
    orientation constraints. What of the calibration is unknown is no part of the format.

    Cameras with a readout time have the shutter type ``rolling``. The velocity of a photo becomes
    Δc of ``rolling_shutter``, its way during half the readout, see `read_opf`; turns are no part
    of the format. The readout time itself is left out, and so are the standard deviations of
    motions: whoever reads the project states them.

    Args:
        network: the network; that of an adjustment is `Solution.as_network`.
        path: the .opf file; the other files go into its folder.

    Raises:
        InputError: the format cannot express something of the network (all is listed), or the
            folder cannot be written to; no file has changed.
    """
    target = Path(path)
    refusals = Refusals("OPF")
    kinds = (ControlPoint.kind, PhotoPosition.kind, SlopeDistance.kind, PointDirection.kind)
    refusals.observations(network, kinds)
    refusals.points(network)
    refusals.photos(network, motions=True)
    refusals.cameras(network, readouts=True)
    if network.frame != LocalFrame():
        refusals.refuse("a frame that is not local, with X east")
    writer = _Writer(network, refusals)
    documents = writer.documents()
    refusals.raise_all()
    items = []
    for item, sources in ITEM_SOURCES.items():
        resources = [
            {
                "uri": quote(name.replace("_", "-") + ".json"),
                "format": JSON_FORMAT.format(_dashed(name)),
            }
            for name in documents
            if name == item or (item == "calibration" and name.startswith("calibrated"))
        ]
        links = [{"id": _id(network, s), "type": s} for s in sources]
        items.append(
            {"id": _id(network, item), "type": item, "resources": resources, "sources": links}
        )
    project = {
        "format": JSON_FORMAT.format("project"),
        "version": "1.0",
        "id": _id(network, "project"),
        "name": network.name,
        "description": "",
        "generator": {"name": "factorgraph_adj", "version": "1"},
        "items": items,
    }
    files: dict[str, str | bytes | None] = {}
    for name, content in documents.items():
        head = {"format": JSON_FORMAT.format(_dashed(name)), "version": "1.0"}
        files[name.replace("_", "-") + ".json"] = _encoded(head | content, target)
    files[target.name] = _encoded(project, target)
    write_files(target.parent, files)


def _dashed(name: str) -> str:
    return name.replace("_", "-")


def _id(network: Network, item: str) -> str:
    return str(uuid.uuid5(ITEM_NAMESPACE, f"{network.name!r} {item}"))


def _encoded(document: Mapping[str, Any], target: Path) -> bytes:
    try:
        return (json.dumps(document, indent=1, ensure_ascii=False) + "\n").encode("utf-8")
    except UnicodeEncodeError as error:
        raise InputError(Problem(f"a name cannot be written: {error}", str(target))) from None


class _Writer:
    """The documents of a project."""

    def __init__(self, network: Network, refusals: Refusals) -> None:
        self.network = network
        self.refusals = refusals
        self.ids = {name: i + 1 for i, name in enumerate(network.photos)}
        self.sensors = {name: i + 1 for i, name in enumerate(network.cameras)}

    def documents(self) -> dict[str, dict[str, Any]]:
        """Return the documents by what they hold."""
        control = self._control()
        marks = self._marks()
        gcps, mtps, projected, found = [], [], [], []
        crs = {"definition": OPF_LOCAL_WKT}
        for name, point in self.network.points.items():
            o = control.get(name)
            at = o.value if o is not None else point.check
            if at is not None and not np.isnan(at).any():
                sigma = list((o.sigma if o is not None else None) or (0.0, 0.0, 0.0))
                place = {"crs": crs, "coordinates": list(map(float, at)), "sigmas": sigma}
                gcps.append(
                    {
                        "id": name,
                        "geolocation": place,
                        "marks": marks.get(name, []),
                        "is_checkpoint": o is None,
                    }
                )
                projected.append({"id": name, "coordinates": place["coordinates"], "sigmas": sigma})
            else:
                mark = {"id": name, "marks": marks.get(name, []), "is_checkpoint": False}
                mtps.append(mark)
            if not np.isnan(point.coordinates).any():
                found.append({"id": name, "coordinates": list(map(float, point.coordinates))})
        captures, positions = self._captures()
        cameras = [{"id": i, "uri": quote(n)} for n, i in self.ids.items()]
        frame = {
            "crs": crs,
            "base_to_canonical": {
                "scale": [1.0, 1.0, 1.0],
                "shift": [0.0, 0.0, 0.0],
                "swap_xy": False,
            },
        }
        sensors = self._sensors()
        return {
            "camera_list": {"cameras": cameras},
            "scene_reference_frame": frame,
            "input_cameras": {
                "sensors": [_SENSOR_DEFAULTS | s for s in sensors],
                "captures": captures,
            },
            "projected_input_cameras": {"sensors": [], "captures": positions},
            "input_control_points": {"gcps": gcps, "mtps": mtps},
            "projected_control_points": {"projected_gcps": projected},
            "constraints": self._constraints(),
            "calibrated_cameras": {
                "sensors": [{k: s[k] for k in ("id", "internals")} for s in sensors],
                "cameras": self._poses(),
            },
            "calibrated_control_points": {"points": found},
        }

    def _control(self) -> dict[str, ControlPoint]:
        out: dict[str, ControlPoint] = {}
        for o in self.network.observations.values():
            if isinstance(o, ControlPoint):
                if o.axes != "xyz" or o.sigma is None or o.point in out:
                    self.refusals.refuse("control but one X, Y, Z with σ for a point", o.label())
                else:
                    out[o.point] = o
        return out

    def _marks(self) -> dict[str, list[dict[str, Any]]]:
        out: dict[str, list[dict[str, Any]]] = {}
        photos, points = list(self.network.photos), list(self.network.points)
        rows = zip(*(c.tolist() for c in self.network.images.columns()), strict=True)
        for photo, point, (x, y), (sx, sy) in rows:
            if sx != sy:
                where = f"image point {photos[photo]}/{points[point]}"
                self.refusals.refuse("different standard deviations of x and y", where)
            mark = {"camera_id": photo + 1, "position_px": [x, 0.0 - y], "accuracy": sx}
            out.setdefault(points[point], []).append(mark)
        return out

    def _sensors(self) -> list[dict[str, Any]]:
        out = []
        for name, camera in self.network.cameras.items():
            where, size = f"camera {name!r}", pixel_format(camera)
            if size is None:
                what = "image coordinates but pixels of a known format, from the upper left corner"
                self.refusals.refuse(what, where)
            if type(camera.lens) not in (Lens, NormalisedLens):
                what = f"the lens model {camera.lens.kind!r}; valid: normalised"
                self.refusals.refuse(what, where)
            if size is None or type(camera.lens) not in (Lens, NormalisedLens):
                continue
            k = dict.fromkeys(NormalisedLens().names, 0.0) | calibration_values(camera)
            internals = {
                "type": "perspective",
                "principal_point_px": [k["x0"], 0.0 - k["y0"]],
                "focal_length_px": k["c"],
                "radial_distortion": [k["k1"], k["k2"], k["k3"]],
                "tangential_distortion": [0.0 - k["p2"], k["p1"]],
            }
            sensor: dict[str, Any] = {"id": self.sensors[name], "name": name}
            sensor["internals"] = internals
            if camera.readout is not None:
                sensor["shutter_type"] = "rolling"
            out.append(sensor | {"image_size_px": [int(side) for side in size]})
        return out

    def _captures(self) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
        observed: dict[str, PhotoPosition] = {}
        for o in self.network.observations.values():
            if isinstance(o, PhotoPosition):
                plain = o.sigma is not None and o.axes == "xyz" and not any(o.lever_arm)
                if not plain or o.mount or o.drift or o.photo in observed:
                    what = "a position of a photo but one by x, y, z and σ"
                    self.refusals.refuse(what, o.label())
                else:
                    observed[o.photo] = o
        captures, positions = [], []
        for name, i in self.ids.items():
            camera = {
                "id": i,
                "sensor_id": self.sensors[self.network.photos[name].camera],
                "model_source": "user",
                "pixel_type": "uint8",
                "pixel_range": {"min": 0, "max": 255},
            }
            capture: dict[str, Any] = {
                "id": i,
                "rig_model_source": "not_applicable",
                "reference_camera_id": i,
                "cameras": [camera],
                "time": CAPTURE_TIME,
            }
            if name in observed:
                value = list(map(float, observed[name].value))
                sigma = list(map(float, observed[name].sigma or ()))
                place = {
                    "crs": {"definition": OPF_LOCAL_WKT},
                    "coordinates": value,
                    "sigmas": sigma,
                }
                capture["geolocation"] = place
                position = {"position": value, "sigmas": sigma}
                positions.append({"id": i, "geolocation": position})
            captures.append(capture)
        return captures, positions

    def _poses(self) -> list[dict[str, Any]]:
        out = []
        for name, i in self.ids.items():
            photo = self.network.photos[name]
            if photo.position is None or photo.rotation is None:
                continue
            angles = np.rad2deg(omega_phi_kappa(photo.rotation)).tolist()
            position = list(map(float, photo.position))
            sensor = self.sensors[photo.camera]
            pose = {"id": i, "sensor_id": sensor, "position": position, "orientation_deg": angles}
            way = self._way_of_half_readout(name)
            out.append(pose if way is None else pose | {"rolling_shutter": way})
        return out

    def _way_of_half_readout(self, photo: str) -> list[float] | None:
        """Return the way of a photo from the middle row to the last one; None without a motion."""
        motion = self.network.of_kind("photo_motion").get(photo)
        camera = self.network.cameras[self.network.photos[photo].camera]
        if motion is None or camera.readout is None:
            return None
        sign = ALONG_ROWS.get(camera.readout_towards)
        if any(motion.values[3:]) or sign is None:
            what = "the motion of a photo but a velocity, and a readout from row to row; "
            what += "network.of_kind('photo_motion') has the motions"
            self.refusals.refuse(what, f"photo {photo!r}")
            return None
        return [sign * v * camera.readout / 2 for v in motion.values[:3]]

    def _constraints(self) -> dict[str, Any]:
        scales, directions = [], []
        for ident, o in self.network.observations.items():
            if o.kind == SlopeDistance.kind and isinstance(o, SlopeDistance):
                set_up = o.instrument_height or o.target_height or o.instrument is not None
                if set_up or not isinstance(o.sigma, float):
                    what = "a distance but one between points with a plain σ"
                    self.refusals.refuse(what, o.label())
                    continue
                ends = {"id": ident, "id_from": o.station, "id_to": o.target}
                scales.append(ends | {"distance": o.value, "sigma": o.sigma})
            elif isinstance(o, PointDirection):
                sigma = o.sigma if isinstance(o.sigma, tuple) else ()
                if len(sigma) != 2 or sigma[0] != sigma[1] or any(o.value):
                    what = "a direction but one of value zero with one σ"
                    self.refusals.refuse(what, o.label())
                    continue
                length = float(np.linalg.norm((o.ux, o.uy, o.uz)))
                vector = [o.ux / length, o.uy / length, o.uz / length]
                ends = {"id": ident, "id_from": o.station, "id_to": o.target}
                degrees = float(np.rad2deg(sigma[0]))
                directions.append(ends | {"unit_vector": vector, "sigma_deg": degrees})
        return {"scale_constraints": scales, "orientation_constraints": directions}
