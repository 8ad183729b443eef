"""Files of an epoch that the exports of the package write: report, results, GeoPackage.

They say which epoch of which site they are of, and which readings it has left out.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..instruments.message_rules import iso
from ..report.adjustment_report import Report
from ..report.options import LeftOutReading, Provenance, ReportOptions, Run
from .decisions import Decision, epoch_decisions, last_decisions
from .live_epochs import LiveEpoch
from .live_network import LiveNetwork
from .observation_list import STATES, ObservationList
from .site import Site

Answer = dict[str, Any]


def epoch_file(network: LiveNetwork, site: Site, name: str, number: int | None) -> bytes:
    """Return a file of an epoch.

    Where no epoch is asked for and the present one determines nothing yet, it is that of the last
    epoch that did.

    Args:
        network: the network.
        site: its site.
        name: ``report.html``, or a name whose suffix tells a format of results.
        number: number of the epoch; None: the present one.

    Raises:
        InputError: there is no such epoch, or it determines nothing.
    """
    from ..export.formats import write
    from ..report.html.page import write_report

    if number is None and not network.has_solution:
        every = [row["number"] for row in reversed(network.epochs())]
        number = next((n for n in every if _has_result(network, n)), None)
    with network.reading(number) as epoch:
        solution = epoch.stream.adjustment.solution()
        units = epoch.stream.context.units
        decided = epoch_decisions(site.database, network.settings.name, epoch.number)
        provenance = Provenance(
            run=Run(subject=subject(site.settings.name, network.settings.name, epoch)),
            left_out=left_out_readings(epoch, last_decisions(decided)),
        )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        if name.endswith(".html"):
            write_report(solution, path, options=ReportOptions(units), provenance=provenance)
        else:
            write(Report(solution, provenance=provenance), path)
        return path.read_bytes()


def _has_result(network: LiveNetwork, number: int) -> bool:
    (row,) = network.epochs(results=True, number=number)
    return row["state"] != "dropped" and bool((row["result"] or {}).get("points"))


def subject(site: str, network: str, epoch: LiveEpoch) -> str:
    """Return which epoch of which network it is, and when it was.

    Args:
        site: name of the site.
        network: name of the network.
        epoch: the epoch.
    """
    end = "" if epoch.end is None else f" to {iso(epoch.end)}"
    state = f", {epoch.state}" if epoch.state != "closed" else ""
    when = f"{iso(epoch.begin)}{end}, revision {epoch.revision}{state}"
    return f"{site}, network {network}, epoch {epoch.number} ({when})"


def left_out_readings(epoch: LiveEpoch, decided: Mapping[str, Decision]) -> list[LeftOutReading]:
    """Return the readings that are not in an epoch, with why.

    Args:
        epoch: the epoch, whose lock is held.
        decided: the last decision about each observation, by ids.
    """
    listed = ObservationList(epoch, None)
    now = listed.tested_now()
    return [
        LeftOutReading(row["label"], state, _why(row, now.get(row["id"]), decided.get(row["id"])))
        for state in STATES[1:]
        for row in listed.others(state)
    ]


def _why(row: Answer, now: Answer | None, decision: Decision | None) -> str:
    """Return why a reading is out: what it lacks, who decided, and its test.

    The test is that against everything that the epoch has in, or that on its arrival.
    """
    said = [row.get("lacks", ""), row.get("cause", "")]
    if decision is not None:
        said.append(decision.do + (f" by {decision.by}" if decision.by else ""))
    tested, when = (row, "on its arrival") if now is None else (now, "against all that are in")
    if tested.get("dof"):
        w = np.nan_to_num(np.abs(np.array(tested["w"], dtype=float)), nan=-1.0)
        i, unit = int(np.argmax(w)), tested["small_unit"]
        off, sigma = tested["innovation"][i], tested["innovation_sigma"][i]
        said.append(
            f"{when} T² = {tested['t2']:.1f}, critical {tested['critical']:.2f}; "
            f"computed − observed {off:.4g} {unit}, σ {sigma:.2g} {unit}"
        )
    return "; ".join(filter(None, said))
