"""Jobs of LINZ SNAP beside their listings: ``python -m tests.benchmarks.snap_jobs FOLDER [JOB …]``.

FOLDER is regression_tests/snap of github.com/linz/snap (BSD-3-Clause), with ``in`` (jobs) and
``check`` (a folder with the listing of each). Prints a line for each job: equal, differs, or
refused with the reason. Of a listing without figures the adjusted stations are compared, or which
readings take part with which errors. Squares are equal to 10⁻⁴ of themselves, or to the digits of
the listing.
A job that a deformation model concerns is refused, and read once more without the model.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

import factorgraph_adj as fga
from tests.loaders.snap_listing import (
    Summary,
    adjusted_stations,
    errors_of,
    read_errors,
    read_stations,
    read_summary,
    same_errors,
    summary,
)

DIGIT, SHARE = 1.5e-5, 1e-4
"""Digits of the listing, and the share that one radius of the Earth for refraction makes."""
LONGEST_REASON = 200


def compared(job: Path, listing: Path) -> tuple[str, str]:
    """Return a verdict on a job, and its figures."""
    theirs = read_summary(listing) if listing.is_file() else None
    stated = "no figures" if theirs is None else shown(theirs)
    remark = ""
    try:
        try:
            network = fga.read(job, format="snap")
        except fga.InputError as error:
            if "deformation='none'" not in str(error):
                raise
            network = fga.read(job, format="snap", deformation="none")
            remark = " without the deformation model"
        ours = summary(network)
    except fga.InputError as error:
        reason = str(error).splitlines()[0][:LONGEST_REASON]
        return "refused", f"{stated}; {reason}"
    table = read_stations(listing)
    if table:
        same = table == adjusted_stations(network)
        remark += ", stations equal" if same else ", stations differ"
    if theirs is None:
        if table and same:
            return "equal", f"stations as listed; {shown(ours)}{remark}"
        errors = read_errors(listing)
        if errors is not None:
            same = same_errors(errors, errors_of(network))
            what = "readings and their errors " + ("as listed" if same else "differ")
            return "equal" if same else "differs", f"{what}; {shown(ours)}{remark}"
        return "read", shown(ours) + remark
    equal = (ours.observations, ours.redundancy) == (theirs.observations, theirs.redundancy)
    near = abs(ours.squares - theirs.squares) <= max(DIGIT, SHARE * theirs.squares)
    verdict = "refused" if remark.startswith(" without") else "differs"
    return ("equal" if equal and near else verdict), f"{stated}; here {shown(ours)}{remark}"


def shown(s: Summary) -> str:
    """Return figures in words."""
    return f"n {s.observations} r {s.redundancy} Σ {s.squares:.5f} σ0 {s.unit_weight:.5f}"


def main() -> None:
    """Print a line for each job, and how many there are of each verdict."""
    folder, *names = sys.argv[1:]
    count: Counter[str] = Counter()
    for listing in sorted((Path(folder) / "check").iterdir()):
        if names and listing.name not in names:
            continue
        job = Path(folder) / "in" / f"{listing.name}.snp"
        verdict, figures = compared(job, listing / f"{listing.name}.lst")
        count[verdict] += 1
        print(f"{listing.name:13s} {verdict:8s} {figures}", flush=True)
    print(", ".join(f"{n} {verdict}" for verdict, n in count.most_common()))


if __name__ == "__main__":
    main()
