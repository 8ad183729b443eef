"""Damaged files of a format: the reader says what is wrong and where, or returns a network.

``python -m tests.hostile.readers [N [SEED [FORMAT …]]]`` damages N sets of files of each format.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable, Collection
from pathlib import Path

import numpy as np

import factorgraph_adj as fga
from tests.hostile.damage import DAMAGES, Damage, Rng, damaged, long_line, nest
from tests.hostile.examples import Example
from tests.hostile.places import is_text, misplaced
from tests.hostile.silence import changes, cuts, skipped

MOST_PROBLEMS = 102
"""Number of problems of a file that a message may list at most."""
LONGEST = 2_000
"""Number of characters of a problem."""
Read = Callable[[Path], fga.Network]
"""Function that reads the file, or the folder, with which a format begins."""


def short_line(rng: Rng, name: str, content: bytes) -> bytes:
    """Append a line of 20 000 characters."""
    return content + b"\n" + (b"1," if rng.random() < 0.5 else b"x") * 10_000


SHORT: tuple[Damage, ...] = (*(d for d in DAMAGES if d not in (long_line, nest)), short_line)
"""Damages that leave a file short, so that hundreds of them take seconds."""


def faults_of(
    error: fga.InputError,
    files: dict[str, bytes],
    whole: dict[str, bytes],
    *,
    folder: str = "",
    options: Collection[str] = (),
) -> list[str]:
    """Return what is wrong with an error: problems without a place, too many, too long.

    Args:
        error: the error.
        files: contents as they were read.
        whole: contents of the undamaged files.
        folder: name of the folder, where the reader begins with it.
        options: options of the reader, which a problem may be about.
    """
    out = []
    if len(error.problems) > MOST_PROBLEMS * len(files):
        out.append(f"lists {len(error.problems)} problems")
    for p in error.problems:
        if len(str(p)) > LONGEST:
            out.append(f"has {len(str(p))} characters: {p}"[:200])
        if fault := misplaced(p, files, whole, folder=folder, options=options):
            out.append(f"{fault}: {p}"[:300])
    return out


def judge(
    read: Read,
    files: dict[str, bytes],
    begin: str,
    folder: Path,
    *,
    seed: int,
    count: int = 200,
    options: Collection[str] = (),
) -> tuple[int, int]:
    """Read damaged files; return how many were read and how many refused.

    Args:
        read: the reader.
        files: contents by name.
        begin: the file with which the reader begins; empty: the folder.
        folder: where the damaged files are written.
        seed: seed of the damage.
        count: number of damaged sets of files.
        options: options of the reader, which a problem may be about.
    """
    good = refused = 0
    for i in range(count):
        rng = np.random.default_rng([i, seed])
        here = folder / "damaged"
        done = f"{i} {damaged(rng, files, here, damages=SHORT)}"
        now = {p.name: p.read_bytes() for p in here.iterdir()}
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                network = read(here / begin)
        except fga.InputError as error:
            whole = "" if begin else here.name
            faults = faults_of(error, now, files, folder=whole, options=options)
            assert error.problems and not faults, (done, faults[:5])
            refused += 1
        except Exception as error:
            raise AssertionError(f"{done}: {error!r}") from error
        else:
            assert isinstance(network, fga.Network), done
            for p in network.points.values():
                assert not np.isinf(p.coordinates).any(), done
            assert np.isfinite(network.images.columns()[2]).all(), done
            good += 1
        shutil.rmtree(here)
    assert refused > count // 4, "the damage does no harm"
    return good, refused


def hear(
    read: Read,
    files: dict[str, bytes],
    begin: str,
    folder: Path,
    *,
    example: Example,
    seed: int,
    count: int,
    options: Collection[str] = (),
) -> list[str]:
    """Change single words, lines and names; return what the reader passes over in silence.

    Args:
        read: the reader.
        files: contents by name.
        begin: the file with which the reader begins; empty: the folder.
        folder: an empty folder.
        example: the files, for what their format declares as not read.
        seed: seed of the choice of changes.
        count: number of changes of each file at most.
        options: options of the reader, which a problem may be about.
    """
    rng = np.random.default_rng(seed)
    for name, content in files.items():
        (folder / name).write_bytes(content)
    before, out = read(folder / begin), []
    for name, content in files.items():
        if not is_text(content):
            for data in cuts(rng, content, count // 10):
                (folder / name).write_bytes(data)
                try:
                    read(folder / begin)
                    out.append(f"{name}: {len(data)} of {len(content)} bytes are read")
                except fga.InputError as error:
                    now = {**files, name: data}
                    out += faults_of(error, now, files, folder=folder.name, options=options)[:1]
            (folder / name).write_bytes(content)
            continue
        every = list(changes(name, content.decode()))
        if example.open_names:
            every = [c for c in every if c.way in ("value", "word", "line")]
        chosen = rng.permutation(len(every))[:count].tolist()
        for c in (every[i] for i in chosen):
            said = f"{name}|{c.way}|{c.word}|{c.row.strip()}"
            now = {**files, name: c.text.encode()}
            (folder / name).write_bytes(now[name])
            try:
                fault = skipped(before, c, read(folder / begin))
            except fga.InputError as error:
                whole = "" if begin else folder.name
                faults = faults_of(error, now, files, folder=whole, options=options)
                out += [f"{said}: {f}" for f in faults[:1]]
            else:
                if fault and not example.declares(said, lost="lost" in fault):
                    out.append(f"{said}: {fault}")
        (folder / name).write_bytes(content)
    return out


if __name__ == "__main__":
    from tests.hostile.formats import FORMATS, OPTIONS

    n = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    first = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    wrong = 0
    for title in sys.argv[3:] or FORMATS:
        form = FORMATS[title]
        with tempfile.TemporaryDirectory() as made:
            at = Path(made)
            (at / "made").mkdir()
            contents = form.files(at / "made")
            (at / "changed").mkdir()
            lost = hear(
                *(form.reads, contents, form.begin, at / "changed"),
                example=form,
                seed=first,
                count=3 * n,
                options=OPTIONS,
            )
            for line in lost[:20]:
                print("   ", line)
            try:
                told_of = judge(
                    *(form.reads, contents, form.begin, at),
                    seed=first,
                    count=n,
                    options=OPTIONS,
                )
                print(f"{title}: {told_of[0]} read, {told_of[1]} refused, {len(lost)} passed over")
            except AssertionError as fault:
                print(f"{title}: FAULT {fault}", flush=True)
                wrong += 1
            wrong += len(lost)
    sys.exit(min(wrong, 1))
