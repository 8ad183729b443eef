"""``python -m tests.hostile [N [FIRST]]``: N inputs damaged at random, and what became of them."""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from pathlib import Path

from .campaign import campaign

if __name__ == "__main__":
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    first = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    counts: Counter[str] = Counter()
    slowest = largest = 0.0
    with tempfile.TemporaryDirectory() as folder:
        for case in campaign(first, n, Path(folder)):
            counts[case.told] += 1
            slowest = max(slowest, case.outcome.seconds)
            largest = max(largest, case.outcome.megabytes)
            if case.outcome.fault:
                print(f"seed {case.seed}, {case.source}, {case.done}: {case.outcome.fault}")
                print("    " + case.outcome.output[-600:].replace("\n", "\n    "), flush=True)
            if (case.seed - first + 1) % 500 == 0:
                print(f"# {case.seed - first + 1}: {dict(counts)}", flush=True)
    print(f"{n} inputs: " + ", ".join(f"{c} {told}" for told, c in counts.most_common()))
    print(f"longest {slowest:.1f} s, largest {largest:.0f} MB")
