"""Surveillance of a network: what its closed epochs tell, its alarms, and who must be told.

The monitor goes on from its state in the database where a service begins
(`factorgraph_adj.site.monitor_states`). It is made again from the estimates of all closed epochs
where there is no state of these settings, and where an earlier epoch has got another result. Alarms
that stand are those of the monitor; the database has when they were raised, acknowledged, silenced
and cleared.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from ..epochs.block_motion import block_motion
from ..epochs.comparison_result import Displacement, EpochComparison
from ..errors import AdjustmentError
from ..monitoring.alarm_rules import OF_REFERENCE, AlarmRule, TestedEpoch, matches
from ..monitoring.epoch_estimates import EpochEstimate
from ..monitoring.monitor import Findings, Monitor
from ..monitoring.motion_filter import DAY_S
from ..service.answers import rounded_figure
from ..units import ANGLE
from .alarm_log import EPOCH_SECONDS, Raised
from .alarm_tables import SiteAlarm
from .live_epochs import LiveEpoch
from .monitor_states import State, state_digest
from .reference_epoch import ReferenceEpoch, reference_epoch
from .site_file import NetworkSettings

AXES = "xyz"
MILLIMETRE = 1e-3
DEFAULT_INTERVAL = 86400.0
"""Time from one epoch to the next where epochs have no length, seconds."""
EPOCHS_AT_ONCE = 30
"""Largest number of ended epochs that are compared again in one transaction."""
COMPARED_LATER = "it is compared again when all epochs before it have been"
"""Problem of findings that wait for a revision."""

Answer = dict[str, Any]
Rows = Sequence[Mapping[str, Any]]


class Surveillance:
    """The monitor of one network."""

    def __init__(
        self,
        settings: NetworkSettings,
        alarms: Sequence[SiteAlarm],
        read: Callable[[str], State | None],
    ) -> None:
        """Take a network, and its state where there is one.

        Args:
            settings: what the site file says of it.
            alarms: the alarms of the site.
            read: reads the state of its monitor for a digest of the settings.
        """
        self.settings, self._of_site = settings, alarms
        self._alarms = {
            a.rule.name: a
            for a in alarms
            if a.network == settings.name and isinstance(a.rule, AlarmRule)
        }
        self._read: Callable[[str], State | None] = read
        self._monitor: Monitor | None = None
        self._last, self._number = 0, 0
        """Number of the last epoch of the monitor, and number of its epochs."""
        self._before: State | None = None
        """What the monitor knew before the last epoch, of which late readings may come."""
        self.reference: ReferenceEpoch | None = None
        """The reference epoch; None: there is none yet."""
        self.digest = state_digest(
            *(self.rules, settings.epochs, settings.objects),
            *(settings.reference, settings.reference_epochs),
        )
        """Digest of the settings on which the state depends."""
        self.revise_from: int | None = None
        """Number of the first epoch whose findings wait for a revision; None: none do."""
        self.late: set[int] = set()
        """Epochs that have got another result since a revision began."""
        self.revision: object | None = None
        """The revision that goes on (`factorgraph_adj.site.epoch_revision`)."""
        self.resume()

    @property
    def rules(self) -> list[AlarmRule]:
        """The rules of the network."""
        return [a.rule for a in self._alarms.values() if isinstance(a.rule, AlarmRule)]

    def drop(self, *, again: bool = False) -> None:
        """Forget the monitor.

        Args:
            again: whether it is made again from all epochs; otherwise it goes on from its state in
                the database.
        """
        self._monitor, self._last, self._number, self.reference = None, 0, 0, None
        self._before = None
        self.revise_from, self.revision = None, None
        self.late.clear()
        if again:
            self._read = _no_state

    def anew(self) -> Surveillance:
        """Return another surveillance of the network, which has seen no epoch."""
        return Surveillance(self.settings, self._of_site, _no_state)

    def adopt(self, other: Surveillance) -> None:
        """Go on with what another one has seen, to which all epochs were given."""
        self.drop()
        self._monitor, self._last, self._number = other._monitor, other._last, other._number
        self.reference = other.reference

    @property
    def state(self) -> State | None:
        """State of the monitor as values of JSON; None: there is none."""
        if self._monitor is None or self.reference is None:
            return None
        of_epochs = {"last": self._last, "number": self._number, "revise_from": self.revise_from}
        return {
            "monitor": self._monitor.to_json(),
            "reference": asdict(self.reference),
            **of_epochs,
        }

    def resume(self) -> None:
        """Go on from the state in the database, where nothing is known and it has one."""
        state = self._read(self.digest) if self._monitor is None else None
        if state is None:
            return
        self._monitor = self._begun()
        self._monitor.resume(state["monitor"])
        self._last, self._number = state["last"], state["number"]
        self.reference = ReferenceEpoch(**state["reference"])
        self.revise_from = state["revise_from"]

    # -- epochs -----------------------------------------------------------------------------------

    def findings(
        self, rows: Callable[[], Rows], epoch: LiveEpoch, new: Answer, *, ended: int = 0
    ) -> dict[int, Findings]:
        """Return what an epoch tells that has just ended, and where it changed, those after it.

        An epoch that follows the last one is added to the monitor; the last one itself, with late
        readings, to what the monitor knew before it. Otherwise this is made again,
        and the findings of all epochs from the reference on are returned, by number. Where there
        are more than `EPOCHS_AT_ONCE`, that is left to a revision, and the problem of the findings
        is `COMPARED_LATER`.

        Args:
            rows: gives the rows of all epochs with their results so far.
            ended: number of epochs that have ended.
            epoch: the epoch.
            new: its new result, with its estimate.

        Raises:
            AdjustmentError: a rate cannot be kept, or frames differ.
        """
        is_later = self._monitor is not None and epoch.number > self._last
        if is_later and not new.get("estimate"):
            return {}
        # The second epoch says whether the first one is whole.
        if is_later and self._number > 1:
            assert self._monitor is not None
            self._before = self._monitor.to_json()
            return {epoch.number: self.added(epoch.number, new)}
        if self._before is not None and epoch.number == self._last and new.get("estimate"):
            self._monitor, self._number = self._begun(), self._number - 1
            self._monitor.resume(self._before)
            return {epoch.number: self.added(epoch.number, new)}
        if ended > EPOCHS_AT_ONCE:
            number = epoch.number
            self.revise_from = min(number, number if self.revise_from is None else self.revise_from)
            self.late.add(number)
            return {number: Findings(number, float(new["time"]), problem=COMPARED_LATER)}
        records = {r["number"]: r["result"] for r in rows() if r["result"]}
        records[epoch.number] = new
        self.begin()
        timed = self.settings.epochs.length is not None
        self.reference = reference_epoch(records, self.settings.reference, timed=timed)
        first = np.inf if self.reference is None else self.reference.number
        numbers = sorted(n for n, r in records.items() if r.get("estimate") and n >= first)
        return {number: self.added(number, records[number]) for number in numbers}

    def begin(self) -> None:
        """Begin with a monitor that has seen no epoch."""
        self._monitor, self._last, self._number = self._begun(), 0, 0
        self._before = None

    def added(self, number: int, result: Answer) -> Findings:
        """Add the estimate of an epoch to the monitor, and return what it tells."""
        assert self._monitor is not None
        self._last, self._number = number, self._number + 1
        return self._monitor.add(EpochEstimate.from_json(result["estimate"]))

    def _begun(self) -> Monitor:
        length = self.settings.epochs.length
        return Monitor(
            self.rules,
            interval=DEFAULT_INTERVAL if length is None else length,
            objects=self.settings.objects or ("*",),
            reference_epochs=self.settings.reference_epochs,
        )

    @property
    def against(self) -> int | None:
        """Number of the reference epoch; None: there is none yet."""
        return None if self.reference is None else self.reference.number

    def shown(self, found: Findings) -> Answer:
        """Return what an epoch tells as JSON, with the reference epoch."""
        out = shown_findings(found, self.against, self.settings.objects)
        if self.reference is not None:
            out["reference"] = self.reference.shown(self.settings.reference_epochs)
        return out

    def standing(self, found: Findings) -> list[Raised]:
        """Return the alarms that stand after an epoch."""
        standing = () if self._monitor is None else self._monitor.open_alarms
        return [self._raised(a.rule, a.point, a.since, found) for a in standing]

    def episodes(self, every: Iterable[Findings]) -> list[Raised]:
        """Return all alarms of some epochs, those that have ended too, in the order of their begin.

        Args:
            every: findings of all epochs from the reference on, in order.
        """
        out: list[Raised] = []
        for found in every:
            self.continue_episodes(out, found)
        return out

    def continue_episodes(self, out: list[Raised], found: Findings) -> None:
        """Add what an epoch does to the alarms of the epochs before it."""
        for event in found.alarms:
            key = event.rule, event.point
            now = self._raised(*key, event.since, found)
            if event.change == "raised":
                out.append(now)
                continue
            i = max(i for i, alarm in enumerate(out) if (alarm.rule, alarm.subject) == key)
            if event.change == "cleared":
                out[i] = replace(out[i], until=found.time)
            else:
                out[i] = replace(out[i], latest=now.data | {"epoch": found.number})

    def _raised(self, rule: str, point: str, since: int | None, found: Findings) -> Raised:
        """Return an alarm with the figures of an epoch."""
        tests = found.points[point].tests if point in found.points else ()
        tests = found.reference_tests if point == OF_REFERENCE else tests
        data: Answer = {"epoch": since, EPOCH_SECONDS: self.settings.epochs.length}
        for said in (a for a in found.alarms if (a.rule, a.point) == (rule, point)):
            data["text"] = said.sentence
        for test in (t for t in tests if t.rule == rule):
            data |= _alarm_figures(test)
        of = self._alarms[rule]
        assert isinstance(of.rule, AlarmRule)
        data["false_alarms_per_month"] = of.rule.false_alarms_per_month
        return Raised(rule, point, data, of.notify, found.number, since=found.time)


def _no_state(digest: str) -> None:
    """Return that the database has no state."""


# -- what is shown ---------------------------------------------------------------------------------


def shown_findings(found: Findings, against: int | None, objects: Sequence[str]) -> Answer:
    """Return what an epoch tells as JSON: displacements in mm, tests, blocks, motions.

    Args:
        found: what it tells.
        against: number of the reference epoch.
        objects: patterns of points that may move.
    """
    out: Answer = {"against": against, "problem": found.problem, "congruence": None}
    out |= {"displacements": [], "blocks": [], "motions": {}, "tests": []}
    comparison = found.comparison
    if comparison is None:
        return out
    axes = comparison.differences.axes
    tests: dict[str, list[TestedEpoch]] = {n: [*p.tests] for n, p in found.points.items()}
    out["displacements"] = [
        _displacement(x, tests.get(n, []), axes) for n, x in comparison.displacements.items()
    ]
    out["congruence"] = _congruence(comparison)
    moved = [n for n, x in comparison.displacements.items() if x.moved and matches(n, objects)]
    if len(moved) > 1:
        out["blocks"] = _blocks(comparison, moved)
    for name, point in found.points.items():
        motion = point.motion
        scale = {"displacement": 1.0 / MILLIMETRE, "velocity": DAY_S / MILLIMETRE}
        mine: Answer = {}
        for what, unit in (("displacement", "mm"), ("velocity", "mm_per_day")):
            values = getattr(motion, what) * scale[what]
            variances = np.diag(getattr(motion, f"{what}_covariance"))
            sigmas = np.sqrt(np.maximum(variances, 0.0)) * scale[what]
            for axis, value, sigma in zip(axes, values, sigmas, strict=True):
                mine[f"{what}_{axis}_{unit}"] = rounded_figure(float(value))
                mine[f"sigma_{what}_{axis}_{unit}"] = rounded_figure(float(sigma))
        mine["T_of_model"] = rounded_figure(motion.model_test)
        mine["critical_of_model"] = rounded_figure(motion.model_critical)
        out["motions"][name] = mine
    out["tests"] = [{"point": name, **_test(t)} for name, of in tests.items() for t in of] + [
        {"point": OF_REFERENCE, **_test(t)} for t in found.reference_tests
    ]
    return out


def _displacement(x: Displacement, tests: Sequence[TestedEpoch], axes: str) -> Answer:
    out: Answer = {"name": x.name, "stable": x.stable, "verdict": x.verdict, "moved": x.moved}
    for axis, value, sigma in zip(AXES, x.vector, x.sigmas, strict=True):
        compared = axis in axes
        out[f"d{axis}_mm"] = rounded_figure(float(value) / MILLIMETRE) if compared else None
        out[f"sigma_d{axis}_mm"] = rounded_figure(float(sigma) / MILLIMETRE) if compared else None
    out |= {"T": rounded_figure(x.test.value), "critical": rounded_figure(x.test.critical)}
    out["detectable_mm"] = rounded_figure(x.detectable / MILLIMETRE)
    of_rules = [t.detectable_mm for t in tests if t.test == "displacement"]
    if of_rules:
        out["alarm_detectable_mm"] = rounded_figure(min(of_rules))
    return out


def _test(found: TestedEpoch) -> Answer:
    return {
        "rule": found.rule,
        "test": found.test,
        "value": rounded_figure(found.value),
        "critical": rounded_figure(found.critical),
        "size_mm": rounded_figure(found.size_mm),
        "detectable_mm": rounded_figure(found.detectable_mm),
        "exceeds": found.exceeds,
    }


def _congruence(found: EpochComparison) -> Answer:
    test = found.global_test
    moved = [n for n, x in found.displacements.items() if x.moved]
    if test is None or test.freedom[0] == 0:
        return {"outcome": "untested", "test": None, "critical": None, "moved": moved}
    outcome = "congruent" if test.accepted else "changed"
    figures = {"test": rounded_figure(test.value), "critical": rounded_figure(test.critical)}
    return {"outcome": outcome, **figures, "moved": moved, "stable": list(found.stable)}


def _blocks(found: EpochComparison, names: Sequence[str]) -> list[Answer]:
    """Return the common rigid motion of the points that moved, or why there is none.

    Components about axes that are not compared or not determined are null.
    """
    out: Answer = {"points": list(names)}
    try:
        block = block_motion(found, names)
    except AdjustmentError as error:
        return [out | {"problem": str(error)}]
    sigmas = dict(zip(block.names, block.sigmas.tolist(), strict=True))
    for what, letter, unit, size in (
        ("translation", "t", "mm", MILLIMETRE),
        ("rotation", "r", "mgon", ANGLE["mgon"]),
    ):
        names_of = [letter + a for a in AXES]
        out[f"{what}_{unit}"] = [
            rounded_figure(block[n] / size) if n in sigmas else None for n in names_of
        ]
        out[f"sigma_{what}_{unit}"] = [
            rounded_figure(sigmas[n] / size) if n in sigmas else None for n in names_of
        ]
    out |= {"moved": not block.motion.accepted, "test": rounded_figure(block.motion.value)}
    out["critical"] = rounded_figure(block.motion.critical)
    if block.fit is not None:
        out |= {"rigid": block.fit.accepted, "fit": rounded_figure(block.fit.value)}
        out["fit_critical"] = rounded_figure(block.fit.critical)
    return [out]


def _alarm_figures(found: TestedEpoch) -> Answer:
    """Return what an alarm shows of its latest test."""
    out: Answer = {"test": found.test, "value": rounded_figure(found.value)}
    return out | {"limit": rounded_figure(found.critical), "size_mm": rounded_figure(found.size_mm)}
