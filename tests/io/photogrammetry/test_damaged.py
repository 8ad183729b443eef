"""Damaged files of photogrammetric programs: a message with its place, or a network."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from tests.hostile.damage import QUICK, damaged
from tests.networks import photo_files

INPUTS = 200


@dataclass(frozen=True)
class Case:
    """Undamaged files, and the one that is read."""

    files: Callable[[Path], dict[str, bytes]]
    read: str
    format: str
    beside: tuple[str, ...] = ()
    """Options that name another file: name and suffix .xml are theirs."""

    def options(self, folder: Path) -> dict[str, Path]:
        """Return the options that name other files."""
        return {name: folder / f"{name}.xml" for name in self.beside}


CASES = {
    "metashape xml": Case(photo_files.metashape, "cameras.xml", "metashape-xml"),
    "metashape psz": Case(photo_files.psz, "project.psz", "metashape"),
    "dbat": Case(lambda _: photo_files.dbat(), "script.xml", "dbat"),
    "aicon": Case(lambda _: photo_files.aicon(), "block.obc", "aicon"),
    "opf": Case(photo_files.opf, "block.opf", "opf"),
    "opensfm": Case(lambda _: photo_files.opensfm(), "reconstruction.json", "opensfm"),
    "openmvg": Case(lambda _: photo_files.openmvg(), "sfm_data.json", "openmvg"),
    "opencv yaml": Case(lambda f: photo_files.opencv(".yml", f), "calibration.yml", "opencv"),
    "opencv xml": Case(lambda f: photo_files.opencv(".xml", f), "calibration.xml", "opencv"),
    "micmac": Case(
        lambda _: photo_files.micmac(),
        "Orientation-0.tif.xml",
        "micmac",
        ("control", "measures"),
    ),
    "bundler": Case(lambda _: {"b.out": photo_files.BUNDLER.encode()}, "b.out", "bundler"),
}


@pytest.mark.parametrize("name", CASES)
def test_undamaged_files_are_read_and_told_by_their_content(name: str, tmp_path: Path) -> None:
    case = CASES[name]
    (tmp_path / "made").mkdir()
    files = case.files(tmp_path / "made")
    for file, content in files.items():
        (tmp_path / file).write_bytes(content)
    network = fga.read(tmp_path / case.read, **case.options(tmp_path))
    assert network.n_image_points and network.photos and network.points


@pytest.mark.parametrize("name", CASES)
def test_damaged_files_are_refused_by_place_or_read(name: str, tmp_path: Path) -> None:
    case = CASES[name]
    (tmp_path / "made").mkdir()
    files = case.files(tmp_path / "made")
    refused = 0
    for seed in range(INPUTS):
        folder = tmp_path / str(seed)
        done = damaged(np.random.default_rng([seed, 21]), files, folder, QUICK)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                network = fga.read(folder / case.read, format=case.format, **case.options(folder))
            except InputError as error:
                refused += 1
                for problem in error.problems:
                    assert problem.where and problem.what, f"{seed} {done}: {problem}"
                    assert len(str(problem)) < 2000
                continue
        assert np.isfinite(network.images.columns()[2]).all(), f"{seed} {done}"
    assert refused > INPUTS // 4
