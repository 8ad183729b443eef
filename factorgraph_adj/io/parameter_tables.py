"""Tables of parameters, derived from the record of each kind: columns, reading, writing of rows.

The tables follow from the record of the kind (`factorgraph_adj.models.unknown_registry`): ``keys``
name the unknown; each component has a column for its value and a column for its standard
deviation; ``fixed`` or ``free`` names the held or the free components. The name of a column ends
in its unit, such as ``zero_mm``; a column without a unit is in the unit of the project.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from ..entities import FREE_ORIENTATION, Key, Parameter
from ..errors import InputError
from ..models.unknown_registry import Component, UnknownKind, UnknownTable
from ..network.network import Network
from ..units import ANGLE, LENGTH, decimal_angle
from . import numbers
from .csv_tables import FieldRow
from .numbers import Units
from .source import FALSE_WORDS, TRUE_WORDS


def parameter_table(kind: UnknownKind) -> UnknownTable:
    """Return the table of a kind of parameters."""
    assert kind.table is not None
    return kind.table


def _units(component: Component) -> tuple[str, ...]:
    """Return the endings of the columns of a component: its units, or an empty text."""
    if component.quantity == "length":
        return tuple(LENGTH)
    if component.quantity == "angle":
        return tuple(ANGLE)
    return ("ppm",) if component.quantity == "ppm" else ("",)


def _column(component: Component) -> str:
    return component.column or component.name


def _sigma_column(kind: UnknownKind, component: Component) -> str:
    """Return the column of a standard deviation without its unit."""
    return "sigma" if kind.size == 1 else f"sigma_{_column(component)}"


def _shares_sigma(kind: UnknownKind) -> bool:
    """Return whether one column ``sigma`` may state the σ of all components."""
    return kind.size > 1 and len({c.quantity for c in kind.components}) == 1


def _join(name: str, unit: str) -> str:
    return f"{name}_{unit}" if unit else name


def parameter_columns(kind: UnknownKind) -> tuple[str, ...]:
    """Return the columns of the table of a kind, in the order in which they are written."""
    table = parameter_table(kind)
    out = [*table.keys]
    for c in kind.components:
        out += [_column(c)] if c.plain else [_join(_column(c), u) for u in _units(c)]
    if _shares_sigma(kind):
        out += [_join("sigma", u) for u in _units(kind.components[0])]
    for c in kind.components:
        out += [_join(_sigma_column(kind, c), u) for u in _units(c)]
    if kind.constants:
        out += ["origin", *kind.constants]
    return (*out, "free" if table.held_unless_free else "fixed")


# -- reading --------------------------------------------------------------------------------------


def read_parameter(
    row: FieldRow, kind: UnknownKind, key: Key, network: Network, units: Units
) -> None:
    """Put the unknown of a row into the network; problems are noted in the row."""
    given = [_value(row, c, units) for c in kind.components]
    components = kind.components[: _size(row, kind, given)]
    values = [c.start if v is None else v for c, v in zip(components, given, strict=False)]
    sigma = _sigmas(row, kind, components)
    names = [c.name for c in components]
    if kind.constants:
        _read_frame(row, str(key), dict(zip(names, given, strict=True)), sigma, network, units)
        return
    if parameter_table(kind).held_unless_free:
        free = _words(row, "free", names)
        fixed = [n for n in names if n not in free and math.isinf(sigma[n])]
    else:
        fixed = _held(row, names)
    if row.failed:
        return
    unknown = [n for n, v in zip(names, values, strict=True) if math.isnan(v)]
    if any(n in fixed or math.isfinite(sigma[n]) for n in unknown):
        column = _column(components[names.index(unknown[0])])
        row.wrong(f"{column} is missing: a held or weighted {kind.name} needs one")
        return
    every = len(fixed) == len(names)
    given_sigma = sigma if any(math.isfinite(s) for s in sigma.values()) else None
    try:
        network.set_unknown(
            kind.name,
            key,
            np.nan_to_num(values).tolist(),
            fixed=True if every else fixed,
            sigma=given_sigma,
        )
    except InputError as error:
        row.wrong_all(error)
        return
    if unknown:
        network.of_kind(kind.name)[key] = FREE_ORIENTATION


def _read_frame(
    row: FieldRow,
    name: str,
    given: Mapping[str, float | None],
    sigma: Mapping[str, float],
    network: Network,
    units: Units,
) -> None:
    """Put the frame of a row into the network; problems are noted in the row."""
    free = row.text("free", default="") or ""
    point = row.text("origin", default="") or ""
    at = [row.number(f"origin_{a}", units.length) for a in "xyz"]
    if point and any(v is not None for v in at):
        row.wrong("give either the point origin or origin_x, origin_y, origin_z, not both")
    if any(v is not None for v in at) and None in at:
        row.wrong("origin_x, origin_y and origin_z are given together, or none of them")
    level = row.flag("level")
    if not row.failed:
        try:
            network.add_frame(
                name,
                free=free,
                values={n: v for n, v in given.items() if v is not None},
                sigma={n: s for n, s in sigma.items() if math.isfinite(s)},
                origin=point or [v or 0.0 for v in at],
                level=level,
            )
        except InputError as error:
            row.wrong_all(error)
    if name not in network.frames:
        # A stand-in, so that other rows can refer to the frame, and it to its point.
        network.add_frame(name, origin=point if point in network.points else (0.0, 0.0, 0.0))


def _value(row: FieldRow, component: Component, units: Units) -> float | None:
    name = _column(component)
    if component.plain:
        return row.number(name, units.angle if component.quantity == "angle" else units.length)
    if component.quantity in ("length", "angle"):
        return row.quantity(name, _units(component))
    return row.number(_join(name, _units(component)[0]), _units(component)[0])


def _size(row: FieldRow, kind: UnknownKind, given: list[float | None]) -> int:
    """Return the number of components that a row states; some kinds may omit the last ones."""
    if not kind.variable_size:
        return kind.size
    size = max((i + 1 for i, v in enumerate(given) if v is not None), default=0)
    least = 0 if kind.default is None else kind.usual  # these have defaults
    if size == 0 and least == 0:
        row.wrong(f"{_column(kind.components[0])} is missing")
    size = max(size, least)
    missing = [_column(kind.components[i]) for i in range(least, size) if given[i] is None]
    if missing:
        row.wrong(f"{missing[0]} is missing: components are given without a gap")
    return size or kind.size


def _sigmas(
    row: FieldRow, kind: UnknownKind, components: tuple[Component, ...]
) -> dict[str, float]:
    """Return the standard deviations of the components; infinite where none is given."""
    for_all = None
    if _shares_sigma(kind):
        for_all = row.quantity("sigma", _units(kind.components[0]), positive=True)
    out = {}
    for c in components:
        name = _sigma_column(kind, c)
        if c.quantity in ("length", "angle"):
            found = row.quantity(name, _units(c), positive=True)
        else:
            found = row.number(_join(name, _units(c)[0]), _units(c)[0], positive=True)
        shared = np.inf if for_all is None else for_all
        out[c.name] = shared if found is None else found
    return out


def _words(row: FieldRow, column: str, names: list[str]) -> list[str]:
    """Return the components that a column names."""
    words = (row.text(column, default="") or "").split()
    wrong = [w for w in words if w not in names]
    if wrong:
        row.wrong(f"{column} must be some of {', '.join(names)}, not {wrong[0]!r}")
    return words


def _held(row: FieldRow, names: list[str]) -> list[str]:
    """Return the held components: all, none, or the named ones."""
    text = str(row.fields.get("fixed") or "").lower()
    if len(names) == 1 or text in (*TRUE_WORDS, *FALSE_WORDS) or not set(text.split()) & set(names):
        return names if row.flag("fixed") else []
    return _words(row, "fixed", names)


# -- writing --------------------------------------------------------------------------------------


def parameter_records(
    network: Network, kind: UnknownKind, units: Units
) -> Iterator[dict[str, str]]:
    """Iterate over the rows of the table of a kind."""
    table = parameter_table(kind)
    for key, p in network.of_kind(kind.name).items():
        keys = (key,) if isinstance(key, str) else key
        out = dict(zip(table.keys, keys, strict=True))
        for c, value in zip(kind.components, p.values, strict=False):
            if not math.isnan(value):
                unit = _unit_of_value(c, units)
                out[_column(c) if c.plain else _join(_column(c), unit)] = numbers.write_quantity(
                    value, unit
                )
        if kind.constants:
            out |= _frame_record(p, units)
        yield out | _sigma_record(kind, p, units) | _held_record(kind, p)


def _frame_record(p: Parameter, units: Units) -> dict[str, str]:
    """Return the constants of a frame."""
    *origin, level = p.constants
    out = {"origin": p.origin} if p.origin else {}
    if any(origin):
        out |= {
            f"origin_{a}": numbers.write_quantity(v, units.length)
            for a, v in zip("xyz", origin, strict=True)
        }
    return out | ({"level": "yes"} if level else {})


def _unit_of_value(component: Component, units: Units) -> str:
    """Return the unit in which the value of a component is written."""
    if component.plain and component.quantity == "angle":
        return units.angle
    if component.whole and component.quantity == "angle":
        return decimal_angle(units.angle)
    if component.whole and component.quantity == "length":
        return units.length
    return _unit(component, units)


def _unit(component: Component, units: Units) -> str:
    """Return the unit in which the standard deviation of a component is written."""
    small = {"length": units.sigma_length, "angle": units.sigma_angle, "ppm": "ppm"}
    return small.get(component.quantity, "")


def _sigma_record(kind: UnknownKind, p: Parameter, units: Units) -> dict[str, str]:
    first = _unit(kind.components[0], units)
    if _shares_sigma(kind) and len(set(p.sigma)) == 1 and math.isfinite(p.sigma[0]):
        return {_join("sigma", first): numbers.write_quantity(p.sigma[0], first)}
    out = {}
    for c, s in zip(kind.components, p.sigma, strict=False):
        if math.isfinite(s):
            name = _join(_sigma_column(kind, c), _unit(c, units))
            out[name] = numbers.write_quantity(s, _unit(c, units))
    return out


def _held_record(kind: UnknownKind, p: Parameter) -> dict[str, str]:
    names = kind.names(len(p.values))
    if parameter_table(kind).held_unless_free:
        parts = zip(names, p.fixed, p.sigma, strict=True)
        return {"free": " ".join(n for n, held, s in parts if not held and not math.isfinite(s))}
    if all(p.fixed):
        return {"fixed": "yes"}
    return {"fixed": " ".join(n for n, held in zip(names, p.fixed, strict=True) if held)}
