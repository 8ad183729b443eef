"""A network in memory: adjusted as a whole or in parts; cut by nested dissection or by regions.

Nested dissection separates the parts by few stations and photos, so that the junctions are few;
regions of the user may take its place. Every observation goes to one part, and every part has what
its observations touch. Object points that only photos see go to the part of a photo; photos that
separate parts have some of their image points in each.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias, overload

import numpy as np

from .. import adjustment
from ..adjustment import SolverName
from ..errors import AdjustmentError, InputError, Problem, known, taking
from ..graph.equations import Equations, compile_network
from ..graph.image_ids import ImageIds
from ..graph.listed_points import with_listed_points_apart
from ..graph.observation_selection import only
from ..graph.variables import Unknowns, Variables
from ..models.unknown_registry import VariableKind
from ..network.network import DatumChoice, Network
from ..orientation.choice_of_start import choose_start
from ..solve.added_factors import ExtraFactors
from ..solve.elimination_layers import layers_of
from ..solve.factorisation import EliminationPlan
from ..solve.gauss_newton import Progress
from ..solve.nested_dissection import BlockPattern, cut_nodes
from ..solve.reduced_system import Nodes
from ..solve.solution import Solution
from ..start.start_values import Start
from ..types import Array, Index, Mask
from .adjustment import adjust_parts
from .part_files import Part, RunFolder, StoredPart, TemporaryFolder, write_part
from .solution import PartsSolution
from .workers import check_client

if TYPE_CHECKING:
    from distributed import Client

Regions: TypeAlias = int | Mapping[str, str] | Callable[[str], str]
"""A number of parts, or the region of each point and photo by its name."""
PARTS_OF_WORKER = 2
"""Number of parts for each worker, so that a worker that is slow or lost can be relieved."""


@dataclass(frozen=True)
class PartAssignment:
    """The part of every observation, and of every variable that has a home."""

    names: tuple[str, ...]
    """Names of the parts."""
    of_rows: Index
    """Part of each scalar observation, (n,)."""
    homes: Mapping[VariableKind, Index]
    """Part of each variable, by kind; −1: none, or several."""


def cut_network(network: Network, regions: Regions, folder: RunFolder) -> list[Part]:
    """Cut a network into parts, and write them into a folder.

    Args:
        network: the network.
        regions: number of parts, or the region of each point and photo.
        folder: where the parts are written.

    Raises:
        InputError: nothing to adjust; points or photos without region.
        ApproximationError: points, photos or sets have no approximate values.
    """
    equations = compile_network(network)
    start = choose_start(equations, "given", None)
    if isinstance(regions, int):
        assigned = _dissected(equations, start, regions)
    else:
        assigned = _by_region(equations, regions)
    untouched = _untouched(equations)
    full, assigned = _parts_with_unknowns(equations, assigned)
    parts = []
    for place, number in enumerate(full):
        home = {}
        for kind, flags in untouched.items():
            at = assigned.homes.get(kind, np.full(len(flags), -1))
            home[kind] = flags & (at == number if place else ~np.isin(at, full[1:]))
        name = assigned.names[number]
        part = _part_network(equations, assigned.of_rows == number, home, name)
        own = folder.of_part(place)
        write_part(own, part, _carried(start, part))
        parts.append(Part(name, StoredPart(own.path, _geoids(network))))
    return parts


# -- which part ----------------------------------------------------------------------------------


def _dissected(equations: Equations, start: Start, parts: int) -> PartAssignment:
    """Assign by nested dissection."""
    if parts < 1:
        raise InputError(f"the number of parts must be at least 1, not {parts}")
    unknowns = equations.unknowns
    nothing = np.zeros(unknowns.n_columns, dtype=bool)
    none = np.zeros(0, dtype=np.intp)
    layers = layers_of(equations, reduce_points=True, touched=nothing, kept=none)
    plan = EliminationPlan.of(equations, layers)
    nodes = plan.nodes
    codes = np.concatenate([none, *_pairs(equations, plan, nodes)])
    first, second = np.divmod(np.unique(codes), max(nodes.n, 1))
    pattern = BlockPattern(nodes.n, nodes.width, nodes.side, first, second)
    part = cut_nodes(pattern, nodes.positions(start.state), parts)
    node = {kind: _nodes(nodes, table) for kind, table in unknowns.tables.items()}
    homes = {kind: np.where(at >= 0, part[at], -1) for kind, at in node.items()}
    beside = _adjacent_parts(pattern, part)
    of_rows = np.full(equations.n_rows, -1, dtype=np.intp)
    fallback = np.zeros(equations.n_rows, dtype=np.intp)
    for block in equations.blocks:
        own = np.full(block.n, -1, dtype=np.intp)
        other = np.full(block.n, -1, dtype=np.intp)
        for kind, index in block.variables:
            own = np.maximum(own, homes[kind][index])
            at = node[kind][index]
            other = np.where((other < 0) & (at >= 0), beside[at], other)
        of_rows[block.rows] = np.repeat(own, block.dimension)
        fallback[block.rows] = np.repeat(np.maximum(other, 0), block.dimension)
    _points_of_photos(equations, layers.reduced, of_rows, fallback)
    of_rows = np.where(of_rows >= 0, of_rows, fallback)
    for c in equations.clusters:
        of_rows[c.rows] = of_rows[c.rows].max()
    names = tuple(str(number + 1) for number in range(int(part.max(initial=0)) + 1))
    return PartAssignment(names, of_rows, homes)


def _pairs(equations: Equations, plan: EliminationPlan, nodes: Nodes) -> list[Index]:
    """Return the pairs of nodes that observations join."""
    out = [plan.pair_codes]
    for c in equations.clusters:
        touched = [np.zeros(0, dtype=np.intp)]
        for block in equations.blocks:
            rows = c.rows[(c.rows >= block.rows.start) & (c.rows < block.rows.stop)]
            on = np.unique((rows - block.first_row) // block.dimension)
            for kind, index in block.variables:
                touched.append(_nodes(nodes, equations.unknowns[kind])[index[on]])
        own = np.unique(np.concatenate(touched))
        own = own[own >= 0]
        i, j = np.triu_indices(len(own), 1)
        out.append(own[i] * nodes.n + own[j])
    return out


def _nodes(nodes: Nodes, table: Variables) -> Index:
    """Return the node of each variable of a kind; −1: border, held, or in the first layer."""
    out = np.full(len(table.names), -1, dtype=np.intp)
    inner = nodes.n * nodes.width
    for c in range(table.free.shape[1]):
        on = np.flatnonzero((table.offset >= 0) & (c < table.size))
        place = nodes.place_of[table.offset[on] + c]
        has = (place >= 0) & (place < inner)
        out[on[has]] = place[has] // nodes.width
    return out


def _adjacent_parts(pattern: BlockPattern, part: Index) -> Index:
    """Return the part of each node, or for nodes that separate parts one that is adjacent."""
    out = part.copy()
    for a, b in ((pattern.first, pattern.second), (pattern.second, pattern.first)):
        np.maximum.at(out, a, np.where(part[a] < 0, part[b], -1))
    return np.maximum(out, 0)


def _points_of_photos(equations: Equations, reduced: Mask, of_rows: Index, fallback: Index) -> None:
    """Give all observations of a point of the first layer one part, in place.

    The photos of such a point are adjacent, so that at most one part has interior ones.
    """
    part = np.full(len(reduced), -1, dtype=np.intp)
    other = np.full(len(reduced), -1, dtype=np.intp)
    mine = []
    for block in equations.blocks:
        for kind, index in block.variables:
            if kind == "point":
                on = np.flatnonzero(reduced[index])
                rows = block.first_row + block.dimension * on
                np.maximum.at(part, index[on], of_rows[rows])
                np.maximum.at(other, index[on], fallback[rows])
                mine.append((block, on, index[on]))
    part = np.where(part >= 0, part, other)
    for block, on, points in mine:
        rows = block.first_row + block.dimension * on[:, None] + np.arange(block.dimension)
        of_rows[rows] = part[points][:, None]


def _by_region(
    equations: Equations, regions: Mapping[str, str] | Callable[[str], str]
) -> PartAssignment:
    """Assign by the region of the first point or photo of each observation."""
    find = regions.get if isinstance(regions, Mapping) else regions
    unknowns = equations.unknowns
    placed: dict[VariableKind, list[str | None]] = {
        "point": [find(name) for name in unknowns["point"].names],
        "pose": [find(name) for name in unknowns["pose"].names],
    }
    lost = [
        (noun, name)
        for kind, noun in (("pose", "photo"), ("point", "point"))
        for name, region in zip(unknowns[kind].names, placed[kind], strict=True)
        if region is None and (kind == "pose" or not len(unknowns["pose"].names))
    ]
    every = sorted({r for found in placed.values() for r in found if r is not None})
    if lost:
        what = f"it has no region; known: {known(every)}"
        raise InputError([Problem(what, f"{noun} {name!r}") for noun, name in lost])
    number = {name: i for i, name in enumerate(every)}
    homes: dict[VariableKind, Index] = {
        kind: np.array([-1 if r is None else number[r] for r in found], dtype=np.intp)
        for kind, found in placed.items()
    }
    of_rows = np.zeros(equations.n_rows, dtype=np.intp)
    for block in equations.blocks:
        own = np.full(block.n, -1, dtype=np.intp)
        for kind, index in block.variables:
            if kind in homes:
                own = np.where(own >= 0, own, homes[kind][index])
        of_rows[block.rows] = np.repeat(np.maximum(own, 0), block.dimension)
    for c in equations.clusters:
        of_rows[c.rows] = of_rows[c.rows[0]]
    return PartAssignment(tuple(every), of_rows, homes)


# -- the parts -----------------------------------------------------------------------------------


def _parts_with_unknowns(
    equations: Equations, assigned: PartAssignment
) -> tuple[list[int], PartAssignment]:
    """Return the parts that have observations of unknowns; the first takes all of other parts."""
    determines = np.zeros(equations.n_rows, dtype=bool)
    for block in equations.blocks:
        if block.prior:
            continue
        for kind, index in block.variables:
            some = equations.unknowns[kind].free[index].any(axis=1)
            determines[block.rows] |= np.repeat(some, block.dimension)
    full = np.unique(assigned.of_rows[determines])
    of_rows = np.where(np.isin(assigned.of_rows, full), assigned.of_rows, full[0])
    return full.tolist(), replace(assigned, of_rows=of_rows)


def _untouched(equations: Equations) -> dict[VariableKind, Mask]:
    """Return the variables that no observation depends on, by kind."""
    out = {k: np.ones(len(t.names), dtype=bool) for k, t in equations.unknowns.tables.items()}
    for block in equations.blocks:
        for kind, index in block.variables:
            if not block.prior:
                out[kind][index] = False
    return out


def _part_network(
    equations: Equations, mine: Mask, home: Mapping[VariableKind, Mask], name: str
) -> Network:
    """Return the network of a part.

    Args:
        equations: the whole network.
        mine: whether each scalar observation belongs to the part, (n,).
        home: whether each variable belongs to the part although nothing observes it, by kind.
        name: name of the part.
    """
    ids: set[str] = set()
    images = np.zeros(equations.network.n_image_points, dtype=bool)
    used = {kind: flags.copy() for kind, flags in home.items()}
    for block in equations.blocks:
        if block.prior:  # a weighted unknown brings its given value along
            continue
        on = np.flatnonzero(mine[block.rows][:: block.dimension])
        for kind, index in block.variables:
            used[kind][index[on]] = True
        if isinstance(block.ids, ImageIds):
            images[block.ids.rows[on]] = True
        else:
            ids.update(block.ids[i] for i in on.tolist())
    names = {
        kind: {equations.unknowns[kind].names[i] for i in np.flatnonzero(flags).tolist()}
        for kind, flags in used.items()
    }
    return only(equations.network, name, ids, images, names)


def _geoids(network: Network) -> tuple[str, ...]:
    """Return the path of the geoid, which processes may open wherever it lies."""
    given = None if network.crs is None else network.crs.geoid
    return (str(Path(given).absolute()), given) if isinstance(given, str) else ()


def _carried(start: Start, network: Network) -> Start:
    """Return start values for a part."""
    found = start.for_unknowns(Unknowns(network))
    assert found is not None
    return found


@overload
def adjust(
    network: Network,
    *,
    datum: DatumChoice | None = None,
    variance: Literal["a-priori", "a-posteriori"] = "a-priori",
    start: Solution | Start | None = None,
    weights: Array | None = None,
    tolerance: float = 1e-5,
    max_iterations: int = 100,
    extra_factors: ExtraFactors = (),
    progress: Progress | None = None,
    leave_out_undetermined: bool = False,
    solver: SolverName = "direct",
) -> Solution: ...


@overload
def adjust(
    network: Network,
    *,
    client: Client,
    regions: Regions | None = None,
    folder: str | Path | None = None,
    variance: Literal["a-priori", "a-posteriori"] = "a-priori",
    tolerance: float = 1e-5,
    max_iterations: int = 100,
    progress: Progress | None = None,
    leave_out_undetermined: bool = False,
) -> PartsSolution: ...


@taking(Network)
def adjust(
    network: Network,
    *,
    client: Client | None = None,
    regions: Regions | None = None,
    folder: str | Path | None = None,
    datum: DatumChoice | None = None,
    variance: Literal["a-priori", "a-posteriori"] = "a-priori",
    start: Solution | Start | None = None,
    weights: Array | None = None,
    tolerance: float = 1e-5,
    max_iterations: int = 100,
    extra_factors: ExtraFactors = (),
    progress: Progress | None = None,
    leave_out_undetermined: bool = False,
    solver: SolverName = "direct",
) -> Solution | PartsSolution:
    """Adjust a network by least squares: minimise vᵀPv over all unknowns.

    Photos that have no pose and see too few known points are oriented from image points alone, see
    `orient`, and the solution says so (``begun``).

    With a client of a Dask cluster the network is cut into parts (Helmert blocks), which the
    workers adjust together; the result is the same. See `adjust_parts` for parts in files.

    Args:
        network: the points, photos, instruments and observations.
        client: client of a Dask cluster (extra ``cluster``), best with one thread for each
            worker; none: the network is adjusted as a whole in this process.
        regions: with a client only: number of parts, or the region of each point and photo by its
            name (a mapping or a function). None: two parts for each worker, cut by nested
            dissection.
        folder: with a client only: folder of the run, as for `adjust_parts`.
        datum: ``given`` (control, fixed, weighted) or ``free`` (inner constraints over the datum
            points); none: the datum of the network. Parts need a given datum.
        variance: whether covariances are scaled by 1 or by σ̂0².
        start: an earlier solution or other values by name, from which the iteration starts; it
            takes a step or two if few observations have changed. The inner constraints refer to
            the same coordinates x₀ as those of ``start``. Not with a client.
        weights: factor on the weight of each scalar observation, in the order of
            ``solution.observations``; see `Equations.reweighted`. Not with a client.
        tolerance: bound on the last step of every unknown, relative to its own σ.
        max_iterations: largest number of iterations; a solution that needs more is returned as
            not converged.
        extra_factors: any ``gtsam.NonlinearFactor`` over the keys of `build_graph`, in a list or
            by name, or functions by name that make them, as for `IncrementalAdjustment.add`; they
            take part in solution and covariance, and have test values in `Reliability.factors`.
            Not with a client.
        progress: called after each iteration; an exception in it ends the adjustment.
        leave_out_undetermined: whether `determined_part` is adjusted, without what the observations
            do not determine; ``solution.network.unknowns_left_out`` names it, with a client
            ``solution.unknowns_left_out``. Not with ``weights``.
        solver: ``direct``, elimination in fronts; or ``conjugate-gradients`` for blocks of photos
            whose fronts do not fit in memory. The minimum is the same within ``tolerance``, without
            the covariances of all unknowns: see `estimate_precision`. It needs a given datum. Not
            with a client.

    Returns:
        The solution; its ``converged`` and ``reason`` say how the iteration ended.

    Raises:
        InputError: an observation cannot be computed, a point lies behind a camera, there is
            nothing to adjust, or too little memory; the error names all of them at once. An
            option is given that belongs to the other way of adjusting.
        ApproximationError: the points, photos or sets that it names have no approximate values.
        DatumError: the observations do not determine the unknowns that it names, or the network
            has datum defects and no free network is asked for.
    """
    if client is None:
        if regions is not None or folder is not None:
            raise InputError("regions and folder belong to client: give a client too")
        return adjustment.adjust(
            network,
            datum=datum,
            variance=variance,
            start=start,
            weights=weights,
            tolerance=tolerance,
            max_iterations=max_iterations,
            extra_factors=extra_factors,
            progress=progress,
            leave_out_undetermined=leave_out_undetermined,
            solver=solver,
        )
    check_client(client)
    given = {
        "start": start,
        "weights": weights,
        "extra_factors": extra_factors or None,
        "solver": None if solver == "direct" else solver,
    }
    if refused := [name for name, value in given.items() if value is not None]:
        raise InputError(f"with a client there is no {', '.join(refused)}: adjust without it")
    if (datum or network.datum) != "given":
        raise InputError(
            "a network in parts needs a given datum: hold or weight some coordinates, and say "
            'datum="given"'
        )
    return adjust_cut(
        network,
        regions,
        client=client,
        folder=folder,
        variance=variance,
        tolerance=tolerance,
        max_iterations=max_iterations,
        progress=progress,
        leave_out_undetermined=leave_out_undetermined,
    )


def adjust_cut(
    network: Network,
    regions: Regions | None,
    *,
    client: Client | None,
    folder: str | Path | None,
    variance: Literal["a-priori", "a-posteriori"],
    tolerance: float = 1e-5,
    max_iterations: int = 100,
    progress: Progress | None = None,
    leave_out_undetermined: bool = False,
) -> PartsSolution:
    """Cut a network into parts and adjust them, see `adjust`; without a client in this process.

    What is to be left out is found in an adjustment of the whole network, if the parts refuse it.
    """
    network = with_listed_points_apart(network)
    if regions is None:
        workers = 1 if client is None else len(client.scheduler_info(n_workers=-1)["workers"])
        regions = PARTS_OF_WORKER * max(workers, 1)
    temporary = TemporaryFolder() if folder is None else None
    place = Path(temporary.path if temporary is not None else str(folder)).absolute()

    def attempt(some: Network) -> PartsSolution:
        return adjust_parts(
            cut_network(some, regions, RunFolder(place).made()),
            client=client,
            folder=place,
            name=network.name,
            variance=variance,
            tolerance=tolerance,
            max_iterations=max_iterations,
            progress=progress,
        )

    try:
        return replace(attempt(network), temporary=temporary)
    except AdjustmentError:
        if not leave_out_undetermined:
            raise
    # Parts do not determine what of all is open: a junction may be open in one of them alone.
    rest = adjustment.determined_part(network)
    left_out = tuple(rest.unknowns_left_out)
    return replace(attempt(rest), temporary=temporary, unknowns_left_out=left_out)
