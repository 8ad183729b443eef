"""Results of the Damped Bundle Adjustment Toolbox (DBAT), and an independent computation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from factorgraph_adj.types import Array
from tests.networks.dbat import table


@dataclass(frozen=True)
class Printed:
    """A printed number and half of its last digit."""

    value: float
    half: float

    @staticmethod
    def fixed(text: str) -> Printed:
        """Read a number with a fixed count of decimals."""
        decimals = len(text.partition(".")[2])
        return Printed(float(text), 0.5 * 10.0**-decimals)

    @staticmethod
    def significant(text: str, digits: int) -> Printed:
        """Read a number with ``digits`` significant digits (%g drops zeros at the end)."""
        value = float(text)
        exponent = 0 if value == 0 else int(np.floor(np.log10(abs(value))))
        return Printed(value, 0.5 * 10.0 ** (exponent - digits + 1))


@dataclass(frozen=True)
class Report:
    """What a DBAT report prints."""

    sigma0: Printed
    """Standard deviation of unit weight."""
    last_error: Printed
    """√vᵀPv at the end."""
    redundancy: int
    n_unknowns: int
    n_observations: int
    calibration: dict[str, tuple[Printed, Printed | None]]
    """Value and standard deviation by DBAT's label, which begins with "K1", "px" and so on."""
    photos: dict[str, dict[str, tuple[Printed, Printed | None]]]
    """Omega, Phi, Kappa (degrees), Xc, Yc, Zc with standard deviations by number of photo."""
    points: dict[str, tuple[list[Printed], list[Printed]]]
    """Adjusted X, Y, Z and standard deviations of control and check points."""


def read_report(path: Path) -> Report:
    """Return what a report prints; standard deviations there are a posteriori."""
    lines = [line.strip() for line in path.read_text().splitlines()]

    def after(label: str) -> str:
        return next(line[len(label) :].strip() for line in lines if line.startswith(label))

    calibration: dict[str, tuple[Printed, Printed | None]] = {}
    photos: dict[str, dict[str, tuple[Printed, Printed | None]]] = {}
    points: dict[str, tuple[list[Printed], list[Printed]]] = {}
    part = "calibration"
    photo = ""
    for i, line in enumerate(lines):
        if line.startswith("Photo ") and line.lower().endswith(".jpg"):
            part, photo = "photo", line.split()[1].rstrip(":")
            photos[photo] = {}
        if line == "Quality":
            part = "quality"
        if line.endswith(":") and i + 1 < len(lines) and lines[i + 1].startswith("Value:"):
            value = lines[i + 1].split()[1]
            follows = lines[i + 2].split()
            sigma = Printed.significant(follows[1], 3) if follows[0] == "Deviation:" else None
            label = line.rstrip(":").split(" - ")[0]
            if part == "calibration":
                calibration[label] = (Printed.significant(value, 6), sigma)
            elif part == "photo":
                photos[photo][label] = (Printed.fixed(value), sigma)
        if line == "Posterior":
            for row in lines[i + 2 :]:
                fields = [f.strip() for f in row.split(",")]
                if len(fields) < 9:
                    break
                points[fields[0]] = (
                    [Printed.fixed(f) for f in fields[1:4]],
                    [Printed.significant(f, 3) for f in fields[4:7]],
                )
    return Report(
        Printed.significant(after("Sigma0:"), 6),
        Printed.significant(after("Last error:"), 6),
        int(after("Redundancy")),
        int(after("Number of params:").split()[0]),
        int(after("Number of observations:").split()[0]),
        calibration,
        photos,
        points,
    )


def read_reliability(folder: Path) -> tuple[list[tuple[str, str, str]], Array]:
    """Return photo, point and component of each row of ``reference_reliability.csv``, and figures.

    An independent computation: v/σ, redundancy number, w a priori, w a posteriori, ∇/σ and δ̄, with
    δ0 = 4.132. It numbers its image points in the order of the files of measurements; control
    coordinates (photo "") follow in the order of the control file, without check points.
    """
    images: list[tuple[str, str]] = []
    if (folder / "sxb.xml").exists():
        for file in ("markpts.txt", "smartpts.txt"):
            images += [(f[1], f[0]) for f in table(folder / "measurements" / file)]
        control = [f[0] for f in table(folder / "reference/sxb-control.txt")]
        control = [name for name in control if name not in ("351", "410")]
    else:
        images = [(f[0], f[1]) for f in table(folder / "measurements/markpts.txt")]
        control = []
    of_row = [(*both, axis) for both in images for axis in "xy"]
    of_row += [("", name, axis) for name in control for axis in "XYZ"]
    rows = list(table(folder / "reference_reliability.csv"))[1:]
    for (photo, _, axis), row in zip(of_row, rows, strict=True):
        assert row[1] == ("img" if photo else "ctrl") and row[4] == axis
    return of_row, np.array([[float(v) for v in row[5:]] for row in rows])
