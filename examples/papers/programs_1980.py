"""Ayeni (1980), table 2: what 28 programs of 1980 did, on one block.

Each program is a function of the block of `methods_1980_block`, or of a project: its units, its
weights, its unknowns and its auxiliary data. The solution of the equations is ours; iterations of
1980 (block overrelaxation, Gauss-Seidel, conjugate gradients) end at the same estimates.

    python -m examples.papers.programs_1980                          # all, on the simulated block
    python -m examples.papers.programs_1980 --programs PAT-M43 BAP   # two of them
    python -m examples.papers.programs_1980 PROJECT --programs PAT-B
"""

from __future__ import annotations

import argparse
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from factorgraph_adj.adjustment import adjust, determined_part
from factorgraph_adj.graph.observation_selection import without
from factorgraph_adj.models.deformation import PROJECTIVE
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import FrameCoordinate, LevelHeight, ProfileHeight
from factorgraph_adj.quality.snooping import snoop
from factorgraph_adj.triangulation.independent_models import (
    ModelBlock,
    as_models,
    photos_of_strips,
    relative_model,
    start_values,
)
from factorgraph_adj.triangulation.strips import control_coordinates, join_models

from . import methods_1980_run as run
from .methods_1980 import Needed, Row, Table3, add_block_options, chosen_block, ran
from .methods_1980_block import SIGMA_STATOSCOPE, MethodBlock
from .methods_1980_run import Method, Outcome

LARGEST_UNIT = 8
"""Largest number of photos in a unit of URELO."""
AFFINE = ("affinity", "shear_xy", "stretch_z", "shear_xz", "shear_yz")
"""Terms that make the seven parameters of a model twelve."""
SIGMA_SHORE = 0.2
"""Standard deviation of the height of a point on a shore, metres."""
SIGMA_ARC = 20.0
"""Standard deviation of the photos of a strip from their curve, metres."""
SHORE_POINTS = 8
"""Number of points on the shore of the lake."""


@dataclass(frozen=True)
class Program:
    """A program of table 2."""

    name: str
    """Its name in the table."""
    what: str
    """What it did, as ours does it."""
    run: Method | None
    """Function that does it; None: it is not there."""
    reason: str = ""
    """Reason why it is not there."""
    needs: Needed = ""
    """Part of the block that it needs besides photos and control."""


# -- units ----------------------------------------------------------------------------------------


def models_and_photos(block: MethodBlock) -> Outcome:
    """ALBANY: the first strip as models, the others as photos, in one network."""
    network = block.network
    first = photos_of_strips(network)[0]
    models = as_models(network, list(pairwise(first)), centres=False)
    out = without(network, (), photos=first)
    _add_models(out, models)
    # A point that models lack and one photo shows is left out.
    return run.outcome(adjust(determined_part(out)), block)


def _add_models(out: Network, models: ModelBlock) -> None:
    """Add models with their frames to a network that has their points."""
    out.of_kind("frame").update(models.network.frames)
    out.add(*(m.observations(centres=False) for m in models.models))


def large_units(block: MethodBlock, *, practice: bool) -> Outcome:
    """URELO and BUNDLE: units of up to eight photos of a strip.

    Args:
        block: the block.
        practice: whether coordinates of a unit count as uncorrelated. With their covariance units
            are quasi-observations that stand for all rays of their photos.
    """
    units = [
        strip[i : i + LARGEST_UNIT]
        for strip in photos_of_strips(block.network)
        for i in range(0, max(1, len(strip) - 1), LARGEST_UNIT - 1)
    ]
    models = as_models(block.network, units, centres=False)
    out = run.uncorrelated(models) if practice else models.network
    return run.outcome(adjust(out), block)


def similarities(block: MethodBlock) -> Outcome:
    """I.M.T., STEREO: models with seven parameters, their coordinates uncorrelated."""
    return run.outcome(adjust(run.uncorrelated(as_models(block.network))), block)


def projective_models(block: MethodBlock) -> Outcome:
    """BATT-SAP: models with fifteen parameters, of which eight are weighted with zero."""
    models = as_models(block.network)
    network = models.network
    focal = next(iter(block.network.cameras.values())).values[0]
    for m in models.models:
        depth = float(np.mean([-x[2] for x in m.points.values()]))
        sigma = run.SIGMA_DEFORMATION * depth / focal
        network.set_model_deformation(m.name, sigma=dict.fromkeys((*AFFINE, *PROJECTIVE), sigma))
    bases = {m.name: float(np.linalg.norm([*m.centres.values()][-1])) for m in models.models}
    for i, o in network.observations.items():
        if isinstance(o, FrameCoordinate) and o.point is not None:
            deformed = replace(o, deformation=o.frame, base=bases[o.frame])
            network.observations[i] = deformed
    return run.outcome(adjust(network), block)


def resected(block: MethodBlock) -> Outcome:
    """TPA: triplets, strips of them on the ground, photos resected there; then the bundle."""
    network = block.network.copy()
    state = start_values(block.network)
    control = control_coordinates(network)
    places: dict[str, list[np.ndarray]] = {}
    triplets = run.triplets(network)
    for strip in photos_of_strips(network):
        own = [t for t in triplets if set(t) <= set(strip)]
        models = [relative_model(block.network, t, state=state) for t in own]
        for n, x in join_models(models).to_ground(control).points.items():
            places.setdefault(n, []).append(x)
    for n, p in network.points.items():
        if not any(p.fixed):
            at = np.mean(places[n], axis=0).tolist() if n in places else [np.nan] * 3
            network.points[n] = replace(p, coordinates=tuple(at))
    for n, f in network.photos.items():
        network.photos[n] = replace(f, position=None, rotation=None)
    return run.outcome(adjust(network), block)


# -- auxiliary data -------------------------------------------------------------------------------


def profile_lake(block: MethodBlock) -> Outcome:
    """PAT-M43-APR-STATOS-LAKE: models with a statoscope, a profile recorder, and a lake.

    Height control is in the corners alone. Each strip has recorded heights of the points under its
    flight, above a surface of its own; a lake of unknown level has eight points on its shore, whose
    heights above the water were measured.
    """
    network = run.with_corners(block.network, axes="z")
    out = as_models(network).network
    run.add_statoscope(out, block)
    true = {n: np.array(p.check) for n, p in out.points.items() if p.check is not None}
    true = {n: x for n, x in true.items() if np.isfinite(x).all()}
    rng = np.random.default_rng(len(true))
    for k, strip in enumerate(photos_of_strips(network), 1):
        line = np.array([network.photos[f].position for f in strip], dtype=float)[:, :2]
        along = (line[-1] - line[0]) / np.linalg.norm(line[-1] - line[0])
        across = np.array([-along[1], along[0]])
        far = {n: abs(float((x[:2] - line[0]) @ across)) for n, x in true.items()}
        half = float(np.linalg.norm(line[-1] - line[0])) / len(strip) / 4
        out.set_profile(f"recorder {k}", free=("height", "height_t"))
        for n in [n for n, d in far.items() if d < half]:
            height = float(true[n][2] + rng.normal(0.0, SIGMA_STATOSCOPE))
            time = float((true[n][:2] - line.mean(axis=0)) @ along) / 1000
            reading = ProfileHeight(
                n, height, profile=f"recorder {k}", time=time, sigma=SIGMA_STATOSCOPE
            )
            out.add(reading)
    out.set_level("lake")
    lowest = sorted(true, key=lambda n: float(true[n][2]))[:SHORE_POINTS]
    water = float(true[lowest[0]][2])
    for n in lowest:
        above = float(true[n][2] - water + rng.normal(0.0, SIGMA_SHORE))
        out.add(LevelHeight(n, "lake", above, sigma=SIGMA_SHORE))
    return run.outcome(adjust(out), block)


def models_in_the_air(block: MethodBlock) -> Outcome:
    """SPACE-M: models with a statoscope and measured tilts; height control in the corners."""
    models = as_models(run.with_corners(block.network, axes="z"))
    out = models.network
    run.add_statoscope(out, block)
    run.observe_tilts(out, models, block)
    return run.outcome(adjust(out), block)


# -- photos ---------------------------------------------------------------------------------------


def several_cameras(block: MethodBlock) -> Outcome:
    """SAPGO-mfl: SAPGO with cameras of two principal distances.

    Photos of every second strip are those of a camera of half the principal distance: their image
    coordinates and standard deviations are half as large.
    """
    network = run.bundle_network(block, terrestrial=True, control="corners")
    ((name, camera),) = network.cameras.items()
    network.add_camera("short", camera.lens, {"c": camera.values[0] / 2})
    second = {f for strip in photos_of_strips(network)[1::2] for f in strip}
    for f in second:
        network.photos[f] = replace(network.photos[f], camera="short")
    photo, _, xy, sigma = network.images.columns()
    names = list(network.photos)
    factor = np.where([names[i] in second for i in photo], 0.5, 1.0)[:, None]
    network.images = network.images.with_columns(xy=xy * factor, sigma=sigma * factor)
    assert name in network.cameras
    return run.outcome(adjust(network), block)


def on_arcs(block: MethodBlock) -> Outcome:
    """LOSAT LOBAT: the photos of each strip on a trajectory; orbits have a ``gm`` in addition.

    Photos are exposed at equal intervals. The block is flown by an aircraft, whose curve is a
    polynomial of the second power.
    """
    network = block.network.copy()
    for k, strip in enumerate(photos_of_strips(network), 1):
        times = {f: float(i - (len(strip) - 1) / 2) for i, f in enumerate(strip)}
        network.add_arc(f"strip {k}", times, sigma=SIGMA_ARC, power=2)
    return run.outcome(adjust(network), block)


def edited(block: MethodBlock, *, lens: str, priors: bool) -> Outcome:
    """MUSAT, SURBAT: the bundle without the observations that data snooping rejects."""
    network = run.bundle_network(block, lens=lens, priors=priors)
    return run.outcome(snoop(network).solution, block)


SELF_CALIBRATION: Method = partial(run.bundle, lens="both", priors=True)
"""Method 30."""

PROGRAMS: tuple[Program, ...] = (
    Program("ALBANY", "a strip of models beside photos", models_and_photos),
    Program("GIANT", "bundle, everything weighted", partial(run.bundle, priors=True)),
    Program("I.M.T.", "models, uncorrelated", similarities),
    Program("FORTBLOCK", "25 bundle", run.bundle),
    Program("SAPGO-mfl", "26, two cameras", several_cameras, needs="terrestrial"),
    Program("MUSAT", "bundle, data snooping", partial(edited, lens="ebner", priors=False)),
    Program("URELO", "units of up to 8 photos", partial(large_units, practice=True)),
    Program("COMBAT II", "30 self-calibration", SELF_CALIBRATION),
    Program("SURBAT", "30, data snooping", partial(edited, lens="both", priors=True)),
    Program("LOSAT LOBAT", "photos on trajectories", on_arcs),
    Program("TPA", "triplets, strips, resections, bundle", resected),
    Program("PAT-M4", "13 an-block", run.models_in_plan),
    Program("PAT-M43", "19 plan and height", lambda b: run.in_turn(b.network, b)),
    Program(
        "PAT-M43-APR-STATOS-LAKE",
        "models, recorder, statoscope, lake",
        profile_lake,
        needs="statoscope",
    ),
    Program("PAT-B", "25 bundle", run.bundle),
    Program("BAP", "30 self-calibration", SELF_CALIBRATION),
    Program("ASP", "25 bundle", run.bundle),
    Program("HVB", "18 polynomials", lambda b: run.bent_strips(b.network, b)),
    Program("SCHUT", "18 polynomials", lambda b: run.bent_strips(b.network, b)),
    Program("SPACE-M", "models, statoscope, tilts", models_in_the_air, needs="statoscope"),
    Program("PABS", "11 polynomials", lambda b: run.bent_strips(b.plotter, b)),
    Program("BATT-SAP", "models, 15 parameters", projective_models),
    Program("EMMBA", "28 additional parameters", partial(run.bundle, lens="ebner")),
    Program("BUEND", "29 calibration", partial(run.bundle, lens="brown", priors=True)),
    Program("STEREO", "models, uncorrelated", similarities),
    Program("AN BLOCK", "13 an-block", run.models_in_plan),
    Program("BUNDLE", "strips as quasi-observations", partial(large_units, practice=False)),
    Program("IMT", "24 simultaneous", run.simultaneous),
)
"""The programs of table 2 in order; numbers are those of methods in table 1."""


def run_programs(block: MethodBlock, *, names: Collection[str] | None = None) -> Table3:
    """Run programs on a block.

    Args:
        block: the block.
        names: names of the programs; by default all.
    """
    rows = [
        ran(Row(i, f"{p.name}: {p.what}", p.run, p.reason, p.needs), block)
        for i, p in enumerate(PROGRAMS, 1)
        if names is None or p.name in names
    ]
    return Table3(f"Ayeni (1980), table 2: {block.network.name}", tuple(rows))


def command_parser() -> argparse.ArgumentParser:
    """Return the parser of the command."""
    parser = argparse.ArgumentParser(prog="python -m examples.papers.programs_1980")
    add_block_options(parser)
    parser.add_argument(
        "--programs",
        nargs="+",
        choices=[p.name for p in PROGRAMS],
        metavar="NAME",
        help="names of the programs to run (all)",
    )
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Print what the programs of table 2 give on the simulated block, or on a project."""
    options = command_parser().parse_args(arguments)
    print(run_programs(chosen_block(options), names=options.programs))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
