"""covariances.csv: joint covariances of observations and of image points, read and written."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import cast

import numpy as np

from ..entities import JointImagePoints
from ..errors import InputError, Problem, known
from ..network.network import Network
from ..observations import KINDS, Correlated, ImagePoint, Observation
from ..stochastic_model import whitening
from ..types import Array
from ..units import LENGTH
from . import numbers
from .csv_tables import CsvTable, FieldRow
from .observation_fields import ImageAxes, is_angle, is_in_image, sigma_fields
from .unknowns_tables import check_columns

COVARIANCE_COLUMNS = (
    *("cluster", "id", "component", "id2", "component2", "covariance_si"),
    *(f"covariance_{u}2" for u in LENGTH),
    "covariance_image2",
)
IN_IMAGE_UNITS = "covariances of image points are stated as covariance_image2"


class CovarianceTable:
    """Clusters of observations from covariances.csv."""

    def __init__(
        self, table: CsvTable, problems: list[Problem], axes_of: Callable[[str], ImageAxes]
    ) -> None:
        self.table = table
        self.problems = problems
        self.axes_of = axes_of
        self.members: dict[str, list[str]] = {}
        self.lines: dict[str, int] = {}
        self.entries: dict[str, list[tuple[int, tuple[str, str], tuple[str, str], float]]] = {}
        self.cluster_of: dict[str, str] = {}
        self.of_images: set[str] = set()
        """Clusters of image points."""
        self.in_image_units: set[str] = set()
        """Clusters whose covariances are in squares of the unit of images."""
        columns = ("cluster", "id", "component", "id2", "component2")
        valid = check_columns(table, COVARIANCE_COLUMNS, ("cluster", "id", "id2"), problems)
        units = [f"{u}2" for u in LENGTH]
        if not {"cluster", "id", "id2"} <= valid:
            return
        for line, fields in table.records():
            row = FieldRow(fields, table.where(line), problems)
            cluster, ident, component, ident2, component2 = (
                row.text(c, required=not c.startswith("component")) or "" for c in columns
            )
            row.of = f"cluster {cluster!r}"
            value = row.number("covariance_image2")
            if value is not None:
                self.in_image_units.add(cluster)
            else:
                value = row.quantity("covariance", units)
            if value is None:
                value = row.number("covariance_si")
            if value is None and not row.failed:
                row.wrong(
                    "covariance_m2 (or another unit, or covariance_si) is missing; of image points "
                    "covariance_image2"
                )
            if value is None or row.failed:
                continue
            self.lines.setdefault(cluster, line)
            for name in (ident, ident2):
                if self.cluster_of.setdefault(name, cluster) != cluster:
                    row.wrong(f"observation {name!r} is in cluster {self.cluster_of[name]!r} too")
                if name not in self.members.setdefault(cluster, []):
                    self.members[cluster].append(name)
            entry = (line, (ident, component), (ident2, component2), value)
            self.entries.setdefault(cluster, []).append(entry)

    def complete_sigma(self, ident: str, record: dict[str, object]) -> None:
        """Give a member without a standard deviation the variances of its cluster."""
        cluster = self.cluster_of.get(ident)
        kind = str(record.get("kind", ""))
        if cluster is None or kind not in KINDS:
            return
        if any(f in record for f in sigma_fields(kind)):
            return
        unit = "image" if is_in_image(kind) else "rad" if is_angle(kind) else "m"
        for _, a, b, value in self.entries[cluster]:
            if a == b and a[0] == ident and value > 0:
                axis = f"_{a[1]}" if a[1] else ""
                record[f"sigma{axis}_{unit}"] = repr(float(np.sqrt(value)))

    def join(self, found: list[Observation]) -> list[Observation | Correlated]:
        """Return the observations; each cluster takes the place of its first member."""
        by_id = {o.id: o for o in found if o.id is not None}
        out: list[Observation | Correlated] = []
        done: set[str] = set()
        for o in found:
            cluster = self.cluster_of.get(o.id or "")
            if cluster is None:
                out.append(o)
            elif cluster not in done:
                done.add(cluster)
                out.extend(self._cluster(cluster, by_id))
        for cluster in self.members:
            if cluster not in done and cluster not in self.of_images:
                self._cluster(cluster, by_id)
        return out

    def image_groups(self, images: Mapping[str, int], signs: Array) -> list[JointImagePoints]:
        """Return the clusters of image points.

        Args:
            images: rows of the image points, by id.
            signs: signs of x and y of each image point in files, (2n,).
        """
        out = []
        for cluster, ids in self.members.items():
            if not set(ids) & images.keys():
                continue
            self.of_images.add(cluster)
            if cluster not in self.in_image_units:
                self.problems.append(Problem(IN_IMAGE_UNITS, self._where(cluster)))
                continue
            components = {i: ("x", "y") for i in ids if i in images}
            matrix = self._matrix(cluster, components, images)
            if matrix is None:
                continue
            rows = np.array([images[i] for i in ids], dtype=np.intp)
            sign = signs.reshape(-1, 2)[rows].ravel()
            out.append(JointImagePoints(rows, matrix * sign[:, None] * sign))
        return out

    def _cluster(
        self, cluster: str, by_id: dict[str, Observation]
    ) -> list[Observation | Correlated]:
        members = [by_id[n] for n in self.members[cluster] if n in by_id]
        components = {n: _components(by_id[n]) for n in self.members[cluster] if n in by_id}
        matrix = self._matrix(cluster, components, by_id)
        if matrix is None:
            return list(members)
        if _in_image_units(members) != (cluster in self.in_image_units):
            what = "covariance_image2 is of observations in images alone"
            what = IN_IMAGE_UNITS if _in_image_units(members) else what
            self.problems.append(Problem(what, self._where(cluster)))
        return [Correlated(tuple(members), matrix * signs_in_group(members, self.axes_of))]

    def _where(self, cluster: str) -> str:
        return f"{self.table.where(self.lines[cluster])}: cluster {cluster!r}"

    def _matrix(
        self, cluster: str, components: Mapping[str, tuple[str, ...]], there: Iterable[str]
    ) -> Array | None:
        """Return the covariance of a cluster; None, with problems, if it is none.

        Args:
            cluster: name of the cluster.
            components: names of the components of its members that are there, by id.
            there: ids of all observations.
        """
        where = self._where(cluster)
        unknown = [n for n in self.members[cluster] if n not in components]
        if unknown:
            names = known(there, meant=unknown[0])
            what = f"unknown id {', '.join(map(repr, unknown))}; known: {names}"
            self.problems.append(Problem(what, where))
            return None
        pairs = [(n, c) for n in self.members[cluster] for c in components[n]]
        place = {pair: number for number, pair in enumerate(pairs)}
        matrix = np.full((len(place), len(place)), np.nan)
        bad = False
        for line, a, b, value in self.entries[cluster]:
            for name, component in (a, b):
                if (name, component) not in place:
                    bad = True
                    every = [c or "(empty)" for c in components[name]]
                    valid = known(every, meant=component)
                    what = f"unknown component {component!r} of {name!r}; valid: {valid}"
                    at = f"{self.table.where(line)}: cluster {cluster!r}"
                    self.problems.append(Problem(what, at))
            if not bad:
                matrix[place[a], place[b]] = value
        if bad:
            return None
        matrix = _symmetric(matrix)
        missing = [k for k, i in place.items() if np.isnan(matrix[i, i])]
        if missing:
            what = "the variance is missing of " + known(f"{i} {c}".strip() for i, c in missing)
            self.problems.append(Problem(what, where))
            return None
        matrix = np.nan_to_num(matrix, nan=0.0)
        try:
            whitening(matrix)
        except InputError as error:
            self.problems.append(Problem(str(error), where))
            return None
        return matrix


def image_correlation(row: FieldRow, axes: ImageAxes) -> float:
    """Return the correlation of x and y up; on failure note a problem and return 0."""
    value = row.number("correlation")
    if value is not None and not abs(value) < 1:
        row.wrong(f"correlation must be between −1 and 1, not {row.fields['correlation']}")
        return 0.0
    return (-1.0 if axes.y_down else 1.0) * (value or 0.0)


def covariance_records(network: Network) -> Iterator[dict[str, str]]:
    """Yield the rows of covariances.csv of the correlated groups of a network."""

    def axes_of(photo: str) -> ImageAxes:
        camera = network.cameras[network.photos[photo].camera]
        return ImageAxes(camera.unit, camera.y_down_in_files)

    groups = [
        ([(i, network.observations[i]) for i in ids], covariance)
        for ids, covariance in network.clusters
    ]
    for group in network.image_groups():
        images = cast("tuple[ImagePoint, ...]", group.observations)
        groups.append(([(o.id or f"{o.photo}/{o.point}", o) for o in images], group.covariance))
    for number, (named, given) in enumerate(groups, start=1):
        column = "covariance_image2" if _in_image_units(o for _, o in named) else "covariance_si"
        covariance = given * signs_in_group([o for _, o in named], axes_of)
        members = [(ident, c) for ident, o in named for c in o.component_names()]
        for i, (id1, c1) in enumerate(members):
            for j, (id2, c2) in enumerate(members):
                value = float(covariance[i, j])
                mirrored = float(covariance[j, i])
                if j < i and value == mirrored:
                    continue
                if value == 0 and mirrored == 0 and i != j:
                    continue
                yield {
                    "cluster": str(number),
                    "id": id1,
                    "component": c1,
                    "id2": id2,
                    "component2": c2,
                    column: numbers.write_quantity(value),
                }


def _in_image_units(observations: Iterable[Observation]) -> bool:
    """Return whether the values of all of some observations are in the unit of their camera."""
    return all(isinstance(o, ImagePoint) or is_in_image(o.kind) for o in observations)


def signs_in_group(members: Iterable[Observation], axes_of: Callable[[str], ImageAxes]) -> Array:
    """Return the signs that covariances of a group have in files, (n, n).

    Covariances of y in an image with others change theirs where the camera has y down.

    Args:
        members: the observations.
        axes_of: axes of images in files, by the name of the photo.
    """
    signs = []
    for o in members:
        turned = _in_image_units([o]) and any(axes_of(photo).y_down for photo in o.photos())
        signs += [-1.0 if turned and name == "y" else 1.0 for name in o.component_names()]
    return np.outer(signs, signs)


def _symmetric(matrix: Array) -> Array:
    """Fill entries whose mirrored entry alone is stated."""
    return np.where(np.isnan(matrix), matrix.T, matrix)


def _components(o: Observation) -> tuple[str, ...]:
    """Return the names of the scalar components as written in covariances.csv."""
    return () if isinstance(o, ImagePoint) else o.component_names()
