"""Arcs in a network: photos of an orbit or of a strip on a trajectory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..entities import Parameter, Photo, sigmas
from ..errors import InputError, Problem, known
from ..frames import Frame
from ..models.arcs import GM, HIGHEST_POWER, SPIN, STATE, TERMS, arc_places
from ..models.base import DegenerateError
from ..models.unknown_registry import VariableKind, unknown_kind
from ..observations.arcs import PhotoOnArc
from ..types import Array
from .construction import problems_of_times

KIND = "arc"
"""Kind of unknowns of arcs."""
FIT_STEPS = 20
"""Largest number of steps by which an orbit is fitted to approximate positions."""


class Arcs:
    """Part of a network: trajectories, functions of time, on which photos are."""

    frame: Frame
    """Frame of the coordinates."""
    photos: dict[str, Photo]
    """Photos by name."""
    parameters: dict[VariableKind, dict[Any, Parameter]]
    """Unknowns by kind and name."""
    add: Any
    """Adds observations, see `Network.add`."""
    set_unknown: Any
    """States an unknown of any kind."""

    def add_arc(
        self,
        name: str,
        times: Mapping[str, float],
        *,
        sigma: float | Sequence[float],
        gm: float = 0.0,
        spin: float = 0.0,
        power: int = 1,
        values: Mapping[str, float] | None = None,
        sigma_components: Mapping[str, float] | None = None,
        fixed: Sequence[str] = ("gm", "spin"),
    ) -> list[str]:
        """Tie the photos of an orbit or a strip to a trajectory; return the ids of the ties.

        The trajectory, a function of time, is the orbit of two bodies with ``gm``, to which terms
        of powers of t from 2 to ``power`` are added; without ``gm`` it is a polynomial. Its place
        x, y, z and velocity x_t, y_t, z_t at t = 0 are free; see `factorgraph_adj.models.arcs`.

        Args:
            name: name of the arc.
            times: time of exposure of each photo, seconds, counted best from the middle.
            sigma: standard deviation of the photos from the curve, metres: one, or three along the
                axes of the camera.
            gm: gravitational parameter GM of the body, m³/s²: 4.9028e12 of the Moon, 3.986004418e14
                of the Earth; 0: a polynomial.
            spin: rate at which the axes of the network turn about z with the body, rad/s:
                2.6617e-6 of the Moon, 7.292115e-5 of the Earth; 0: they do not turn.
            power: highest power of t, 1 to 5.
            values: start or given values by component, SI; those that are not given follow from
                the positions of the photos.
            sigma_components: standard deviations of weighted components of the arc about their
                values, SI, such as those of x_tt, y_tt, z_tt (m/s²) about zero. Those of the photos
                from the arc are ``sigma``.
            fixed: components that are held.

        Raises:
            InputError: unknown photos, photos without a position where values are wanted, times
                that are not finite, a wrong power, or unknown components.
        """
        where = f"arc {name!r}"
        found = problems_of_times(times, self.photos, where)
        if power not in range(1, HIGHEST_POWER + 1):
            found.append(Problem(f"power must be 1 to {HIGHEST_POWER}, not {power!r}", where))
            power = 1
        if not gm >= 0.0:
            found.append(Problem(f"gm must not be negative, and it is {gm!r}", where))
        names = unknown_kind(KIND).names(TERMS + 3 * (power - 1))
        given = dict(values or {}) | {"gm": gm, "spin": spin}
        strange = [c for c in (*given, *(sigma_components or {}), *fixed) if c not in names]
        found += [
            Problem(f"unknown component {c!r}; valid: {known(names, most=30, meant=c)}", where)
            for c in dict.fromkeys(strange)
        ]
        wanted = [i for i, c in enumerate(names) if c not in given and (i < STATE or gm == 0.0)]
        centres = {f: p.position for f, p in self.photos.items() if p.position is not None}
        placed = {f: t for f, t in times.items() if f in centres}
        few = min(len(placed), 1 + power) if gm == 0.0 else 2
        if not found and wanted and len(placed) < few:
            what = (
                f"{len(placed)} of its photos have a position: give values of "
                f"{', '.join(names[i] for i in wanted)}, or positions of photos"
            )
            found.append(Problem(what, where))
        if found:
            raise InputError(found)
        start = np.array([given.get(c, 0.0) for c in names])
        if wanted:
            at = np.array([centres[f] for f in placed])
            start = _fitted(self.frame, start, wanted, at, np.array(list(placed.values())))
        held = [c for c in fixed if c not in (sigma_components or {})]
        self.set_unknown(KIND, name, start.tolist(), fixed=held, sigma=sigma_components or None)
        x, y, z = sigmas(sigma, 3, f"sigma of {where}")
        ties = [PhotoOnArc(f, name, time=float(t), sigma=(x, y, z)) for f, t in times.items()]
        return list(self.add(*ties))


def _fitted(frame: Frame, start: Array, wanted: Sequence[int], at: Array, time: Array) -> Array:
    """Return an arc (k,) whose wanted components fit positions (n, 3) at times (n,).

    An orbit begins at the straight line or parabola through the positions, in axes that do not
    turn. Where it does not fit, this start is returned: the adjustment has more observations.
    """
    best = start.copy()
    columns = [*range(STATE), *range(TERMS, TERMS + 3)] if len(time) > 2 else [*range(STATE)]
    guess = np.zeros(max(len(start), TERMS + 3))
    guess[SPIN] = start[SPIN]
    guess[columns] = _step(frame, guess, columns, at, time)
    own = [i for i in wanted if i < STATE or start[GM] == 0.0]
    best[own] = guess[own]
    misfit = np.inf
    for _ in range(FIT_STEPS):
        try:
            new = best.copy()
            new[own] += _step(frame, best, own, at, time)
            size = float(
                np.linalg.norm(arc_places(frame, np.tile(new, (len(time), 1)), time)[0] - at)
            )
        except DegenerateError:
            break
        if not size < misfit:
            break
        best, misfit = new, size
    return best


def _step(frame: Frame, arc: Array, columns: Sequence[int], at: Array, time: Array) -> Array:
    """Return the step of components of an arc towards positions, by least squares."""
    place, by = arc_places(frame, np.tile(arc, (len(time), 1)), time)
    a = by[:, :, columns].reshape(-1, len(columns))
    norm = np.linalg.norm(a, axis=0)
    norm = np.where(norm > 0.0, norm, 1.0)
    return np.asarray(np.linalg.lstsq(a / norm, (at - place).ravel(), rcond=None)[0] / norm)
