"""``python -m tests.badly_posed [N [FIRST]]``: N badly posed networks, and how they ended."""

from __future__ import annotations

import sys
from collections import Counter

import numpy as np

from .campaign import Judged, campaign

if __name__ == "__main__":
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 5000
    first = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    found: list[Judged] = []
    for case in campaign(first, n):
        found.append(case)
        if case.fault:
            print(f"seed {case.seed}, {case.family}: {case.fault}; {case.reason}", flush=True)
    print(f"{n} networks: {dict(Counter(c.told for c in found))}")
    for family in sorted({c.family for c in found}):
        own = [c for c in found if c.family == family]
        rest = [c for c in own if c.told == "converged"]
        ratio = np.array([c.unknown / c.stated for c in rest])
        print(
            f"{family:12} {dict(Counter(c.told for c in own))}, faults "
            f"{sum(bool(c.fault) for c in own)}; distance / stated: median "
            f"{np.median(ratio) if len(ratio) else np.nan:.2g}, largest "
            f"{np.nanmax(ratio, initial=0.0):.2g}; stated beyond 1e-5 σ: "
            f"{sum(c.stated > 1e-5 for c in rest)}"
        )
    print("reasons: " + str(Counter(c.reason[:50] for c in found).most_common(12)))
