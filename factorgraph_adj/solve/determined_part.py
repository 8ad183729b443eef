"""The part of a network that its observations determine, and what is left out of it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

from ..errors import ApproximationError, DatumError, InputError, UnknownLeftOut
from ..models.variables import UNKNOWNS
from ..network.entities import parameter_name
from ..network.network import Network
from ..network.selection import without

UNDETERMINED = "its observations do not determine it"
"""Why an unknown in the null space is left out."""
APART = "it belongs to a part without datum"
"""Why an unknown of another part is left out."""
NOT_REACHED = "no approximate value leads to it"
"""Why an unknown without a value is left out."""
NOT_OBSERVED = "it has no observation"
"""Why an unknown that nothing observes is left out."""
OPTION = (
    "adjust --leave-out-undetermined, or fga.adjust(network, leave_out_undetermined=True), leaves "
    "it out with its observations, and names what was left out"
)
"""What a user can do where a part of the network is determined."""

_Named = tuple[str, str]
"""Kind and name of an unknown."""


Adjusted = TypeVar("Adjusted")


def largest_determined(
    network: Network, attempt: Callable[[Network], Adjusted]
) -> tuple[Network, Adjusted]:
    """Return the network without what an attempt to adjust it calls undetermined, adjusted.

    What is left out takes its observations along, so that others may lose theirs: the attempt is
    repeated until it succeeds. Coefficients that serve many observations (calibrations, refraction,
    constants of instruments) are never left out: they are to be held, or weighted.

    Args:
        network: the network; it stays unchanged, and is returned itself if it is determined.
        attempt: adjusts a network, or raises the errors of `adjust`.

    Raises:
        ApproximationError, DatumError: nothing that can be left out makes the rest determined; the
            error is that of the whole network.
    """
    rest: Network | None = network
    first: ApproximationError | DatumError | None = None
    while rest is not None:
        try:
            return rest, attempt(rest)
        except InputError:  # such as: nothing is left to adjust
            if first is None:
                raise
            break
        except (ApproximationError, DatumError) as error:
            first = first or error
            rest = _without(rest, _unknowns(error))
    assert first is not None
    raise first


def with_option(error: ApproximationError | DatumError) -> ApproximationError | DatumError:
    """Return an error that says, if something can be left out, which option does so."""
    if _concerned(_unknowns(error)):
        error.args = (f"{error}\n  {OPTION}",)
    return error


def _unknowns(error: ApproximationError | DatumError) -> dict[_Named, str]:
    """Return the unknowns that an error names, with the reason."""
    if isinstance(error, ApproximationError):
        return dict.fromkeys(error.unknowns, NOT_REACHED)
    return dict.fromkeys(error.apart, APART) | dict.fromkeys(error.unknowns, UNDETERMINED)


def _concerned(unknowns: Iterable[_Named]) -> Sequence[_Named]:
    """Return what can be left out: points and photos, otherwise sets and frames.

    Sets of directions and frames lose their observations with their points. Where a coefficient is
    open too, it may be what leaves the points open, and nothing is left out.
    """
    every = list(unknowns)
    if any(UNKNOWNS[kind].additional or UNKNOWNS[kind].on_earth for kind, _ in every):
        return []
    return [u for u in every if u[0] in ("point", "pose")] or every


def _without(network: Network, unknowns: dict[_Named, str]) -> Network | None:
    """Return the network without some unknowns; None if none of them can be left out."""
    concerned = _concerned(unknowns)
    ids = _observations(network, concerned)
    points = [name for kind, name in concerned if kind == "point"]
    photos = [name for kind, name in concerned if kind == "pose"]
    gone = {i for own in ids.values() for i in own if i in network.observations}
    if not gone and not points and not photos:
        return None
    out = without(network, gone, points=points, photos=photos)
    before = {i for left in network.unknowns_left_out for i in left.ids}
    for u in concerned:
        # What has lost its observations with another unknown is reached by nothing; what never had
        # any is not observed.
        why = unknowns[u] if ids[u] or before else NOT_OBSERVED
        out.unknowns_left_out.append(UnknownLeftOut(*u, why, tuple(ids[u])))
    return out


def _observations(network: Network, concerned: Sequence[_Named]) -> dict[_Named, list[str]]:
    """Return the ids of the observations of each unknown; image points by photo/point."""
    wanted = set(concerned)
    found: dict[_Named, list[str]] = defaultdict(list)
    for i, o in network.observations.items():
        named = {
            *(("point", name) for name in o.points()),
            *(("pose", name) for name in o.photos()),
            *((kind, parameter_name(key)) for kind, key in o.parameters()),
        }
        for u in wanted & named:
            found[u].append(i)
    photo, point, *_ = network.images.columns()
    photos, points = list(network.photos), list(network.points)
    for f, p in zip(photo.tolist(), point.tolist(), strict=True):
        for u in wanted & {("pose", photos[f]), ("point", points[p])}:
            found[u].append(f"{photos[f]}/{points[p]}")
    return found
