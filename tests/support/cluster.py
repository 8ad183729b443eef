"""A Dask cluster on this machine, however busy the machine is."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from tests.support.processes import HANGS


@contextmanager
def local_client(*, allowed_failures: int) -> Iterator[object]:
    """Start a cluster of two processes; give a client of it.

    A worker that is slow on a busy machine is not taken for dead.

    Args:
        allowed_failures: number of workers that may die of a task before it is not repeated.
    """
    dask = pytest.importorskip("dask")
    distributed = pytest.importorskip("distributed", reason="the extra cluster is not installed")
    settings = {
        "distributed.scheduler.allowed-failures": allowed_failures,
        "distributed.scheduler.worker-ttl": None,
        "distributed.comm.timeouts.connect": HANGS,
        "distributed.comm.timeouts.tcp": HANGS,
    }
    with (
        dask.config.set(settings),
        distributed.LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            processes=True,
            dashboard_address=":0",
            silence_logs=50,
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client
