"""Refractive indices and ports of a network; image points that are seen through an interface."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ..entities import ImageTable, JointImagePoints, Point
from ..errors import InputError, Problem, known
from ..models.unknown_registry import unknown_kind
from ..observations.correlated_observations import Correlated
from ..observations.refracted_images import ImageThroughLevel, ImageThroughPlane, ImageThroughPort
from ..types import Mask
from .construction import required
from .photo_motions import PhotoMotions


class RefractedImages(PhotoMotions):
    """Part of a network: what its image rays pass between the camera and the points."""

    points: dict[str, Point]
    """Points by name."""
    images: ImageTable
    """Image points."""
    image_mask: Any
    """Keeps some of the image points, see `Network.image_mask`."""

    def set_refractive_index(
        self,
        name: str,
        value: float = 4.0 / 3.0,
        *,
        sigma: float | None = None,
        fixed: bool = False,
    ) -> None:
        """State the refractive index of a medium, such as water, relative to that of the camera.

        It is free unless held or weighted. That of water relative to air is 1.332 to 1.343, see
        `factorgraph_adj.atmosphere.water_index`.
        """
        if not 0.1 < value < 10.0:
            what = f"a refractive index must be between 0.1 and 10, not {value}"
            raise InputError(Problem(what, f"refractive index {name!r}"))
        self.set_unknown("refractive_index", name, (value,), fixed=fixed, sigma=sigma)

    def set_port(
        self,
        name: str,
        *,
        distance: float,
        thickness: float = 0.0,
        glass_index: float = 1.5,
        slopes: tuple[float, float] = (0.0, 0.0),
        free: Iterable[str] = (),
        sigma: Mapping[str, float] | None = None,
    ) -> None:
        """State a flat port, the plane window of a camera's housing.

        Args:
            name: its name.
            distance: distance of the inner face from the projection centre along the normal,
                metres.
            thickness: thickness of the glass, metres; 0: its refraction is neglected.
            glass_index: refractive index of the glass, relative to that of the camera.
            slopes: slopes of the normal against the axis of the camera, to the right and up:
                tangents of angles.
            free: components to estimate without a prior: slope_x, slope_y, distance, thickness,
                glass_index. Those that are neither free nor weighted are held.
            sigma: standard deviations of weighted components by name.

        Raises:
            InputError: an unknown component, a distance or an index that is not greater than zero,
                a negative thickness.
        """
        where = f"flat port {name!r}"
        if not distance > 0.0 or not thickness >= 0.0 or not glass_index > 0.0:
            what = (
                "distance and glass_index must be greater than zero, and thickness not negative: "
                f"{distance}, {glass_index}, {thickness}"
            )
            raise InputError(Problem(what, where))
        names = unknown_kind("port").names()
        wanted, weights = tuple(free), dict(sigma or {})
        unknown = [n for n in (*wanted, *weights) if n not in names]
        if unknown:
            what = f"unknown components {', '.join(unknown)}; valid: {', '.join(names)}"
            raise InputError(Problem(what, where))
        held = [n for n in names if n not in wanted and n not in weights]
        values = (*slopes, distance, thickness, glass_index)
        self.set_unknown("port", name, values, fixed=held, sigma=weights)

    def refract_images(
        self,
        *,
        medium: str,
        level: str | None = None,
        plane: str | None = None,
        port: str | None = None,
        points: Iterable[str] | None = None,
        photos: Iterable[str] | None = None,
    ) -> list[str]:
        """Take image points as seen through an interface; return the ids of the observations.

        They leave the table of image points and become observations of `ImageThroughLevel`,
        `ImageThroughPlane` or `ImageThroughPort`, with their coordinates, standard deviations and
        correlations; a group with a joint covariance becomes a `Correlated` of them.

        Args:
            medium: the refractive index of the medium that the points are in.
            level: the level surface, see `set_level`.
            plane: the frame of a plane, see `add_shape`.
            port: the flat port of the camera, see `set_port`.
            points: the points in the medium; None: all.
            photos: the photos that see them through the interface; None: all.

        Raises:
            InputError: not exactly one of level, plane and port, names that are unknown, no image
                point of such a point and photo, or not all of a group with a joint covariance.
        """
        where = "refracted image points"
        kinds: tuple[tuple[str, str | None, type[Any]], ...] = (
            ("level", level, ImageThroughLevel),
            ("plane", plane, ImageThroughPlane),
            ("port", port, ImageThroughPort),
        )
        stated = [(attribute, name, kind) for attribute, name, kind in kinds if name is not None]
        if len(stated) != 1:
            raise InputError(Problem("give one of level, plane and port", where))
        ((attribute, name, kind),) = stated
        photo, point, xy, sigma = self.images.columns()
        seen = np.ones(len(photo), dtype=bool)
        for given, there, number, what in (
            (photos, self.photos, photo, "photo"),
            (points, self.points, point, "point"),
        ):
            if given is not None:
                chosen = list(given)
                for each in chosen:
                    required(each, there, what, where)
                of = {n: i for i, n in enumerate(there)}
                seen &= np.isin(number, [of[n] for n in chosen])
        if not seen.any():
            raise InputError(Problem("no image point is of these photos and points", where))
        groups = self._whole_groups(seen, where)
        photo_names, point_names = tuple(self.photos), tuple(self.points)
        rho = self.images.correlation

        def through(row: int) -> Any:
            x, y = sigma[row].tolist()
            xy_both = float(rho[row]) * x * y
            alone = {"sigma": (x, y)}
            joint = {"covariance": np.array([[x * x, xy_both], [xy_both, y * y]])}
            return kind(
                photo_names[photo[row]],
                point_names[point[row]],
                tuple(xy[row].tolist()),
                medium=medium,
                id=self.images.ids.get(row),
                source=self.images.sources.get(row),
                **(joint if xy_both else alone),
                **{attribute: name},
            )

        grouped = {row for g in groups for row in g.rows.tolist()}
        found: list[Any] = [through(r) for r in np.flatnonzero(seen).tolist() if r not in grouped]
        found += [Correlated(tuple(map(through, g.rows.tolist())), g.covariance) for g in groups]
        before = self.images
        self.image_mask(~seen)
        try:
            return list(self.add(*found))
        except InputError:
            self.images = before
            raise

    def _whole_groups(self, seen: Mask, where: str) -> list[JointImagePoints]:
        """Return the groups with a joint covariance whose image points are all among those seen.

        Raises:
            InputError: some image points of a group are among them, and others are not.
        """
        photo, point, *_ = self.images.columns()
        photos, points = tuple(self.photos), tuple(self.points)
        whole, problems = [], []
        for group in self.images.joint:
            inside = seen[group.rows]
            if inside.all():
                whole.append(group)
            elif inside.any():
                some, others = (
                    known(f"{photos[photo[r]]}/{points[point[r]]}" for r in group.rows[on])
                    for on in (inside, ~inside)
                )
                what = (
                    f"{some} have a joint covariance with {others}, which are not to be seen "
                    "through the interface: image points of both kinds have none; choose all or "
                    "none of them, or state image points without a joint covariance"
                )
                problems.append(Problem(what, where))
        if problems:
            raise InputError(problems)
        return whole
