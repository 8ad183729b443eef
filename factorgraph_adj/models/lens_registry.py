"""The lens models by name; `register_lens` adds a new class."""

from __future__ import annotations

from ..errors import InputError, Problem
from .film_lens import FilmLens
from .grid_lens import GridLens
from .lens import (
    AffineLens,
    BalancedLens,
    BrownForwardLens,
    BrownLens,
    HarmonicLens,
    Lens,
    NormalisedLens,
)
from .normalised_lens import (
    AffineNormalisedLens,
    CentredBrownLens,
    FraserNormalisedLens,
    RationalLens,
)
from .orthogonal_lens import EbnerLens, GruenLens
from .place_lens import ParallelLens
from .ray_lens import DivisionLens, EquirectangularLens, FisheyeLens, FovLens, UnifiedLens
from .rpc_lens import RpcLens
from .scanner_lens import CylindricalLens, LineLens

LENSES: dict[str, type[Lens]] = {}
"""Registered lens models by name."""


def register_lens(lens: type[Lens]) -> type[Lens]:
    """Add a lens model; the function can be used as a decorator of the class.

    Args:
        lens: the class, a frozen dataclass derived from `factorgraph_adj.models.lens.Lens`.

    Returns:
        The class.

    Raises:
        InputError: the class is no lens model, has no name or that of another model, or defines
            ``residual`` instead of ``partials``.
    """
    name = getattr(lens, "kind", None)
    where = f"lens model {name!r}"
    if not (isinstance(lens, type) and issubclass(lens, Lens)):
        raise InputError(Problem("it must be a class derived from Lens", where))
    if not name or (name in LENSES and LENSES[name] is not lens):
        what = "a lens model of this name is registered already" if name else "it has no name"
        raise InputError(Problem(what, where))
    if lens is not Lens and name == Lens.kind:
        raise InputError(Problem("it needs a name of its own: the class attribute kind", where))
    if lens.residual is not Lens.residual:
        what = "it must define partials, or _correction: residual only packs what partials returns"
        raise InputError(Problem(what, where))
    LENSES[name] = lens
    return lens


for _lens in (
    Lens,
    HarmonicLens,
    BrownLens,
    CentredBrownLens,
    BrownForwardLens,
    NormalisedLens,
    AffineNormalisedLens,
    FraserNormalisedLens,
    BalancedLens,
    AffineLens,
    EbnerLens,
    GruenLens,
    RationalLens,
    FisheyeLens,
    FovLens,
    DivisionLens,
    UnifiedLens,
    EquirectangularLens,
    GridLens,
    ParallelLens,
    FilmLens,
    RpcLens,
    LineLens,
    CylindricalLens,
):
    register_lens(_lens)
