"""The adjustment of a network in parts: junctions, iteration, results; resumption, progress."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Literal
from uuid import uuid4

import numpy as np

from ..adjustment import VARIANCE_SCALES
from ..blas_threads import with_one_thread
from ..errors import AdjustmentError, ApproximationError, InputError, Problem, SingularError, known
from ..observations.registry import in_image_table
from ..solve.gauss_newton import IterationEnd, Progress
from ..solve.gauss_newton_steps import Damping
from ..solve.minimum import MAX_REWEIGHTINGS
from ..solve.normal_equations import MIN_COVARIANCE_PIVOT
from ..solve.second_minimum import BETWEEN_TWO_PLACES, MAX_RESUMPTIONS
from ..types import Array, Keys
from .iteration import IterationPoint, WholeNetwork, iterate_parts
from .junctions import (
    IterationState,
    Junctions,
    PartStart,
    PartSurvey,
    RootPlaces,
    packed_triangle,
    problem_in_part,
    shared_keys,
)
from .loaded_part import PartJob
from .part_files import PartSource, RunFolder, TemporaryFolder, named_parts
from .solution import PartsSolution, Totals, WholeQuality
from .tasks import (
    JUNCTIONS_FILE,
    ambiguous_places,
    begin_part,
    finish_part,
    has_ambiguous_points,
    has_equal_weights,
    labels_of,
    leave_ambiguous_places,
    observations_at,
    shared_variables,
    survey_part,
)
from .workers import Workers, check_client

if TYPE_CHECKING:
    from distributed import Client


@with_one_thread
def adjust_parts(
    parts: Sequence[PartSource],
    *,
    client: Client | None = None,
    folder: str | Path | None = None,
    name: str = "",
    variance: Literal["a-priori", "a-posteriori"] = "a-priori",
    tolerance: float = 1e-5,
    max_iterations: int = 100,
    progress: Progress | None = None,
) -> PartsSolution:
    """Adjust a network that is given in parts (Helmert blocks), each read by its own process.

    Unknowns of the same kind and name in several parts are the same unknown, a junction. The
    result is that of the whole network: estimates, covariances, redundancy numbers. A given value
    of a weighted junction counts once, although several parts may state it.

    Args:
        parts: project files or folders, or `Part` with a function that returns a network.
        client: client of a Dask cluster (extra ``cluster``), best with one thread for each worker;
            none: the parts are read and eliminated one after another in this process, so that a
            network may be larger than the memory.
        folder: folder of the run, which all workers reach under this path. States and results
            are written there; a run that was killed resumes from it. None: a temporary folder of
            this machine, which disappears with the solution.
        name: name of the network.
        variance: whether covariances are scaled by 1 or by σ̂0².
        tolerance: bound on the last step of every unknown, relative to its own σ.
        max_iterations: largest number of iterations.
        progress: called after each iteration.

    Returns:
        The solution; its ``converged`` and ``reason`` say how the iteration ended.

    Raises:
        InputError: parts cannot be read, differ in what they hold, weight or estimate, have
            cameras of one name with different lenses, measure the same point in the same photo,
            have different frames, or ask for a free network; the folder belongs to another run;
            errors of all parts at once, each with the name of its part.
        ApproximationError: points, photos or sets of a part have no approximate values.
        DatumError: unknowns of a part are not determined by the part and its junctions, or the
            junctions are not determined by all parts together.
    """
    if variance not in VARIANCE_SCALES:
        raise InputError(
            f"unknown variance {variance!r}; valid: {known(VARIANCE_SCALES, meant=variance)}"
        )
    if client is not None:
        check_client(client)
    temporary = TemporaryFolder() if folder is None else None
    place = RunFolder(Path(temporary.path if temporary is not None else str(folder)).absolute())
    place.made()
    run = uuid4().hex
    jobs = [PartJob(part, number, place, run) for number, part in enumerate(named_parts(parts))]
    with Workers(jobs, client) as workers:
        surveyed = workers.all(survey_part, [()] * len(jobs))
        signature = _signature(jobs, surveyed)
        point = _resumed(place, signature, tolerance)
        keys = shared_keys(surveyed, [job.part.name for job in jobs])
        whole, begun, repeated = _begin_parts(workers, keys)
        point, ended = _iterate_with_weights(
            whole,
            point,
            ProgressNote(place, signature, tolerance),
            sum(b.n_rows for b in begun),
            tolerance=tolerance,
            max_iterations=max_iterations,
            progress=progress,
        )
        quality = _finish_parts(
            whole, begun, IterationState(point.state, point.weights), ended, variance
        )
    return PartsSolution(
        name=name,
        jobs=tuple(jobs),
        junctions=whole.junctions,
        state=point.state,
        weights=point.weights,
        begun=tuple(begun),
        quality=quality,
        repeated=repeated,
        sent=workers.sent,
        received=workers.received,
        temporary=temporary,
    )


class ProgressNote:
    """Writes the progress of a run."""

    def __init__(self, folder: RunFolder, signature: str, tolerance: float) -> None:
        """Take in where, of which run, and what it counts as rest."""
        self._folder, self._signature, self._tolerance = folder, signature, tolerance

    def __call__(self, point: IterationPoint) -> None:
        """Write a point."""
        d = point.damping
        self._folder.note(
            {
                "signature": self._signature,
                "state": point.state,
                "weights": point.weights,
                "iterations": point.iterations,
                "last": point.last,
                "damping": [d.value, d.resume, d.growth],
                "expecting": point.expecting,
                "tolerance": self._tolerance,
                "ended": None if point.ended is None else asdict(point.ended),
            }
        )


def _signature(jobs: Sequence[PartJob], surveyed: Sequence[PartSurvey]) -> str:
    """Return a digest of all parts."""
    digest = hashlib.blake2b(digest_size=16)
    for job, part in zip(jobs, surveyed, strict=True):
        digest.update(f"{job.part.name}\0{part.frame}\0{part.digest}\0".encode())
    return digest.hexdigest()


def _resumed(folder: RunFolder, signature: str, tolerance: float) -> IterationPoint:
    """Return the point at which a run goes on.

    Raises:
        InputError: the folder belongs to a run with other parts.
    """
    found = folder.progress()
    if found is None:
        return IterationPoint()
    if found.get("signature") != signature:
        what = (
            "the folder belongs to a run with other parts, or the parts have changed since: give "
            "an empty folder"
        )
        raise InputError(Problem(what, str(folder.path)))
    return IterationPoint(
        found["state"],
        found["weights"],
        found["iterations"],
        found["last"],
        Damping(*found["damping"]),
        found["expecting"],
        IterationEnd(**found["ended"])
        if found["ended"] and found["tolerance"] <= tolerance
        else None,
    )


def _repeated(workers: Workers, keys: Keys) -> tuple[tuple[str, str], ...]:
    """Return observations that several parts have, each with the name of its part.

    They agree in kind, unknowns and values to the last digit, so that one observation has probably
    come into two parts.

    Raises:
        InputError: parts measure the same point in the same photo; all such image points are named.
    """
    numbers = workers.all(observations_at, [(keys,)] * len(workers.jobs))
    found, counts = np.unique(np.concatenate(numbers), return_counts=True)
    twice = found[counts > 1]
    if not len(twice):
        return ()
    labels = workers.all(labels_of, [(keys, twice)] * len(workers.jobs))
    named = [
        (job.part.name, kind, label)
        for job, of_part in zip(workers.jobs, labels, strict=True)
        for kind, label in of_part
    ]
    problems = []
    for job in workers.jobs:
        own = [(kind, label) for name, kind, label in named if name == job.part.name]
        images = [label for kind, label in own if in_image_table(kind)]
        if images:
            what = f"other parts measure the same points in the same photos: {known(images)}"
            problems.append(Problem(f"{what}; give them in one part", f"part {job.part.name!r}"))
    if problems:
        raise InputError(problems)
    return tuple((name, label) for name, _, label in named)


def _begin_parts(
    workers: Workers, keys: Keys
) -> tuple[WholeNetwork, list[PartStart], tuple[tuple[str, str], ...]]:
    """Find the junctions and repeated observations, and let every part begin."""
    names = [job.part.name for job in workers.jobs]
    shared = workers.all(shared_variables, [(keys,)] * len(workers.jobs))
    junctions = Junctions(shared, names)
    repeated = _repeated(workers, keys)
    start = junctions.given()
    while True:
        begun = workers.all(begin_part, [(setup,) for setup in junctions.setups(start)])
        found = _first_known(junctions, start, begun)
        news = any(
            np.isnan(a).any() and not np.isnan(b).any() for a, b in zip(start, found, strict=True)
        )
        if not news:
            break
        start = found  # a part may need what another one has found, and all start from the same
    missing = [
        problem_in_part(name, where, what)
        for name, part in zip(names, begun, strict=True)
        for where, what in part.missing
    ]
    if missing:
        raise ApproximationError(missing)
    return WholeNetwork(workers, junctions, RootPlaces(junctions, begun)), begun, repeated


def _first_known(
    junctions: Junctions, start: Sequence[Array], begun: Sequence[PartStart]
) -> list[Array]:
    """Return the start values of the junctions, with what the first part has found."""
    out = list(start)
    for of_part, part in zip(junctions.of_part, begun, strict=True):
        for i, found in zip(of_part.tolist(), part.start, strict=True):
            if np.isnan(out[i]).any() and not np.isnan(found).any():
                out[i] = found
    return out


def _iterate_with_weights(
    whole: WholeNetwork,
    point: IterationPoint,
    note: ProgressNote,
    n_rows: int,
    *,
    tolerance: float,
    max_iterations: int,
    progress: Progress | None,
) -> tuple[IterationPoint, IterationEnd]:
    """Iterate; repeat with the weights that follow from the new lengths of sights."""
    if point.ended is not None:
        return point, point.ended
    for _ in range(MAX_REWEIGHTINGS):
        for _ in range(MAX_RESUMPTIONS):
            point, ended = iterate_parts(
                whole,
                point,
                tolerance=tolerance,
                max_iterations=max_iterations,
                note=note,
                progress=progress,
            )
            at = IterationState(point.state, point.weights)
            if not ended.converged or ended.iterations >= max_iterations:
                break
            n = len(whole.workers.jobs)
            if not any(whole.workers.all(has_ambiguous_points, [(at,)] * n)):
                break
            whole.workers.all(leave_ambiguous_places, [(at, point.state + 1)] * n)
            point = IterationPoint(point.state + 1, point.weights, point.iterations)
        else:
            return point, replace(ended, converged=False, reason=BETWEEN_TWO_PLACES, left=np.inf)
        if not ended.converged or ended.iterations >= max_iterations:
            break
        misfit = float(np.sqrt(ended.vtpv / n_rows))
        if all(whole.workers.all(has_equal_weights, [(at, misfit)] * len(whole.workers.jobs))):
            point = replace(point, ended=ended)
            note(point)
            break
        point = replace(point, weights=point.state)
    return point, ended


def _finish_parts(
    whole: WholeNetwork,
    begun: Sequence[PartStart],
    at: IterationState,
    ended: IterationEnd,
    variance: str,
) -> WholeQuality:
    """Let every part write its covariances and its reliability."""
    try:
        root, found = whole.eliminated(at)
    except SingularError:
        whole.explain(at)
        raise
    if found.smallest < MIN_COVARIANCE_PIVOT:
        whole.explain(at)
        raise AdjustmentError(
            f"no covariances: a pivot is {found.smallest:.1g} of its diagonal element, so weakly "
            "is an unknown determined; adjust the network as a whole, or add observations"
        )
    n = sum(b.n_rows for b in begun)
    u = sum(b.n_unknowns for b in begun) + whole.junctions.n_columns
    factor = found.vtpv / (n - u) if variance == "a-posteriori" and n > u else 1.0
    totals = Totals(
        found.vtpv, n - u, factor, ended.converged, ended.reason, ended.iterations, ended.left
    )
    covariances = root.covariances()
    for job, columns in zip(whole.workers.jobs, whole.junctions.columns, strict=True):
        mine = packed_triangle(covariances.of(columns))
        job.own.write_arrays(JUNCTIONS_FILE, {"covariances": mine})
        whole.workers.sent += mine.nbytes
    finished = whole.workers.all(finish_part, [(at, totals)] * len(whole.workers.jobs))
    places = whole.workers.all(ambiguous_places, [(at,)] * len(begun)) if ended.converged else []
    return WholeQuality(totals, n, u, tuple(finished), tuple(chain.from_iterable(places)))
