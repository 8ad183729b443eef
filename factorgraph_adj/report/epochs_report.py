"""Report of two epochs: text report, CSV of displacements, figures that pages and plots share."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import isinf
from typing import Any

import numpy as np

from ..columns import Columns
from ..epochs.alternative_explanations import identical_readings_note as identical
from ..epochs.block_motion import BlockMotion
from ..epochs.comparison_result import Congruence, Displacement
from ..epochs.congruence_tests import HypothesisTest
from ..errors import known
from ..io.numbers import Units
from ..network.network import Network
from ..quality.error_ellipses import ErrorEllipse
from ..solve.solution import Solution
from ..statistical_tests import CONFIDENCE_OF_REGION
from ..types import Array
from .adjusted_coordinates import ellipse_columns
from .adjusted_points import COVARIANCE_PAIRS
from .doubtful_results import unknowns_left_out
from .layout import listed, paragraph, short, table, title
from .options import Provenance
from .tables import DATA, READ, Column, Table, as_frame, as_text, unit_of

EPOCH_WORDS = {1: ("common",), 2: ("first", "second")}
"""Words for the adjustments, by their number."""
MAX_NAMES_IN_EPOCHS_TEXT = 12
"""Largest number of names in a sentence."""
EPOCH_POINT_STATES = ("stable", "left", "moved", "kept")
"""A point of a comparison is a stable reference point, a reference point that left the reference,
an object point that moved, or one that did not move significantly."""
FIT_WORDS = {True: "yes", False: "no"}
"""Words for the test of the points that are left; a test of no points says nothing."""
DISPLACEMENT_VERDICT_WORDS = {
    "stable": "stable",
    "doubtful": "doubtful",
    "moved": "yes",
    "kept": "no",
    "untested": "not tested",
}
"""Words for the verdict of a displacement."""
PARAMETER_UNITS = {"t": ("mm", 1e3), "r": ("µrad", 1e6), "s": ("ppm", 1e6), "e": ("ppm", 1e6)}
"""Unit of a parameter of a common motion by its first letter, and its number in the unit of SI."""


@dataclass(frozen=True, eq=False)
class EpochsReport:
    """What text, figures, pages and exports of two epochs need."""

    found: Congruence
    """The comparison."""
    blocks: Sequence[BlockMotion] = ()
    """Common motions of points."""
    provenance: Provenance = field(default_factory=Provenance)
    """The run."""
    confidence: float | None = CONFIDENCE_OF_REGION
    """Probability of the ellipses of displacements; None: standard ellipses."""
    units: Units = field(default_factory=Units)
    """Units of figures that people read."""

    @property
    def network(self) -> Network:
        """The network of the first epoch."""
        return self.found.network

    @property
    def unknowns_left_out(self) -> tuple[str, ...]:
        """Sentences on what nothing determines, and was left out of each epoch."""
        return left_out_of_epochs(self.found.solutions)

    @cached_property
    def doubts(self) -> tuple[str, ...]:
        """Why the displacements are doubtful; empty if there are none."""
        return tuple(_doubts(self.found))

    @cached_property
    def ellipses(self) -> tuple[ErrorEllipse, ...]:
        """Ellipses of the displacements in plan, in the order of the displacements."""
        return self.found.ellipses(confidence=self.confidence)

    @property
    def names(self) -> list[str]:
        """Names of the points, in the first epoch."""
        return list(self.found.displacements)

    @cached_property
    def places(self) -> Array:
        """Places of the points in the first epoch, (n, 3) metres."""
        every = self.found.displacements.values()
        return np.array([x.place for x in every]).reshape(-1, 3)

    @cached_property
    def vectors(self) -> Array:
        """Displacements, (n, 3) metres."""
        every = self.found.displacements.values()
        return np.array([x.vector for x in every]).reshape(-1, 3)

    @cached_property
    def states(self) -> tuple[str, ...]:
        """What each point is, one of `EPOCH_POINT_STATES`."""
        found = self.found
        out = []
        for name, x in found.displacements.items():
            if x.stable:
                out.append("stable")
            elif name in found.reference:
                out.append("left")
            else:
                out.append("moved" if x.moved else "kept")
        return tuple(out)


def left_out_of_epochs(solutions: Sequence[Solution]) -> tuple[str, ...]:
    """Return sentences on the unknowns that were left out of each epoch."""
    return tuple(
        f"{which} epoch: {said}"
        for which, solution in zip(EPOCH_WORDS[len(solutions)], solutions, strict=True)
        for said in unknowns_left_out(solution.network)
    )


def _doubts(found: Congruence) -> Iterator[str]:
    for which, solution in zip(EPOCH_WORDS[len(found.solutions)], found.solutions, strict=True):
        if not solution.converged:
            yield f"the {which} adjustment did not converge: {solution.reason}"
    ratio = found.ratio
    if ratio is not None and not ratio.accepted:
        yield (
            f"the variances of the epochs do not agree, F {ratio.ratio:.2f} > {ratio.critical:.2f}"
        )
    for name, size in found.held_apart.items():
        yield (
            f"point {name!r} is held in both epochs, {1000 * size:.2f} mm apart: all "
            "displacements refer to it"
        )
    for why, names in found.held_in_one.items():
        points = f"point{'s' * (len(names) > 1)} {known(map(repr, names))}"
        verb = "are" if len(names) > 1 else "is"
        # Open motions of a free epoch take up what its datum differs by; held points do not.
        closed = not found.differences.motions.size
        also = ", and displacements have the difference of the datums too" if closed else ""
        yield (
            f"{points} {verb} {why}, and cannot be compared{also}: hold the same points in both "
            "epochs, or none"
        )
    yield from found.alternatives
    if found.steps and not found.steps[-1].test.accepted:
        yield "no set of reference points kept its shape"


def displacement_columns(report: EpochsReport) -> list[Column[Displacement]]:
    """Return the columns of displacements, with the ellipse of each in the horizon of its point."""
    found, small = report.found, unit_of(report.units.sigma_length)
    axes = ["xyz".index(a) for a in found.differences.axes]
    state = dict(zip(report.names, report.states, strict=True))
    ellipses = dict(zip(report.names, report.ellipses, strict=True))
    later = dict(zip(report.names, found.differences.later, strict=True))

    def size(title: str, value: Callable[[Displacement], float], **options: Any) -> Any:
        """Return the column of a length."""
        return Column[Displacement](
            title=title,
            value=value,
            unit=small,
            digits=2,
            shown=lambda x: "∞" if isinf(value(x)) else None,
            suffix=True,
            exact=True,
            short_heading=True,
            **options,
        )

    def record(name: str, value: Callable[[Displacement], Any]) -> Column[Displacement]:
        return Column(title=name, value=value, only=("json",))

    def ellipse(x: Displacement) -> dict[str, Any]:
        e = ellipses[x.name]
        semi_axes = {"semi_axes": list(e.semi_axes), "azimuth": e.azimuth}
        return {**semi_axes, "confidence": report.confidence}

    table, both = ("csv", "frame"), (*READ, "csv", "frame")
    test: dict[str, Any] = {"digits": 2, "exact": True, "only": both}
    flat = any(e.semi_axes[0] > 0 for e in report.ellipses)
    return [
        Column(title="point", key="name", value="name"),
        record("name_later", lambda x: later[x.name]),
        record("state", lambda x: state[x.name]),
        Column(title="stable", value="stable", only=table),
        *(
            record(n, lambda x, n=n: getattr(x, n).tolist())  # type: ignore[misc]
            for n in ("place", "vector")
        ),
        record("covariance", lambda x: [float(x.covariance[p]) for p in COVARIANCE_PAIRS.values()]),
        *(
            size(
                f"{name}{a}",
                lambda x, of=of, i=i: float(getattr(x, of)[i]),  # type: ignore[misc]
                key=f"{key}{a}",
                help=explained,
                only=both if i in axes else table,
            )
            for name, key, of, explained in (
                ("d", "d", "vector", "displacement"),
                ("σ d", "sigma_d", "sigmas", "sigma_d"),
            )
            for i, a in enumerate("xyz")
        ),
        size("length", lambda x: x.length, only=(*both, "json")),
        Column(title="T", key="test_value", value=lambda x: x.test.value, help="t_epochs", **test),
        Column(title="critical", value=lambda x: x.test.critical, **test),
        Column(title="dof", value=lambda x: x.test.freedom[0], only=("html",)),
        Column(
            title="p",
            value=lambda x: x.test.p_value,
            shown=lambda x: _p(x.test.p_value),
            help="p",
            only=("html",),
        ),
        record("test", lambda x: record_of_test(x.test)),
        Column(
            title="moved",
            value=lambda x: DISPLACEMENT_VERDICT_WORDS[x.verdict],
            translated=True,
            only=READ,
        ),
        Column(title="moved", value="moved", only=DATA),
        size("detectable", lambda x: x.detectable, help="detectable", only=(*both, "json")),
        record("hardest", lambda x: x.hardest.tolist()),
        *(
            replace(c, help="ellipse_d", exact=True)
            for c in ellipse_columns(
                report.units, lambda x: ellipses[x.name], None, ("html",) if flat else ()
            )
        ),
        Column(title="confidence", value=lambda x: report.confidence, only=("csv",)),
        record("ellipse", ellipse),
    ]


def displacements_table(report: EpochsReport) -> Table[Displacement]:
    """Return the table of displacements; lengths and angles are in the units of the report."""
    rows = list(report.found.displacements.values())
    return Table("displacements", rows, displacement_columns(report))


def displacement_frame(found: Congruence) -> Columns:
    """Return the displacements as arrays, metres."""
    return as_frame(displacements_table(EpochsReport(found)))


def record_of_test(test: HypothesisTest) -> dict[str, Any]:
    """Return a test by its members."""
    return {
        "value": test.value,
        "critical": test.critical,
        "freedom": list(test.freedom),
        "p_value": test.p_value,
        "accepted": test.accepted,
    }


def render_congruence(found: Congruence, *, blocks: Sequence[BlockMotion] = ()) -> str:
    """Return the text report of the comparison of two epochs.

    Args:
        found: the comparison.
        blocks: common motions of points, which are listed too.
    """
    lines = [*title("Two epochs"), *_tested(found), "", *_variances(found), ""]
    if found.steps:
        lines += [*title("Reference points"), *_reference(found), ""]
    lines += [*title("Displacements"), *_displacements(found)]
    if blocks:
        lines += ["", *title("Common motions"), *(line for b in blocks for line in _block(b))]
    return "\n".join(lines) + "\n"


def _tested(found: Congruence) -> list[str]:
    """Say what the reference is, and what was tested and what was not."""
    n, objects = len(found.reference), [x for x in found.displacements if x not in found.reference]
    same = identical(*found.solutions) if len(found.solutions) == 2 else ""
    held = list(found.roles.held)
    datum = "the points held in both epochs" if held else "the datum of the adjustments"
    out = paragraph(same) if same else []
    for said in found.alternatives:
        out += paragraph(f"ATTENTION: {said}.")
    for said in left_out_of_epochs(found.solutions):
        out += paragraph(f"The {said}.")
    if n:
        out += paragraph(
            f"Reference, tested together for a change of shape: {_points(found.reference)}. "
            "Common points are reference points unless they are named as objects."
        )
    else:
        out += paragraph(f"Reference: {datum}, without a test.")
    if objects:
        out += paragraph(f"Tested one by one against the reference: {_points(objects)}.")
    else:
        out += paragraph("No point was tested as an object: none is named.")
    if held:
        out += paragraph(
            f"Held in both epochs, and taken as stable without a test: {_points(held)}."
        )
    reasons: dict[str, list[str]] = {}
    for name, why in found.roles.not_compared.items():
        reasons.setdefault(why, []).append(name)
    for why, names in reasons.items():
        out += paragraph(f"NOT compared, {why}: {_points(names)}.")
    return out


def _points(names: Sequence[str]) -> str:
    count = f"{len(names)} point" if len(names) == 1 else f"{len(names)} points"
    return f"{count}, {listed(names, MAX_NAMES_IN_EPOCHS_TEXT)}"


def _variances(found: Congruence) -> list[str]:
    ratio = found.ratio
    out: list[str] = []
    if ratio is not None:
        same = "agree" if ratio.accepted else "DO NOT AGREE"
        out += paragraph(
            f"σ̂0 {ratio.sigma0[0]:.3f} (r {ratio.redundancy[0]}) and {ratio.sigma0[1]:.3f} "
            f"(r {ratio.redundancy[1]}): the variances {same}, their ratio {ratio.ratio:.2f} has "
            f"the critical value {ratio.critical:.2f}."
        )
        if not ratio.accepted:
            out += paragraph(
                "One epoch is less accurate than its weights say: find out which, before its "
                "displacements are believed."
            )
    if np.isinf(found.scale.freedom):
        out += paragraph("The tests take σ0 = 1 as known.")
    else:
        out += paragraph(
            f"The tests take σ̂0 = {np.sqrt(found.scale.variance):.3f} of both epochs together, "
            f"{found.scale.freedom:.0f} degrees of freedom."
        )
    return out


def _reference(found: Congruence) -> list[str]:
    first = found.steps[0].test
    kept = "kept" if first.accepted else "DID NOT keep"
    out = paragraph(
        f"The {len(found.reference)} reference points {kept} their shape: {_words(first)}."
    )
    if len(found.steps) > 1:
        rows = [
            (
                listed(s.left, MAX_NAMES_IN_EPOCHS_TEXT) or "—",
                listed(s.back, MAX_NAMES_IN_EPOCHS_TEXT) or "—",
                f"{s.test.value:.2f}",
                f"{s.test.critical:.2f}",
                FIT_WORDS[s.test.accepted] if s.test.freedom[0] else "—",
            )
            for s in found.steps[1:]
        ]
        out += ["", *table(("left", "came back", "T of the others", "critical", "fits"), rows)]
    if found.stable and not found.steps[-1].test.accepted:
        out += paragraph(
            "No set of reference points that could be tested kept its shape: the displacements "
            "below refer to points that moved against each other."
        )
    if found.scale_change is not None:
        s = found.scale_change
        told = "significant" if s.significant else "not significant"
        if first.accepted or s.rest.accepted:
            out += paragraph(
                f"Scale of the second epoch relative to the first, from all reference points: {s}, "
                f"{told}; {_words(s.test)}."
            )
        else:
            out += paragraph(f"No common scale explains the change: {_words(s.rest)}.")
    if found.stable:
        kept = "Stable" if found.steps[-1].test.accepted else "Left in the reference"
        out += paragraph(f"{kept}: {listed(found.stable, MAX_NAMES_IN_EPOCHS_TEXT)}.")
    else:
        out += paragraph(
            "No reference point is stable: the displacements below refer to the points held in "
            "both epochs, or to the observations that carry the datum."
        )
    return out


def _words(test: HypothesisTest) -> str:
    degrees = "degree" if test.freedom[0] == 1 else "degrees"
    return (
        f"T = {test.value:.2f}, critical {test.critical:.2f} "
        f"({test.freedom[0]} {degrees} of freedom, p {_p(test.p_value)})"
    )


def _p(value: float) -> str:
    return "< 0.0001" if value < 1e-4 else f"{value:.4f}"


def _displacements(found: Congruence) -> list[str]:
    out = paragraph(_moved(found))
    note = (
        f"lengths in mm; detectable: the displacement that is found with a probability of "
        f"{found.power:.0%} in the direction in which it is hardest to find. Stable points are "
        "compared with the other stable ones."
    )
    if any(x.verdict == "doubtful" for x in found.displacements.values()):
        note += (
            " doubtful: a point of the reference whose own test rejects; where the reference kept "
            f"its shape, one in {1 / found.alpha:.0f} of those that kept their places is."
        )
    shown = as_text(displacements_table(EpochsReport(found)))
    return [*out, "", *shown, "", *paragraph(note)]


def _moved(found: Congruence) -> str:
    """Say which points moved, of those that were tested."""
    alpha = f"with α = {found.alpha:g} for each"
    loose = len(found.displacements) - len(found.stable)
    if found.moved:
        moved = listed(found.moved, MAX_NAMES_IN_EPOCHS_TEXT)
        return f"{len(found.moved)} of {loose} points that may have moved did, {alpha}: {moved}."
    if loose:
        return (
            f"None of the {loose} points tested against the reference moved significantly, {alpha}."
        )
    kept = found.steps[-1].test.accepted
    shape = "kept their shape" if kept else "did not keep their shape"
    return f"No point was tested against the reference. The reference points {shape}, see above."


def _block(b: BlockMotion) -> list[str]:
    moved = "DID NOT move" if b.motion.accepted else "moved"
    out = paragraph(
        f"{listed(b.points, MAX_NAMES_IN_EPOCHS_TEXT)}: the block {moved}, {b.model}; "
        f"{_words(b.motion)}."
    )
    if b.fit is None:
        out += paragraph("Its points have no redundancy to test whether they moved like this.")
    else:
        fits = "moved" if b.fit.accepted else "DID NOT move"
        out += paragraph(f"Its points {fits} like this: {_words(b.fit)}.")
    rows = []
    for name, value, sigma in zip(b.names, b.values.tolist(), b.sigmas.tolist(), strict=True):
        unit, size = PARAMETER_UNITS[name[0]]
        rows.append((f"{name} [{unit}]", short(size * value), short(size * sigma)))
    out += ["", *table(("parameter", "value", "σ"), rows)]
    if b.model == "affine":
        strains, axes = b.principal_strains()
        told = (
            f"{1e6 * e:.1f} ppm along ({', '.join(f'{v:.3f}' for v in axis)})"
            for e, axis in zip(strains.tolist(), axes.tolist(), strict=True)
        )
        out += paragraph(f"Principal strains: {'; '.join(told)}.")
    return out
