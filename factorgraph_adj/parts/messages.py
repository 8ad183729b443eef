"""What the root and the processes of the parts tell one another; all of it can be pickled."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..errors import Problem
from ..models.variables import VariableKind
from ..types import Array, Keys, Mask

LISTED = 20
"""Number of observations with the largest tests that a part reports, and a solution lists."""


@dataclass(frozen=True)
class At:
    """The point of the iteration that a task belongs to."""

    state: int
    """Number of the written state at which the observations are linearised."""
    weights: int = 0
    """Number of the written state whose lengths of sights give the standard deviations."""
    damping: float = 0.0
    """Share λ of the diagonal of N that is added to N."""


@dataclass(frozen=True)
class Surveyed:
    """What a part has: enough to find the unknowns that several parts have."""

    keys: Keys
    """A 64-bit number for each variable, from its kind and name, (k,)."""
    frame: str
    """The frame of its coordinates."""
    free_network: bool
    """Whether the part asks for the datum of a free network."""
    digest: str
    """A digest of names, observed values and weights: a changed part is noticed."""


@dataclass(frozen=True, order=True)
class Variable:
    """Kind and name of a variable."""

    kind: VariableKind
    """Kind."""
    name: str
    """Name."""


@dataclass(frozen=True)
class Shared:
    """A variable of a part that other parts have too."""

    variable: Variable
    """Kind and name."""
    components: tuple[str, ...]
    """Names of its components."""
    model: str
    """What its values belong to: the lens of a calibration, the calibration of a photo."""
    free: Mask
    """Whether each component is estimated, (k,)."""
    sigma: Array
    """Standard deviations of weighted components, infinite for others, (k,)."""
    given: Array
    """Given values in stored form, NaN where unknown."""
    stated: tuple[float, ...] = ()
    """Given values of the components, NaN where unknown, of a kind of which single rotations may be
    held: the stored rotation is not known before all three are."""


@dataclass(frozen=True)
class Setup:
    """What a part has to know about its junctions."""

    variables: tuple[Variable, ...]
    """The junctions of the part, in the order of the root."""
    start: tuple[Array, ...]
    """Start values of each junction in stored form, NaN where no part knows them yet."""
    foreign: tuple[bool, ...]
    """Whether the given value of a weighted junction counts as an observation in another part."""


@dataclass(frozen=True)
class Begun:
    """How a part has divided its unknowns."""

    start: tuple[Array, ...]
    """Start values of each junction, in stored form; NaN where the part does not know them."""
    missing: tuple[tuple[str, str], ...] = ()
    """Where and why approximate values are missing; the part has not begun."""
    n_rows: int = 0
    """Number of scalar observations."""
    n_unknowns: int = 0
    """Number of free components that no other part has."""
    positions: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """Where each junction stands, (k, 3) metres."""
    spread: Mask = field(default_factory=lambda: np.zeros(0, dtype=bool))
    """Whether each junction touches everything in the part, such as a calibration, (k,)."""


@dataclass(frozen=True)
class Reduced:
    """The normal equations of a part, reduced to its m free junction components."""

    normal: Array
    """Lower triangle of S, row by row, (m (m + 1) / 2,)."""
    right: Array
    """s, (m,)."""
    diagonal: Array
    """Diagonal of N before the elimination, (m,)."""
    vtpv: float
    """Value of vᵀPv of the part."""
    smallest: float
    """Smallest pivot of the interior, relative to its diagonal element of N; 0: singular."""
    rounding: float
    """δᵀ diag(N) δ of the part for the units δ in the last digits of its values."""


@dataclass(frozen=True)
class Moved:
    """A part after a step."""

    vtpv: float
    """Value of vᵀPv of the part; infinite where a step is impossible."""
    downhill: float
    """Share −gᵀdx of the part, g of its own observations."""
    damped: float
    """Share dxᵀλD dx of the part."""


@dataclass(frozen=True)
class Tested:
    """An observation with its test, for the list of the largest."""

    label: str
    """Readable name."""
    w: float
    """Test value."""
    redundancy: float
    """Redundancy number."""


@dataclass(frozen=True)
class Finished:
    """The quality of a part; its arrays are written to its folder."""

    redundancy: float
    """Sum of the redundancy numbers of its observations."""
    uncontrolled: int
    """Number of observations that no other controls."""
    largest: tuple[Tested, ...]
    """Observations with the largest |w|, the largest first."""
    memory: int
    """Largest memory of the process so far, bytes; 0 where the system does not tell."""


@dataclass(frozen=True)
class Refused:
    """An error in a part, which the root raises together with those of other parts."""

    kind: str
    """Name of the class of the error."""
    lines: tuple[tuple[str, str], ...]
    """Where and what, for each problem."""
    defect: int = 0
    """Number of missing conditions."""
    unknowns: tuple[tuple[str, str], ...] = ()
    """Kind and name of the undetermined unknowns."""


def in_part(name: str, where: str, what: str) -> Problem:
    """Return a problem of a part: its place begins with the name of the part."""
    return Problem(what, f"part {name!r}, {where}" if where else f"part {name!r}")


def packed(a: Array) -> Array:
    """Return the lower triangle of a symmetric matrix, row by row, (m (m + 1) / 2,)."""
    return np.ascontiguousarray(a[np.tril_indices(len(a))])


def unpacked(a: Array) -> Array:
    """Return the symmetric matrix of a lower triangle, row by row."""
    m = int((np.sqrt(8 * len(a) + 1) - 1) / 2)
    out = np.zeros((m, m))
    rows, columns = np.tril_indices(m)
    out[rows, columns] = out[columns, rows] = a
    return out
