"""Two photos of a Wild RC-30 with fiducial marks: phisan-chula/pyBundleBlock, commit 51b8239f.

The repository states no licence; its figures are compared, and none of its files is copied. Image
coordinates are columns and negative rows of a scan, calibrated marks are in millimetres.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.models.film_lens import FilmLens, Transformation, transformation_parameters
from factorgraph_adj.types import Array

FOCAL_LENGTH, PIXEL = 154.006, 0.015
"""Millimetres."""
PHOTOS = ("P62_15", "P63_15")
_ROW = re.compile(r"^\s*(\w+)\s*:\s*\[([-\d.,\s]+)\]")


@dataclass(frozen=True)
class Block:
    """The block as its files have it."""

    control: dict[str, Array]
    """Control points, metres."""
    images: dict[str, dict[str, Array]]
    """Image coordinates by photo and point, pixels of the scan, y up."""
    marks: dict[str, dict[str, tuple[Array, Array]]]
    """Measured (pixels) and calibrated (millimetres) coordinates by photo and mark."""

    def network(
        self, transformation: Transformation, *, sigma_marks: float, sigma: float = 0.1
    ) -> fga.Network:
        """Return the network with fiducial marks as observations; σ in pixels."""
        network = fga.Network("pyBundleBlock")
        network.add_camera(
            "RC-30",
            FilmLens(pixel=PIXEL),
            {"c": FOCAL_LENGTH / PIXEL},
            free=transformation_parameters(transformation),
            unit="px",
            per_photo=True,
        )
        for name, at in self.control.items():
            network.add_point(name, at, fixed="xyz")
        for name in self.images[PHOTOS[0]]:
            if name not in network.points:
                network.add_point(name)
        for photo in PHOTOS:
            network.add_photo(photo, "RC-30")
            for point, xy in self.images[photo].items():
                network.add(fga.ImagePoint(photo, point, *xy.tolist(), sigma=sigma))
            for mark, (xy, (film_x, film_y)) in self.marks[photo].items():
                network.add(
                    fga.FiducialMark(
                        photo,
                        mark,
                        tuple(xy.tolist()),
                        film_x=film_x,
                        film_y=film_y,
                        sigma=(sigma_marks,) * 2,
                    )
                )
        return network


def read_block(folder: Path) -> Block:
    """Read the block in pixels, and the marks of both photos."""
    control: dict[str, Array] = {}
    images: dict[str, dict[str, Array]] = {photo: {} for photo in PHOTOS}
    of = control
    for line in (folder / "Block_62_63_6TP_TLE2020px.yml").read_text().splitlines():
        if line.startswith("GCP"):
            of = control
        elif (head := line.strip().rstrip(":")) in images:
            of = images[head]
        elif line.startswith("IOP"):
            of = {}
        elif found := _ROW.match(line):
            of[found[1]] = np.array([float(v) for v in found[2].split(",")])
    marks = {}
    for photo in PHOTOS:
        with (folder / "AffineLSQ" / f"{photo[1:3]}_affine.csv").open() as file:
            rows = [[cell.strip() for cell in row] for row in csv.reader(file) if row]
        values = {name: np.array(rest, dtype=float) for name, *rest in rows}
        marks[photo] = {name: (v[:2], v[2:]) for name, v in values.items()}
    return Block(control, images, marks)
