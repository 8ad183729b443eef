"""Every public computation runs with one BLAS thread, and leaves the process as it was."""

from __future__ import annotations

import threading

import pytest
from threadpoolctl import threadpool_limits

import factorgraph_adj as fga
from factorgraph_adj.blas_threads import numbers_of_threads, one_thread, with_one_thread
from factorgraph_adj.observations import SlopeDistance
from tests.networks.small_block import small_block

COMPUTATIONS = {
    "adjust": fga.adjust,
    "reliability": lambda n: fga.reliability(fga.adjust(n)),
    "snoop": fga.snoop,
    "robust_adjust": fga.robust_adjust,
    "estimate_variance_components": fga.estimate_variance_components,
    "causes": lambda n: fga.causes(fga.reliability(fga.adjust(n))),
    "build_graph": fga.build_graph,
    "IncrementalAdjustment": lambda n: fga.IncrementalAdjustment(n).settle(),
}


@pytest.fixture(autouse=True)
def two_threads():
    with threadpool_limits(limits=2):
        if set(numbers_of_threads()) != {2}:
            pytest.skip("these BLAS libraries have one thread")
        yield


@pytest.mark.parametrize("name", COMPUTATIONS)
def test_a_computation_has_one_thread_and_gives_the_others_back(name, monkeypatch) -> None:
    seen = set()
    original = fga.solve.normal.NormalEquations.factorise

    def looked(self, *args, **kwargs):
        seen.add(numbers_of_threads())
        return original(self, *args, **kwargs)

    monkeypatch.setattr(fga.solve.normal.NormalEquations, "factorise", looked)
    COMPUTATIONS[name](small_block())
    assert seen <= {(1,) * len(numbers_of_threads())}
    assert seen or name == "build_graph"
    assert set(numbers_of_threads()) == {2}


def test_an_error_gives_them_back() -> None:
    network = fga.Network("loose")
    network.add_point("A", (0.0, 0.0, 0.0))
    network.add_point("B", (1.0, 0.0, 0.0))
    network.add(SlopeDistance("A", "B", 1.0, sigma=0.001))
    with pytest.raises(fga.AdjustmentError):
        fga.adjust(network)
    assert set(numbers_of_threads()) == {2}


def test_computations_inside_others_and_in_other_threads_leave_the_process_as_it_was() -> None:
    inside, go_on = threading.Event(), threading.Event()

    @with_one_thread
    def waits() -> None:
        inside.set()
        go_on.wait(10.0)

    other = threading.Thread(target=waits)
    with one_thread:
        other.start()
        assert inside.wait(10.0)
        with one_thread:
            assert set(numbers_of_threads()) == {1}
    assert set(numbers_of_threads()) == {2}  # though the other one is still at work
    go_on.set()
    other.join()
    assert set(numbers_of_threads()) == {2}
