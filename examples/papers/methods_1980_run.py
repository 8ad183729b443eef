"""Ayeni's methods on one block: a function for each feasible one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.collocation.image_corrections import image_corrections
from factorgraph_adj.collocation.point_corrections import point_corrections
from factorgraph_adj.collocation.signal_variables import with_image_signals
from factorgraph_adj.errors import InputError
from factorgraph_adj.models.deformation import DISPLACEMENTS
from factorgraph_adj.models.lens import BrownLens, NoDistortion
from factorgraph_adj.models.orthogonal_lens import EbnerLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import FrameCoordinate
from factorgraph_adj.rotation import log_rotation
from factorgraph_adj.simulation.generate.scene import corners
from factorgraph_adj.solve.solution import Solution
from factorgraph_adj.triangulation.independent_models import (
    FACING_DOWN,
    ModelBlock,
    RelativeModel,
    as_models,
    pairs_of_strips,
    photos_of_strips,
    relative_model,
    start_values,
)
from factorgraph_adj.triangulation.plan_blocks import an_block, plan_height, radial_observations
from factorgraph_adj.triangulation.strips import (
    MIN_COMMON_PLACES,
    as_strips,
    control_coordinates,
    join_models,
)
from factorgraph_adj.types import Array

from .methods_1980_block import SIGMA_TILT, MethodBlock

ROUNDS = 5
"""Rounds of plan and height: practice had three to five."""
DEFORMED = tuple(n for n in DISPLACEMENTS[3:] if n not in ("stretch_z", "shear_xz", "shear_yz"))
"""Additional parameters of models: the 8 + 3 of Ebner."""
SIGMA_DEFORMATION = 0.010
"""Standard deviation of additional parameters at image scale, mm."""
HEIGHT = ("z", "z_x", "z_y", "z_xx")
"""Terms of the height of strip polynomials."""
WEIGHTS = {"c": 0.05, "x0": 0.05, "y0": 0.05}
"""Standard deviations of the interior orientation as observed, mm."""
SIGMA_LOOSE = 0.030
"""Standard deviation of control that places a block and does not bend it, at image scale, mm."""
SIGMA_CONTROL, SIGMA_CENTRE, SIGMA_ATTITUDE = 0.02, 20.0, 0.02
"""Standard deviations of observed control (m), centres (m) and attitudes (rad)."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """The results of a method."""

    n: int
    """Number of observations of its last adjustment."""
    u: int
    """Number of unknowns of the same."""
    errors: Array
    """Errors at check points, (k, 3) metres; NaN where it gives no coordinate."""
    sigma0: float = np.nan
    """σ̂0; NaN without an adjustment."""
    redundancy: int | None = None
    """Redundancy, where it is not n − u."""

    @property
    def r(self) -> int:
        """Redundancy."""
        return self.n - self.u if self.redundancy is None else self.redundancy


Method = Callable[[MethodBlock], Outcome]
"""A method."""


def outcome(solution: Solution, block: MethodBlock, *, plan: bool = False) -> Outcome:
    """Return the outcome of an adjustment; ``plan``: heights are ignored."""
    errors = np.array(
        [
            solution.point(n) - np.array(p.check)
            for n, p in block.network.points.items()
            if p.check is not None and n in solution.network.points
        ]
    ).reshape(-1, 3)
    if plan:
        errors[:, 2] = np.nan
    sigma0 = solution.sigma0 if solution.redundancy else np.nan
    return Outcome(
        solution.n_observations, solution.n_unknowns, errors, sigma0, solution.redundancy
    )


# -- units ----------------------------------------------------------------------------------------


def triplets(network: Network) -> list[tuple[str, ...]]:
    """Return units of three photos along strips; neighbours share one photo or two."""
    found: list[tuple[str, ...]] = []
    for strip in photos_of_strips(network):
        starts = [*range(0, len(strip) - 2, 2)]
        if len(strip) >= 3 and starts[-1] + 3 < len(strip):
            starts.append(len(strip) - 3)
        found += [tuple(strip[i : i + 3]) for i in starts]
    return found


def strips_of_models(network: Network) -> dict[str, list[RelativeModel]]:
    """Return the models of each strip."""
    state = start_values(network)
    return {
        f"strip {i}": [relative_model(network, pair, state=state) for pair in pairwise(strip)]
        for i, strip in enumerate(photos_of_strips(network), 1)
    }


def uncorrelated(block: ModelBlock) -> Network:
    """Return models as practice weighted them: no covariance between points."""
    out = block.network.copy()
    out.clusters = []
    return out


# -- models ---------------------------------------------------------------------------------------


def section_templates(block: MethodBlock) -> Outcome:
    """4: sections of two models, joined in plan."""
    models = as_models(block.plotter, triplets(block.plotter), centres=False)
    return outcome(adjust(an_block(uncorrelated(models))), block, plan=True)


def models_in_plan(block: MethodBlock) -> Outcome:
    """5, 13: models with four parameters in plan."""
    models = as_models(block.plotter, centres=False)
    return outcome(adjust(an_block(uncorrelated(models))), block, plan=True)


def joined_strips(block: MethodBlock) -> Outcome:
    """8: models joined one to the next, each strip with seven parameters on its control."""
    network = block.plotter
    control, found, n, u = control_coordinates(network), dict[str, list[Array]](), 0, 0
    for models in strips_of_models(network).values():
        strip = join_models(models).to_ground(control)
        n += 3 * sum(p in control for p in strip.points)
        u += 7
        for p, x in strip.points.items():
            found.setdefault(p, []).append(x)
    errors = [
        np.mean(found[p], axis=0) - np.array(given.check)
        for p, given in network.points.items()
        if given.check is not None and p in found
    ]
    return Outcome(n, u, np.array(errors))


def bent_strips(network: Network, block: MethodBlock) -> Outcome:
    """11, 18: strips with polynomials of degree 2, a block of them at once."""
    strips = strips_of_models(network)
    control = control_coordinates(network)
    enough = all(
        sum(p in control for m in models for p in m.points) >= MIN_COMMON_PLACES
        for models in strips.values()
    )
    bent = as_strips(network, strips, sigma=(0.1, 0.1, 0.2), height=HEIGHT)
    solution = adjust(bent)
    if not enough:
        places = {p: solution.point(p) for p in bent.points}
        solution = adjust(
            as_strips(network, strips, sigma=(0.1, 0.1, 0.2), height=HEIGHT, places=places)
        )
    return outcome(solution, block)


def in_turn(network: Network, block: MethodBlock) -> Outcome:
    """12, 19: models with projection centres, four and three parameters in turn."""
    found = plan_height(uncorrelated(as_models(network)), rounds=ROUNDS)
    end = outcome(found.simultaneous, block)
    errors = np.array(
        [
            np.array(found.network.points[n].coordinates) - np.array(p.check)
            for n, p in block.network.points.items()
            if p.check is not None and n in found.network.points
        ]
    )
    return replace(end, errors=errors, sigma0=np.nan)


def geodetic_control(block: MethodBlock) -> Outcome:
    """10: models, distances and azimuths instead of control in plan."""
    models = as_models(without_plan(block.plotter), centres=True).network
    models.add(*(o for o in block.terrestrial if set(o.points()) <= models.points.keys()))
    return outcome(adjust(models), block)


def aerolevelled(network: Network, block: MethodBlock, *, practice: bool) -> Outcome:
    """9, 22: models with heights of photos from a statoscope, height control in the corners."""
    models = as_models(with_corners(network, axes="z"))
    out = uncorrelated(models) if practice else models.network
    add_statoscope(out, block)
    return outcome(adjust(out), block)


def add_statoscope(out: Network, block: MethodBlock) -> None:
    """Add the statoscope: heights of photos above a surface of its own for each strip."""
    for o in block.statoscope:
        if o.profile is not None and o.profile not in out.profiles:
            out.set_profile(o.profile, free=("height", "height_t"))
    out.add(*(o for o in block.statoscope if o.photo in out.photos))


def tilted(block: MethodBlock) -> Outcome:
    """14: models whose tilts are those measured of their first photos; control as 9."""
    models = as_models(with_corners(block.plotter, axes="z"))
    out = uncorrelated(models)
    observe_tilts(out, models, block)
    return outcome(adjust(out), block)


def observe_tilts(out: Network, models: ModelBlock, block: MethodBlock) -> None:
    """Weight the tilts of models with those that were measured of their first photos."""
    for m in models.models:
        rotation = block.tilts[m.photos[0]] @ FACING_DOWN.T
        turn = log_rotation(rotation[None])[0].tolist()
        given = out.frames[m.name]
        sigma = (SIGMA_TILT, SIGMA_TILT, *given.sigma[2:])
        out.of_kind("frame")[m.name] = replace(
            given, values=(*turn, *given.values[3:]), sigma=sigma
        )


def without_plan(network: Network) -> Network:
    """Return the block with one control point in plan, that with most rays; heights are held."""
    _, point, *_ = network.images.columns()
    rays = np.bincount(point, minlength=len(network.points))
    control = [n for n, p in network.points.items() if all(p.fixed)]
    kept = max(control, key=lambda n: int(rays[network.point_number[n]]))
    return _freed(network, [n for n in control if n != kept], "xy")


def _freed(network: Network, names: Sequence[str], axes: str) -> Network:
    """Return the block with some axes of some control points free."""
    out = network.copy()
    for n in names:
        p = out.points[n]
        held = [f and a not in axes for f, a in zip(p.fixed, "xyz", strict=True)]
        check = [x if a in axes else np.nan for x, a in zip(p.coordinates, "xyz", strict=True)]
        out.points[n] = replace(
            p, fixed=(held[0], held[1], held[2]), check=(check[0], check[1], check[2])
        )
    return out


def with_corners(network: Network, *, axes: str = "xy") -> Network:
    """Return the block with control of some axes in its corners alone; others are held."""
    control = [n for n, p in network.points.items() if all(p.fixed)]
    xy = np.array([network.points[n].coordinates[:2] for n in control])
    kept = {control[i] for i in corners(xy)}
    return _freed(network, [n for n in control if n not in kept], axes)


def simultaneous(
    block: MethodBlock, units: Sequence[Sequence[str]] | None = None, *, deformed: bool = False
) -> Outcome:
    """21, 23, 24: models with seven parameters each and the covariance of their orientations."""
    models = as_models(block.network, units)
    network = models.network
    if deformed:
        _deform(models, block)
    return outcome(adjust(network), block)


def collocated(block: MethodBlock) -> Outcome:
    """20: models that control places and does not bend; its residuals then correct all points.

    Control with its own standard deviation would bend the block towards it where it stands, and
    leave no residuals. Gaussian covariance functions of plan and height are estimated from the
    residuals, whose noise is that of control.
    """
    models = as_models(block.network)
    network = uncorrelated(models)
    loose = SIGMA_LOOSE * _scale(models, block)
    for n, p in network.points.items():
        if any(p.fixed):
            sigma = [loose if held else np.inf for held in p.fixed]
            network.points[n] = replace(p, fixed=(False,) * 3, sigma=(sigma[0], sigma[1], sigma[2]))
    solution = adjust(network)
    found = point_corrections(
        solution, covariance="gaussian", height="gaussian", noise=SIGMA_CONTROL, alpha=1.0
    )
    errors = [
        found.coordinates[i] - np.array(check)
        for i, n in enumerate(found.names)
        if (check := block.network.points[n].check) is not None
    ]
    return replace(outcome(solution, block), errors=np.array(errors).reshape(-1, 3))


def _scale(models: ModelBlock, block: MethodBlock) -> float:
    """Return metres on the ground for a millimetre in the images."""
    focal = next(iter(block.network.cameras.values())).values[0]
    return float(np.mean([-x[2] for m in models.models for x in m.points.values()])) / focal


def _deform(models: ModelBlock, block: MethodBlock) -> None:
    """Give all models one deformation, weighted with zero."""
    network = models.network
    bases = {m.name: float(np.linalg.norm([*m.centres.values()][-1])) for m in models.models}
    mean = float(np.mean([*bases.values()]))
    sigma = SIGMA_DEFORMATION * _scale(models, block)
    network.set_model_deformation("all", sigma=dict.fromkeys(DEFORMED, sigma))
    for i, o in network.observations.items():
        if isinstance(o, FrameCoordinate) and o.point is not None:
            network.observations[i] = replace(o, deformation="all", base=mean)


# -- photos ---------------------------------------------------------------------------------------


def pseudo_images(block: MethodBlock) -> Outcome:
    """15: coordinates of models become images of their photos again, which a bundle joins (F2.6).

    A photo in two models has the mean of both images. Models have no parallax left, so that one of
    the four image coordinates of a point in a model is none of its own: σ̂0 is too small.
    """
    network = block.plotter
    state = start_values(network)
    out = Network("pseudo-images", frame=network.frame)
    focal = next(iter(network.cameras.values())).values[0]
    out.add_camera("model", NoDistortion(), {"c": focal})
    models = [relative_model(network, pair, state=state) for pair in pairs_of_strips(network)]
    for n in dict.fromkeys(p for m in models for p in m.points):
        at = state["point"][network.point_number[n]]
        held = network.points[n].held
        out.add_point(n, at.tolist() if np.isfinite(at).all() else None, fixed=held)
    images: dict[str, dict[str, list[Array]]] = {}
    for m in models:
        for photo in m.photos:
            rotation = np.asarray(m.solution.pose(photo).rotation)
            for n, x in m.points.items():
                # Camera axes have y down and z forward.
                d = (x - m.centres[photo]) @ rotation
                xy = focal * d[:2] / d[2] * [1.0, -1.0]
                images.setdefault(photo, {}).setdefault(n, []).append(xy)
    sigma = float(network.images.columns()[3].mean())
    for photo, found in images.items():
        pose = state["pose"][network.photo_number[photo]]
        out.add_photo(photo, "model", position=pose[9:].tolist(), rotation=pose[:9].reshape(3, 3))
        mean = np.array([np.mean(each, axis=0) for each in found.values()])
        out.add_image_points(photo, list(found), mean, sigma=sigma)
    return outcome(adjust(out), block)


def radial(block: MethodBlock) -> Outcome:
    """16: directions in plan; tilts are those of the start values."""
    return outcome(adjust(radial_observations(block.network)), block, plan=True)


def bundle(
    block: MethodBlock,
    *,
    lens: str = "held",
    terrestrial: bool = False,
    control: Literal["all", "corners", "one"] = "all",
    priors: bool = False,
) -> Outcome:
    """17, 25, 26, 28, 29, 30: the bundle, with the options of `bundle_network`."""
    network = bundle_network(
        block, lens=lens, terrestrial=terrestrial, control=control, priors=priors
    )
    return outcome(adjust(network), block)


def bundle_with_signals(block: MethodBlock) -> Outcome:
    """27: a second bundle with the full covariance of images that residuals of the first have.

    The covariance function of the residuals of all photos in the axes of the camera is estimated
    after the first bundle; the signal of the images is then unknown in the second one, by weighted
    amplitudes of its modes, which stand for the full covariance.
    """
    network, first = block.network, image_corrections(adjust(block.network))
    if not first.cameras:
        raise InputError("; ".join(first.remarks))
    for name, found in first.cameras.items():
        (function, _) = found.collocation.functions
        assert function is not None
        network = with_image_signals(network, covariance=function, cameras=[name])
    return outcome(adjust(network), block)


def bundle_network(
    block: MethodBlock,
    *,
    lens: str = "held",
    terrestrial: bool = False,
    control: Literal["all", "corners", "one"] = "all",
    priors: bool = False,
) -> Network:
    """Return the block of photos with what a method observes, weights and leaves free.

    Args:
        block: the block.
        lens: ``held``, ``ebner`` (weighted additional parameters), ``brown`` (self-calibration with
            observed interior orientation), ``both``.
        terrestrial: whether distances and azimuths are used.
        control: control that is held in plan: all, that of the corners, or one point.
        priors: whether control, exterior and interior orientation are observations.
    """
    network = block.network.copy()
    if control == "one":
        network = without_plan(network)
    elif control == "corners":
        network = with_corners(network)
    if terrestrial:
        network.add(*block.terrestrial)
    if lens != "held":
        _calibrate(network, block, lens)
    if priors:
        for n, p in network.points.items():
            if any(p.fixed):
                sigma = (SIGMA_CONTROL,) * 3
                network.points[n] = replace(p, fixed=(False,) * 3, sigma=sigma)
        state = start_values(network)
        for i, (n, f) in enumerate(network.photos.items()):
            pose = state["pose"][i]
            network.photos[n] = replace(
                f,
                position=tuple(pose[9:].tolist()),
                rotation=pose[:9].reshape(3, 3),
                sigma_position=(SIGMA_CENTRE,) * 3,
                sigma_attitude=SIGMA_ATTITUDE,
            )
    return network


def _calibrate(network: Network, block: MethodBlock, lens: str) -> None:
    """Replace the camera by one with weighted parameters."""
    ((name, camera),) = network.cameras.items()
    c = camera.values[0]
    del network.cameras[name]
    if lens == "brown":
        weights = WEIGHTS | {"k1": 1e-7, "p1": 1e-6, "p2": 1e-6}
        network.add_camera(name, BrownLens(), {"c": c}, sigma=weights)
        return
    model = EbnerLens(image_base=block.image_base)
    weights = dict.fromkeys(model.names[3:], SIGMA_DEFORMATION)
    if lens == "both":
        weights |= WEIGHTS
    network.add_camera(name, model, {"c": c}, sigma=weights)
