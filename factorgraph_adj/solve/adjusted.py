"""A network with adjusted values in place of the given ones."""

from __future__ import annotations

from dataclasses import replace

from ..graph.variables import State, Unknowns
from ..models.variables import parameter_kinds
from ..network.entities import parameter_name
from ..network.network import Network


def with_values(network: Network, unknowns: Unknowns, state: State) -> Network:
    """Return a network with the values of a state as given values; what is held stays held.

    A camera with a calibration for each photo keeps its given values: a network has one set of
    values for it.

    Args:
        network: the network; it is not changed.
        unknowns: its unknowns.
        state: values of all of them.
    """
    out = network.copy()
    points, poses = unknowns["point"].number, unknowns["pose"].number
    out.points = {
        n: replace(p, coordinates=tuple(state["point"][points[n]].tolist()))
        for n, p in network.points.items()
    }
    for name, photo in network.photos.items():
        stored = state["pose"][poses[name]]
        at = tuple(stored[9:].tolist())
        rotation = stored[:9].reshape(3, 3).copy()
        out.photos[name] = replace(photo, position=at, rotation=rotation)
    calibrations = unknowns["calibration"].number
    for name, camera in network.cameras.items():
        if name in calibrations and not camera.per_photo:
            values = unknowns.given(state, "calibration", calibrations[name])
            out.cameras[name] = replace(camera, values=tuple(values.tolist()))
    for kind in parameter_kinds():
        numbers = unknowns[kind.name].number
        for key, parameter in network.parameters.get(kind.name, {}).items():
            values = unknowns.shown(state, kind.name, numbers[parameter_name(key)])
            out.of_kind(kind.name)[key] = replace(parameter, values=tuple(values.tolist()))
    return out
