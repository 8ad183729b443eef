"""Ayeni (1980), table 3: the seven published blocks, simulated with their geometry.

Table 3 states the photo scale, the camera, the area, the overlaps, the numbers of photos or models
and of control points, and RMS errors at check points. The columns after the numbers of control
points are photos or models for each of them. What it leaves open is chosen here, and said. Images
have random errors of 4 µm in a comparator and 10 µm in a plotter, and systematic ones: the twelve
terms of an Ebner model at random, together 9 µm at most in x or y at von Gruber's nine places, as
Ebner (1976) found in the block Oberschwaben. Errors are RMS of one coordinate over all points that
are no control.

    python -m examples.papers.table_3_1980                          # all blocks, three seeds
    python -m examples.papers.table_3_1980 Atlanta Jämijärvi --seeds 10

Sources besides the paper: Ebner (1976), goobi.tib.eu 1066535345/547, for Frankfurt, which is the
block Oberschwaben of the OEEPE; Brown (1976), 1066535345/527, for Atlanta; Hvidegaard (1979),
Photogrammetria 35, for Ålborg.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from factorgraph_adj.graph.observation_selection import without
from factorgraph_adj.models.orthogonal_lens import EbnerLens, gram_polynomials
from factorgraph_adj.network.network import Network
from factorgraph_adj.report import layout
from factorgraph_adj.simulation.generate.control import Control
from factorgraph_adj.simulation.generate.photo_blocks import Aerial
from factorgraph_adj.simulation.generate.scene import Camera
from factorgraph_adj.simulation.measurement import Seed
from factorgraph_adj.simulation.spec import Spec, design
from factorgraph_adj.types import Array

from .methods_1980 import METHODS, ran
from .methods_1980_block import (
    CAMERA,
    FORMAT,
    IMAGE_BASE,
    PLOTTER,
    MethodBlock,
    read_images,
)

COMPARATOR = 0.004
"""Standard deviation of image coordinates in a comparator, mm: Ebner's σ̂0 is 4.3 µm."""
LARGEST_EFFECT = 0.009
"""Largest systematic error of an image coordinate at von Gruber's places, mm."""
RELIEF = 0.03
"""Largest height of the terrain above and below its mean, as a fraction of the flying height."""
SEEDS = 3
"""Number of repetitions of each block."""


def systematic_errors(seed: Seed) -> dict[str, float]:
    """Return parameters of Ebner's model whose common effect has the largest value, mm."""
    terms = EbnerLens.terms
    rng = np.random.default_rng([seed, 3])
    values = dict(zip(terms, rng.uniform(-1.0, 1.0, len(terms)).tolist(), strict=True))
    at, _ = gram_polynomials(np.array([-1.0, 0.0, 1.0]), EbnerLens.grid)
    effect = np.zeros((2, 3, 3))
    for name, term in terms.items():
        for axis, products in enumerate((term.in_x, term.in_y)):
            for i, j, factor in products:
                effect[axis] += values[name] * factor * np.outer(at[i], at[j])
    size = LARGEST_EFFECT / float(np.abs(effect).max())
    return {n: size * v for n, v in values.items()}


@dataclass(frozen=True)
class PublishedBlock:
    """A block of table 3."""

    name: str
    """Title of the project."""
    scale: float
    """Denominator of the photo scale."""
    strips: int
    """Number of strips."""
    photos: int
    """Number of photos in a strip."""
    overlaps: tuple[float, float]
    """Overlaps along and across the strips."""
    control: Control
    """Control points."""
    methods: tuple[int, ...]
    """Methods of table 1; of two, the second is with parameters or collocation."""
    printed: tuple[str, ...]
    """RMS errors that the table prints for these methods, cm: plan, height."""
    open_points: str
    """What the table does not state or contradicts, and what is chosen."""
    focal: float = 153.0
    """Principal distance, mm."""
    less: int = 0
    """Number of photos in the middle of the block that are left out."""
    points: int = 20
    """Points in a photo."""
    known: str = field(default="", kw_only=True)
    """What a source besides the table states."""

    def network(self, seed: Seed) -> Network:
        """Return the plan: photos with true image points, control held, check points."""
        camera = Camera(
            name=CAMERA,
            c_mm=self.focal,
            format_mm=(FORMAT, FORMAT),
            lens="ebner",
            lens_options={"image_base": IMAGE_BASE},
            parameters=systematic_errors(seed),
        )
        flown = Aerial(
            strips=self.strips,
            photos_per_strip=self.photos,
            forward_overlap=self.overlaps[0],
            side_overlap=self.overlaps[1],
            scale=self.scale,
            camera=camera,
            relief=RELIEF * self.scale * self.focal / 1000,
            points_per_photo=self.points,
        )
        plan = design(Spec(parts=(flown,), control=self.control, name=self.name, seed=seed))
        middle = self.strips // 2 * self.photos + self.photos // 2
        missing = [*plan.photos][middle : middle + self.less]
        if missing:
            plan = without(plan, (), photos=missing)
            rays = np.bincount(plan.images.columns()[1], minlength=len(plan.points))
            few = [n for n, k in zip(plan.points, rays, strict=True) if k < 2]
            plan = without(plan, (), points=few)
        for n, p in plan.points.items():
            plan.points[n] = replace(p, check=None if any(p.fixed) else p.coordinates)
        return plan

    def block(self, seed: Seed) -> MethodBlock:
        """Return the block as measured in a comparator and in a plotter."""
        plan = self.network(seed)
        read = [
            read_images(plan, sigma, 10 * seed + k, self.focal)
            for k, sigma in enumerate((COMPARATOR, PLOTTER))
        ]
        return MethodBlock(read[0], read[1])


BLOCKS: tuple[PublishedBlock, ...] = (
    PublishedBlock(
        "Appenweier",
        7800,
        7,
        17,
        (0.6, 0.34),
        Control(horizontal="full", horizontal_count=27, vertical="full", vertical_count=60),
        (19, 20),
        ("5.3 plan", "4.4 plan"),
        "overlaps: 34 % across fits 112 models on 94.6 km²; strips: 7 with 16 models; control in "
        "height: 60 points",
    ),
    PublishedBlock(
        "Frankfurt",
        28000,
        4,
        26,
        (0.6, 0.224),
        Control(horizontal="perimeter", horizontal_count=32, vertical="full", vertical_count=60),
        (24, 23),
        ("28 plan", "17.6 plan"),
        "control in height: 60 points",
        known="4 strips with 100 models on 20 × 62.5 km²; control every 2 b = 5 km",
    ),
    PublishedBlock(
        "Zürich",
        28000,
        7,
        26,
        (0.6, 0.2),
        Control(horizontal="perimeter", horizontal_count=28, vertical="full", vertical_count=61),
        (12,),
        ("42.2 plan, 46.7 height",),
        "strips: 7 with 25 models; they cover 2300 km², not the 1500 of the table",
        points=30,
    ),
    PublishedBlock(
        "Casa Grande",
        4000,
        2,
        4,
        (0.6, 0.4),
        Control(horizontal="perimeter", horizontal_count=6, vertical="perimeter", vertical_count=6),
        (25, 27),
        ("3.2 plan, 2.9 height", "2.2 plan, 1.6 height"),
        "strips: 2 with 4 photos",
    ),
    PublishedBlock(
        "Jämijärvi",
        4000,
        6,
        8,
        (0.6, 0.6),
        Control(horizontal="perimeter", horizontal_count=8, vertical="full", vertical_count=16),
        (25, 28),
        ("6.1 plan, 4.3 height", "2.3 plan, 3.0 height"),
        "strips: 6 with 8 photos, without one in the middle",
        less=1,
    ),
    PublishedBlock(
        "Ålborg",
        8000,
        9,
        9,
        (0.6, 0.3),
        Control(horizontal="full", horizontal_count=35, vertical="full", vertical_count=35),
        (25,),
        ("5.0 plan",),
        "strips: 9 with 9 photos; number of control points: 35; 5 cm is the standard error of a "
        "point by distances between points, over 11 blocks",
        known="control by a net of 2 km",
    ),
    PublishedBlock(
        "Atlanta",
        17500,
        4,
        7,
        (0.6, 0.6),
        Control(horizontal="perimeter", horizontal_count=6, vertical="perimeter", vertical_count=6),
        (30,),
        ("7.0 plan, 3.0 height",),
        "strips: 4 with 7 photos; the table has 27 photos and 19 checks in height, Brown 28 and 9",
        focal=85.0,
        known="RMS 9.4 and 6.9 cm in X and Y of targets, 7.0 and 4.1 of monuments",
    ),
)
"""The blocks of table 3 in order."""


@dataclass(frozen=True, eq=False)
class BlockResult:
    """RMS errors of a method on a block, over the seeds."""

    block: PublishedBlock
    """The block."""
    method: int
    """The method."""
    printed: str
    """What the table prints."""
    plan: Array
    """RMS errors of one coordinate in plan by seed, metres; empty: the method was not run."""
    height: Array
    """RMS errors of heights by seed, metres."""
    reason: str = ""
    """Reason why it was not run."""


def run_block(block: PublishedBlock, *, seeds: int = SEEDS) -> list[BlockResult]:
    """Run the methods of a block.

    Args:
        block: the block.
        seeds: number of repetitions, with seeds 1, 2, …
    """
    measured = [block.block(seed) for seed in range(1, seeds + 1)]
    out = []
    for number, printed in zip(block.methods, block.printed, strict=True):
        row = next(r for r in METHODS if r.number == number)
        found = [ran(row, b) for b in measured]
        reason = next((f.reason for f in found if f.outcome is None), "")
        rms = np.array([f.rms for f in found if f.outcome is not None]).reshape(-1, 3)
        plan = np.sqrt(np.mean(rms[:, :2] ** 2, axis=1))
        out.append(BlockResult(block, number, printed, plan, rms[:, 2], reason))
    return out


def as_text(results: Sequence[BlockResult]) -> str:
    """Return the results as a table, and what is chosen."""
    header = ["block", "method", "printed, cm", "plan, cm", "height, cm"]
    lines = [
        [r.block.name, f"{r.method}", r.printed, _range(r.plan), _range(r.height)] for r in results
    ]
    notes = [f"{r.block.name}, {r.method}: {r.reason}." for r in results if r.reason]
    for block in dict.fromkeys(r.block for r in results):
        known = f" Other sources: {block.known}." if block.known else ""
        notes.append(f"{block.name}: chosen are {block.open_points}.{known}")
    said = [line for n in notes for line in layout.paragraph(n)]
    title = layout.title("Ayeni (1980), table 3: blocks of its geometry")
    return "\n".join([*title, *layout.table(header, lines), "", *said])


def _range(values: Array) -> str:
    """Return the mean of values in cm, with the smallest and the largest."""
    if not len(values):
        return "–"
    low, high = 100 * values.min(), 100 * values.max()
    mean = f"{100 * values.mean():.1f}"
    return mean if len(values) == 1 else f"{mean} ({low:.1f} to {high:.1f})"


def _block(name: str) -> PublishedBlock:
    """Return a block by its name."""
    for block in BLOCKS:
        if block.name == name:
            return block
    raise argparse.ArgumentTypeError(f"unknown block {name!r}")


def command_parser() -> argparse.ArgumentParser:
    """Return the parser of the command."""
    parser = argparse.ArgumentParser(prog="python -m examples.papers.table_3_1980")
    names = ", ".join(b.name for b in BLOCKS)
    parser.add_argument("blocks", nargs="*", metavar="BLOCK", type=_block, help=f"{names} (all)")
    parser.add_argument("--seeds", type=int, default=SEEDS, help=f"repetitions ({SEEDS})")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Print errors at check points of simulated blocks beside those of table 3."""
    options = command_parser().parse_args(arguments)
    chosen = options.blocks or BLOCKS
    print(as_text([r for b in chosen for r in run_block(b, seeds=options.seeds)]))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
