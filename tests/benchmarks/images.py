"""Blocks from images alone: CPU times, where they end, and what is done with mismatches.

    python -m tests.benchmarks.images [SEEDS]

Every simulated block is oriented, adjusted, and compared with the adjustment from the truth. Blocks
with mismatches go through data snooping: counted are mismatches that stay (missed), and good image
points that are rejected (false), once all of them and once without those of points of which fewer
than two good image points are left. Published blocks are timed where their data are there.
"""

from __future__ import annotations

import sys
import time
from collections import Counter

import numpy as np

import factorgraph_adj as fga
from tests.networks.image_blocks import KINDS, ImageBlock, aerial, images_alone, ring

SAME = 1e-9


def ends(seeds: int) -> None:
    """Print how many simulated blocks end where the truth leads, and the CPU times."""
    for kind, make in KINDS.items():
        if kind == "mismatches":
            continue
        same, tried, start, rest = 0, 0, [], []
        for seed in range(seeds):
            block = make(seed)
            try:
                true = fga.adjust(block.truth).vtpv
            except fga.DatumError:
                continue  # chance has put two of its control points into one of its parts
            tried += 1
            began = time.process_time()
            found = fga.orient(block.network)
            start.append(time.process_time() - began)
            began = time.process_time()
            vtpv = fga.adjust(block.network, start=found.start).vtpv
            rest.append(time.process_time() - began)
            same += abs(vtpv / true - 1.0) < SAME
        print(
            f"{kind:20} {same} of {tried} at the minimum of the truth; CPU s, median: start "
            f"{np.median(start):.2f}, adjustment {np.median(rest):.2f}",
            flush=True,
        )


def lost_points(block: ImageBlock) -> set[str]:
    """Return the points of which fewer than two good image points are left."""
    good: Counter[str] = Counter(dict.fromkeys(block.network.points, 0))
    for i in block.network.image_points():
        good[i.point] += f"{i.photo}/{i.point}" not in block.mismatched
    return {name for name, n in good.items() if n < 2}


def mismatches(seeds: int) -> None:
    """Print the shares of missed mismatches and of false rejections of data snooping."""
    for title, kind in (("aerial", aerial), ("ring", ring)):
        for share in (0.05, 0.1, 0.2):
            n_bad = n_good = missed = false = avoidable = 0
            seconds = 0.0
            for seed in range(seeds):
                block = kind(100 + seed, control=0, mismatches=share)
                began = time.process_time()
                gone = set(fga.snoop(block.network).rejected_ids)
                seconds += time.process_time() - began
                wrong, lost = gone - block.mismatched, lost_points(block)
                n_bad += len(block.mismatched)
                n_good += block.network.n_image_points - len(block.mismatched)
                missed += len(block.mismatched - gone)
                false += len(wrong)
                avoidable += sum(i.split("/")[1] not in lost for i in wrong)
            print(
                f"{title:7} {share:4.0%} of {n_bad + n_good} image points are mismatches: missed "
                f"{missed} of {n_bad} ({missed / n_bad:.2%}), false {false} of {n_good} "
                f"({false / n_good:.2%}), of points with two good image points {avoidable} "
                f"({avoidable / n_good:.2%}); {seconds / seeds:.2f} CPU s a block",
                flush=True,
            )


def published() -> None:
    """Print CPU times of published blocks without poses and points."""
    from tests.networks.aicon import read_aicon
    from tests.networks.dbat import read_camcal, read_roma, read_sxb
    from tests.support.places import data_dir

    blocks = (
        ("DBAT sxb", lambda: read_sxb(data_dir("dbat_sxb")), None),
        ("DBAT camcal", lambda: read_camcal(data_dir("dbat_camcal")), None),
        ("AICON", lambda: read_aicon(data_dir("aicon_jaicov"), start="photos astray"), None),
        ("DBAT Roma", lambda: read_roma(data_dir("dbat_roma")), "free"),
    )
    for title, read, datum in blocks:
        network = images_alone(read(), datum=datum)
        began = time.process_time()
        found = fga.orient(network)
        start = time.process_time() - began
        began = time.process_time()
        solution = fga.adjust(network, start=found.start, variance="a-posteriori")
        rest = time.process_time() - began
        print(
            f"{title:12} {len(network.photos):4} photos {network.n_image_points:6} image points: "
            f"start {start:.2f}, adjustment {rest:.2f} CPU s; σ̂0 {solution.sigma0:.6f}",
            flush=True,
        )


if __name__ == "__main__":
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    ends(n)
    mismatches(n)
    published()
