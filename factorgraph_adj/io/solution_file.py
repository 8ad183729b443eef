"""A solution in one file (.npz), saved and loaded: network, state and σ, factorised again.

The file is a NumPy archive (.npz): ``header`` is JSON with the version of the format, the project
files of the network and how the iteration ended; the other entries are arrays. Loading linearises
the network at the state and factorises it again, so that covariances and reliability are those of
the adjustment.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Mapping
from dataclasses import asdict, replace
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from ..errors import InputError, Problem, UnknownLeftOut
from ..files import read_arrays
from ..graph.equations import Equations, compile_network
from ..graph.observation_selection import without
from ..solve.added_factors import AddedFactors
from ..solve.adjustment_run import RunRecord
from ..solve.datum_defects import Defect, FreeDatum
from ..solve.gauss_newton_steps import ExtrapolationRecord
from ..solve.linearised_equations import ExtraRows
from ..solve.normal_equations import Solver
from ..solve.solution import Solution
from ..types import Array
from .file_transaction import write_files
from .json_records import network_files, network_of
from .transaction_folders import recover_folder

SOLUTION_FORMAT = 1
"""Version of the format; other versions are refused."""
SOLUTION_MARK = "factorgraph_adj solution"
DAMAGE_ERRORS = (
    *(ValueError, TypeError, KeyError, AttributeError, EOFError, RecursionError, OverflowError),
    *(MemoryError, NotImplementedError, BadZipFile, zlib.error, struct.error),
)
"""What reading a damaged archive ends in."""


def save_solution(solution: Solution, path: str | Path) -> None:
    """Write a solution into a file; `load_solution` reads it.

    Args:
        solution: the result of an adjustment. Of factors that the user added the file has the rows
            at the solution, as a pickled solution.
        path: the file; one that is there is replaced, and stays as it is after an error.

    Raises:
        InputError: the file cannot be written; or the solution comes from `s_transform`: save the
            one before, and transform it after loading.
    """
    if solution.reference is not None:
        raise InputError(
            "a solution of s_transform has no file: save the solution before, and transform it "
            "after loading"
        )
    datum = solution.datum
    header = {
        "what": SOLUTION_MARK,
        "format": SOLUTION_FORMAT,
        "files": network_files(solution.network),
        "converged": solution.converged,
        "reason": solution.reason,
        "iterations": solution.iterations,
        "within": solution.within,
        "second_places": solution.second_places,
        "begun": solution.begun,
        "listed_points": list(solution.network.listed_points),
        "unknowns_left_out": [asdict(x) for x in solution.network.unknowns_left_out],
        "vtpv": solution.vtpv,
        "variance": solution.variance,
        "extrapolated": asdict(solution.extrapolated),
        "drifting": solution.run.drifting,
        "defects": len(solution.defects),
        "extra": [e.name for e in solution.extra.rows],
        "extra_apart": solution.extra.apart,
    }
    arrays: dict[str, Any] = {"constraint": solution.run.constraint}
    arrays |= {f"state/{kind}": x for kind, x in solution.state.items()}
    arrays |= {f"start/{kind}": x for kind, x in solution.start.items()}
    arrays["sigmas"] = solution.equations.sigmas()
    if solution.weights is not None:
        arrays["weights"] = solution.weights
    if datum is not None:
        arrays |= {"datum/motions": datum.motions, "datum/columns": datum.columns}
    for i, d in enumerate(solution.defects):
        centre, size = d.about
        fields: dict[str, Any] = {
            "part": d.part,
            "motions": d.motions,
            "mixture": d.mixture,
            "inside": d.inside,
        }
        fields |= {"centre": np.asarray(centre), "size": np.asarray(size)}
        arrays |= {f"defect/{i}/{name}": x for name, x in fields.items()}
    for i, e in enumerate(solution.extra.rows):
        arrays |= {f"extra/{i}/columns": e.columns, f"extra/{i}/a": e.a}
        arrays[f"extra/{i}/residual"] = e.residual
    text = json.dumps(header, ensure_ascii=False).encode("utf-8")
    buffer = BytesIO()
    np.savez_compressed(buffer, header=np.frombuffer(text, dtype=np.uint8), **arrays)
    file = Path(path)
    write_files(file.parent, {file.name: buffer.getvalue()})


def load_solution(path: str | Path, *, allow_outside: bool = False) -> Solution:
    """Return the solution of a file that `save_solution` wrote.

    Args:
        path: the file.
        allow_outside: whether the geoid of its reference system may lie outside the folder of the
            file.

    Raises:
        InputError: the file cannot be read, is none of a solution, is damaged, or is of another
            version.
    """
    recover_folder(Path(path).parent)
    try:
        entries = read_arrays(Path(path))
        header = json.loads(entries.pop("header").tobytes().decode("utf-8"))
    except DAMAGE_ERRORS as error:
        what = "is no file of `save_solution`, or is damaged"
        if Path(path).suffix in (".json", ".txt", ".csv"):
            what = "is a report; `Solution.save` writes the file of a solution"
        raise InputError(Problem(what, str(path))) from error
    if not isinstance(header, dict) or header.get("what") != SOLUTION_MARK:
        raise InputError(Problem("is no file of a solution", str(path)))
    if header.get("format") != SOLUTION_FORMAT:
        what = f"is of format {header.get('format')!r}; this program reads format {SOLUTION_FORMAT}"
        raise InputError(Problem(what, str(path)))
    try:
        return _solution(header, entries, Path(path).parent, allow_outside)
    except (KeyError, ValueError, TypeError, IndexError) as error:
        what = f"is damaged: {type(error).__name__}: {error}"
        raise InputError(Problem(what, str(path))) from None


def _solution(
    header: dict[str, Any], entries: Mapping[str, Any], folder: Path, allow_outside: bool
) -> Solution:
    network = network_of(header["files"], home=folder, allow_outside=allow_outside)
    if listed := header.get("listed_points"):
        points = {name: network.points[name] for name in listed}
        network = without(network, (), points=listed)
        network.listed_points = points
    network.unknowns_left_out = [
        UnknownLeftOut(x["kind"], x["name"], x["why"], tuple(x["ids"]))
        for x in header.get("unknowns_left_out", ())
    ]
    network.datum = "free" if "datum/motions" in entries else network.datum
    weights = entries.get("weights")
    equations = _equations_with_sigmas(compile_network(network), entries["sigmas"], weights)
    state = _state(equations, entries, "state")
    rows = tuple(
        ExtraRows(name=name, **{w: entries[f"extra/{i}/{w}"] for w in ("columns", "a", "residual")})
        for i, name in enumerate(header["extra"])
    )
    datum = None
    if "datum/motions" in entries:
        datum = FreeDatum(entries["datum/motions"], entries["datum/columns"])
    return Solution(
        network=network,
        equations=equations,
        state=state,
        start=_state(equations, entries, "start"),
        converged=header["converged"],
        reason=header["reason"],
        iterations=header["iterations"],
        within=header["within"],
        second_places=tuple(header["second_places"]),
        begun=tuple(header.get("begun", ())),
        vtpv=header["vtpv"],
        run=RunRecord(
            Solver.of(equations, rows),
            entries["constraint"],
            tuple((kind, name) for kind, name in header["drifting"]),
        ),
        datum=datum,
        defects=tuple(_defect(entries, i) for i in range(header["defects"])),
        variance=header["variance"],
        weights=weights,
        extra=AddedFactors(None, rows, apart=header.get("extra_apart", 0))
        if rows
        else AddedFactors(),
        extrapolated=ExtrapolationRecord(**header["extrapolated"]),
    )


def _state(equations: Equations, entries: Mapping[str, Any], name: str) -> dict[str, Array]:
    """Return the values of all variables.

    Raises:
        ValueError: they are not those of the network.
    """
    out = {}
    for kind, table in equations.unknowns.tables.items():
        values = entries[f"{name}/{kind}"]
        if values.shape != table.values.shape:
            raise ValueError(f"{name} of kind {kind} is {values.shape}, not {table.values.shape}")
        out[kind] = values
    return out


def _equations_with_sigmas(equations: Equations, sigmas: Array, weights: Array | None) -> Equations:
    """Return equations with the standard deviations that the adjustment ended with."""
    if sigmas.shape != (equations.n_rows,):
        raise ValueError(f"{len(sigmas)} standard deviations for {equations.n_rows} observations")
    if weights is not None:
        equations = equations.reweighted(weights)
    blocks = tuple(
        replace(b, sigma=sigmas[b.rows].reshape(b.observed.shape)) for b in equations.blocks
    )
    return replace(equations, blocks=blocks)


def _defect(entries: Mapping[str, Any], number: int) -> Defect:
    def of(name: str) -> Any:
        return entries[f"defect/{number}/{name}"]

    about = of("centre"), float(of("size"))
    return Defect(of("part"), of("motions"), of("mixture"), about, of("inside"))
