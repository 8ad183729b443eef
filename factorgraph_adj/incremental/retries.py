"""When what waits is looked at again.

Searching all that hangs together for what it determines by now costs more with every
observation that waits. Little is looked at whenever something arrives. Where much waits, only
what the arrival itself depends on is looked at each time, and the rest when it has grown by a
tenth, or when something that it depends on has become known.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence

from .register import Register
from .units import Unit, Variable, pending

LITTLE = 30
"""Rows that are always looked at."""
GROWN = 1.1
"""Growth from which on something is looked at again."""
MORE = 2
"""Rows that it has to grow by at least."""


class Retries:
    """Units that waited on when they were looked at."""

    def __init__(self) -> None:
        """Start with none."""
        self.rows: dict[str, int] = {}
        """Rows that hung together when a unit, by its first id, was looked at last."""
        self.weak: dict[str, int] = {}
        """Rows that had arrived when no solution was reached with a unit: with all that there
        was, it is looked at when the others have changed."""
        self.because: dict[str, frozenset[str]] = {}
        """Ids of what arrived whenever a unit was let go, wherever it is by now."""

    def copy(self) -> Retries:
        """Return a copy."""
        out = Retries()
        out.rows, out.weak = self.rows.copy(), self.weak.copy()
        out.because = self.because.copy()
        return out

    def forget(self, key: str) -> None:
        """Forget a unit that does not wait any more, or has to be looked at in any case."""
        self.rows.pop(key, None)
        self.weak.pop(key, None)

    def clear(self) -> None:
        """Have everything looked at."""
        self.rows.clear()
        self.weak.clear()

    def note(self, units: Sequence[Unit]) -> None:
        """Note that units were looked at, together and in vain."""
        self.rows.update(dict.fromkeys((u.ids[0] for u in units), _rows(units)))

    def note_beside(self, component: Sequence[Unit]) -> None:
        """Note units that have not been looked at with those that have, as if they had."""
        then = max(n for u in component if (n := self.rows.get(u.ids[0])) is not None)
        for u in component:
            self.rows.setdefault(u.ids[0], then)

    def fail(self, units: Iterable[Unit], arrived: int) -> None:
        """Note that no solution was reached with units, and how many rows there were then."""
        self.weak.update(dict.fromkeys((u.ids[0] for u in units), arrived))

    def let_go(self, keys: Iterable[str], arrived: int, because: Iterable[str]) -> None:
        """Note units that had to leave when others arrived, as weak until those are gone."""
        out = list(keys)
        others = frozenset(because).difference(out)
        for key in out:
            self.weak[key] = arrived
            self.because[key] = self.because.get(key, frozenset()) | others

    def let_go_of(self, keys: Iterable[str]) -> set[str]:
        """Return those keys whose units were let go."""
        return {k for k in keys if k in self.because}

    def freed(self, gone: set[str], pool: Container[str]) -> list[str]:
        """Return the keys of units that left because of what is gone, and take them for others.

        Args:
            gone: ids of what is gone.
            pool: keys of what waits.
        """
        out = [k for k, of in self.because.items() if k in pool and not gone.isdisjoint(of)]
        for key in out:
            self.forget(key)
        return out

    def due(self, arrived: int) -> list[str]:
        """Return the keys of the weak ones to be looked at again, and take them for others."""
        out = [k for k, then in self.weak.items() if arrived > GROWN * then + MORE]
        for key in out:
            self.rows.pop(key, None)
            del self.weak[key]
        return out

    def worthwhile(self, component: Sequence[Unit], waited: Container[str]) -> bool:
        """Return whether units that hang together are to be looked at, all of them.

        Args:
            component: the units.
            waited: keys of the units that have waited until now.
        """
        rows = _rows(component)
        if rows <= LITTLE:
            return True
        then = [self.rows.get(u.ids[0], 0) for u in component if u.ids[0] in waited]
        return not then or min(then) == 0 or rows > GROWN * max(then) + MORE


def around(register: Register, component: Sequence[Unit], new: Iterable[Unit]) -> list[Unit]:
    """Return the units of a component that wait for nothing else than new ones do."""
    own: set[Variable] = {v for u in new for v in pending(register, u)}
    return [u for u in component if own.issuperset(pending(register, u))]


def _rows(units: Sequence[Unit]) -> int:
    return sum(u.n_scalars for u in units)
