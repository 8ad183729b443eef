"""GNU Gama: the XML of adjustment results of gama-local."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from factorgraph_adj.types import Array

NAMESPACE = "{http://www.gnu.org/software/gama/gama-local-adjustment}"
MM2 = 1e-6


@dataclass(frozen=True)
class GamaObservation:
    """A scalar observation as Gama reports it; lengths in m and mm, angles in gon and cc."""

    kind: str
    """Element of the file: direction, distance, slope-distance, zenith-angle, dx, …"""
    names: tuple[str, ...]
    """Points, in the order of the file: from, to, or from, backsight, foresight."""
    observed: float
    adjusted: float
    stdev: float
    """Of the adjusted value, mm or cc."""
    qrr: float
    """Weight coefficient of the residual; qrr times the weight is the redundancy number."""
    f: float
    """In per cent: 100 (1 − √(q_ll of the adjusted value / q_ll of the observation))."""
    standardised: float | None
    """|v| / its standard deviation."""
    error: float | None
    """Error of the observation if it alone is wrong, true − observed, mm or cc."""

    @property
    def redundancy(self) -> float:
        """Redundancy number r = 1 − (1 − f/100)²."""
        return 1.0 - (1.0 - self.f / 100.0) ** 2


@dataclass(frozen=True)
class GamaResult:
    """What gama-local found."""

    equations: int
    unknowns: int
    redundancy: int
    defect: int
    vtpv: float
    """[pvv], weights (sigma-apr / stdev)²."""
    apriori: float
    aposteriori: float
    used: str
    """Which of the two covariances are scaled by: apriori or aposteriori."""
    consistent: bool
    """Whether axes and angles turn the same way (ne, sw, es, wn with clockwise angles …)."""
    approximate: dict[str, Array]
    """Where the last step was linearised, metres, 6 decimals; NaN where not adjusted."""
    points: dict[str, Array]
    """Adjusted coordinates, metres; NaN where not adjusted."""
    place: dict[tuple[str, str], int]
    """Row in the covariance matrix of (point, axis)."""
    covariance: Array
    """Of coordinates (m²), then of orientation unknowns (not converted)."""
    observations: tuple[GamaObservation, ...]

    def covariance_of(self, name: str) -> Array:
        """Return the covariance (3, 3) of a point, m²; zero where not adjusted."""
        axes = [i for i, a in enumerate("xyz") if (name, a) in self.place]
        rows = [self.place[name, "xyz"[i]] for i in axes]
        out = np.zeros((3, 3))
        out[np.ix_(axes, axes)] = self.covariance[np.ix_(rows, rows)]
        return out


def read_gama_result(path: Path) -> GamaResult:
    """Read the ``.xml`` beside a ``.gkf``."""
    root = ElementTree.parse(path).getroot()

    def element(way: str) -> ElementTree.Element:
        found = root.find("/".join(NAMESPACE + step for step in way.split("/")))
        assert found is not None, way
        return found

    def number(way: str) -> float:
        return float(element(way).text or "nan")

    summary = "network-processing-summary"
    general = element("network-general-parameters").attrib
    left_handed = general["axes-xy"] in ("ne", "sw", "es", "wn")
    points = _points(element("coordinates/adjusted"))
    rows = [(n, a) for n, xyz in points.items() for a, v in zip("xyz", xyz, strict=True) if v == v]
    place = {row: i for i, row in enumerate(rows)}
    matrix = element("coordinates/cov-mat")
    size, band = int(_text(matrix, "dim")), int(_text(matrix, "band"))
    assert band == size - 1
    covariance = np.zeros((size, size))
    covariance[np.triu_indices(size)] = [float(e.text or "nan") for e in matrix if "flt" in e.tag]
    covariance = covariance + np.triu(covariance, 1).T
    covariance[: len(place), : len(place)] *= MM2
    return GamaResult(
        int(number(f"{summary}/project-equations/equations")),
        int(number(f"{summary}/project-equations/unknowns")),
        int(number(f"{summary}/project-equations/degrees-of-freedom")),
        int(number(f"{summary}/project-equations/defect")),
        number(f"{summary}/project-equations/sum-of-squares"),
        number(f"{summary}/standard-deviation/apriori"),
        number(f"{summary}/standard-deviation/aposteriori"),
        element(f"{summary}/standard-deviation/used").text or "",
        left_handed == (general["angles"] == "left-handed"),
        _points(element("coordinates/approximate")),
        points,
        place,
        covariance,
        tuple(_observation(e) for e in element("observations")),
    )


def _points(parent: ElementTree.Element) -> dict[str, Array]:
    """Return x, y, z by name; capital letters are constrained coordinates."""
    out = {}
    for point in parent:
        xyz = np.full(3, np.nan)
        for child in point:
            axis = child.tag.removeprefix(NAMESPACE).lower()
            if axis in ("x", "y", "z"):
                xyz["xyz".index(axis)] = float(child.text or "nan")
        out[_text(point, "id")] = xyz
    return out


def _text(parent: ElementTree.Element, tag: str) -> str:
    return parent.findtext(NAMESPACE + tag, "").strip()


def _observation(element: ElementTree.Element) -> GamaObservation:
    def number(tag: str) -> float:
        return float(_text(element, tag))

    names = (_text(element, tag) for tag in ("from", "to", "left", "right", "id"))
    standardised, error = _text(element, "std-residual"), _text(element, "err-obs")
    return GamaObservation(
        element.tag.removeprefix(NAMESPACE),
        tuple(n for n in names if n),
        number("obs"),
        number("adj"),
        number("stdev"),
        number("qrr"),
        number("f"),
        float(standardised) if standardised else None,
        float(error) if error else None,
    )
