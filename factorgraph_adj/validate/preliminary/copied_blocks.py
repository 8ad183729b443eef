"""Blocks of readings that repeat earlier ones in all digits: a file that was read twice.

One reading may equal another by chance, and repeated sets do so within the rounding of a display.
Readings in a row that equal earlier ones, with the same kinds, names and values in the same order,
`LEAST` numbers or more, are no chance unless the resolution of the display makes them: they count
where less than `CHANCE` such blocks are expected among all readings, with the probabilities of
`repeated`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from ...network.network import Network
from ...observations import Observation
from .repeated import CHANCE, STEPS, chance_of_equal, reading, resolution, scatter_of

LEAST = 5
"""Smallest number of observed values in a row that are told."""
MOST_EARLIER = 4
"""Largest number of earlier readings that equal one, of which the latest are looked at."""

Key = tuple[object, ...]
Place = Callable[[str, Observation], str]
"""Says where a reading is, from its id and itself."""


@dataclass
class _Block:
    """Readings from ``first`` on that repeat those from ``earlier`` on; numbers of readings."""

    earlier: int
    first: int
    length: int
    values: int = 0
    """Number of observed values in it."""


@dataclass
class CopiedBlocks:
    """Readings in the order of their arrival, and the blocks of them that repeat earlier ones."""

    _readings: list[tuple[str, Observation]] = field(default_factory=list)
    _compared: int = 0
    """How many of them have been compared with earlier ones: not before somebody asks."""
    _numbers: dict[Key, list[int]] = field(default_factory=dict)
    _open: dict[int, _Block] = field(default_factory=dict)
    """Blocks that end at the latest reading, by the number of the earlier reading at their end."""
    _blocks: list[_Block] = field(default_factory=list)

    def add(self, readings: Iterable[tuple[str, Observation]]) -> CopiedBlocks:
        """Take further readings in, with their ids; return the same object."""
        self._readings += readings
        return self

    def _compare(self) -> None:
        """Compare with earlier readings what has come since."""
        for number in range(self._compared, len(self._readings)):
            key = _key(self._readings[number][1])
            earlier = self._numbers.setdefault(key, [])
            going: dict[int, _Block] = {}
            for j in earlier:
                block = self._open.get(j - 1)
                if block is None:
                    block = _Block(j, number, 0)
                if j < block.first:  # what repeats itself is told once
                    if block.values < LEAST <= block.values + len(key) - 2:
                        self._blocks.append(block)
                    block.length += 1
                    block.values += len(key) - 2
                    going[j] = block
            self._open = going
            earlier.append(number)
            del earlier[:-MOST_EARLIER]
        self._compared = len(self._readings)

    def told(
        self, there: Callable[[str], bool] = lambda _: True, place: Place | None = None
    ) -> list[str]:
        """Return a sentence for each block of copies.

        Args:
            there: whether a reading is still in use, by its id.
            place: says where a reading is; none: its label says it.
        """
        self._compare()
        out, seen = [], set[int]()
        for block in self._blocks:
            mine = [
                k
                for k in range(block.length)
                if block.first + k not in seen and there(self._readings[block.first + k][0])
            ]
            values = sum(len(reading(self._readings[block.first + k][1])) for k in mine)
            if values < LEAST or self._by_chance(block, mine):
                continue
            seen.update(block.first + k for k in mine)
            ends = [
                (place or _place)(*self._readings[at + k])
                for at in (block.first, block.earlier)
                for k in (mine[0], mine[-1])
            ]
            out.append(
                f"{len(mine)} readings in a row, {ends[0]} to {ends[1]}, repeat {ends[2]} to "
                f"{ends[3]} in all digits and in their order: if a file was read twice, leave one "
                "out, as copies make the result look more precise than it is"
            )
        return out

    def _by_chance(self, block: _Block, mine: list[int]) -> bool:
        """Return whether honest readings would repeat each other so."""
        kinds = {self._readings[block.first + k][1].kind for k in mine}
        of_kind = {kind: self._figures(kind) for kind in kinds}
        p = 1.0
        for k in mine:
            o = self._readings[block.first + k][1]
            step, scatter = of_kind[o.kind]
            if scatter is not None and scatter < STEPS * step:
                continue  # equal ones say nothing
            p *= chance_of_equal(o, step, scatter)
        return p * len(self._readings) > CHANCE

    def _figures(self, kind: str) -> tuple[float, float | None]:
        """Return resolution and scatter of the readings of a kind."""
        groups: dict[Key, list[np.ndarray]] = defaultdict(list)
        for _, o in self._readings:
            if o.kind == kind:
                groups[o.names()].append(reading(o))
        every = [np.array(some) for some in groups.values()]
        return resolution(np.concatenate([x.ravel() for x in every])), scatter_of(every)


def copied_blocks(network: Network) -> list[str]:
    """Return a sentence for each block of readings of a network that repeats an earlier one."""
    return CopiedBlocks().add(network.observations.items()).told()


def _place(ident: str, o: Observation) -> str:
    unknown = getattr(o, "id", None) is None and getattr(o, "source", None) is None
    return f"{o.label()} (id {ident})" if unknown else o.label()


def _key(o: Observation) -> Key:
    """Return kind and names, and the observed values."""
    return (o.kind, o.names(), *reading(o).tolist())
