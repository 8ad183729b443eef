"""Content of results.json of an adjustment and of two epochs, in SI units, with its JSON Schemas.

``results.schema.json`` and ``epochs.schema.json`` beside this module describe every member.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

import numpy as np

from ..crs.reference_system import ReferenceSystem
from ..epochs.block_motion import BlockMotion
from ..frames import frame_record
from ..graph.variables import camera_of_calibration
from ..quality.rejections import Rejected, Snooping, Unresolved
from ..statistical_tests import global_test
from ..version import __version__
from .adjusted_coordinates import lines_table
from .adjusted_observations import observation_table
from .adjusted_photos import photos_table
from .adjusted_points import has_values, points_table
from .adjustment_report import Report
from .doubtful_results import notes_of_network, notes_of_solution
from .epochs_report import EpochsReport, displacements_table, record_of_test
from .layout import finite_json, json_text
from .misfit_causes import causes_table
from .tables import as_json, as_json_by_name, as_json_columns
from .unknowns import calibration_table, orientations_table, others_table

RESULTS_FORMAT = 3
"""Version of results.json; it grows with every change that a reader could stumble over."""
RESULTS_SCHEMA = "https://github.com/factorgraph-adj/factorgraph_adj/results-3.schema.json"
"""Name of the schema of the format."""
EPOCHS_FORMAT = 1
"""Version of the file; it grows with every change that a reader could stumble over."""
EPOCHS_SCHEMA = "https://github.com/factorgraph-adj/factorgraph_adj/epochs-1.schema.json"
"""Name of the schema of the format."""


def results_text(report: Report) -> str:
    """Return results.json."""
    return json_text(finite_json(results_record(report))) + "\n"


def results_record(report: Report) -> dict[str, Any]:
    """Return the content of results.json."""
    s, network = report.solution, report.network
    test = global_test(s)
    run = {name: text for name, text in asdict(report.provenance.run).items() if text}
    return {
        "$schema": RESULTS_SCHEMA,
        "format": RESULTS_FORMAT,
        "program": f"factorgraph_adj {__version__}",
        **({"run": run} if run else {}),
        "name": network.name,
        "units": {"length": "m", "angle": "rad"},
        **frame_record(network.frame),
        **({} if network.crs is None else {"reference_system": system_record(network.crs)}),
        "converged": s.converged,
        "reason": s.reason,
        "iterations": s.iterations,
        **({"start": list(s.begun)} if s.begun else {}),
        **({"left_out": [str(left) for left in network.left_out]} if network.left_out else {}),
        **({"remarks": list(network.remarks)} if network.remarks else {}),
        **({"extrapolated": asdict(s.extrapolated)} if s.extrapolated.count else {}),
        "n_observations": s.n_observations,
        "n_unknowns": s.n_unknowns,
        "datum": "given" if s.datum is None else "free",
        "datum_defect": s.datum_defect,
        "redundancy": s.redundancy,
        "vtpv": s.vtpv,
        "sigma0": s.sigma0,
        "variance": s.variance,
        "global_test": {
            **asdict(test),
            "accepted": test.accepted,
            "outcome": test.outcome,
        },
        "doubts": list(report.doubts),
        **(
            {"notes": notes}
            if (
                notes := [
                    *notes_of_solution(s),
                    *notes_of_network(network),
                    *map(str, report.provenance.left_out),
                ]
            )
            else {}
        ),
        **(
            {"unknowns_left_out": [asdict(x) for x in network.unknowns_left_out]}
            if network.unknowns_left_out
            else {}
        ),
        "observation_groups": [
            {
                "kind": g.label,
                "number": g.observations,
                "scalars": g.scalars,
                "normalised_rms": g.normalised_rms,
                "largest": g.largest,
            }
            for g in report.rows.groups()
        ],
        "reliability": _reliability(report),
        "causes": []
        if report.causes is None
        else as_json(causes_table(report, report.causes.more_probable)),
        "undecided": [] if report.causes is None else list(report.causes.undecided),
        **({} if report.snooping is None else {"snooping": _snooping(report, report.snooping)}),
        **({} if report.components is None else {"variance_components": _components(report)}),
        **({} if report.significance is None else {"parameters": _parameters(report)}),
        **(_unknown_values(report) if has_values(report) else {}),
        **({"relative": as_json(lines_table(report))} if report.lines else {}),
        "observations": as_json_columns(observation_table(report)),
    }


def system_record(system: ReferenceSystem) -> dict[str, Any]:
    """Return how a reference system was stated."""
    stated = {
        "definition": system.definition,
        "geoid": system.geoid,
        "heights": system.heights,
        "datum": system.datum,
        "parameters": None if system.parameters is None else asdict(system.parameters),
    }
    return {n: v for n, v in stated.items() if v is not None}


def _reliability(report: Report) -> dict[str, Any]:
    rel = report.reliability
    if rel is None:
        return {"reason": report.no_reliability}
    r = rel.redundancy_numbers
    values, critical = report.tests
    size = np.where(np.isfinite(values), np.abs(values), 0.0)
    above = np.flatnonzero(size > critical)
    above = above[np.argsort(-size[above], kind="stable")][: report.options.most]
    return {
        "alpha": rel.alpha,
        "power": rel.power,
        "delta0": rel.delta0,
        "critical_w": rel.critical_w,
        "critical_tau": rel.critical_tau,
        "test": "pope" if report.pope else "baarda",
        "largest": float(size.max(initial=0.0)),
        "above_critical": int(np.sum(size > critical)),
        "uncontrolled": int(np.sum(~rel.controlled)),
        "redundancy_number": {
            "sum": float(r.sum()) + rel.redundancy_of_extra_factors,
            "minimum": float(r.min()),
            "mean": float(r.mean()),
            "maximum": float(r.max()),
        },
        "observations": [
            {
                "kind": g.label,
                "scalars": g.scalars,
                "sum": float(r[g.rows].sum()),
                "minimum": float(r[g.rows].min()),
                "mean": float(r[g.rows].mean()),
                "maximum": float(r[g.rows].max()),
                "uncontrolled": int(np.sum(~rel.controlled[g.rows])),
            }
            for g in report.rows.groups()
        ],
        "suspects": [
            {
                "id": row.id,
                "component": row.component,
                "test_value": row.sign * float(values[row.number]),
                "redundancy_number": float(r[row.number]),
                "estimated_error": row.sign * float(rel.estimated_errors[row.number]),
                "mdb": float(rel.mdb[row.number]),
            }
            for row in report.rows.at(above.tolist())
        ],
    }


def _snooping(report: Report, found: Snooping) -> dict[str, Any]:
    def shown(r: Rejected | Unresolved) -> dict[str, Any]:
        sign, found = report.sign_in_report(r), asdict(r)
        turned = ("test", "estimated_error", "final_error", "final_test")
        return found | {n: sign * found[n] for n in turned if n in found}

    return {
        "test": found.test,
        "alpha": found.reliability.alpha,
        "critical": found.critical,
        "reason": found.reason,
        "rounds": [asdict(r) for r in found.rounds],
        "rejected": [
            shown(r) | {"inseparable": [{"what": o, "correlation": c} for o, c in r.inseparable]}
            for r in found.rejected
        ],
        "readmitted": list(found.readmitted),
        "rejected_points": [asdict(p) | {"rays": list(p.rays)} for p in found.rejected_points],
        "unresolved": [shown(u) for u in found.unresolved],
    }


def _components(report: Report) -> dict[str, Any]:
    found = report.components
    assert found is not None
    return {
        "converged": found.converged,
        "reason": found.reason,
        "iterations": found.iterations,
        "exact": found.exact,
        "components": [
            {**asdict(c), "freedom": c.freedom, "p_value": c.p_value} for c in found.components
        ],
        "correlation": found.correlation.tolist(),
    }


def _parameters(report: Report) -> dict[str, Any]:
    found = report.significance
    assert found is not None
    return {
        "alpha": found.alpha,
        "critical": found.critical,
        "tests": [
            {
                "kind": p.kind,
                "name": p.name,
                "component": p.component,
                "reference": p.reference,
                "t": p.t,
                "significant": p.significant,
                "variance_inflation": p.variance_inflation,
            }
            for p in found.parameters
        ],
        "overparametrised": list(found.overparametrised),
    }


def _unknown_values(report: Report) -> dict[str, Any]:
    return {
        "points": as_json_by_name(points_table(report)),
        "photos": as_json_by_name(photos_table(report)),
        "calibrations": {name: _calibration(report, name) for name in report.calibrations},
        "orientations": as_json(orientations_table(report)),
        "others": as_json(others_table(report)),
    }


def _calibration(report: Report, name: str) -> dict[str, Any]:
    e = report.calibrations[name]
    camera = camera_of_calibration(report.network, name)
    return {
        "lens": camera.lens.kind,
        "y_axis": "down" if camera.y_down_in_files else "up",
        "unit": e.unit,
        **as_json_columns(calibration_table(report, name)),
        "correlation": e.correlation.tolist(),
    }


def epochs_results_text(report: EpochsReport) -> str:
    """Return results.json of two epochs."""
    return (
        json.dumps(finite_json(epochs_results_record(report)), indent=1, ensure_ascii=False) + "\n"
    )


def epochs_results_record(report: EpochsReport) -> dict[str, Any]:
    """Return the content of results.json of two epochs."""
    found, network = report.found, report.network
    run = {name: text for name, text in asdict(report.provenance.run).items() if text}
    ratio = found.ratio
    return {
        "$schema": EPOCHS_SCHEMA,
        "format": EPOCHS_FORMAT,
        "program": f"factorgraph_adj {__version__}",
        **({"run": run} if run else {}),
        "units": {"length": "m", "angle": "rad"},
        **frame_record(network.frame),
        **({} if network.crs is None else {"reference_system": system_record(network.crs)}),
        "doubts": list(report.doubts),
        "adjustments": [
            {
                "name": s.network.name,
                "converged": s.converged,
                "n_observations": s.n_observations,
                "n_unknowns": s.n_unknowns,
                "datum_defect": s.datum_defect,
                "redundancy": s.redundancy,
                "vtpv": s.vtpv,
                "sigma0": s.sigma0,
                **(
                    {"unknowns_left_out": [asdict(x) for x in s.network.unknowns_left_out]}
                    if s.network.unknowns_left_out
                    else {}
                ),
            }
            for s in found.solutions
        ],
        "variance_ratio": None
        if ratio is None
        else {"ratio": ratio.ratio, "critical": ratio.critical, "accepted": ratio.accepted},
        "sigma0_of_tests": found.scale.variance**0.5,
        "freedom_of_sigma0": found.scale.freedom,
        "alpha": found.alpha,
        "power": found.power,
        "axes": found.differences.axes,
        "reference": list(found.reference),
        "stable": list(found.stable),
        "held": list(found.roles.held),
        "not_compared": [
            {"name": name, "reason": why} for name, why in found.roles.not_compared.items()
        ],
        "steps": [
            {"left": list(s.left), "back": list(s.back), "test": record_of_test(s.test)}
            for s in found.steps
        ],
        "displacements": as_json(displacements_table(report)),
        "blocks": [_block(b) for b in report.blocks],
    }


def _block(b: BlockMotion) -> dict[str, Any]:
    out: dict[str, Any] = {
        "points": list(b.points),
        "model": b.model,
        "centre": b.centre.tolist(),
        "parameters": dict(zip(b.names, b.values.tolist(), strict=True)),
        "sigmas": dict(zip(b.names, b.sigmas.tolist(), strict=True)),
        "fit": None if b.fit is None else record_of_test(b.fit),
        "motion": record_of_test(b.motion),
    }
    if b.model == "affine":
        strains, axes = b.principal_strains()
        out["principal_strains"] = {"values": strains.tolist(), "axes": axes.tolist()}
    return out
