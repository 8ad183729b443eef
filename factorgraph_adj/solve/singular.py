"""The error of a factorisation whose pivot vanished."""

from __future__ import annotations

from ..errors import AdjustmentError


class SingularError(AdjustmentError):
    """A pivot of the elimination is zero; the caller determines the unknowns concerned."""
