"""Synthetic models of pycolmap with known truth; tests that use them skip without pycolmap."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest


def synthetic(
    seed: int = 1,
    *,
    rigs: int = 2,
    cameras: int = 1,
    frames: int = 4,
    points: int = 40,
    model: str = "SIMPLE_RADIAL",
    parameters: tuple[float, ...] = (1280.0, 512.0, 384.0, 0.05),
    database: Path | None = None,
) -> Any:
    """Return a reconstruction without noise."""
    pycolmap = pytest.importorskip("pycolmap")
    pycolmap.set_random_seed(seed)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs = rigs
    options.num_cameras_per_rig = cameras
    options.num_frames_per_rig = frames
    options.num_points3D = points
    options.camera_model_id = getattr(pycolmap.CameraModelId, model)
    options.camera_params = list(parameters)
    options.sensor_from_rig_translation_stddev = 0.3
    options.sensor_from_rig_rotation_stddev = 5.0
    if database is None:
        return pycolmap.synthesize_dataset(options)
    opened = pycolmap.Database.open(str(database))
    made = pycolmap.synthesize_dataset(options, opened)
    opened.close()
    return made


def disturb(reconstruction: Any, *, pixels: float = 0.5, start: float = 0.01) -> None:
    """Add noise to measurements, and disturb the start values of points and poses."""
    pycolmap = pytest.importorskip("pycolmap")
    noise = pycolmap.SyntheticNoiseOptions()
    noise.point2D_stddev = pixels
    noise.point3D_stddev = start
    noise.rig_from_world_translation_stddev = start
    noise.rig_from_world_rotation_stddev = 50.0 * start
    pycolmap.synthesize_noise(noise, reconstruction)


def written(reconstruction: Any, folder: Path, *, text: bool = False) -> Path:
    """Write a reconstruction; return the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    write = reconstruction.write_text if text else reconstruction.write_binary
    write(str(folder))
    return folder
