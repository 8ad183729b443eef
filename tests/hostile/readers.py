"""Damaged files of one format: the reader says what is wrong, or returns a network."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

import factorgraph_adj as fga
from tests.hostile.damage import DAMAGES, Damage, Rng, damaged, long_line, nest

MOST_LINES = 60
"""Number of lines of a message that a reader may have at most."""


def short_line(rng: Rng, name: str, content: bytes) -> bytes:
    """Append a line of 20 000 characters."""
    return content + b"\n" + (b"1," if rng.random() < 0.5 else b"x") * 10_000


SHORT: tuple[Damage, ...] = (*(d for d in DAMAGES if d not in (long_line, nest)), short_line)
"""Damages that leave a file short, so that hundreds of them take seconds."""


def judge(
    read: Callable[[Path], fga.Network],
    files: dict[str, bytes],
    begin: str,
    folder: Path,
    *,
    seed: int,
    count: int = 200,
) -> tuple[int, int]:
    """Read damaged files; return how many were read and how many refused.

    Args:
        read: the reader.
        files: contents by name.
        begin: the file with which the reader begins.
        folder: where the damaged files are written.
        seed: seed of the damage.
        count: number of damaged sets of files.
    """
    rng = np.random.default_rng(seed)
    good = refused = 0
    for i in range(count):
        here = folder / str(i)
        done = damaged(rng, files, here, damages=SHORT)
        try:
            network = read(here / begin)
        except fga.InputError as error:
            message = str(error)
            assert message.strip(), done
            assert message.count("\n") < MOST_LINES * len(files), (done, message[:500])
            assert any(name in message for name in files), (done, message[:500])
            refused += 1
            continue
        assert isinstance(network, fga.Network), done
        assert network.points, done
        for p in network.points.values():
            assert not np.isinf(p.coordinates).any(), done
        good += 1
    assert refused > count // 4, "the damage does no harm"
    return good, refused
