"""Fixed-width text: columns, and numbers with as many digits as they mean."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import floor, isfinite, log10, nan, sqrt

WIDTH = 100
"""Width of a protocol's heading."""


def title(text: str) -> list[str]:
    """Return a heading."""
    return [text, "-" * len(text)]


def table(header: Sequence[str], rows: Iterable[Sequence[str]], *, left: int = 1) -> list[str]:
    """Return lines of columns as wide as they need; the first ``left`` are flush left."""
    cells = [list(header), *(list(r) for r in rows)]
    widths = [max(len(r[i]) for r in cells) for i in range(len(header))]
    lines = [
        "  ".join(
            c.ljust(w) if i < left else c.rjust(w)
            for i, (c, w) in enumerate(zip(r, widths, strict=True))
        )
        for r in cells
    ]
    return [f"  {lines[0]}", "  " + "-" * len(lines[0]), *(f"  {line}" for line in lines[1:])]


def exponent(value: float) -> int:
    """Return the power of ten of the first digit of a positive number."""
    return floor(log10(value))


def decimals(sizes: Iterable[float], *, default: int, most: int) -> int:
    """Return decimals that show the median of ``sizes`` with two digits."""
    positive = sorted(s for s in sizes if s > 0 and isfinite(s))
    if not positive:
        return default
    return min(max(1 - exponent(positive[len(positive) // 2]), 0), most)


def short(value: float) -> str:
    """Return three significant digits, without an exponent where that is readable."""
    if value == 0 or not isfinite(value):
        return "0" if value == 0 else "–"
    size = exponent(abs(value))
    return f"{value:.2e}" if size > 5 or size < -4 else f"{value:.{max(2 - size, 0)}f}"


def with_sigma(value: float, sigma: float) -> str:
    """Return a value down to the second digit of its σ."""
    if not sigma > 0 or not isfinite(sigma):
        return f"{value:.7g}"
    last = exponent(sigma) - 1
    if value == 0 or exponent(abs(value)) > -4:
        return f"{value:.{max(-last, 0)}f}" if last > -12 else f"{value:.3e}"
    return f"{value:.{max(exponent(abs(value)) - last, 1)}e}"


def rms(values: Sequence[float]) -> float:
    """Return the root mean square; NaN of nothing."""
    return sqrt(sum(v * v for v in values) / len(values)) if values else nan
