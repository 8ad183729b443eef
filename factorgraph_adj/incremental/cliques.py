"""The cliques of an iSAM2's factors, and what a pass up or down them gives.

iSAM2 shows its own tree only as a drawing. Where variables are many its factors are eliminated
once more, and the cliques of that tree serve all variances and any right side.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import gtsam
import numpy as np

from ..solve.selected_inverse import SelectedInverse
from ..solve.singular import SingularError
from ..solve.tree import Clique, cliques_of, down, up
from ..solve.triangular import upper_solve
from ..types import Array, Index
from .tree import LinearTree

MOST_DRAWN = 300
"""Variables up to which the cliques are read from iSAM2's own tree."""

_LABEL = re.compile(r'label="([^":]*)')
_KEY = re.compile(r"([a-z])(\d+)")


def own_cliques(tree: LinearTree, columns: dict[int, Index]) -> list[Clique]:
    """Return the cliques of iSAM2's Bayes tree, parents first.

    iSAM2 shows its cliques only as a drawing; with the order of elimination read from that,
    ``jointBayesNet`` gives the conditionals of the tree itself. That takes time with the square
    of their number; a large tree's factors are eliminated anew instead.
    """
    isam = tree.isam
    if len(columns) > MOST_DRAWN:
        return cliques_anew(tree, columns)
    groups = [
        [gtsam.symbol(c, int(i)) for c, i in _KEY.findall(label)]
        for label in _LABEL.findall(isam.dot())
    ]
    groups.reverse()
    order = [key for group in groups for key in group]
    net = isam.jointBayesNet(order, gtsam.EliminateQR)
    place = {key: i for i, key in enumerate(order)}
    of = {c.keys()[0]: c for c in (net.at(i) for i in range(net.size()))}
    clique_of = {key: n for n, group in enumerate(groups) for key in group}
    count = len(groups)
    out: list[Clique] = []
    for n in range(count - 1, -1, -1):
        group = groups[n]
        conditionals = [of[key] for key in group]
        seen: dict[int, None] = {}
        for c in conditionals:
            seen.update(dict.fromkeys(c.keys()))
        own = set(group)
        separator = sorted((k for k in seen if k not in own), key=place.__getitem__)
        r, s = _stack(group, separator, conditionals, columns)
        t = upper_solve(r, s) if s.size else s
        parent = count - 1 - clique_of[separator[0]] if separator else -1
        out.append(
            Clique(
                np.concatenate([columns[k] for k in group]),
                np.concatenate([columns[k] for k in separator] or [np.zeros(0, dtype=np.intp)]),
                r,
                t,
                parent,
            )
        )
    return out


def cliques_anew(tree: LinearTree, columns: dict[int, Index]) -> list[Clique]:
    """Return the cliques of the same factors, eliminated once more, parents first.

    Args:
        tree: the tree.
        columns: columns of each key.

    Raises:
        SingularError: a pivot vanished.
    """
    graph = tree.linear()
    ordering = tree.ordering()
    if not tree.qr:
        try:
            return cliques_of(graph.eliminateMultifrontal(ordering), columns)
        except RuntimeError:
            pass  # Cholesky may refuse in this order what it did in the tree's
    try:
        bayes = graph.eliminateMultifrontal(ordering, gtsam.EliminateQR)
    except RuntimeError as error:
        raise SingularError(str(error)) from None
    return cliques_of(bayes, columns)


def those_above(cliques: Sequence[Clique], columns: Index) -> tuple[list[Clique], Index]:
    """Return the part of a tree that tells about some columns, and the columns of that part.

    These are the cliques that eliminate them, and those between them and the roots: nothing else
    takes part in a joint covariance. Their columns are numbered anew, in the order returned.

    Args:
        cliques: all, parents first.
        columns: the columns, (k,).
    """
    n = 1 + max((int(c.frontal.max()) for c in cliques), default=-1)
    owner = np.full(n, -1, dtype=np.intp)
    for number, c in enumerate(cliques):
        owner[c.frontal] = number
    wanted = np.zeros(len(cliques), dtype=bool)
    for number in np.unique(owner[columns]).tolist():
        while number >= 0 and not wanted[number]:
            wanted[number] = True
            number = cliques[number].parent
    chosen = np.flatnonzero(wanted)
    place = np.cumsum(wanted) - 1
    nothing = [np.zeros(0, dtype=np.intp)]
    inside = np.concatenate([cliques[i].frontal for i in chosen.tolist()] or nothing)
    new = np.full(n, -1, dtype=np.intp)
    new[inside] = np.arange(len(inside))
    return [
        replace(
            c,
            frontal=new[c.frontal],
            separator=new[c.separator],
            parent=int(place[c.parent]) if c.parent >= 0 else -1,
        )
        for c in (cliques[i] for i in chosen.tolist())
    ], inside


def variances_of(cliques: Sequence[Clique], n: int) -> Array:
    """Return the variances of all columns from one pass down the tree, (n,)."""
    inverse = SelectedInverse(cliques, None, np.full(n, -1), n)
    return inverse.joint(np.arange(n)[:, None])[:, 0, 0]


def cofactor_times(cliques: Sequence[Clique], y: Array) -> Array:
    """Return Q y over all columns, (n, k); y is changed.

    Raises:
        SingularError: a pivot vanished.
    """
    x = np.zeros_like(y)
    up(cliques, down(cliques, y), x)
    if not np.isfinite(x).all():
        raise SingularError("a pivot vanished")
    return x


def _stack(
    group: Sequence[int],
    separator: Sequence[int],
    conditionals: Sequence[gtsam.GaussianConditional],
    columns: dict[int, Index],
) -> tuple[Array, Array]:
    """Return R (f, f) and S (f, s) of a clique from the conditionals of its variables."""
    first: dict[int, int] = {}
    n = 0
    for key in (*group, *separator):
        first[key] = n
        n += len(columns[key])
    f = sum(len(columns[k]) for k in group)
    whole = np.zeros((f, n), order="F")
    for key, c in zip(group, conditionals, strict=True):
        at = first[key]
        k = len(columns[key])
        r = np.array(c.R())
        s = np.array(c.S()).reshape(k, -1)
        model = c.get_model()
        if model is not None:
            scale = 1.0 / np.array(model.sigmas())
            r, s = r * scale[:, None], s * scale[:, None]
        whole[at : at + k, at : at + k] = r
        left = 0
        for other in list(c.keys())[1:]:
            size = len(columns[other])
            to = first[other]
            if to < at:
                raise SingularError("the tree is not in the order of its drawing")
            whole[at : at + k, to : to + size] = s[:, left : left + size]
            left += size
    r = np.asfortranarray(whole[:, :f])
    if not np.all(np.isfinite(r)) or np.any(np.diag(r) == 0):
        raise SingularError("a pivot vanished")
    return r, whole[:, f:]
