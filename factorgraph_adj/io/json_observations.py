"""Observations as plain JSON, see `factorgraph_adj.io.json_records`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..errors import InputError, Problem, known
from ..observations import (
    KINDS,
    AnyObservation,
    Correlated,
    Observation,
)
from ..types import Array
from . import numbers, records
from .context import ImageAxes, RecordContext
from .fields import is_angle, is_in_image, names_of, numbers_of, rules_of, sigma_fields, texts_of
from .numbers import Units
from .tables import IGNORED, Row

Fields = dict[str, object]
CORRELATED = "correlated"
"""Value of ``kind`` for observations with a joint covariance."""
SI = Units("m", "rad", "rad", "m", "rad")
"""Units of written records."""
_CORRELATED_KEYS = ("kind", "observations", "covariance_si", *IGNORED)


def plain(record: Mapping[str, str], texts: Iterable[str]) -> Fields:
    """Return the filled fields of a record in SI; text of numbers becomes numbers."""
    return {k: v if k in texts else float(v) for k, v in record.items() if v}


def checked(fields: object, source: str) -> Mapping[str, object]:
    """Return the fields; InputError if they are not a JSON object."""
    if isinstance(fields, Mapping):
        return fields
    raise InputError(Problem(f"a record must be an object {{…}}, not {fields!r}", source))


def observation_fields(
    item: AnyObservation, *, id: str | Sequence[str] | None, unit: str = "mm"
) -> Fields:
    """Return the record of an observation, without its source.

    Args:
        item: the observation, or several with a joint covariance.
        id: name in the network, for an observation without its own id; for correlated
            observations a sequence with one name for each.
        unit: unit of the camera, for image coordinates: px or a length; it ends the name of σ.

    Raises:
        InputError: the id or the name of a set is empty, or no part of the standard deviation
            applies: a record cannot state these.
    """
    if not isinstance(item, Correlated):
        return _single_fields(item, id if isinstance(id, str) else None, unit)
    ids: Sequence[str | None] = [None] * len(item.observations)
    if id is not None:
        ids = [id] if isinstance(id, str) else id
    return {
        "kind": CORRELATED,
        "observations": [
            _single_fields(o, i, unit) for o, i in zip(item.observations, ids, strict=True)
        ],
        "covariance_si": np.asarray(item.covariance, dtype=float).tolist(),
    }


def _single_fields(item: Observation, id: str | None, unit: str) -> Fields:
    # An empty field counts as absent; reading it would give another observation.
    stated = {n: getattr(item, n, None) for n in ("id", *item.record.texts)}
    problems = [
        Problem(f"{name} must be text that is not empty, not {value!r}", item.label())
        for name, value in stated.items()
        if value is not None and (not isinstance(value, str) or not value)
    ]
    record = records.record(item, id=id, units=SI, axes=ImageAxes(unit))
    kind = item.kind
    out = plain(record, {"kind", "id", *names_of(kind), *texts_of(kind), *rules_of(kind)})
    if problems:
        raise InputError(problems)
    # ``unit`` is that of the value; angles beside it are read in gon.
    angles = [n for n, quantity in numbers_of(kind).items() if quantity == "angle" and n in out]
    # Text keeps all digits, a number in gon would be rounded.
    out |= {n: numbers.write(getattr(item, n), "gon") for n in angles}
    if item.record.unit != "image":
        out["unit"] = "rad" if is_angle(item.kind) else "m"
    return out


def observation_of(
    fields: Mapping[str, object], *, context: RecordContext | None = None, source: str = ""
) -> AnyObservation:
    """Return the observation that a record describes.

    Args:
        fields: the record, as `json.loads` gives it.
        context: defaults of the project. Without a context, lengths are metres and angles gon
            where the record states no ``unit``, heights of instruments and targets are metres,
            and image coordinates have the unit that σ names. Records of `observation_fields`
            are read without a context.
        source: where the record stands, for messages and for the observation.

    Raises:
        InputError: all problems of the record, as `records.observation` lists them; for
            correlated observations also an empty or malformed list, and a covariance that is
            not square, symmetric, positive definite or of the size of their components.
    """
    fields = checked(fields, source)
    if fields.get("kind") == CORRELATED:
        return _correlated_of(fields, context, source)
    return _single_of(fields, context, source)


def _single_of(
    fields: Mapping[str, object], context: RecordContext | None, source: str
) -> Observation:
    if context is None and fields.get("kind") == "image":
        context = RecordContext(images={str(fields.get("photo")): _own_axes(fields)})
    return records.observation(fields, context=context, source=source)


def _own_axes(fields: Mapping[str, object]) -> ImageAxes:
    """Return image axes with the unit that the name of a record's σ states."""
    named = [f.rpartition("_")[2] for f in sigma_fields("image") if f in fields]
    return ImageAxes(named[0]) if named else ImageAxes()


def _correlated_of(
    fields: Mapping[str, object], context: RecordContext | None, source: str
) -> Correlated:
    problems: list[Problem] = []
    row = Row(fields, source, problems, CORRELATED)
    for name in row.fields:
        if name not in _CORRELATED_KEYS:
            row.wrong(
                f"unknown field {name!r}; known: {known(_CORRELATED_KEYS, meant=name, most=40)}"
            )
    covariance = _matrix(row)
    given = row.take("observations", required=True)
    if given is not None and not isinstance(given, list):
        row.wrong(f"observations must be a list of records, not {given!r}")
    members: list[Observation] = []
    begin = 0
    for number, entry in enumerate(given if isinstance(given, list) else (), start=1):
        where = ", ".join(part for part in (source, f"observation {number}") if part)
        try:
            record = checked(entry, where)
            kind = record.get("kind")
            if kind in (CORRELATED, "image"):
                raise InputError(Problem(f"{kind} cannot be in a correlated group", where))
            if covariance is not None:
                record = _with_sigma(record, np.diag(covariance)[begin:])
            members.append(replace(_single_of(record, context, where), source=source or None))  # type: ignore[call-arg]
            begin += _size(record)
        except InputError as error:
            problems.extend(error.problems)
            # The places of the following members in the covariance are unknown now.
            covariance = None
    if isinstance(given, list) and not given:
        row.wrong("observations must be one record or more")
    if problems or covariance is None:
        raise InputError(problems)
    try:
        return Correlated(tuple(members), covariance)
    except InputError as error:
        row.wrong_all(error)
        raise InputError(problems) from None


def _matrix(row: Row) -> Array | None:
    """Return the covariance; None, noted in the row, if it is not a square matrix of numbers."""
    given = row.take("covariance_si", required=True)
    if given is None:
        return None
    if not isinstance(given, list) or not all(
        isinstance(line, list) and len(line) == len(given) for line in given
    ):
        row.wrong("covariance_si must be a square matrix: a list of rows as long as itself")
        return None
    try:
        return np.array([[numbers.parse(v) for v in line] for line in given])
    except ValueError as error:
        row.wrong(f"covariance_si: {error}")
        return None


def _axes(record: Mapping[str, object]) -> tuple[str, ...]:
    """Return the components of a record, which is not checked yet."""
    kind = KINDS.get(str(record.get("kind")))
    if kind is not None and "axes" in kind.attributes:
        return tuple(str(record.get("axes") or "xyz").replace(" ", ""))
    return () if kind is None else kind.observation.components


def _size(record: Mapping[str, object]) -> int:
    return len(_axes(record))


def _with_sigma(record: Mapping[str, object], variances: Array) -> Mapping[str, object]:
    """Give a member without a standard deviation the variances of the group, as tables do."""
    kind, axes = str(record.get("kind")), _axes(record)
    if kind not in KINDS or any(record.get(f) is not None for f in sigma_fields(kind)):
        return record
    unit = "image" if is_in_image(kind) else "rad" if is_angle(kind) else "m"
    own = zip(axes, variances.tolist(), strict=False)
    stated = {f"sigma_{a}_{unit}" if a else f"sigma_{unit}": v**0.5 for a, v in own if v > 0}
    return {**record, **stated}
