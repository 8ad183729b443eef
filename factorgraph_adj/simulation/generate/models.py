"""Independent models in the place of the photos of earlier parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ...triangulation.models import as_models, photos_of_strips
from ..parameters import number
from ..simulate import measure
from .part import Part, Scene


@dataclass(frozen=True)
class IndependentModels(Part):
    """Models of the photos of all earlier parts, with the covariance of their orientations.

    Relative orientations of the true images give coordinates and covariance of each model; rays
    leave the network. Readings then have the errors that measured images would have given. Points
    that no model has are left out.
    """

    kind = "models"
    photos: int = number(2, least=2, most=8)
    """Photos in a model that follow one another in a strip: pairs, triplets …"""
    shared: int = number(1, least=0)
    """Photos that models which follow one another share, fewer than ``photos``."""
    centres: bool = True
    """Whether projection centres are coordinates of the models."""
    joint: bool = False
    """Whether models that share photos have one covariance."""

    def add_to(self, scene: Scene) -> None:
        """Replace the photos by models."""
        scene.points.append([])
        if self.shared >= self.photos:
            scene.fail("shared", f"is {self.shared}; valid: fewer than photos, {self.photos}")
        true = measure(scene.plan, seed=0, noise=False)
        units = [u for strip in photos_of_strips(true) for u in self._units(strip)]
        block = as_models(true, units, centres=self.centres, joint=self.joint)
        vars(scene.plan).update(vars(block.network))
        scene.points = [[p for p in names if p in scene.plan.points] for names in scene.points]
        scene.strips = {
            part: [[p for p in strip if p in scene.plan.photos] for strip in strips]
            for part, strips in scene.strips.items()
        }

    def _units(self, strip: Sequence[str]) -> list[tuple[str, ...]]:
        step = self.photos - self.shared
        starts = range(0, len(strip) - self.photos + 1, step)
        return [tuple(strip[i : i + self.photos]) for i in starts]
