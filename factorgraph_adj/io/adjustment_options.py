"""Options of the adjustment that a project states in ``[adjust]``, and their reader."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal, TypeAlias, cast

from .csv_tables import FieldRow

VarianceChoice: TypeAlias = Literal["a-priori", "a-posteriori"]
"""Whether standard deviations are scaled by 1 or by σ̂0."""


@dataclass(frozen=True)
class AdjustOptions:
    """Options of the adjustment that the project states."""

    variance: VarianceChoice = "a-priori"
    """Variance of unit weight that scales standard deviations."""
    max_iterations: int = 100
    """Largest number of iterations of the adjustment."""

    @property
    def remark(self) -> str:
        """What a network that leaves its project says of the options that stay behind."""
        usual = AdjustOptions()
        stated = ", ".join(
            f"{f.name}={value!r}"
            for f in fields(self)
            if (value := getattr(self, f.name)) != getattr(usual, f.name)
        )
        return (
            f"The project states {stated} in [adjust]. This holds for the command alone: in "
            "Python these are arguments of the functions."
        )


def adjust_options(row: FieldRow) -> AdjustOptions:
    """Read the section of a project; a value that is wrong is a problem of the row."""
    variance = row.choice("variance", ("a-priori", "a-posteriori"), "a-priori")
    most = row.take("max_iterations")
    if most is not None and (not isinstance(most, int) or isinstance(most, bool) or most < 1):
        row.wrong(f"max_iterations must be a whole number from 1, not {most!r}")
        most = None
    return AdjustOptions(cast(VarianceChoice, variance), 100 if most is None else most)
