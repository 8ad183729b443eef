"""Which of the arriving items stay, by the policy, and what their verdicts say."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..quality.leave_out import Figures, Tested, critical_t2
from ..types import Array, Mask
from .forms import Item
from .system import TIED
from .units import Variable
from .verdicts import Gain, Outcome, Verdict

MOST_GAINS = 300
"""Largest number of items of one arrival for which it is worked out what each adds to its points.
"""
NOTHING = 1e-9
"""Eigenvalue of M, and part of σ, that are rounding."""


@dataclass
class Decision:
    """What happens to tested items, by their numbers."""

    stay: list[int]
    """Items that stay."""
    out: dict[int, tuple[Figures, float]] = field(default_factory=dict)
    """Items that failed their test: their figures at that moment, and the critical value."""
    back: list[int] = field(default_factory=list)
    """Items that contradict each other: the next ones may tell which is wrong."""
    loose: set[Variable] = field(default_factory=set)
    """Variables that only those determined."""

    @property
    def unchanged(self) -> bool:
        """Whether all items stay."""
        return not self.out and not self.back


def decide(
    tested: Tested,
    raw: Sequence[Array],
    alpha: float,
    fixed: Mask,
    held_by: Callable[[int, Array], set[Variable]],
    touching: Callable[[int], Iterable[Variable]],
) -> Decision:
    """Leave out items one by one, the one with the largest T²/critical first.

    Args:
        tested: the items.
        raw: L of each item with Σ = L Lᵀ.
        alpha: probability of a false alarm of one test.
        fixed: which items stay whatever their tests say, (n,).
        held_by: returns the entering variables that combinations (d, n) of the rows of an item
            alone determine.
        touching: returns the variables of an item.
    """
    out = Decision(stay=list(range(len(tested.rows))))
    while out.stay:
        ratios = np.where(fixed, 0.0, tested.ratios(alpha))[out.stay]
        worst = int(np.argmax(ratios))
        if not ratios[worst] > 1.0:
            break
        i = out.stay[worst]
        values, vectors = np.linalg.eigh(tested.block(i))
        tied = vectors[:, values <= TIED]
        lost = held_by(i, tied) if tied.shape[1] else set()
        if lost:
            # Without it something is not determined: whatever joins that goes back to waiting.
            gone = [j for j in out.stay if not lost.isdisjoint(touching(j))]
            out.back += gone
            out.loose |= lost
        else:
            gone = [i]
            figures = tested.figures(raw, np.array([i]))
            dof = int(figures.dof[0])
            out.out[i] = figures, critical_t2(alpha, dof)
        for j in gone:
            tested.leave_out(j)
        out.stay = [j for j in out.stay if j not in gone]
    return out


def verdict(
    item: Item,
    outcome: Outcome,
    figures: Figures,
    number: int,
    *,
    critical: float,
    entered: bool,
    gains: tuple[Gain, ...] = (),
) -> list[Verdict]:
    """Return the verdict on every observation of a tested item.

    Args:
        item: the item.
        outcome: what becomes of it.
        figures: figures of several items.
        number: its number among them.
        critical: critical value of its T².
        entered: whether it had been waiting.
        gains: what it adds to its points.
    """
    out, at = [], 0
    for ident, o in zip(item.ids, item.observations, strict=True):
        names = o.component_names()
        part = slice(at, at + len(names))
        at = part.stop
        out.append(
            Verdict(
                ident,
                o.kind,
                o.label(),
                outcome,
                names,
                figures.innovation[number, part],
                figures.sigma[number, part],
                figures.w[number, part],
                figures.redundancy_numbers[number, part],
                float(figures.t2[number]),
                int(figures.dof[number]),
                critical,
                entered,
                "",
                item.points,
                gains,
            )
        )
    return out


def accepted(
    items: Sequence[Item],
    tested: Tested,
    raw: Sequence[Array],
    alpha: float,
    given: Collection[str],
    gains: Callable[[int, Array], tuple[Gain, ...]] | None,
) -> Iterator[Verdict]:
    """Iterate over the verdicts on items that stay.

    Args:
        items: the items.
        tested: their tests, with no item left out.
        raw: L of each item with Σ = L Lᵀ.
        alpha: probability of a false alarm of one test.
        given: ids of observations that did not wait before.
        gains: returns what an item, given its number and M, adds to its points; none: gains are
            not worked out. They never are for more than `MOST_GAINS` items.
    """
    figures = tested.figures(raw, np.arange(len(items)))
    worked_out = gains if len(items) <= MOST_GAINS else None
    for i, item in enumerate(items):
        yield from verdict(
            item,
            "accepted",
            figures,
            i,
            critical=critical_t2(alpha, int(figures.dof[i])),
            entered=item.ids[0] not in given,
            gains=worked_out(i, tested.block(i)) if worked_out is not None else (),
        )


def waiting(item: Item, lacks: str) -> list[Verdict]:
    """Return the verdicts on an item that waits."""
    return [
        Verdict(
            i, o.kind, o.label(), "waiting", o.component_names(), lacks=lacks, points=item.points
        )
        for i, o in zip(item.ids, item.observations, strict=True)
    ]


def gain(name: str, variance: Array, spread: Array, m: Array, free: Mask) -> Gain:
    """Return what an item adds to a point: without the item, Q + Q Aᵀ M⁻¹ A Q.

    Args:
        name: the point.
        variance: variances of its coordinates with the item, (3,).
        spread: Q Aᵀ of the point with the rows of the item, (3, d).
        m: M of the item, (d, d).
        free: flags of its free coordinates, (3,).
    """
    variance = np.maximum(variance, 0.0)
    values, vectors = np.linalg.eigh(m)
    on = values > NOTHING
    turned = spread @ vectors
    more = (turned[:, on] ** 2 / values[on]).sum(axis=1)
    lost = (np.abs(turned[:, ~on]) > NOTHING * np.sqrt(variance)[:, None]).any(axis=1)
    before = np.where(free, np.where(lost, np.inf, np.sqrt(variance + more)), 0.0)
    return Gain(name, before, np.where(free, np.sqrt(variance), 0.0))


def by_id(verdicts: Iterable[Verdict]) -> Mapping[str, Verdict]:
    """Return verdicts by the ids of their observations."""
    return {v.id: v for v in verdicts}
