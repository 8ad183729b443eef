"""Reader of VisualSFM (.nvm): cameras, poses, points with their image points, of one model.

    p = R (X − C),  x right, y down, z ahead;  m = (x, y)/f of the measured place
    p_x/p_z = (1 + r |m|²) m_x,  p_y/p_z = (1 + r |m|²) m_y

The radial distortion is that of the measured place (Wu's multicore bundle adjustment), so that it
is the k1 = r/f² of `BrownLens`, whose correction is of measured coordinates in pixels.

COLMAP writes this format with other meanings: image coordinates count from the upper left corner,
and r is −k1 of its camera, m = f (1 − r |p|²) p, the k1 of `NormalisedLens`.

The first line is ``NVM_V3``, perhaps with ``FixedK fx cx fy cy``. A model is the number of its
photos, a row for each: file, f, quaternion w x y z of R, centre C, r, 0; the number of its points,
a row for each: coordinates, colour, number of image points, and photo, feature, x, y of each.
Further models follow; 0 ends them, and a list of PLY files may come after it. A file name has ``"``
for each blank. Source: VisualSFM's documentation and LoadNVM of multicore bundle adjustment.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from ...errors import InputError
from ...models.lens import BrownLens, Lens, NormalisedLens
from ...network.network import Network
from ...rotation import rotation_of_quaternion
from ...types import Array
from ..format_options import option_text
from ..format_reader import NetworkReader, Reader, begins_with
from ..source import LeftOutReason, TextSource, is_unread
from .block_source import (
    POINTS_WITH_FEW_RAYS,
    TIE_PREFIX,
    ImagePoints,
    add_pixel_camera,
)
from .ground_control import place_by_positions

ProgramChoice = Literal["visualsfm", "colmap"]
"""Program that wrote a file: COLMAP has another origin and another distortion."""
PHOTO_FIELDS = 10
"""Fields of a photo behind its name."""
POINT_FIELDS = 7
"""Fields of a point before its image points."""
RAY_FIELDS = 4
"""Fields of an image point."""
QUATERNION_ERROR = 0.01
"""Largest difference of the length of a quaternion from 1."""
REPEATED_RAYS = LeftOutReason(
    "image points", "their points are measured several times in one photo"
)


def read_nvm(
    path: str | Path,
    *,
    model: int = 1,
    sigma_px: float = 1.0,
    program: ProgramChoice | None = None,
    principal_point: tuple[float, float] | None = None,
    repeated: Literal["refuse", "leave out"] = "refuse",
    positions: str | Path | None = None,
    sigma_positions: tuple[float, float] | None = None,
    positions_system: str | None = None,
) -> Network:
    """Read a model of VisualSFM, as a free network or by positions of its photos.

    Every photo has a camera of its own with unknown c and k1, as in VisualSFM; with ``FixedK`` all
    have one camera that is held. VisualSFM counts image coordinates from the centre of the image,
    so that some are negative; COLMAP counts from the upper left corner, and the file has no size of
    the images, so that its files need ``principal_point``. Tie points are named ``tie NUMBER``. Not
    read: colours, numbers of features, the list of PLY files. Tried on the example of Blender's
    photogrammetry importer, whose residuals are 0.5 px as a file of COLMAP and 1.2 px otherwise.

    Args:
        path: the file.
        model: number of the model in the file, from 1.
        sigma_px: standard deviation of image coordinates, pixels; the format has none.
        program: program that wrote the file; None: VisualSFM, and a file without any negative
            image coordinate is refused, because it seems to be of COLMAP.
        principal_point: principal point in pixels from the upper left corner, x right, y down,
            for ``program="colmap"``: half the size of the image.
        repeated: what to do with a point that is measured several times in one photo, of which one
            measurement at most is right: refuse the file, or leave all of them out.
        positions: list of observed positions of photos, which places the model on the Earth:
            geo.txt of ODM, or a table, see `io.photogrammetry.coordinate_lists`; None: the model
            is free.
        sigma_positions: standard deviations of positions for which the file states no σ,
            horizontal and vertical, metres.
        positions_system: reference system of a table of positions that states none.

    Raises:
        InputError: the file has problems, each with file and line.
    """
    if not sigma_px > 0:
        raise InputError(f"sigma_px must be greater than zero, not {sigma_px}")
    if program not in (None, *get_args(ProgramChoice)):
        valid = ", ".join(get_args(ProgramChoice))
        raise InputError(f"program must be one of {valid}, not {program!r}")
    if (program == "colmap") != (principal_point is not None):
        raise InputError("program=colmap and principal_point are given together, or neither")
    if repeated not in ("refuse", "leave out"):
        raise InputError(f"repeated must be refuse or leave out, not {repeated!r}")
    reading = _Reading(TextSource(path), sigma_px, program, principal_point, repeated)
    return place_by_positions(
        reading.network(model), positions, sigma=sigma_positions, system=positions_system
    )


class _Reading:
    """A file while it is read."""

    def __init__(
        self,
        source: TextSource,
        sigma_px: float,
        program: ProgramChoice | None,
        principal_point: tuple[float, float] | None,
        repeated: str,
    ) -> None:
        self.source = source
        self.sigma_px = sigma_px
        self.program = program
        x0, y0 = principal_point or (0.0, 0.0)
        self.principal = (float(x0), -float(y0))
        self.repeated = repeated
        self.rows: Iterator[tuple[int, str]] = source.filled()
        self.fixed: tuple[float, ...] | None = None

    def network(self, wanted: int) -> Network:
        """Return the network of one model."""
        self._head()
        models, found = 0, None
        while True:
            photos = self._count("photos", last=True)
            if not photos:
                break
            models += 1
            made = self._model(photos, self.source.path.name, use=models == wanted)
            found = found if made is None else made
        self.source.raise_all()
        if found is None:
            what = f"has {models} models; valid for model: 1 to {models}, not {wanted}"
            self.source.wrong(0, what if models else "has no model")
            self.source.raise_all()
        if models > 1:
            self.source.problems.remarks.append(f"model {wanted} of {models} models was read")
        self.source.problems.finish(found)
        assert found is not None
        return found

    def _head(self) -> None:
        line, text = next(self.rows, (1, ""))
        words = text.split()
        if words[:1] != ["NVM_V3"]:
            self.source.wrong(line, "must begin with NVM_V3")
            self.source.raise_all()
        if len(words) == 1:
            return
        if words[1] != "FixedK" or len(words) not in (6, 7):
            self.source.wrong(line, "has words behind NVM_V3; valid: FixedK fx cx fy cy, and r")
            self.source.raise_all()
        names = ("fx", "cx", "fy", "cy", "r")
        self.fixed = tuple(
            self.source.field(line, w, n).number() for n, w in zip(names, words[2:], strict=False)
        )
        if not is_unread(*self.fixed) and not (self.fixed[0] > 0 and self.fixed[2] > 0):
            self.source.wrong(line, "focal lengths must be greater than zero")
        self.source.raise_all()

    def _count(self, what: str, *, last: bool = False) -> int:
        """Return a number of rows that follow; 0 at the end."""
        line, text = next(self.rows, (self.source.last, ""))
        if not text:
            if last and not self.source.problems.count:
                return 0
            self.source.wrong(line, f"ends where the number of {what} should be")
            self.source.raise_all()
        found = self.source.field(line, text, f"number of {what}").integer(largest=10**9)
        self.source.raise_all()
        assert found is not None
        return found

    def _next(self, what: str, at: int, n: int) -> tuple[int, list[str]]:
        line, text = next(self.rows, (0, ""))
        if not line:
            self.source.wrong(0, f"ends in {what} {at} of {n}")
            self.source.raise_all()
        return line, text.split()

    def _model(self, n_photos: int, name: str, *, use: bool) -> Network | None:
        """Read a model; None if it is not the wanted one, whose rows are counted only."""
        photos = [self._next("photo", i, n_photos) for i in range(n_photos)]
        n_points = self._count("points")
        points = [self._next("point", i, n_points) for i in range(n_points)]
        if not use:
            return None
        network = Network(name, datum="free")
        if self.fixed is not None:
            fx, cx, fy, cy, *r = self.fixed
            lens, values = self._lens(fy, r[0] if r else 0.0)
            if self.program == "colmap":
                values |= {"x0": cx, "y0": -cy}
            if fx != fy:
                what = f"fx = {fx:g} and fy = {fy:g} differ: VisualSFM has one focal length"
                self.source.wrong(1, what)
            add_pixel_camera(network, "fixed", lens, values, size=None)
        names = [self._photo(network, *row) for row in photos]
        images = ImagePoints(self.source.problems)
        for i, row in enumerate(points):
            self._point(network, images, f"{TIE_PREFIX}{i}", names, *row)
        self._check_origin(images)
        self.source.raise_all()
        images.into(network)
        return network

    def _lens(self, f: float, r: float) -> tuple[Lens, dict[str, float]]:
        """Return lens model and calibration of a focal length and a radial distortion."""
        values = {"c": f, "x0": self.principal[0], "y0": self.principal[1]}
        if self.program == "colmap":
            return NormalisedLens(), values | {"k1": -r}
        return BrownLens(residuals="ideal"), values | {"k1": r / f**2}

    def _check_origin(self, images: ImagePoints) -> None:
        """Refuse a file whose image coordinates seem to count from the corner."""
        every = [row[1:3] for rows in images.rows.values() for row in rows]
        if self.program is None and every:
            xy = np.array(every)
            if xy[:, 0].min() >= 0.0 and xy[:, 1].max() <= 0.0:
                self.source.wrong(
                    0,
                    "no image coordinate is negative: they seem to count from the upper left "
                    f"corner, as COLMAP writes them; say {option_text('program', 'colmap')} and "
                    f"{option_text('principal_point', ('x', 'y'))}, half the size of the images, "
                    f"or {option_text('program', 'visualsfm')}",
                )

    def _photo(self, network: Network, line: int, words: list[str]) -> str | None:
        """Add a photo; return its name, None after a problem."""
        if len(words) != 1 + PHOTO_FIELDS:
            what = "name, f, qw qx qy qz, Cx Cy Cz, r, 0"
            n = 1 + PHOTO_FIELDS
            self.source.wrong(line, f"a photo has {n} fields, {what}, not {len(words)}")
            return None
        name = words[0].replace('"', " ")
        titles = ("f", "qw", "qx", "qy", "qz", "Cx", "Cy", "Cz", "r", "last field")
        numbers = [
            self.source.field(line, w, what).number()
            for w, what in zip(words[1:], titles, strict=True)
        ]
        if is_unread(*numbers):
            return None
        f, r = numbers[0], numbers[8]
        q = np.array(numbers[1:5])
        length = float(np.linalg.norm(q)) if np.abs(q).max() < 2.0 else np.inf
        if not abs(length - 1.0) <= QUATERNION_ERROR:
            self.source.wrong(line, "its quaternion has not the length 1")
            return None
        if not f > 0:
            self.source.wrong(line, f"f must be greater than zero, not {f:g}")
            return None
        if numbers[9] != 0.0:
            self.source.wrong(line, f"the last field of a photo is 0, not {words[-1][:20]}")
            return None
        with self.source.problems.collect(self.source.place(line)):
            camera = "fixed"
            if self.fixed is None:
                camera = name
                lens, values = self._lens(f, r)
                add_pixel_camera(network, name, lens, values, size=None, free=("c", "k1"))
            rotation: Array = rotation_of_quaternion(q / length).T
            network.add_photo(name, camera, position=numbers[5:8], rotation=rotation)
            return name
        return None

    def _point(
        self,
        network: Network,
        images: ImagePoints,
        name: str,
        photos: list[str | None],
        line: int,
        words: list[str],
    ) -> None:
        """Add a point with its image points."""
        titles = ("X", "Y", "Z", "red", "green", "blue", "number of image points")
        numbers = [
            self.source.field(line, w, what).number()
            for w, what in zip(words, titles, strict=False)
        ]
        if len(numbers) < POINT_FIELDS:
            what = f"a point has {POINT_FIELDS} fields before its image points, not {len(words)}"
            self.source.wrong(line, what)
            return
        if is_unread(*numbers):
            return
        rest = words[POINT_FIELDS:]
        if len(rest) != RAY_FIELDS * numbers[6]:
            what = (
                f"says {words[6]} image points of {RAY_FIELDS} fields, and has {len(rest)} fields"
            )
            self.source.wrong(line, what)
            return
        rays: dict[str, list[tuple[float, float]]] = {}
        for i in range(0, len(rest), RAY_FIELDS):
            found = self._ray(line, rest[i : i + RAY_FIELDS], photos)
            if found is not None:
                rays.setdefault(found[0], []).append(found[1])
        for photo in [p for p, seen in rays.items() if len(seen) > 1]:
            if self.repeated == "refuse":
                what = f"photo {photo!r} measures the point {len(rays[photo])} times; "
                self.source.wrong(
                    line, f"{what}{option_text('repeated', 'leave out')} leaves them out"
                )
            else:
                for _ in rays.pop(photo):
                    self.source.leave_out(line, REPEATED_RAYS, f"{photo} {name}")
        if len(rays) < 2:
            self.source.leave_out(line, POINTS_WITH_FEW_RAYS, name)
            return
        with self.source.problems.collect(self.source.place(line)):
            network.add_point(name, numbers[:3])
        for photo, ((x, y), *_) in rays.items():
            images.add(photo, name, (x, -y), (self.sigma_px,), self.source.place(line))

    def _ray(
        self, line: int, words: list[str], photos: list[str | None]
    ) -> tuple[str, tuple[float, float]] | None:
        """Return photo and place of an image point, y down; None after a problem."""
        largest = len(photos) - 1
        photo = self.source.field(line, words[0], "number of a photo").integer(largest=largest)
        feature = self.source.field(line, words[1], "number of a feature").integer()
        x, y = (
            self.source.field(line, w, n).number() for n, w in zip("xy", words[2:], strict=True)
        )
        name = None if photo is None else photos[photo]
        return None if name is None or is_unread(feature, x, y) else (name, (x, y))


READER = Reader(
    "nvm",
    (".nvm",),
    "model of VisualSFM",
    NetworkReader(read_nvm),
    recognises=begins_with(rb"\s*NVM_V3\b"),
)
