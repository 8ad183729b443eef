"""The adjustment of a network in memory, as a whole or in parts on a cluster."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, overload

from ..errors import AdjustmentError, InputError
from ..network.network import DatumChoice, Network
from ..solve import batch
from ..solve.extra import ExtraFactors
from ..solve.iterate import Progress
from ..solve.solution import Solution
from ..solve.start import Start
from ..types import Array
from .adjust import adjust_parts
from .cut import Regions, cut_network
from .folder import Folder, Scratch
from .result import PartsSolution
from .workers import check_client

if TYPE_CHECKING:
    from distributed import Client

FOR_EACH_WORKER = 2
"""Number of parts for each worker, so that a worker that is slow or lost can be relieved."""


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
        return batch.adjust(
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
        )
    check_client(client)
    given = {
        "start": start,
        "weights": weights,
        "extra_factors": extra_factors or None,
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
    if regions is None:
        workers = 1 if client is None else len(client.scheduler_info(n_workers=-1)["workers"])
        regions = FOR_EACH_WORKER * max(workers, 1)
    temporary = Scratch() if folder is None else None
    place = Path(temporary.path if temporary is not None else str(folder)).absolute()

    def attempt(some: Network) -> PartsSolution:
        return adjust_parts(
            cut_network(some, regions, Folder(place).made()),
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
    # Parts do not tell what of all is open: a junction may be open in one of them alone.
    rest = batch.determined_part(network)
    left_out = tuple(rest.unknowns_left_out)
    return replace(attempt(rest), temporary=temporary, unknowns_left_out=left_out)
