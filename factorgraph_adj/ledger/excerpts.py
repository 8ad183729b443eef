"""Excerpt of a network: the part that some observations touch, with known variables held.

The excerpt is a network of its own: models, the search for approximate values and the adjustment
of small parts are those of every network.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from ..entities import FREE_ORIENTATION, Camera, Parameter, parameter_name
from ..graph.variables import camera_of_calibration
from ..models.unknown_registry import ENTITIES, UNKNOWNS, VariableKind, parameter_kinds
from ..network.network import DatumChoice, Network
from ..types import Array, Index
from .ledger import Ledger
from .row_store import insert_units

HELD = (True, True, True)
"""Flags of a point that is held altogether."""


class Known(Protocol):
    """Variables whose values are known."""

    def known(self, kind: VariableKind, name: str) -> bool:
        """Return whether a variable is known."""
        ...

    def value(self, kind: VariableKind, name: str) -> Array | None:
        """Return the value of a variable as in a state; None: it is not known."""
        ...


def excerpt(
    ledger: Ledger, known: Known, rows: Index, *, datum: DatumChoice = "given", hold: bool = True
) -> Network:
    """Return the network of some observations, with known variables at their values.

    A camera with a calibration for each photo becomes one camera for each photo, of the name
    that its calibration has among the unknowns.

    Args:
        ledger: everything that was described.
        known: what is known.
        rows: the observations.
        datum: datum of the network.
        hold: whether known variables are held. Otherwise they are as they were described, without
            weights; what is not known must then be held in any case.
    """
    return _Excerpt(ledger, known, datum, hold).of(rows)


class _Excerpt:
    """A network that is put together."""

    def __init__(self, ledger: Ledger, known: Known, datum: DatumChoice, hold: bool) -> None:
        self.ledger, self.network, self.known, self.hold = ledger, ledger.network, known, hold
        self.out = Network(
            self.network.name, frame=self.network.frame, datum=datum, crs=self.network.crs
        )

    def of(self, chosen: Index) -> Network:
        """Return the network of some rows."""
        out, network, rows, names = self.out, self.network, self.ledger.rows, self.ledger.names
        units = [unit for _, unit in rows.units(chosen)]
        poses: dict[str, None] = {}
        for kind, name in dict.fromkeys(v for u in units for v in u.variables):
            if kind == "point":
                self._point(name)
            elif kind == "pose":
                poses[name] = None
            elif kind == "calibration":
                self._lens(camera_of_calibration(network, name), name)
            elif kind not in ENTITIES and UNKNOWNS[kind].absent != "found":
                self._stated(kind, name)
        rays = rows.images(chosen)
        for number in np.unique(rows.point[rays]).tolist():
            self._point(names.points[number])
        poses |= {names.photos[f]: None for f in np.unique(rows.photo[rays]).tolist()}
        for name in out.verticals:  # a vertical needs its station; horizons turn with it
            self._point(name)
        for name in poses:
            self._photo(name)
        out.images = rows.table(rays)
        for column, all_names, number_of in (
            (out.images.photo, names.photos, out.photo_number),
            (out.images.point, names.points, out.point_number),
        ):
            every, place = np.unique(column[0], return_inverse=True)
            new = np.array([number_of[all_names[i]] for i in every.tolist()], dtype=np.intp)
            column[0] = new[place]
        insert_units(out, units)
        for kind in (k.name for k in parameter_kinds() if k.absent == "found"):
            found, given = out.of_kind(kind), network.of_kind(kind)
            for key in found:
                stated = given.get(key, FREE_ORIENTATION)
                found[key] = self._parameter(kind, parameter_name(key), stated)
        return out

    def _stated(self, kind: VariableKind, name: str) -> None:
        given = self.network.of_kind(kind)
        compound = (k for k in given if not isinstance(k, str) and parameter_name(k) == name)
        key = name if name in given else next(compound, None)
        if key is not None:
            self.out.of_kind(kind)[key] = self._parameter(kind, name, given[key])

    def _point(self, name: str) -> None:
        if name in self.out.points:
            return
        point = self.network.points[name]
        value = self.known.value("point", name)
        if value is not None:
            at = tuple(value.tolist())
            point = replace(
                point, coordinates=at, sigma=None, fixed=HELD if self.hold else point.fixed
            )
        self.out.points[name] = point
        self.out.point_number[name] = len(self.out.point_number)

    def _photo(self, name: str) -> None:
        photo = self.network.photos[name]
        camera = self.network.cameras[photo.camera]
        calibration = f"{camera.name}@{name}" if camera.per_photo else camera.name
        self._lens(camera, calibration)
        value = self.known.value("pose", name)
        if value is not None:
            photo = replace(
                photo,
                position=tuple(value[9:].tolist()),
                rotation=value[:9].reshape(3, 3),
                fixed=(True,) * 6 if self.hold else photo.fixed,
                sigma_position=None,
                sigma_attitude=None,
            )
        self.out.photos[name] = replace(photo, camera=calibration)
        self.out.photo_number[name] = len(self.out.photo_number)
        for kind, of_photo in self.network.of_photo(name):
            self._stated(kind, of_photo)

    def _lens(self, camera: Camera, name: str) -> None:
        if name not in self.out.cameras:
            self.out.cameras[name] = self._camera(camera, name)

    def _camera(self, camera: Camera, name: str) -> Camera:
        value = self.known.value("calibration", name)
        out = replace(camera, name=name, per_photo=False)
        if value is None:
            return out
        k = len(camera.values)
        fixed = (True,) * k if self.hold else camera.fixed
        return replace(out, values=tuple(value[:k].tolist()), fixed=fixed, sigma=(np.inf,) * k)

    def _parameter(self, kind: VariableKind, name: str, given: Parameter) -> Parameter:
        value = self.known.value(kind, name)
        if value is None:
            return given
        k = len(given.values)
        value = UNKNOWNS[kind].given(value[None])[0]
        fixed = (True,) * k if self.hold else given.fixed
        values = tuple(value[:k].tolist())
        return replace(given, values=values, fixed=fixed, sigma=(np.inf,) * k)
