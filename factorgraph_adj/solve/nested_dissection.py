"""Order of elimination by nested dissection: separators, parts, and the tree of fronts.

Nodes are halved along an axis of their positions, or by their distance in the graph from a node at
its edge; the nodes of one half that are adjacent to the other half separate the two and are
eliminated after both. Where no small separator exists (photos around an object that see all of it),
the nodes make one dense front.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import csr_array

from ..types import NO_ROWS, Array, Index, Mask

MAX_LEAF_NODES = 30
"""Largest number of nodes that are not divided any more."""
MAX_SEPARATOR_SHARE = 0.5
"""Largest share of the nodes in a separator for which a division pays."""
MIN_HUB_SHARE = 0.25
"""Share of all nodes that a hub is joined to at least."""
MAX_HUB_NODES_SHARE = 0.1
"""Largest share of hubs among all nodes."""


@dataclass(frozen=True)
class BlockPattern:
    """The blocks of a symmetric matrix: nodes of equal width, and a border of full columns."""

    n: int
    """Number of nodes."""
    width: int
    """Number of columns of each node."""
    side: int
    """Number of columns of the border."""
    first: Index
    """First node of each block off the diagonal, (p,)."""
    second: Index
    """Second node of each block, larger than the first, (p,)."""


@dataclass(eq=False)
class Front:
    """Nodes that are eliminated together, and the nodes that their elimination joins."""

    own: Index
    """Nodes that are eliminated, (k,)."""
    children: tuple[Front, ...]
    """Fronts that are eliminated before."""
    border: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    """Later nodes that are joined, in the order of elimination, (b,)."""
    blocks: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    """Blocks of the pattern that the front takes in."""
    rows: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    """Place of the later node of each of these blocks in the front."""
    columns: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    """Place of the earlier node of each of these blocks in the front."""
    transposed: Mask = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    """Whether the earlier node is the first one of the block."""
    in_parent: tuple[tuple[int, int, int], ...] = ()
    """Runs of ``border`` in the parent: first and end in the border, first place in the parent."""

    @property
    def size(self) -> int:
        """Number of nodes."""
        return len(self.own) + len(self.border)


def dissect(
    pattern: BlockPattern, positions: Array, last: Index = NO_ROWS, leaves: Index = NO_ROWS
) -> list[Front]:
    """Return the fronts in the order of elimination; the last one is the root.

    Args:
        pattern: the blocks.
        positions: where the nodes are, (n, 3); any length unit.
        last: nodes that the root must hold; without any the dissection decides.
        leaves: nodes without blocks between them that are eliminated first, each alone.
    """
    graph = _Graph.of(pattern, leaves)
    others = np.setdiff1d(np.arange(pattern.n), np.concatenate([last, leaves]))
    if not len(last):
        root = _divide(graph, others, positions)
    else:
        below = (_divide(graph, others, positions),) if len(others) else ()
        root = Front(last, below)
    if len(leaves):
        _add_leaves(root, graph, leaves)
    fronts = list(_order(root))
    _join(fronts, pattern)
    return fronts


def dissect_parts(pattern: BlockPattern, positions: Array, parts: Sequence[Index]) -> list[Front]:
    """Return the fronts of nodes that are joined because they belong to the same parts.

    Whole parts are divided, and the nodes that both halves have separate them: a line through the
    middle of parts would separate nothing but all nodes of these parts.

    Args:
        pattern: the blocks; any two nodes of a part have one.
        positions: where the nodes are, (n, 3); any length unit.
        parts: nodes of each part; every node belongs to at least one part.
    """
    front = _divide_parts(list(parts), positions, np.zeros(pattern.n, dtype=bool))
    fronts = [f for f in _order(front) if len(f.own) or f is front]
    _join(fronts, pattern)
    return fronts


def _divide_parts(parts: list[Index], positions: Array, taken: Mask) -> Front:
    """Return the tree of fronts of some parts without the nodes that are taken."""
    if len(parts) <= 1:
        own = np.concatenate([np.zeros(0, dtype=np.intp), *parts])
        return Front(own[~taken[own]], ())
    centres = np.array([positions[p].mean(axis=0) if len(p) else np.zeros(3) for p in parts])
    centred = centres - centres.mean(axis=0)
    _, axes = np.linalg.eigh(centred.T @ centred)
    best: tuple[Index, list[Index], list[Index]] | None = None
    for axis in axes.T[::-1]:
        order = np.argsort(centred @ axis, kind="stable").tolist()
        half = len(parts) // 2
        low, high = [parts[i] for i in order[:half]], [parts[i] for i in order[half:]]
        both = np.intersect1d(np.concatenate(low), np.concatenate(high))
        both = both[~taken[both]]
        if best is None or len(both) < len(best[0]):
            best = both, low, high
    assert best is not None
    both, low, high = best
    taken[both] = True
    children = tuple(_divide_parts(some, positions, taken) for some in (low, high))
    return Front(both, _with_nodes(children))


def _with_nodes(fronts: tuple[Front, ...]) -> tuple[Front, ...]:
    """Return fronts, with the children of those that eliminate nothing in their place."""
    return tuple(f for front in fronts for f in ((front,) if len(front.own) else front.children))


def cut_nodes(pattern: BlockPattern, positions: Array, parts: int) -> Index:
    """Cut nodes into parts between which there are no blocks: the largest part is halved first.

    Args:
        pattern: the blocks.
        positions: where the nodes are, (n, 3); any length unit.
        parts: largest number of parts; there are fewer where no division pays.

    Returns:
        Number of the part of each node, (n,); −1 for nodes that separate parts.
    """
    graph = _Graph.of(pattern)
    done: list[Index] = []
    waiting = [np.arange(pattern.n)]
    while waiting and len(done) + len(waiting) < parts:
        waiting.sort(key=len)
        largest = waiting.pop()
        found = _separate(graph, largest, positions) if len(largest) > 1 else None
        if found is None:
            done.append(largest)
        else:
            waiting += found[1:]
    out = np.full(pattern.n, -1, dtype=np.intp)
    for number, nodes in enumerate([*done, *waiting]):
        out[nodes] = number
    return out


@dataclass(frozen=True)
class _Graph:
    """The neighbours of each node."""

    first: Index
    neighbours: Index

    @classmethod
    def of(cls, pattern: BlockPattern, leaves: Index = NO_ROWS) -> _Graph:
        """Return the graph of a pattern; the elimination of leaves joins their neighbours."""
        a = np.concatenate([pattern.first, pattern.second])
        b = np.concatenate([pattern.second, pattern.first])
        if len(leaves):
            leaf = np.full(pattern.n, -1, dtype=np.intp)
            leaf[leaves] = np.arange(len(leaves))
            on = leaf[a] >= 0
            met = csr_array((np.ones(on.sum()), (leaf[a[on]], b[on])), (len(leaves), pattern.n))
            joined = (met.T @ met).tocoo()
            code = np.concatenate([a * pattern.n + b, joined.row * pattern.n + joined.col])
            a, b = np.divmod(np.unique(code[code // pattern.n != code % pattern.n]), pattern.n)
        order = np.argsort(a, kind="stable")
        counts = np.bincount(a, minlength=pattern.n)
        return cls(np.concatenate([[0], np.cumsum(counts)]).astype(np.intp), b[order])

    def around(self, nodes: Index) -> tuple[Index, Index]:
        """Return the neighbours of some nodes, and the place of the node in ``nodes``."""
        counts = self.first[nodes + 1] - self.first[nodes]
        owner = np.repeat(np.arange(len(nodes)), counts)
        place = np.arange(int(counts.sum())) - np.repeat(np.cumsum(counts) - counts, counts)
        return self.neighbours[self.first[nodes][owner] + place], owner

    def levels(self, nodes: Index) -> Array:
        """Return the distances of ``nodes`` in the graph from one at its edge, (k,)."""
        start = int(nodes[0])
        inside = np.zeros(len(self.first) - 1, dtype=bool)
        inside[nodes] = True
        level = np.zeros(len(inside))
        for _ in range(2):  # the last node of the first search is at the edge
            level[nodes] = np.inf
            level[start] = 0.0
            front = np.array([start])
            distance = 0.0
            while len(front):
                distance += 1.0
                found, _ = self.around(front)
                found = np.unique(found[inside[found] & np.isinf(level[found])])
                level[found] = distance
                if len(found):
                    start = int(found[-1])
                front = found
        out = level[nodes]
        out[np.isinf(out)] = distance + 1.0  # other parts
        return np.asarray(out)


def _divide(graph: _Graph, nodes: Index, positions: Array) -> Front:
    """Return the tree of fronts of some nodes."""
    if len(nodes) > MAX_LEAF_NODES:
        found = _separate(graph, nodes, positions) or _separate_beside_hubs(graph, nodes, positions)
        if found is not None:
            separator, one, other = found
            children = tuple(_divide(graph, part, positions) for part in (one, other))
            return Front(separator, children)
    return Front(nodes, ())


def _separate(graph: _Graph, nodes: Index, positions: Array) -> tuple[Index, Index, Index] | None:
    """Return the smallest separator found and the two parts; None: no division pays."""
    centred = positions[nodes] - positions[nodes].mean(axis=0)
    scale, axes = np.linalg.eigh(centred.T @ centred)
    keys = [centred @ axis for axis, s in zip(axes.T, scale, strict=True) if s > 1e-6 * scale[-1]]
    keys.append(graph.levels(nodes))
    near, owner = graph.around(nodes)
    half = np.zeros(len(graph.first) - 1, dtype=np.int8)
    best: tuple[Index, Index, Index] | None = None
    for key in keys:
        order = np.argsort(key, kind="stable")
        low, high = nodes[order[: len(nodes) // 2]], nodes[order[len(nodes) // 2 :]]
        half[low], half[high] = 1, 2
        across = half[near] + half[nodes[owner]] == 3
        edge = nodes[np.unique(owner[across])]
        half[nodes] = 0
        inside = np.isin(edge, low)
        for separator, one, other in ((edge[inside], low, high), (edge[~inside], high, low)):
            if best is None or len(separator) < len(best[0]):
                best = separator, np.setdiff1d(one, separator, assume_unique=True), other
    assert best is not None
    separator, one, other = best
    if len(separator) > MAX_SEPARATOR_SHARE * len(nodes) or not len(one) or not len(other):
        return None
    return best


def _separate_beside_hubs(
    graph: _Graph, nodes: Index, positions: Array
) -> tuple[Index, Index, Index] | None:
    """Return a separator with the few nodes that many others meet, such as a beacon of a drive."""
    inside = np.zeros(len(graph.first) - 1, dtype=bool)
    inside[nodes] = True
    near, owner = graph.around(nodes)
    degree = np.bincount(owner[inside[near]], minlength=len(nodes))
    hub = degree > MIN_HUB_SHARE * len(nodes)
    if not hub.any() or hub.sum() > MAX_HUB_NODES_SHARE * len(nodes):
        return None
    found = _separate(graph, nodes[~hub], positions)
    return None if found is None else (np.concatenate([found[0], nodes[hub]]), *found[1:])


def _add_leaves(root: Front, graph: _Graph, leaves: Index) -> None:
    """Let each leaf be a child of the front that eliminates the first of its neighbours."""
    fronts = list(_order(root))
    where = np.full(len(graph.first) - 1, len(fronts) - 1)
    for number, front in enumerate(fronts):
        where[front.own] = number
    near, owner = graph.around(leaves)
    parent = np.full(len(leaves), len(fronts) - 1)
    np.minimum.at(parent, owner, where[near])
    for leaf, number in zip(leaves, parent.tolist(), strict=True):
        fronts[number].children += (Front(np.array([leaf]), ()),)


def _order(front: Front) -> Iterator[Front]:
    """Iterate over the fronts below a front, and the front itself."""
    for child in front.children:
        yield from _order(child)
    yield front


def _join(fronts: list[Front], pattern: BlockPattern) -> None:
    """Fill in the borders of all fronts, and the places of their blocks."""
    rank, where = np.empty(pattern.n, dtype=np.intp), np.empty(pattern.n, dtype=np.intp)
    at = 0
    for number, front in enumerate(fronts):
        rank[front.own] = at + np.arange(len(front.own))
        where[front.own] = number
        at += len(front.own)
    forward = rank[pattern.first] < rank[pattern.second]
    early = np.where(forward, pattern.first, pattern.second)
    late = np.where(forward, pattern.second, pattern.first)
    order = np.argsort(where[early], kind="stable")
    cuts = np.searchsorted(where[early][order], np.arange(len(fronts) + 1))
    place = np.full(pattern.n, -1, dtype=np.intp)
    for number, front in enumerate(fronts):
        blocks = order[cuts[number] : cuts[number + 1]]
        joined = np.unique(np.concatenate([late[blocks], *(c.border for c in front.children)]))
        joined = joined[where[joined] != number]
        front.border = joined[np.argsort(rank[joined])]
        both = np.concatenate([front.own, front.border])
        place[both] = np.arange(len(both))
        front.blocks = blocks
        front.rows, front.columns = place[late[blocks]], place[early[blocks]]
        front.transposed = forward[blocks]
        for child in front.children:
            inside = place[child.border]
            starts = np.flatnonzero(np.diff(inside, prepend=-2) != 1)
            stops = np.append(starts[1:], len(inside))[: len(starts)]
            child.in_parent = tuple(
                (int(s), int(t), int(inside[s])) for s, t in zip(starts, stops, strict=True)
            )
