"""Members of rigs: photos that sit on a carrier by a mount."""

from __future__ import annotations

from collections.abc import Container, Mapping

from ..errors import InputError, Problem, known
from ..observations.relative import RelativePosition, RelativeRotation

RIGID = (1e-8, 1e-6)
"""Play of a rigid mount, radians and metres: beside a projection centre with σ = 1 mm it changes
nothing by more than (play/σ)² = 10⁻⁶ of σ. Ten times less costs digits that large blocks need."""


def member_of_rig(
    photo: str,
    carrier: str,
    mount: str,
    *,
    play: tuple[float, float] = RIGID,
    photos: Mapping[str, object],
    mounts: Mapping[str, object],
    observations: Container[str] = (),
    source: str | None = None,
) -> tuple[RelativeRotation, RelativePosition]:
    """Return the relative pose, of value zero, that puts a photo on its carrier.

    Args:
        photo: the member.
        carrier: the photo that carries it, or is its reference.
        mount: the mount of the member.
        play: standard deviations of its rotation, radians, and position, metres.
        photos: photos that may be carriers, by name.
        mounts: mounts, by name.
        observations: ids that are taken.
        source: file and line that put the photo there.

    Raises:
        InputError: everything that is wrong.
    """
    where, problems = f"photo {photo!r}", []
    if carrier == photo:
        problems.append(Problem("a photo cannot be its own carrier", where))
    elif carrier not in photos:
        there = known(photos, meant=carrier)
        problems.append(Problem(f"unknown carrier {carrier!r}; photos: {there}", where))
    if mount not in mounts:
        there = known(mounts, meant=mount)
        if not mounts:
            there += "; rows of mounts.csv state them, or set_mount"
        problems.append(Problem(f"unknown mount {mount!r}; known: {there}", where))
    if len(play) != 2 or not all(0 < s < float("inf") for s in play):
        what = f"play must be two standard deviations > 0, radians and metres, not {play}"
        problems.append(Problem(what, where))
    ids = [f"{photo} on {carrier} {part}" for part in ("rotation", "position")]
    problems += [Problem(f"duplicate id {i!r}", where) for i in ids if i in observations]
    if problems:
        raise InputError(problems)
    zero = (0.0, 0.0, 0.0)
    turn, shift = play
    rotation, position = ids
    return (
        RelativeRotation(
            carrier, photo, zero, sigma=(turn,) * 3, mount=mount, id=rotation, source=source
        ),
        RelativePosition(
            carrier, photo, zero, sigma=(shift,) * 3, mount=mount, id=position, source=source
        ),
    )
