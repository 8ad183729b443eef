"""Experiment: a trial, its factors with levels and cells, and the seeds of its repetitions."""

from __future__ import annotations

import hashlib
import inspect
import json
import math
import numbers
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, product
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ..errors import InputError, Problem

Level: TypeAlias = "bool | int | float | str | tuple[Level, ...] | None"
"""A value of a factor, which can be written as text and compared with other values."""
Levels: TypeAlias = Mapping[str, Level]
"""A cell of the experiment: one level of every factor, by name of the factor."""
Trial: TypeAlias = Callable[..., Mapping[str, float]]
"""Function ``trial(seed, **levels)`` that returns figures by name."""

RESERVED = ("repetition", "seed", "error", "message")
"""Columns of every table of results; factors and figures must have other names."""
SEED_BITS = 48
"""Number of bits of a repetition's seed: at most 15 decimal digits, which a spreadsheet does not
round."""
_EXACT = 2.0**53
"""Limit below which a float without decimals equals an integer exactly."""


@dataclass(frozen=True)
class Experiment:
    """A trial and the conditions under which it is repeated.

    A trial is a function of a module, ``trial(seed, **levels)``, that simulates, adjusts and
    returns figures by name. All its random numbers must follow from the seed; then every
    repetition gives the same figures at any time and on any machine.

    The cells are all combinations of levels (full factorial), or the listed ``cells``. The seed
    of a repetition is drawn with `numpy.random.SeedSequence` from the experiment's seed and the
    number of the repetition, and without ``common`` also from the names and values of the cell's
    levels. More levels, more repetitions or another order therefore leave existing repetitions
    unchanged. 28 and 28.0 are one value.

    Raises:
        InputError: a level cannot be written as text or occurs twice, a name is reserved, or the
            trial does not take the factors; the error lists all problems.
    """

    name: str
    """Name of the experiment, also in its file."""
    trial: Trial
    """The repeated function; a function of a module if other processes take part."""
    factors: Mapping[str, Sequence[Level]] = field(default_factory=dict)
    """Levels of every factor."""
    seed: int = 0
    """Seed of the experiment, not negative."""
    cells: Sequence[Levels] | None = field(default=None, kw_only=True)
    """The cells instead of ``factors``, if they are not all combinations of levels."""
    common: bool = field(default=True, kw_only=True)
    """Whether repetition k has the same seed in all cells (common random numbers). Differences
    between cells are then paired, and common random effects cancel in them. If false, the cells
    are independent samples."""

    def __post_init__(self) -> None:
        """Check all fields; turn sequences into tuples, and numpy's scalars into Python's."""
        problems: list[Problem] = []
        if not isinstance(self.name, str) or not self.name:
            problems.append(Problem("must be a text that is not empty", "name"))
        whole = isinstance(self.seed, int | np.integer) and not isinstance(self.seed, bool)
        if not whole or self.seed < 0:
            problems.append(Problem(f"must be a whole number ≥ 0, not {self.seed!r}", "seed"))
        factors = _factors(self.factors, problems)
        cells = None
        if self.cells is not None:
            if self.factors:
                problems.append(Problem("give factors or cells, not both", "cells"))
            cells = _cells(self.cells, problems)
        if not problems:
            object.__setattr__(self, "seed", int(self.seed))
            object.__setattr__(self, "factors", factors)
            object.__setattr__(self, "cells", cells)
            problems += self._of_trial()
        if problems:
            raise InputError(problems)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the factors, in their order."""
        return tuple(self.combinations[0])

    @property
    def combinations(self) -> tuple[Levels, ...]:
        """All cells in order; the last factor varies fastest."""
        if self.cells is not None:
            return tuple(self.cells)
        every = product(*self.factors.values())
        return tuple(dict(zip(self.factors, levels, strict=True)) for levels in every)

    def seed_of(self, levels: Levels, repetition: int) -> int:
        """Return the seed that a trial gets: 48 bits.

        Args:
            levels: the cell.
            repetition: counted from 0.
        """
        where = b"" if self.common else hashlib.sha256(key(levels).encode()).digest()
        words = np.frombuffer(where, dtype="<u4").tolist()
        drawn = np.random.SeedSequence(self.seed, spawn_key=(repetition, *words))
        return int(drawn.generate_state(1, np.uint64)[0]) >> (64 - SEED_BITS)

    def trial_name(self) -> str:
        """Return module and name of the trial; the module of a script has the name of its file."""
        module = getattr(self.trial, "__module__", "") or ""
        if module == "__main__":
            main = sys.modules["__main__"]
            spec = getattr(main, "__spec__", None)
            module = spec.name if spec else Path(getattr(main, "__file__", "__main__")).stem
        return f"{module}.{getattr(self.trial, '__qualname__', type(self.trial).__name__)}"

    def _of_trial(self) -> Iterator[Problem]:
        if not callable(self.trial):
            yield Problem(f"must be a function, not {self.trial!r}", "trial")
            return
        try:
            signature = inspect.signature(self.trial)
        except ValueError:  # compiled functions may have none
            return
        try:
            signature.bind(0, **self.combinations[0])
        except TypeError as error:
            call = ", ".join(["seed", *(f"{n}=…" for n in self.names)])
            what = f"cannot be called as trial({call}): {error}; it takes {signature}"
            yield Problem(what, f"trial {self.trial_name()}")


def key(levels: Levels) -> str:
    """Return the key of a cell: names and values as JSON, in the order of names."""
    return json.dumps(encoded(levels), sort_keys=True)


def encoded(levels: Levels) -> dict[str, Any]:
    """Return levels as JSON types; equal values give equal results."""
    return {name: _encoded(level) for name, level in levels.items()}


def written(level: Level) -> str:
    """Return a level as a table shows it; floats with all their digits."""
    if isinstance(level, tuple):
        return json.dumps(_encoded(level), ensure_ascii=False)
    return "" if level is None else str(level)


def _encoded(level: Level) -> Any:
    if isinstance(level, tuple):
        return [_encoded(item) for item in level]
    if isinstance(level, float):
        if not math.isfinite(level):
            return {"float": repr(level)}
        return int(level) if level.is_integer() and abs(level) < _EXACT else level
    return level


def _level(value: object) -> Level:
    """Return a level in Python's own types; raise ValueError for other types and values."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, str):
        if value and not value.isprintable():
            raise ValueError(f"{value!r} has a character that is not printable")
        return value
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, numbers.Real):
        if math.isnan(value):
            raise ValueError("NaN is no level: it does not equal itself")
        return float(value)
    if isinstance(value, list | tuple | np.ndarray):
        return tuple(_level(item) for item in value)
    raise ValueError(
        f"{value!r} is of type {type(value).__name__}; valid: numbers, texts, true and false, "
        "none, and tuples of them"
    )


def _factors(factors: object, problems: list[Problem]) -> dict[str, tuple[Level, ...]]:
    if not isinstance(factors, Mapping):
        problems.append(Problem("must be a mapping of names to levels", "factors"))
        return {}
    found: dict[str, tuple[Level, ...]] = {}
    for name, levels in factors.items():
        where = f"factor {name!r}"
        problems += _of_name(name, where)
        if isinstance(levels, str | bytes) or not isinstance(levels, Sequence | np.ndarray):
            what = f"its levels must be a list, not {levels!r}"
            problems.append(Problem(what, where))
            continue
        good = [_checked(level, where, problems) for level in levels]
        if not good:
            problems.append(Problem("has no levels", where))
        problems += [
            Problem(f"level {written(cell[name])!r} occurs twice", where)
            for cell in _twice([{name: level[0]} for level in good if level])
        ]
        found[name] = tuple(level[0] for level in good if level)
    return found


def _cells(cells: object, problems: list[Problem]) -> tuple[Levels, ...]:
    if isinstance(cells, str) or not isinstance(cells, Sequence) or not cells:
        problems.append(Problem("must be a list of at least one cell", "cells"))
        return ()
    found: list[Levels] = []
    names: tuple[str, ...] | None = None
    for number, cell in enumerate(cells, start=1):
        where = f"cell {number}"
        if not isinstance(cell, Mapping):
            what = f"must be a mapping of factors to levels, not {cell!r}"
            problems.append(Problem(what, where))
            continue
        if names is None:
            names = tuple(cell)
            problems += chain.from_iterable(_of_name(n, f"factor {n!r}") for n in names)
        if set(cell) != set(names):
            what = f"has the factors {', '.join(cell)}; others have {', '.join(names)}"
            problems.append(Problem(what, where))
            continue
        levels = {n: _checked(cell[n], f"{where}, {n}", problems) for n in names}
        if all(levels.values()):
            found.append({n: level[0] for n, level in levels.items()})
    problems += [Problem(f"occurs twice: {said(cell)}", "cells") for cell in _twice(found)]
    return tuple(found)


def said(levels: Levels) -> str:
    """Return a cell in words."""
    return ", ".join(f"{n} = {written(v)}" for n, v in levels.items()) or "the only cell"


def _of_name(name: object, where: str) -> Iterator[Problem]:
    if not isinstance(name, str) or not name or not name.isprintable():
        yield Problem("its name must be a text that is not empty", where)
    elif name in RESERVED:
        yield Problem(f"another name is needed; reserved: {', '.join(RESERVED)}", where)


def _checked(value: object, where: str, problems: list[Problem]) -> list[Level]:
    """Return a list with the level, empty if it is invalid (None is a valid level)."""
    try:
        return [_level(value)]
    except ValueError as error:
        problems.append(Problem(str(error), where))
        return []


def _twice(cells: Sequence[Levels]) -> list[Levels]:
    seen: set[str] = set()
    again = []
    for cell in cells:
        if key(cell) in seen:
            again.append(cell)
        seen.add(key(cell))
    return again
