"""GNSS vectors of a network in a reference frame of their own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from ..errors import InputError, Problem, known
from ..observations import FrameVector, GnssVector
from .network import Network


def vectors_in_own_datum(
    network: Network,
    name: str = "GNSS",
    *,
    free: Iterable[str] = ("rotation", "scale"),
    sigma: Mapping[str, float] | None = None,
    values: Mapping[str, float] | None = None,
    ids: Iterable[str] | None = None,
) -> Network:
    """Return the network with GNSS vectors in a frame whose rotation and scale are unknown.

    Each `GnssVector` becomes a `FrameVector` of the same id, covariance and source, along the same
    axes; X_j − X_i = e^ℓ R d, with the rotation vector of R about the axes of the network, which in
    geocentric networks are geocentric. Vectors of several systems get a frame each: call it for
    each of them.

    Args:
        network: the network, in a geocentric or topocentric frame, or a local one.
        name: name of the new frame.
        free: components that are unknown: ``rotation``, ``scale``, or some of rx, ry, rz, ln_scale.
        sigma: standard deviations of weighted components, radians; ln_scale is a ratio.
        values: values of components; those that are not stated are 0.
        ids: ids of the vectors; None: all GNSS vectors.

    Raises:
        InputError: there is no such vector, one has heights of antennas, or the frame is there.
    """
    every = {i: o for i, o in network.observations.items() if isinstance(o, GnssVector)}
    wanted = list(every) if ids is None else list(ids)
    problems = [
        Problem(f"there is no GNSS vector {i!r}; known: {known(every)}")
        for i in wanted
        if i not in every
    ]
    problems += [
        Problem("has heights of antennas: reduce it to the marks", every[i].label())
        for i in wanted
        if i in every and (every[i].instrument_height or every[i].target_height)
    ]
    if not wanted:
        problems.append(Problem("has no GNSS vectors", network.name))
    if problems:
        raise InputError(problems)
    out = network.copy()
    out.add_frame(name, free=free, values={**ZERO, **(values or {})}, sigma=sigma)
    for i in wanted:
        o = every[i]
        out.observations[i] = FrameVector(
            name,
            o.station,
            o.target,
            o.value,
            sigma=o.sigma,
            covariance=o.covariance,
            id=o.id,
            source=o.source,
        )
    return out


ZERO = {"rx": 0.0, "ry": 0.0, "rz": 0.0}
"""Start of rotations between reference frames, radians: they are seconds of arc."""
