"""Frames that are not level in a network with left-handed axes."""

from __future__ import annotations

from collections.abc import Iterator

from ...errors import known
from ...network.network import Network
from ...observations import KINDS, Observation
from .finding import Finding


def left_handed(network: Network) -> Iterator[Finding]:
    """Tell of frames with places that no rotation leads to, as the network is left-handed.

    The axes of a level frame are those of the horizon, east, north, up, whatever the axes of the
    network; those of any other frame are turned from the axes of the network.
    """
    if not network.frame.left_handed:
        return
    seen = {f for o in network.observations.values() if _places(o) for f in o.frames()}
    names = [n for n, frame in network.frames.items() if n in seen and not frame.constants[-1]]
    if names:
        yield Finding(
            f"the axes of the network are left-handed, and frames are not level: {known(names)}; "
            "no rotation leads from one to the other",
            "choose axes en, nw, ws or se of the network, or state that the frames are level",
        )


def _places(o: Observation) -> bool:
    """Return whether an observation tells of a place in a frame of its own."""
    record = KINDS.get(o.kind)
    return record is not None and record.tells != "nothing"
