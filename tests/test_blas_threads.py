"""Every public computation runs with one BLAS thread, and leaves the process as it was."""

from __future__ import annotations

import inspect
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from types import FrameType

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

import factorgraph_adj as fga
from factorgraph_adj.blas_threads import numbers_of_threads, one_thread, with_one_thread
from factorgraph_adj.observations import SlopeDistance
from factorgraph_adj.quality.reliability import Reliability
from factorgraph_adj.solve.solution import Solution
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

KERNELS = {
    "factor",
    "fronts",
    "leverage",
    "normal",
    "ray_leverage",
    "reduction",
    "root",
    "triangular",
}
"""Modules of `factorgraph_adj.solve` in which matrices are large."""
ASKED = {"number", "save", "normal", "at", "forget", "row", "factor"}
"""Methods that compute nothing, or need something that the network has not."""


@pytest.fixture(autouse=True)
def two_threads():
    with threadpool_limits(limits=2):
        if set(numbers_of_threads()) != {2}:
            pytest.skip("these BLAS libraries have one thread")
        yield


@pytest.mark.parametrize("name", COMPUTATIONS)
def test_a_computation_has_one_thread_and_gives_the_others_back(name, monkeypatch) -> None:
    seen = set()
    original = fga.solve.normal_equations.NormalEquations.factorise

    def looked(self, *args, **kwargs):
        seen.add(numbers_of_threads())
        return original(self, *args, **kwargs)

    monkeypatch.setattr(fga.solve.normal_equations.NormalEquations, "factorise", looked)
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


def with_more_threads(compute: Callable[[], object]) -> set[str]:
    """Return the functions of kernels that a computation calls while BLAS has several threads."""
    threads: dict[str, bool] = {}

    def called(frame: FrameType, event: str, _: object) -> None:
        file = Path(frame.f_code.co_filename)
        if event == "call" and file.stem in KERNELS and file.parent.name == "solve":
            name = f"{file.stem}.{frame.f_code.co_name}"
            if name not in threads:
                threads[name] = set(numbers_of_threads()) != {1}

    sys.setprofile(called)
    try:
        compute()
    finally:
        sys.setprofile(None)
    return {name for name, several in threads.items() if several}


def questions(kind: type, arguments: dict[str, tuple[object, ...]]) -> list[str]:
    """Return the names of what a result can be asked: properties, methods with known arguments."""
    out = []
    for name, member in vars(kind).items():
        if name.startswith("_") or (callable(member) and name in ASKED):
            continue
        if isinstance(member, (property, cached_property)):
            out.append(name)
        elif inspect.isfunction(member):
            needed = [
                p
                for p in list(inspect.signature(member).parameters.values())[1:]
                if p.default is p.empty and p.kind is not p.VAR_KEYWORD
            ]
            assert not needed or name in arguments, f"say in this test how {name} is asked"
            out.append(name)
    return out


def test_what_results_compute_when_they_are_asked_has_one_thread_too() -> None:
    network = small_block()
    solution = fga.adjust(network)
    rel = fga.reliability(solution)
    point = next(p for p, e in network.points.items() if not any(e.fixed))
    photo, camera = next(iter(network.photos)), next(iter(network.cameras))
    state = solution.state
    arguments: dict[str, tuple[object, ...]] = {
        **dict.fromkeys(("point", "covariance", "standard_deviations"), (point,)),
        **dict.fromkeys(("pose", "pose_covariance"), (photo,)),
        **dict.fromkeys(("orientation", "vertical", "distance_meter"), ("",)),
        "calibration": (camera,),
        "unknown": ("point", point),
        "variable_covariance": (("point", point),),
        "normal_at": (state,),
        "cofactor_times": (solution.normal().gradient[:, None],),
        "effect_on": (int(rel.controlled.argmax()),),
        "correlation": ([0, 1],),
        "correlations_with": (np.array([0, 1]),),
    }
    asked = 0
    for made, kind in (
        (lambda: replace(solution), Solution),
        (lambda: replace(rel, solution=replace(solution)), Reliability),
    ):
        for name in questions(kind, arguments):
            fresh = made()

            def ask(of=fresh, name=name) -> None:
                answer = getattr(of, name)
                if callable(answer):
                    with suppress(fga.InputError):  # nothing of that kind in the network
                        answer(*arguments.get(name, ()))

            assert not with_more_threads(ask), f"{kind.__name__}.{name}"
            asked += 1
    assert asked > 40
    constraint = solution.run.constraint, solution.datum
    assert with_more_threads(lambda: solution.normal().for_covariances(*constraint))
