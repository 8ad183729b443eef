"""What stands for the retired unknowns of an adjustment, and what says so where they are named."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from ..errors import Problem
from ..graph.dependence import Variable
from ..models.variables import UNKNOWNS, VariableKind
from ..network.entities import FREE_ORIENTATION, Key, Photo, Point, parameter_name
from ..network.network import Network
from ..observations import Observation
from ..solve.missed_step import NOTHING_MISSED, MissedStep
from ..solve.prior import Prior
from .retired_archive import Archive, LastEstimate

TAKES_BACK = "settle(all=True) takes everything back"


@dataclass(frozen=True, eq=False)
class Retired:
    """All that was retired."""

    prior: Prior
    """What its observations say of the unknowns that remain."""
    archive: Archive = field(default_factory=Archive)
    """Where it is kept."""
    number: int = 0
    """Number of retirements."""
    points: int = 0
    """Number of retired points."""
    photos: int = 0
    """Number of retired photos."""
    observations: int = 0
    """Number of observations that were in the graph."""
    found: tuple[tuple[VariableKind, Key], ...] = ()
    """Unknowns of the prior that nobody has to state, such as orientations."""
    missed: MissedStep = NOTHING_MISSED
    """What the linear rows miss."""

    def last_estimate(self, variable: Variable) -> LastEstimate | None:
        """Return what was known of an unknown when it was retired; none: it was not."""
        return self.archive.find(variable, self.number)

    def told(self, variable: Variable) -> str:
        """Say that an unknown was retired, and what to do; empty where it was not."""
        found = self.last_estimate(variable)
        return "" if found is None else f"was retired {found.moment}; {TAKES_BACK}"

    def of_id(self, ident: str) -> str:
        """Say that an observation was retired, and what to do; empty where it was not."""
        if moment := self.archive.moment_of(ident, self.number):
            return f"was retired {moment}; {TAKES_BACK}"
        at = ident.find("/")
        while at >= 0:
            both: tuple[Variable, ...] = ("pose", ident[:at]), ("point", ident[at + 1 :])
            for variable in both:
                if told := self.told(variable):
                    return f"{UNKNOWNS[variable[0]].noun} {variable[1]!r} {told}"
            at = ident.find("/", at + 1)
        return ""

    def named_by(self, o: Observation, network: Network) -> list[Problem]:
        """Return the problems that an observation names what was retired, or has its id.

        Args:
            o: the observation.
            network: what remains.
        """
        variables: list[Variable] = [("point", n) for n in o.points() if n not in network.points]
        variables += [("pose", name) for name in o.photos() if name not in network.photos]
        variables += [
            (kind, parameter_name(key))
            for kind, key in o.parameters()
            if UNKNOWNS[kind].absent == "found"
        ]
        out = []
        for variable in dict.fromkeys(variables):
            if told := self.told(variable):
                what = f"{UNKNOWNS[variable[0]].noun} {variable[1]!r} {told}"
                out.append(Problem(f"{what}, and then this observation can be added", o.label()))
        ident = getattr(o, "id", None)
        if not out and ident is not None and (moment := self.archive.moment_of(ident, self.number)):
            what = f"duplicate id {ident!r}: the observation with it was retired {moment}"
            out.append(Problem(f"{what}; give the new one another id", o.label()))
        return out

    def named_again(self, points: Iterable[Point], photos: Iterable[Photo]) -> list[Problem]:
        """Return the problems that new points or photos have names of retired ones."""
        new: list[Variable] = [("point", p.name) for p in points]
        new += [("pose", f.name) for f in photos]
        return [
            Problem(
                f"one of this name {told}; or give the new one another name", f"{noun} {name!r}"
            )
            for kind, name in new
            for noun in (UNKNOWNS[kind].noun,)
            if (told := self.told((kind, name)))
        ]

    def state_found(self, network: Network) -> None:
        """State the unknowns of the prior that nobody has to state."""
        for kind, key in self.found:
            network.of_kind(kind).setdefault(key, FREE_ORIENTATION)

    def __str__(self) -> str:
        """Say what was retired."""
        return (
            f"{self.observations} observations with {self.points} points and {self.photos} photos "
            "are retired"
        )
