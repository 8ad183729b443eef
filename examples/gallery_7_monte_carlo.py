"""A simulation repeated 40 times
==============================

What do more taped distances contribute? Every repetition simulates the block again, adjusts it and
returns figures. Repetition k has the same seed for all numbers of distances: the differences
between them are paired.
"""

import argparse

import numpy as np

import factorgraph_adj as fga
from examples.published_blocks.industry_1981 import simulate_industry_block
from factorgraph_adj.experiment.runs import Experiment, run

MM = 1e-3
DISTANCES = (35, 150)


def trial(seed: int, *, distances: int) -> dict[str, float]:
    """Simulate and adjust the block once."""
    simulated = simulate_industry_block(seed, photos=4, distances=distances)
    solution = fga.adjust(simulated.network)
    truth = simulated.truth.points
    errors = np.array([solution.point(p) - xyz for p, xyz in truth.items()])
    variances = np.einsum("nii->ni", solution.point_covariances)
    return {
        "RMS error of the plan, mm": float(np.sqrt(np.mean(errors[:, :2] ** 2)) / MM),
        "squared errors / expected": float(np.mean(errors**2) / np.mean(variances)),
        "variance factor": solution.sigma0**2,
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--plot", metavar="FILE", help="draw the errors against the distances")
    parser.add_argument("--processes", type=int, default=1, metavar="N", help="at once (1)")
    options = parser.parse_args()

    experiment = Experiment("distances of the industry block", trial, {"distances": DISTANCES}, 7)
    results = run(experiment, 40, processes=options.processes)
    print(results)
    print(results.summary())

    errors = {n: results.values("RMS error of the plan, mm", distances=n) for n in DISTANCES}
    print("\nRMS error of the plan, each repetition with itself:")
    for n in DISTANCES[1:]:
        gain = errors[DISTANCES[0]] - errors[n]
        sigma = gain.std(ddof=1) / np.sqrt(len(gain))
        print(f"{n:4} distances instead of {DISTANCES[0]}: {gain.mean():.3f} ± {sigma:.3f} mm less")

    if options.plot:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(6, 4), layout="constrained")
        axes = figure.add_subplot(xlabel="taped distances", ylabel="RMS error of the plan [mm]")
        axes.set_title(
            "40 simulated blocks each; box: quartiles and median,\nwhiskers: least and largest",
            fontsize="medium",
        )
        axes.boxplot([errors[n] for n in DISTANCES], whis=(0, 100), tick_labels=DISTANCES)
        figure.savefig(options.plot, dpi=150)
        print(f"{options.plot}: errors of 40 repetitions for each number of distances")
