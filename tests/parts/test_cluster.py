"""Parts on a local Dask cluster: the same result, also when a worker is killed."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.parts import workers
from factorgraph_adj.parts.part_files import RunFolder, read_part
from factorgraph_adj.parts.whole_network import cut_network
from tests.benchmarks.grids import simulate_grid
from tests.support.cluster import local_client

distributed = pytest.importorskip("distributed", reason="the extra cluster is not installed")


@pytest.fixture(scope="module")
def client() -> Iterator[object]:
    """A client of a cluster that repeats what a worker died of, once."""
    with local_client(allowed_failures=1) as made:
        yield made


@dataclass(frozen=True)
class Deadly:
    """Reads a part; the first process that does so dies."""

    path: Path
    """A stored part."""
    died: Path
    """A file that says that a process has died."""
    always: bool = False
    """Whether every process dies."""

    def __call__(self) -> fga.Network:
        if self.always or not self.died.exists():
            self.died.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        network, _ = read_part(RunFolder(self.path))
        return network


@pytest.mark.slow(
    "networks in parts on a cluster of processes; short tests adjust parts in this process"
)
def test_a_network_on_a_cluster_has_the_result_of_its_parts_to_the_last_bit(client, tmp_path):
    network = simulate_grid(1, points=144).network
    found = fga.adjust(network, client=client, folder=tmp_path)
    assert len(found.jobs) == 4  # two for each worker
    assert found.name == network.name
    parts = cut_network(network, 4, RunFolder(tmp_path / "here"))
    here = fga.adjust_parts(parts, folder=tmp_path / "here")
    assert found.vtpv == here.vtpv
    assert found.received == here.received
    for (_, a), (_, b) in zip(found.results(), here.results(), strict=True):
        np.testing.assert_array_equal(a.state["point"], b.state["point"])
        np.testing.assert_array_equal(a.redundancy_numbers, b.redundancy_numbers)


@pytest.mark.slow(
    "networks in parts on a cluster of processes; short tests adjust parts in this process"
)
def test_a_killed_worker_changes_nothing(client, tmp_path):
    network = simulate_grid(1, points=144).network
    stored = cut_network(network, 3, RunFolder(tmp_path))
    here = fga.adjust_parts(stored, folder=tmp_path / "here")
    parts = [
        *stored[:2],
        fga.Part("deadly", Deadly(stored[2].load.path, tmp_path / "died")),
    ]
    found = fga.adjust_parts(parts, client=client, folder=tmp_path / "there")
    assert (tmp_path / "died").exists()
    assert found.vtpv == pytest.approx(here.vtpv, rel=1e-12)
    for name in network.points:
        np.testing.assert_allclose(found.point(name), here.point(name), rtol=0, atol=1e-12)


@pytest.mark.slow(
    "networks in parts on a cluster of processes; short tests adjust parts in this process"
)
def test_a_part_that_kills_every_worker_is_named(client, tmp_path):
    network = simulate_grid(1, points=36).network
    stored = cut_network(network, 2, RunFolder(tmp_path))
    deadly = Deadly(stored[1].load.path, tmp_path / "died", always=True)
    with pytest.raises(fga.AdjustmentError, match="part 'deadly': every worker that computed it"):
        fga.adjust_parts([stored[0], fga.Part("deadly", deadly)], client=client)


def test_a_cluster_without_workers_is_refused(monkeypatch):
    monkeypatch.setattr(workers, "CONNECTION_TIMEOUT", "0.3s")
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=":0") as cluster,
        distributed.Client(cluster) as client,
        pytest.raises(fga.InputError, match=r"no workers after 0\.3s: start some with dask worker"),
    ):
        fga.adjust(simulate_grid(1, points=36).network, client=client)
    with pytest.raises(fga.InputError, match="the client of the Dask cluster is closed"):
        fga.adjust(simulate_grid(1, points=36).network, client=client)


@pytest.mark.slow(
    "networks in parts on a cluster of processes; short tests adjust parts in this process"
)
def test_what_parts_cannot_do_is_refused(client):
    network = simulate_grid(1, points=36).network
    with pytest.raises(fga.InputError, match="with a client there is no start, weights"):
        fga.adjust(network, client=client, start=fga.adjust(network), weights=np.ones(3))
    with pytest.raises(fga.InputError, match="needs a given datum"):
        fga.adjust(network, client=client, datum="free")
    with pytest.raises(fga.InputError, match="regions and folder belong to client"):
        fga.adjust(network, regions=3)
    with pytest.raises(fga.InputError, match=r"synchronous distributed\.Client of Dask, not str"):
        fga.adjust(network, client="tcp://here:8786")
