"""The folder of a run holds arrays and JSON: reading it runs no code of whoever wrote it."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.parts.part_files import RunFolder, read_part, write_part
from factorgraph_adj.parts.whole_network import cut_network
from factorgraph_adj.start.start_values import approximate_start
from tests.networks import simulated

RUN: list[str] = []
"""What code in a file has done."""


class _Code:
    """An object whose pickle runs code when it is read."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return RUN.append, ("run",)


def test_a_run_writes_arrays_and_json_alone(tmp_path: Path) -> None:
    fga.adjust_parts(
        cut_network(simulated.levelling(), 2, RunFolder(tmp_path)), folder=tmp_path / "r"
    )
    files = [p for p in tmp_path.rglob("*") if p.is_file()]
    assert {p.suffix for p in files} == {".npz", ".json"}
    for path in (p for p in files if p.suffix == ".npz"):
        with np.load(path, allow_pickle=False) as stored:
            assert all(stored[name].dtype.kind != "O" for name in stored.files)


def test_a_part_reads_back_to_the_bit(tmp_path: Path) -> None:
    network = simulated.levelling()
    start = approximate_start(compile_network(network), "given", None)
    write_part(RunFolder(tmp_path), network, start)
    again, begun = read_part(RunFolder(tmp_path))
    assert again.points == network.points
    assert list(again.observations.values()) == list(network.observations.values())
    for mine, other in ((start.state, begun.state), (start.origin, begun.origin)):
        for kind, values in mine.items():
            np.testing.assert_array_equal(other[kind], values)


@pytest.mark.parametrize("of", ["network", "setup", "stamp"])
def test_pickles_of_earlier_versions_are_refused_and_not_run(of: str, tmp_path: Path) -> None:
    (tmp_path / f"{of}.pickle").write_bytes(pickle.dumps(_Code()))
    folder = RunFolder(tmp_path)
    with pytest.raises(fga.InputError, match="earlier version, whose pickled objects could run"):
        folder.arrays(of) if of == "network" else folder.read(of)
    assert not RUN
    np.savez(tmp_path / "network.npz", header=np.array([_Code()], dtype=object))
    RUN.clear()
    with pytest.raises(fga.InputError, match="is damaged"):
        read_part(folder)
    assert not RUN
