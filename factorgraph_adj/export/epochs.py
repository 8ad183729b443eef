"""Displacements of two epochs as layers: vectors with their ellipses, and points by their state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import InputError
from ..report.epochs.context import EpochsReport
from ..report.plots.displaced import EpochsDrawing
from ..version import __version__
from .layer import Drawn, Layer
from .points import MM, shapes_of


@dataclass(frozen=True, eq=False)
class EpochsLayers:
    """Layers whose shapes are in the frame of the first epoch, metres."""

    name: str
    """Names of the epochs."""
    layers: tuple[Layer, ...]
    """The layers, the lowest one of a picture first."""
    facts: Mapping[str, str | float | bool]
    """Figures of the comparison."""


def epochs_layers(report: EpochsReport, drawn: Drawn) -> EpochsLayers:
    """Return ``displacement_ellipses``, ``displacements`` and ``points`` of two epochs.

    A displacement is a line from the place of the first epoch, with its ellipse at its end; one
    factor exaggerates both.

    Args:
        report: the comparison.
        drawn: probability of the ellipses, and the factor.

    Raises:
        InputError: the confidence is outside (0, 1), or two factors are asked for.
    """
    if drawn.vector_exaggeration is not None:
        raise InputError(
            "displacements and their ellipses are drawn with one factor: state exaggeration alone"
        )
    report = replace(report, confidence=drawn.confidence)
    plan = EpochsDrawing(report, drawn.exaggeration)
    found, factor = report.found, plan.factor
    ends = report.places + factor * report.vectors
    columns = _columns(report)
    looks = [f"displacements_{'moved' if moved else 'kept'}" for moved in columns["moved"]]
    lines = np.stack([report.places, ends], axis=1)
    title = f"displacements between two epochs, drawn {factor:.10g} times their size"
    exaggerated = {**columns, "exaggeration": [factor] * len(lines)}
    vectors = Layer("displacements", title, "LINESTRING", list(lines), exaggerated, looks)
    at = {n: i for i, n in enumerate(report.names)}
    shapes = shapes_of(report.ellipses, report.network.frame)
    own = [at[n] for n in shapes.names]
    shapes = replace(shapes, centres=ends[own])
    level = "standard" if report.confidence is None else f"{100 * report.confidence:.10g} %"
    ellipses = Layer(
        "displacement_ellipses",
        f"ellipses of displacements, {level}, drawn {factor:.10g} times their size",
        "POLYGON",
        shapes.rings(factor),
        {
            **shapes.columns(),
            "moved": [columns["moved"][i] for i in own],
            "exaggeration": [factor] * len(own),
        },
        [looks[i] for i in own],
    )
    title = "compared points at their places of the first epoch, with their displacements"
    points = Layer("points", title, "POINT", list(report.places[:, None]), columns)
    name = " → ".join(s.network.name for s in found.solutions)
    facts: dict[str, str | float | bool] = {
        "program": f"factorgraph_adj {__version__}",
        "epochs": name,
        "doubts": "; ".join(report.doubts),
        "sigma0_of_tests": float(np.sqrt(found.scale.variance)),
        "alpha": found.alpha,
        "power": found.power,
        "stable": ", ".join(found.stable),
        "moved": ", ".join(found.moved),
        "confidence_of_ellipses": report.confidence or "standard ellipses",
        "exaggeration": factor,
    }
    return EpochsLayers(name, (ellipses, vectors, points), facts)


def _columns(report: EpochsReport) -> dict[str, Sequence[Any]]:
    every = list(report.found.displacements.values())
    sigmas = np.array([x.sigmas for x in every]).reshape(-1, 3)
    frame = report.network.frame
    enu = frame.basis(report.places, np.zeros((len(every), 2))).enu
    local = np.einsum("nij,nj->ni", enu, report.vectors)
    columns: dict[str, Sequence[Any]] = {"name": report.names, "status": list(report.states)}
    columns |= {a: report.places[:, i].tolist() for i, a in enumerate("xyz")}
    columns |= {f"d{a}_mm": (report.vectors[:, i] / MM).tolist() for i, a in enumerate("xyz")}
    columns |= {f"sigma_d{a}_mm": (sigmas[:, i] / MM).tolist() for i, a in enumerate("xyz")}
    for i, a in enumerate(("east", "north", "up")):
        columns[f"d_{a}_mm"] = (local[:, i] / MM).tolist()
    return columns | {
        "length_mm": [x.length / MM for x in every],
        "test_value": [x.test.value for x in every],
        "critical": [x.test.critical for x in every],
        "p_value": [x.test.p_value for x in every],
        "moved": [x.moved for x in every],
        "detectable_mm": [x.detectable / MM for x in every],
    }
