"""Observed heights above surfaces of pressure and of water; formulas: `models.positions`."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, field
from typing import ClassVar

from .base import Observation


@dataclass(frozen=True)
class ProfileHeight(Observation):
    """Reading of a height in a profile: z = (1 + s) (h − a − b t − c t²), metres.

    Of a photo it is what its statoscope or barometer read; of a point what a barometer read there,
    or the ground height of an airborne profile recorder. h is the height of the point, or of the
    instrument at X₀ + R a; the profile, see `Network.set_profile`, has a, b, c and s. A profile
    that is not named means h itself. Pressures become readings by
    `factorgraph_adj.atmosphere.pressure_height`.
    """

    kind: ClassVar[str] = "profile_height"
    point: str | None
    """The point; None if ``photo`` is given."""
    value: float
    """The reading, metres, positive upwards."""
    _: KW_ONLY
    photo: str | None = None
    """The photo at whose exposure the instrument was read; None if ``point`` is given."""
    sigma: float
    """Standard deviation, metres."""
    profile: str | None = None
    """The profile; None: the readings are heights."""
    time: float = field(default=0.0, metadata={"quantity": "number"})
    """Place t along the profile: kilometres from its middle, or a time; the profile's slope counts
    by this unit."""
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Vector a from the projection centre to the instrument, metres, in photogrammetric axes of
    the camera: x right, y up, z backwards. The arm of ``mount`` is added."""
    mount: str | None = None
    """Mount with an unknown arm; None: ``lever_arm`` alone."""

    def _check(self) -> None:
        super()._check()
        if (self.point is None) == (self.photo is None):
            self._fail("give either a point or a photo")
        if self.photo is None and (any(self.lever_arm) or self.mount is not None):
            self._fail("a point has neither lever_arm nor mount; give the photo of an instrument")


@dataclass(frozen=True)
class LevelHeight(Observation):
    """Height of a point above a level surface, metres: h − (w + slope · along + geoid).

    It is 0 for points on the shore line of a lake, whose height w is the unknown that ``level``
    names, see `Network.set_level`. h is the height in the frame of the network, above the ellipsoid
    in geocentric and topocentric frames; water follows the geoid, so that ``geoid`` then has the
    geoid undulation at the point less that at the place to which w belongs.
    """

    kind: ClassVar[str] = "level_height"
    point: str
    """The point."""
    level: str
    """The level surface."""
    value: float = 0.0
    """Height above the surface, metres: 0 on the shore line."""
    _: KW_ONLY
    sigma: float
    """Standard deviation, metres, with that of the identification of the shore line."""
    slope: float = field(default=0.0, metadata={"quantity": "number"})
    """Known rise of the surface in the direction of ``along``, metres per metre: of a river."""
    along: float = 0.0
    """Distance from the place to which w belongs, metres."""
    geoid: float = 0.0
    """Geoid undulation at the point less that at the place to which w belongs, metres."""

    def _check(self) -> None:
        super()._check()
        if not self.level:
            self._fail("level must name a level surface")
