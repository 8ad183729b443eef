"""What writers of network files share: problems of a network, and where they are."""

from __future__ import annotations

from collections.abc import Iterable

from ..errors import InputError, Problem
from ..network.network import Network
from ..observations import Observation
from ..stochastic import StandardDeviation


class Refused:
    """Collects what a format cannot express."""

    def __init__(self, format: str) -> None:
        """Start without problems.

        Args:
            format: name of the format, for messages.
        """
        self.format = format
        self.problems: list[Problem] = []

    def add(self, what: str, where: str = "") -> None:
        """Note a problem."""
        self.problems.append(Problem(what, where))

    def raise_all(self) -> None:
        """Raise InputError with all problems, if there are any."""
        if self.problems:
            raise InputError(self.problems)

    def parts(self, network: Network, *, unknowns: Iterable[str] = ("orientation",)) -> None:
        """Refuse photos, cameras, a free datum, and unknowns other than those of some kinds."""
        for what, found in (
            ("photos", network.photos),
            ("cameras", network.cameras),
            ("image points", network.n_image_points),
        ):
            if found:
                self.add(f"{self.format} has no {what}")
        if network.datum == "free":
            self.add(f"{self.format} has no free datum: hold points, or write a solution")
        for kind, given in network.parameters.items():
            if given and kind not in unknowns:
                names = ", ".join(str(n) for n in list(given)[:3])
                self.add(f"{self.format} has no unknowns of the kind {kind}: {names}")

    def sigma(self, o: Observation) -> float:
        """Return the standard deviation of an observation as one number; refuse others."""
        given = getattr(o, "sigma", None)
        if isinstance(given, StandardDeviation):
            alone = StandardDeviation(given.constant or 1.0, combine=given.combine)
            if given != alone:
                self.add(f"{self.format} has standard deviations of one part only", o.label())
            return given.constant
        return float(given) if given is not None else float("nan")

    def nothing_of(self, o: Observation, *attributes: str) -> None:
        """Refuse an observation that has a value other than none, zero or 1 in an attribute."""
        for name in attributes:
            value = getattr(o, name, None)
            if value not in (None, 0.0, 1, ""):
                self.add(f"{self.format} has no {name} ({value})", o.label())
