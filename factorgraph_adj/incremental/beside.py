"""Observations between known variables, tested and taken in beside a system."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..errors import AdjustmentError
from ..quality.leave_out import Tested
from ..types import Array, Index
from .deciding import Decision, accepted, by_id, decide, gain, verdict
from .forms import Item, items_of, together
from .ledger import Ledger, Some
from .rebasing import Draft, Failure
from .rules import Rules
from .system import MOST_BESIDE, System, Trial
from .verdicts import Gain, Verdict


@dataclass(frozen=True, eq=False)
class Beside:
    """Items that were tried out beside a system."""

    ledger: Ledger
    """Where they wait."""
    system: System
    """The system without them."""
    trial: Trial
    """They and the system."""
    decision: Decision
    """Which of them stay."""
    rules: Rules
    """The options."""

    @classmethod
    def of(
        cls, ledger: Ledger, system: System, some: Some, fixed: Collection[str], rules: Rules
    ) -> Beside | None:
        """Test observations; none where only a new base can take them in.

        Args:
            ledger: where they wait.
            system: the system, which knows all their variables.
            some: the observations.
            fixed: ids of observations that are in without a test.
            rules: the options.

        Raises:
            InputError: names observations whose geometry has no answer.
        """
        if some.n_rows > MOST_BESIDE:
            return None
        items = items_of(ledger, some)
        forms = system.forms(ledger, items)
        if system.notices(forms):
            return None
        trial = system.trial(forms)
        if trial is None:
            return None
        decision = Decision(stay=list(range(len(items))))
        if any(rules.tests(i, fixed) for i in items):
            tested = _tested(system, trial)
            free = [not rules.tests(i, fixed) for i in items]
            decision = decide(
                tested, forms.raw, rules.alpha, np.array(free), lambda *_: set(), lambda _: ()
            )
        return cls(ledger, system, trial, decision, rules)

    @property
    def items(self) -> tuple[Item, ...]:
        """The items."""
        return self.trial.forms.items

    @cached_property
    def kept(self) -> Trial | None:
        """The items that stay, beside the system; none: no item stays."""
        if len(self.decision.stay) == len(self.items):
            return self.trial
        if not self.decision.stay:
            return None
        return self.system.trial(self.trial.forms.some(self.decision.stay))

    @cached_property
    def after(self) -> System:
        """The system with the items that stay."""
        if self.kept is None:
            return self.system
        return self.system.with_trial(self.kept)

    def state(self) -> tuple[Ledger, System] | None:
        """Return ledger and system with the items; none where only a new base keeps the promise."""
        rules = self.rules
        out = [self.items[i] for i in self.decision.out]
        stay = together([self.items[i] for i in self.decision.stay])
        told = by_id(self._left_out())
        ledger = self.ledger.moved(stay, "accepted", "arrival")
        ledger = ledger.moved(together(out), rules.failed, "test", verdicts=told)
        if self.kept is None:
            return ledger, self.system
        if self.system.doubt:
            found = self._adjusted(ledger, self.system)
            return ledger, found if isinstance(found, System) else self.system
        try:
            within = self.after.within(rules.accuracy, self.kept.forms)
        except AdjustmentError:
            return None
        if within is not None:
            return ledger, within
        found = self._adjusted(ledger, self.after)
        return (ledger, found) if isinstance(found, System) else None

    def _adjusted(self, ledger: Ledger, start: System) -> System | Failure:
        """Return a new base."""
        datum = self.rules.datum
        return Draft.of(ledger, start, datum).adjusted(datum, doubted=bool(start.doubt))

    # -- verdicts -----------------------------------------------------------------------------

    def _left_out(self) -> Iterator[Verdict]:
        for i, (figures, critical) in self.decision.out.items():
            yield from verdict(
                self.items[i], self.rules.failed, figures, 0, critical=critical, entered=False
            )

    def verdicts(self, given: Collection[str]) -> Iterator[Verdict]:
        """Iterate over the verdicts.

        Args:
            given: ids of observations that did not wait before.
        """
        yield from self._left_out()
        if self.kept is None:
            return
        tested, forms = _tested(self.system, self.kept), self.kept.forms
        gains = self._gains if self.rules.datum == "given" else None
        yield from accepted(forms.items, tested, forms.raw, self.rules.alpha, given, gains)

    def _gains(self, i: int, m: Array) -> tuple[Gain, ...]:
        """Return what an item adds to its points."""
        assert self.kept is not None
        system, forms = self.after, self.kept.forms
        rows: Index = len(self.system.update.signs) + forms.rows[i]
        unknowns = system.base.equations.unknowns
        out = []
        for name in dict.fromkeys(forms.items[i].points):
            columns = system.columns("point", name)
            if not len(columns):
                continue
            f = system.lifted.expand(columns, np.eye(3), system.slots)
            spread = f.b @ system.update.spread[f.at] @ system.update.inverse[:, rows]
            variance = np.diag(system.cofactors(("point", name), ("point", name)))
            out.append(gain(name, variance, spread, m, unknowns.free[columns]))
        return tuple(out)


def _tested(system: System, trial: Trial) -> Tested:
    """Return the items of a trial, to be tested against everything else."""
    new = len(system.update.signs) + np.arange(len(trial.forms.v))
    inverse = trial.update.inverse
    m = inverse[np.ix_(new, new)]
    v = inverse[new] @ trial.update.residuals
    forms = trial.forms
    return Tested(forms.rows, v, lambda u: m[:, u])
