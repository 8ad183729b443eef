"""Coordinates of a model: photos that no control and no position places in a reference system."""

from __future__ import annotations

from ...crs.reference_system import ReferenceSystem
from ...errors import InputError, Problem
from ...frames import LocalFrame
from ...observations.registry import DISTANCE_QUANTITIES, SIGHT_QUANTITIES
from ..network import Network

LEVELLED_SIGHTS = SIGHT_QUANTITIES - DISTANCE_QUANTITIES
"""Quantities of instruments on tripods, whose points have approximate coordinates from a map."""


def has_model_coordinates(network: Network) -> bool:
    """Return whether photos are in a local frame of which nothing says where it is.

    Structure from motion has its model anywhere, turned anyhow and of any scale. Coordinates of a
    reference system come from points or photos that are held, weighted or observed, and attitudes
    count from its axes. Networks with readings of total stations, levels or GNSS vectors are not
    asked: approximate coordinates of free ones come from a map, where a model's come from nowhere.
    """
    return (
        network.images.size > 0
        and isinstance(network.frame, LocalFrame)
        and not any(any(p.fixed) or p.sigma is not None for p in network.points.values())
        and not any(any(p.fixed) or p.sigma_position for p in network.photos.values())
        and all(
            o.record.fixes == "nothing" and o.record.quantity not in LEVELLED_SIGHTS
            for o in network.observations.values()
        )
    )


def refuse_model_coordinates(network: Network, system: ReferenceSystem) -> None:
    """Refuse to take coordinates of a model for those of a reference system.

    Raises:
        InputError: `has_model_coordinates`.
    """
    if has_model_coordinates(network):
        raise InputError(
            Problem(
                f"the {len(network.photos)} photos are a free model, whose coordinates are not "
                f"those of {system.name}: no point and no photo has held, weighted or observed "
                "coordinates; give ground control or positions of photos, such as --set "
                "gcp=gcp_list.txt or --set positions=geo.txt where the format has these options, "
                "control in a project or to join, ControlPoint or PhotoPosition in Python; or "
                "leave the reference system out",
                network.name,
            )
        )
