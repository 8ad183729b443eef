"""results.json of two epochs: what moved, for programs, in metres and radians throughout.

``epochs.schema.json`` beside `factorgraph_adj.report.summary` describes every member.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

from ...epochs.blocks import BlockMotion
from ...epochs.hypotheses import Test
from ...version import __version__
from ..json_text import finite
from ..summary import COVARIANCE, frame_record, system_record
from .context import EpochsReport

FORMAT = 1
"""Version of the file; it grows with every change that a reader could stumble over."""
SCHEMA = "https://github.com/factorgraph-adj/factorgraph_adj/epochs-1.schema.json"
"""Name of the schema of the format."""


def epochs_text(report: EpochsReport) -> str:
    """Return results.json of two epochs."""
    return json.dumps(finite(epochs_summary(report)), indent=1, ensure_ascii=False) + "\n"


def epochs_summary(report: EpochsReport) -> dict[str, Any]:
    """Return the content of results.json of two epochs."""
    found, network = report.found, report.network
    run = {name: text for name, text in asdict(report.provenance.run).items() if text}
    ratio = found.ratio
    return {
        "$schema": SCHEMA,
        "format": FORMAT,
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
        "displacements": _displacements(report),
        "blocks": [_block(b) for b in report.blocks],
    }


def record_of_test(test: Test) -> dict[str, Any]:
    """Return a test by its members."""
    return {
        "value": test.value,
        "critical": test.critical,
        "freedom": list(test.freedom),
        "p_value": test.p_value,
        "accepted": test.accepted,
    }


def _displacements(report: EpochsReport) -> list[dict[str, Any]]:
    found = report.found
    later = dict(zip(found.differences.names, found.differences.later, strict=True))
    every = zip(found.displacements.values(), report.states, report.ellipses, strict=True)
    return [
        {
            "name": x.name,
            "name_later": later[x.name],
            "state": state,
            "place": x.place.tolist(),
            "vector": x.vector.tolist(),
            "covariance": [float(x.covariance[i, j]) for i, j in COVARIANCE],
            "length": x.length,
            "test": record_of_test(x.test),
            "moved": x.moved,
            "detectable": x.detectable,
            "hardest": x.hardest.tolist(),
            "ellipse": {
                "semi_axes": list(e.semi_axes),
                "azimuth": e.azimuth,
                "confidence": report.confidence,
            },
        }
        for x, state, e in every
    ]


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
