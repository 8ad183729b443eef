"""Data files of SNAP in SINEX: positions of a solution with their covariance, as one set of GX.

Format: LINZ, SNAP help, "The data_file command" and "SINEX observation files".
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from ...observations import GnssPosition
from ..gnss.sinex import read_sinex
from ..gnss.sinex_blocks import SinexFile
from ..source import TextSource
from .snap_data_commands import REFERENCE_FRAME
from .snap_lines import parsed_date
from .snap_readings import SnapReading, SnapSet
from .snap_selections import JobLine

CODES = {"SITE": False, "POINT": True}
"""Whether the code of a station has that of its point, by option."""
GNSS_FRAME = "GNSS"
"""Reference frame of positions whose option names none."""
FULL = "full"


@dataclass
class SinexOptions:
    """Options of a data file in SINEX."""

    points: bool = False
    """Whether codes are SITE_POINT."""
    frame: str = GNSS_FRAME
    """Code of the reference frame."""
    date: datetime | None = None
    """Date of the observations; None: that of the file."""

    def take(self, at: JobLine, word: str) -> bool:
        """Take an option ``name=value``; return whether the word is one."""
        name, equals, value = word.partition("=")
        if not equals:
            return False
        low = name.lower()
        if low == "code":
            found = at.source.field(at.line, value.upper(), "code").choice(CODES)
            self.points = bool(found)
        elif low == "ref_frame":
            self.frame = at.source.field(at.line, value, "ref_frame").name()
        elif low == "date":
            self.date = parsed_date(value)
            if self.date is None:
                at.wrong(f"date {value[:40]!r} is none; valid: such as 2008-01-13")
        else:
            return False
        return True


def read_sinex_set(at: JobLine, path: Path, options: SinexOptions) -> list[SnapSet]:
    """Return the positions of a solution, with the constraints that it has; what is wrong is noted.

    Args:
        at: the line of the job that names the file.
        path: the file.
        options: its options.
    """
    network = at.source.attempt(at.line, read_sinex, path, apriori="keep")
    if network is None:
        return []
    source = TextSource(path, at.source.problems)
    of_sites = {p.site[0]: p for p in SinexFile(path).parameters["ESTIMATE"].values()}
    readings = []
    for observation in network.observations.values():
        code = observation.names()[0]
        site = of_sites.get(code)
        date = options.date
        if date is None and site is not None and math.isfinite(site.epoch):
            date = _date(site.epoch)
        if options.points and site is not None:
            code = f"{code}_{site.site[1].strip()}"
        line = int((observation.source or ":0").rpartition(":")[2])
        readings.append(
            SnapReading(
                "GX",
                code,
                "",
                0.0,
                0.0,
                tuple(float(v) for v in getattr(observation, "value", ())),
                None,
                False,
                {REFERENCE_FRAME: options.frame},
                date,
                "",
                {},
                line,
            )
        )
    if network.clusters:
        ((_, covariance),) = network.clusters
    else:  # of one station
        (only,) = network.observations.values()
        assert isinstance(only, GnssPosition)  # read_sinex has nothing else
        covariance = np.asarray(only.covariance)
    return [SnapSet(tuple(readings), source, FULL, covariance)]


def _date(year: float) -> datetime:
    """Return the date of a year with its part."""
    begin = datetime(int(year), 1, 1)
    return begin + (year - int(year)) * (datetime(int(year) + 1, 1, 1) - begin)
