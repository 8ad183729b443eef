"""Experiments: the same table whoever computes it, whatever interrupts it; and what it says."""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats
from threadpoolctl import threadpool_limits

from factorgraph_adj.blas_threads import numbers_of_threads
from factorgraph_adj.errors import InputError
from factorgraph_adj.experiment.repetitions import (
    DIED,
    REPETITIONS_IN_ADVANCE,
    Outcome,
    Repetition,
    Task,
    on_cluster,
    repeat,
)
from factorgraph_adj.experiment.repetitions import _serve as serve
from factorgraph_adj.experiment.runs import Experiment, Results, run
from tests.support import journals, trials
from tests.support.cluster import local_client
from tests.support.places import ROOT
from tests.support.processes import HANGS

LONG = pytest.mark.slow(
    "an experiment in a process that is killed; short tests run and resume in one process"
)

SEED = 1981
ROUNDING = 1e-12

NORMAL = Experiment("normal", trials.normal, {"size": [1, 4]}, SEED)
EVERY = Experiment(
    "every case",
    trials.every_case,
    {"kind": ["slow", "odd", "fails"], "size": [(3, 0.1), (150, math.inf), (150, 1.0)]},
    SEED,
)
SEVERAL = 4
"""Repetitions of `STEPS_PER_TRIAL`."""
PINNED = (110541168522967, 147240792056152)
"""Seeds of repetition 3 at size 4: common to all cells, and the cell's own."""
PRINTED = """\
heights: intervals of 95 % confidence
1 of 6 repetitions failed
  1 × DatumError: no datum (first with seed 2, layout = none)

height
  layout  n  failed  mean   from    to  std. dev.   from    to   RMS
  ------------------------------------------------------------------
  dense   3       0  2.00  -0.48  4.48       1.00  0.521  6.28  2.16
  none    2       1  11.5   -1.2  24.2       1.41  0.631  45.1  11.5"""


@pytest.fixture(scope="module")
def alone() -> Results:
    """`STEPS_PER_TRIAL`, computed in this process."""
    return run(EVERY, SEVERAL)


@pytest.fixture(scope="module")
def client() -> Iterator[object]:
    """A client of a cluster that believes a worker's death at once."""
    with local_client(allowed_failures=0) as made:
        yield made


def environment() -> dict[str, str]:
    """Return the environment of a script that imports what the tests import."""
    return os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}


def lines(path: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


# -- the same results -----------------------------------------------------------------------------


@pytest.mark.slow(
    "processes and clusters of their own are started; short tests run repetitions in this process"
)
def test_two_processes_give_the_same_table_as_one(alone, tmp_path):
    out = tmp_path / "study.jsonl"
    results = run(EVERY, SEVERAL, out=out, processes=2)
    assert results.table() == alone.table()
    assert len(alone.rows) == 9 * SEVERAL and 0 < len(alone.failed) < 3 * SEVERAL
    assert run(EVERY, SEVERAL, out=out, processes=2).table() == alone.table()  # from the file


@pytest.mark.slow(
    "processes and clusters of their own are started; short tests run repetitions in this process"
)
def test_what_is_finished_first_is_written_first_and_stands_in_its_place(tmp_path):
    """The first repetition ends once another one is written, whenever that one starts."""
    out = tmp_path / "study.jsonl"
    first = Experiment("seeds", trials.normal, seed=SEED).seed_of({}, 0)
    experiment = Experiment(
        "order", trials.waits_for_another, {"out": [str(out)], "first": [first]}, SEED
    )
    results = run(experiment, 4 * REPETITIONS_IN_ADVANCE, out=out, processes=2)
    written = [r["repetition"] for r in lines(out)[1:]]
    assert (
        written[0] >= REPETITIONS_IN_ADVANCE
    )  # the others of the first process wait behind the first repetition
    assert sorted(written) == list(range(4 * REPETITIONS_IN_ADVANCE))
    assert [r.repetition for r in results.rows] == list(range(4 * REPETITIONS_IN_ADVANCE))
    assert not results.failed


@pytest.fixture
def one_worker_here():
    """Leave signals and threads of this process as they are, which a worker changes."""
    interrupt = signal.getsignal(signal.SIGINT)
    threads = threadpool_limits(limits=None)
    yield
    signal.signal(signal.SIGINT, interrupt)
    threads.restore_original_limits()


def test_a_worker_serves_what_arrives_until_nothing_does(one_worker_here):
    """A worker in this process; a thread stands for the one that asked for the run."""
    ours, theirs = multiprocessing.Pipe()
    said = []

    def ask() -> None:
        said.append(ours.recv())
        for seed in (3, 5):
            ours.send(Task(0, 0, seed))
            said.append(ours.recv())
        ours.close()

    asking = threading.Thread(target=ask)
    asking.start()
    serve(theirs, pickle.dumps((trials.normal, ({"size": 4},))))
    asking.join()
    began, *outcomes = said
    assert began == ""
    assert [o.figures for o in outcomes] == [trials.normal(3, 4), trials.normal(5, 4)]


def test_a_worker_that_does_not_find_the_trial_says_so(one_worker_here):
    ours, theirs = multiprocessing.Pipe()
    serve(theirs, b"no pickle")
    assert ours.recv().startswith("UnpicklingError: ")


@pytest.mark.slow(
    "that processes of a cluster have the table of one process; short tests compare threads"
)
def test_a_dask_cluster_gives_the_same_table(alone, client, tmp_path):
    out = tmp_path / "study.jsonl"
    half = run(EVERY, SEVERAL // 2, out=out, client=client)
    assert len(half.rows) == len(alone.rows) // 2
    assert run(EVERY, SEVERAL, out=out, client=client).table() == alone.table()
    assert run(EVERY, SEVERAL, out=out).table() == alone.table()


def test_blas_has_one_thread_here_too():
    with threadpool_limits(limits=2):
        before = numbers_of_threads()
        (row,) = run(Experiment("threads", trials.threads), 1).rows
        assert list(row.figures.values()) == [1.0] * len(before)
        assert numbers_of_threads() == before


@pytest.mark.slow(
    "processes and clusters of their own are started; short tests run repetitions in this process"
)
def test_a_worker_that_ends_is_one_failed_repetition(tmp_path):
    ends = Experiment("seeds", trials.normal, seed=SEED).seed_of({}, 5)
    experiment = Experiment("ends", trials.sometimes_ends, {"ends": [ends, -1]}, SEED)
    out = tmp_path / "study.jsonl"
    results = run(experiment, 12, out=out, processes=2)
    (bad,) = results.failed
    assert (bad.seed, bad.repetition, bad.error) == (ends, 5, DIED)
    assert bad.message == "the process that ran it ended with exit code 7"
    plain = run(Experiment("normal", trials.normal, seed=SEED), 12)
    expected = plain.values("offset")
    assert np.array_equal(results.values("offset", ends=-1), expected)
    expected[5] = math.nan
    assert np.array_equal(results.values("offset", ends=ends), expected, equal_nan=True)
    assert run(experiment, 12, out=out).table() == results.table()  # or this would end here


@pytest.mark.slow(
    "processes and clusters of their own are started; short tests run repetitions in this process"
)
@pytest.mark.filterwarnings("default")  # Dask warns of its own worker's death
def test_a_cluster_worker_that_ends_is_one_failed_repetition(client):
    ends = Experiment("seeds", trials.normal, seed=SEED).seed_of({}, 5)
    results = run(
        Experiment("ends", trials.sometimes_ends, {"ends": [ends]}, SEED), 12, client=client
    )
    (bad,) = results.failed
    assert (bad.seed, bad.repetition, bad.error) == (ends, 5, DIED)
    plain = run(Experiment("normal", trials.normal, seed=SEED), 12).values("offset")
    good = np.arange(12) != 5
    assert np.array_equal(results.values("offset")[good], plain[good])


class LostOnce:
    """A future whose result is lost with its worker when it is looked at, and computed again."""

    def __init__(self, outcome: Outcome) -> None:
        self._states = iter(("lost", "pending"))
        self.result = lambda: outcome

    @property
    def status(self) -> str:
        return next(self._states, "finished")


class LosingClient:
    """As much of a client as repetitions need; its first repetition is lost."""

    def nthreads(self) -> dict[str, int]:
        return {"worker": 2}

    def submit(self, function: Callable[..., object], *arguments: object, pure: bool) -> object:
        outcome = function(*arguments)
        return LostOnce(outcome) if isinstance(outcome, Outcome) else SimpleNamespace(result=bool)


class Arriving(list):
    """Futures in the order in which they were added."""

    add = list.append

    def __next__(self) -> object:
        return self.pop(0)


def test_a_result_that_is_lost_with_its_worker_is_waited_for_again(monkeypatch):
    """It was finished when the worker lived, which depends on who is sooner."""
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(distributed, "as_completed", Arriving)
    tasks = [Task(0, k, k) for k in range(3)]
    found = dict(on_cluster(LosingClient(), trials.normal, [{}], tasks))
    assert {t: o.figures for t, o in found.items()} == {t: trials.normal(t.seed) for t in tasks}


# -- seeds ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("common", [True, False])
def test_more_levels_and_repetitions_leave_seeds_as_they_were(common):
    small = Experiment("x", trials.normal, {"size": [4, 9]}, SEED, common=common)
    large = replace(small, factors={"size": np.array([1, 9, 2, 4])})
    seeds = {
        (r.levels["size"], r.repetition): r.seed for r in run(large, 5).rows if r.repetition < 3
    }
    for row in run(small, 3).rows:
        assert seeds[row.levels["size"], row.repetition] == row.seed
    assert len(set(seeds.values())) == (3 if common else 12)


def test_a_seed_follows_from_values_alone():
    own = Experiment("x", trials.normal, {"size": [4]}, SEED, common=False)
    for same in (4.0, np.int64(4), np.float32(4)):
        other = replace(own, factors={"size": [1, same]})
        assert other.seed_of(other.combinations[1], 7) == own.seed_of(own.combinations[0], 7)
    assert own.seed_of({"a": 1, "b": 2}, 0) == own.seed_of({"b": 2, "a": 1}, 0)
    different = [{"a": 1}, {"a": True}, {"a": "1"}, {"a": None}, {"a": (1,)}, {"b": 1}, {"a": 1.5}]
    assert len({own.seed_of(levels, 0) for levels in different}) == len(different)


def test_seeds_are_those_of_earlier_versions():
    """Or no file of an earlier version could be resumed."""
    experiment = Experiment("x", trials.normal, {"size": [4]}, SEED)
    drawn = np.random.SeedSequence(SEED, spawn_key=(3,)).generate_state(1, np.uint64)[0]
    assert experiment.seed_of({"size": 4}, 3) == int(drawn) // 2**16 == PINNED[0]
    assert replace(experiment, common=False).seed_of({"size": 4}, 3) == PINNED[1]


# -- interrupted and resumed ----------------------------------------------------------------------

STUDY = """
import sys
from tests.support import trials
from factorgraph_adj.experiment.runs import Experiment, run

def tell(done, total):
    if done == 15:
        print("well on its way", flush=True)
    if done == 1000:
        sys.stdin.read()  # a fast machine waits to be killed

if __name__ == "__main__":
    run(
        Experiment("waits", trials.waits, seed=3),
        2000,
        out=sys.argv[1],
        processes=2,
        progress=tell,
    )
"""


@LONG
def test_a_killed_run_resumes(tmp_path):
    out, script = tmp_path / "study.jsonl", tmp_path / "study.py"
    script.write_text(STUDY, encoding="utf-8")
    env = environment()
    process = subprocess.Popen(
        [sys.executable, str(script), str(out)],
        env=env,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    with process:
        assert process.stdout is not None
        assert process.stdout.readline() == "well on its way\n"
        process.send_signal(signal.SIGKILL)
    kept = out.read_bytes().count(b"\n") - 1
    experiment = Experiment("waits", trials.waits, seed=3)
    calls: list[tuple[int, int]] = []
    results = run(experiment, kept + 5, out=out, progress=lambda *now: calls.append(now))
    # Two processes finish in another order than they begin: a few of the first may be left.
    assert kept >= 14 and 5 <= len(calls) - 1 <= 5 + 8
    assert calls[-1] == (kept + 5, kept + 5)
    assert results.table() == run(experiment, kept + 5).table()


def test_an_interruption_leaves_a_file_that_resumes(tmp_path):
    out = tmp_path / "study.jsonl"

    def interrupt(done: int, total: int) -> None:
        if done == 3:
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        run(NORMAL, 4, out=out, progress=interrupt)
    assert len(lines(out)) == 4
    calls: list[tuple[int, int]] = []
    results = run(NORMAL, 4, out=out, progress=lambda *now: calls.append(now))
    assert calls == [(done, 8) for done in range(3, 9)]
    assert results.table() == run(NORMAL, 4).table()


def test_a_torn_line_is_dropped(tmp_path):
    out = tmp_path / "study.jsonl"
    table = run(NORMAL, 4, out=out).table()
    data = out.read_bytes()
    for cut in (1, 10, 40):
        out.write_bytes(data[:-cut])
        assert run(NORMAL, 4, out=out).table() == table
        assert out.read_bytes() == data


def test_repetitions_and_levels_can_be_added(tmp_path):
    out = tmp_path / "study.jsonl"
    run(NORMAL, 2, out=out)
    first = out.read_bytes()
    assert run(NORMAL, 3, out=out).table() == run(NORMAL, 3).table()
    wider = replace(NORMAL, factors={"size": [9, 4, 1.0]})
    assert run(wider, 4, out=out).table() == run(wider, 4).table()
    assert out.read_bytes().startswith(first)
    assert len(lines(out)) == 1 + 12
    assert run(wider, 1, out=out).table() == run(wider, 1).table()
    assert len(lines(out)) == 1 + 12


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": "other"}, "its name is 'normal', not 'other'"),
        ({"seed": 7}, "its seed is 1981, not 7"),
        ({"common": False}, "its common is True, not False"),
        (
            {"trial": trials.other},
            r"its trial is 'tests\.support\.trials\.normal', not 'tests\.support\.trials\.other'",
        ),
        ({"factors": {}}, r"its factors is \['size'\], not \[\]"),
        ({"factors": {"size": [2, 4]}}, "size = 1, which is no level of this .* levels: 2, 4"),
    ],
)
def test_the_file_of_another_experiment_is_refused(tmp_path, change, message):
    out = tmp_path / "study.jsonl"
    run(NORMAL, 2, out=out)
    before = out.read_bytes()
    with pytest.raises(InputError, match=message):
        run(replace(NORMAL, **change), 2, out=out)
    assert out.read_bytes() == before


def test_files_that_are_no_results_are_refused(tmp_path):
    out = tmp_path / "study.jsonl"
    journals.write(out, [{"network": {}}])
    for text, message in (
        ("size,offset\n1,2\n", "is not a journal"),
        (out.read_text(encoding="utf-8"), "not of an experiment's repetitions"),
    ):
        out.write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match=message):
            run(NORMAL, 1, out=out)
        assert out.read_text(encoding="utf-8") == text
    out.unlink()
    run(NORMAL, 1, out=out)
    header, one, two = journals.read(out)
    journals.write(out, [header, one | {"seed": 5}, {}, two])
    with pytest.raises(InputError) as raised:
        run(NORMAL, 1, out=out)
    assert [problem.where[-2:] for problem in raised.value.problems] == [":2", ":3"]
    with pytest.raises(InputError, match="its folder cannot be made"):
        run(NORMAL, 1, out=out / "study.jsonl")


def test_the_folder_of_a_file_is_made_as_that_of_a_table_is(tmp_path):
    out = tmp_path / "none" / "yet" / "study.jsonl"
    run(NORMAL, 1, out=out).write(tmp_path / "nor" / "this" / "study.csv")
    assert len(lines(out)) == 3
    assert (tmp_path / "nor" / "this" / "study.csv").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="no locks of files there")
def test_two_runs_do_not_share_a_file(tmp_path):
    out = tmp_path / "study.jsonl"

    def second(done: int, total: int) -> None:
        with pytest.raises(InputError, match="is in use already"):
            run(NORMAL, 1, out=out)

    run(NORMAL, 1, out=out, progress=second)
    assert len(lines(out)) == 3


# -- failures -------------------------------------------------------------------------------------


def test_failed_repetitions_are_recorded_and_tried_again_on_request(tmp_path, monkeypatch):
    out = tmp_path / "study.jsonl"
    broken = [2, 3]

    def fragile(seed: int) -> dict[str, float]:
        if experiment_seeds.index(seed) in broken:
            raise ZeroDivisionError("a message, with «signs»\nand lines")
        return {"value": seed / 3}

    experiment = Experiment("fragile", fragile, seed=SEED)
    experiment_seeds = [experiment.seed_of({}, k) for k in range(6)]
    first = run(experiment, 6, out=out)
    assert [(r.repetition, r.seed) for r in first.failed] == [
        (k, experiment_seeds[k]) for k in broken
    ]
    assert {(r.error, r.message) for r in first.failed} == {
        ("ZeroDivisionError", "a message, with «signs»\nand lines")
    }
    broken.clear()
    assert run(experiment, 6, out=out).table() == first.table()
    again = run(experiment, 6, out=out, retry=True)
    assert not again.failed
    assert again.table() == run(experiment, 6).table() == run(experiment, 6, out=out).table()


@pytest.mark.parametrize(
    ("returned", "error", "message"),
    [
        (None, "TypeError", "returns a mapping of names to numbers, not NoneType"),
        ({"x": "1"}, "TypeError", "figure 'x' is a number, not of type str"),
        ({"x": 1j}, "TypeError", "figure 'x' is a number, not of type complex"),
        ({"x": np.zeros(1)}, "TypeError", "figure 'x' is a number, not of type ndarray"),
        ({1: 1.0}, "TypeError", "name of a figure is a text that is not empty, not 1"),
        ({"size": 1.0}, "ValueError", "another name than 'size'; taken: size, repetition, seed"),
        ({"seed": 1.0}, "ValueError", "another name than 'seed'"),
    ],
)
def test_what_is_no_figure_is_a_failed_repetition(returned, error, message):
    outcome = repeat(lambda seed, size: returned, 1, {"size": 2})
    assert outcome.error == error and message in outcome.message and not outcome.figures


def test_numbers_of_all_kinds_are_figures():
    kinds = {"a": 1, "b": True, "c": np.float32(0.5), "d": np.int16(3), "e": np.bool_(False)}
    outcome = repeat(lambda seed: kinds, 1, {})
    assert outcome == Outcome({"a": 1.0, "b": 1.0, "c": 0.5, "d": 3.0, "e": 0.0})
    assert all(type(value) is float for value in outcome.figures.values())


def test_leaving_python_is_a_failure_and_an_interruption_is_not():
    def leave(seed: int) -> dict[str, float]:
        raise SystemExit(4) if seed else KeyboardInterrupt

    assert repeat(leave, 1, {}).error == "SystemExit"
    with pytest.raises(KeyboardInterrupt):
        repeat(leave, 0, {})


def test_a_message_that_no_file_could_hold_is_written_as_escapes(tmp_path):
    def odd(seed: int) -> dict[str, float]:
        raise ValueError("\ud800")

    assert run(Experiment("odd", odd), 1, out=tmp_path / "x").failed[0].message == "\\ud800"


# -- bad input ------------------------------------------------------------------------------------


def test_a_trial_that_cannot_be_sent_is_refused():
    def inner(seed: int) -> dict[str, float]:
        return {"x": 1.0}

    for trial in (inner, lambda seed: {"x": 1.0}):
        experiment = Experiment("x", trial)
        assert run(experiment, 1).rows[0].figures == {"x": 1.0}
        with pytest.raises(InputError, match="not a lambda or a function inside another"):
            run(experiment, 1, processes=2)


@pytest.mark.slow(
    "what a user's script, started anew by each of its processes, is told; short tests "
    "start their processes from here"
)
def test_a_trial_that_other_processes_do_not_find_is_refused_as_one_that_cannot_be_sent(tmp_path):
    """A function under the guard of a script is inside something too: processes skip that."""
    script = tmp_path / "study.py"
    script.write_text(
        "import sys\nfrom factorgraph_adj.experiment.runs import Experiment, run\n"
        'if __name__ == "__main__":\n'
        "    def local(seed):\n        return {'x': 1.0}\n"
        "    run(Experiment('x', local), 4, processes=2)\n",
        encoding="utf-8",
    )
    ran = subprocess.run(
        [sys.executable, str(script)],
        env=environment(),
        capture_output=True,
        text=True,
        check=False,
        timeout=HANGS,
    )
    last = ran.stderr.splitlines()[-1]
    assert "InputError: trial: cannot be sent to other processes" in last
    assert "not a lambda or a function inside another" in last


def test_a_cluster_is_not_given_a_trial_that_cannot_be_sent(client):
    with pytest.raises(InputError, match="not a lambda"):
        run(Experiment("x", lambda seed: {"x": 1.0}), 1, client=client)


@pytest.mark.slow(
    "what a user's script, started anew by each of its processes, is told; short tests "
    "start their processes from here"
)
def test_a_script_without_its_guard_is_told_so(tmp_path):
    script = tmp_path / "study.py"
    script.write_text(
        STUDY.replace('if __name__ == "__main__":', "if True:").replace("2000", "1"),
        encoding="utf-8",
    )
    ran = subprocess.run(
        [sys.executable, str(script), str(tmp_path / "out")],
        env=environment(),
        capture_output=True,
        text=True,
        check=False,
        timeout=HANGS,
    )
    assert ran.returncode == 1
    last = ran.stderr.splitlines()[-1]
    assert "InputError: a worker process ended before it could begin (exit code 1)" in last
    assert "if __name__ == '__main__'" in last


def test_bad_arguments_of_a_run_are_named_together():
    with pytest.raises(InputError) as raised:
        run(NORMAL, 0, processes=1.5, client="tcp://scheduler")
    assert [(p.where, p.what.split(",")[0]) for p in raised.value.problems] == [
        ("repetitions", "must be a whole number ≥ 1"),
        ("processes", "must be a whole number ≥ 1"),
        ("client", "give processes or a client"),
        ("client", "must be a distributed.Client (not an asynchronous one)"),
    ]


def test_without_dask_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"pip install 'factorgraph_adj\[cluster\]'"):
        run(NORMAL, 1, client="a client")


def test_bad_factors_are_named_together():
    factors = {
        "seed": [1],
        "size": [1, 1.0, math.nan, {2}],
        "control": "full",
        "none": [],
        "": ["a\n"],
    }
    with pytest.raises(InputError) as raised:
        Experiment("", trials.normal, factors, -1)
    assert [(p.where, p.what.split(":")[0].split(";")[0]) for p in raised.value.problems] == [
        ("name", "must be a text that is not empty"),
        ("seed", "must be a whole number ≥ 0, not -1"),
        ("factor 'seed'", "another name is needed"),
        ("factor 'size'", "NaN is no level"),
        ("factor 'size'", "{2} is of type set"),
        ("factor 'size'", "level '1.0' occurs twice"),
        ("factor 'control'", "its levels must be a list, not 'full'"),
        ("factor 'none'", "has no levels"),
        ("factor ''", "its name must be a text that is not empty"),
        ("factor ''", "'a\\n' has a character that is not printable"),
    ]


@pytest.mark.parametrize(
    ("trial", "message"),
    [
        (trials.sometimes_ends, r"called as trial\(seed, size=…\): missing .*'ends'"),
        (trials.waits, r"called as trial\(seed, size=…\): got an unexpected keyword .* 'size'"),
        (3, "must be a function, not 3"),
    ],
)
def test_a_trial_that_does_not_take_the_factors_is_refused(trial, message):
    with pytest.raises(InputError, match=message):
        Experiment("x", trial, {"size": [1]})


def test_cells_can_be_listed():
    cells = [{"kind": "a", "size": 3}, {"size": 1, "kind": "b"}]
    experiment = Experiment("x", lambda seed, kind, size: {kind: size}, cells=cells)
    assert experiment.names == ("kind", "size")
    table = run(experiment, 1).table()
    seed = experiment.seed_of({}, 0)
    assert table == (
        f"kind,size,repetition,seed,a,b,error,message\na,3,0,{seed},3.0,,,\nb,1,0,{seed},,1.0,,\n"
    )
    with pytest.raises(InputError, match="cells: occurs twice: size = 3"):
        Experiment("x", trials.normal, cells=[{"size": 3}, {"size": 3.0}])
    with pytest.raises(InputError, match="cell 2: has the factors kind; others have size"):
        Experiment("x", trials.normal, cells=[{"size": 3}, {"kind": 1}])
    with pytest.raises(InputError, match="give factors or cells, not both"):
        Experiment("x", trials.normal, {"size": [1]}, cells=[{"size": 3}])


# -- the table ------------------------------------------------------------------------------------


def test_the_table_has_all_digits(alone, tmp_path):
    header, *rows = alone.table().splitlines()
    assert header == "kind,size,repetition,seed,sum,last,nothing,low,high,minus,error,message"
    odd = alone.rows[3 * SEVERAL]
    text = f'odd,"[3, 0.1]",0,{odd.seed},{odd.figures["sum"]!r},{odd.figures["last"]!r}'
    assert rows[3 * SEVERAL] == f"{text},nan,-inf,inf,-0.0,,"
    path = tmp_path / "table.csv"
    path.write_text("old", encoding="utf-8")
    alone.write(path)
    assert path.read_text(encoding="utf-8") == alone.table()
    assert list(tmp_path.iterdir()) == [path]
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(InputError, match="cannot be written"):
        alone.write(tmp_path / "file" / "table.csv")


def test_figures_survive_the_file_to_the_last_bit(tmp_path):
    values = [math.pi, 1 / 3, 5e-324, 1.7976931348623157e308, -0.0, math.nan, math.inf, -math.inf]
    experiment = Experiment("x", lambda seed: dict(zip("abcdefgh", values, strict=True)))
    out = tmp_path / "study.jsonl"
    run(experiment, 1, out=out)
    read = np.array(list(run(experiment, 1, out=out).rows[0].figures.values()))
    assert read.tobytes() == np.array(values).tobytes()


def test_a_data_frame_has_the_same_columns(alone):
    pandas = pytest.importorskip("pandas")
    frame = alone.to_pandas()
    assert ",".join(frame.columns) == alone.table().splitlines()[0]
    assert len(frame) == len(alone.rows)
    assert np.array_equal(frame["sum"], alone.values("sum"), equal_nan=True)
    assert pandas.api.types.is_integer_dtype(frame["seed"])
    assert (frame["error"] != "").sum() == len(alone.failed)


def test_without_pandas_the_extra_is_named(alone, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match=r"pip install 'factorgraph_adj\[table\]'"):
        alone.to_pandas()


def test_values_are_chosen_by_levels(alone):
    chosen = alone.values("sum", kind="odd", size=[3, 0.1])
    assert chosen.tolist() == [
        r.figures["sum"] for r in alone.rows if r.levels == {"kind": "odd", "size": (3, 0.1)}
    ]
    for call, message in (
        (lambda: alone.values("mean"), "unknown figure 'mean'; known: sum, last"),
        (lambda: alone.values("sum", colour=1), "unknown factor 'colour'; known: kind, size"),
        (lambda: alone.values("sum", kind="x"), "unknown level 'x'; known: slow, odd, fails"),
    ):
        with pytest.raises(InputError, match=message):
            call()


# -- summaries ------------------------------------------------------------------------------------


def of_values(*values: float, **more: float) -> Results:
    """Return the results of one cell with the given values of a figure."""
    rows = [Repetition({}, k, k, {"offset": v} | more) for k, v in enumerate(values)]
    return Results("given", (), tuple(rows))


def test_intervals_are_those_of_scipy():
    values = run(NORMAL, 20).values("offset", size=4)
    row = run(NORMAL, 20).summary(confidence=0.9).of("offset", size=4)
    student = stats.ttest_1samp(values, 0.0).confidence_interval(0.9)
    assert row.mean_interval == pytest.approx(tuple(student), rel=ROUNDING)
    assert row.mean == pytest.approx(values.mean(), rel=ROUNDING)
    assert row.standard_deviation == pytest.approx(stats.tstd(values), rel=ROUNDING)
    squares = np.sum((values - values.mean()) ** 2)
    low, high = stats.chi2(19).interval(0.9)
    expected = (math.sqrt(squares / high), math.sqrt(squares / low))
    assert row.standard_deviation_interval == pytest.approx(expected, rel=ROUNDING)
    assert row.rms == pytest.approx(np.linalg.norm(values) / math.sqrt(20), rel=ROUNDING)
    assert (row.n, row.n_failed, row.n_missing) == (20, 0, 0)


def test_intervals_hold_the_truth_as_often_as_they_say():
    """Of 1 500 experiments with 6 repetitions; binomial bounds at 99.9 % for each figure."""
    experiments, confidence = 1500, 0.8
    draws = np.random.default_rng(SEED).normal(5.0, 2.0, (experiments, 6))
    of_mean = of_deviation = 0
    for values in draws:
        (row,) = of_values(*values).summary(confidence=confidence).rows
        of_mean += row.mean_interval[0] <= 5.0 <= row.mean_interval[1]
        of_deviation += (
            row.standard_deviation_interval[0] <= 2.0 <= row.standard_deviation_interval[1]
        )
    low, high = stats.binom(experiments, confidence).interval(0.999)
    assert low <= of_mean <= high
    assert low <= of_deviation <= high


def test_too_few_values_have_no_interval():
    (row,) = of_values(3.0).summary().rows
    assert (row.mean, row.rms, row.n) == (3.0, 3.0, 1)
    nothing = (row.standard_deviation, *row.mean_interval, *row.standard_deviation_interval)
    assert all(map(math.isnan, nothing))
    (row,) = of_values(math.nan).summary().rows
    assert (row.n, row.n_missing) == (0, 1) and math.isnan(row.mean) and math.isnan(row.rms)


def test_equal_values_do_not_scatter():
    (row,) = of_values(*[0.1] * 10).summary().rows
    assert (row.mean, row.mean_interval, row.standard_deviation) == (0.1, (0.1, 0.1), 0.0)
    assert row.standard_deviation_interval == (0.0, 0.0)


def test_what_does_not_count_is_counted(alone):
    summary = alone.summary()
    row = summary.of("high", kind="odd", size=(3, 0.1))
    assert (row.n, row.n_missing, row.n_failed) == (0, SEVERAL, 0)
    rows = [r for r in summary.rows if r.figure == "sum" and r.levels["kind"] == "fails"]
    assert sum(r.n_failed for r in rows) == len(alone.failed) == summary.n_failed
    assert all(r.n + r.n_missing + r.n_failed == SEVERAL for r in summary.rows)


def test_a_summary_is_found_by_its_levels(alone):
    summary = alone.summary()
    for call, message in (
        (lambda: summary.of("mean"), "unknown figure 'mean'; known: sum, last"),
        (lambda: summary.of("sum", colour=1), "unknown factor 'colour'; known: kind, size"),
        (lambda: summary.of("sum", kind="odd"), "3 cells have kind = odd; cells: kind = slow"),
        (lambda: summary.of("sum", kind="x"), "no cell has kind = x; cells"),
        (lambda: alone.summary(confidence=95), "confidence must be between 0 and 1, not 95"),
    ):
        with pytest.raises(InputError, match=message):
            call()


def test_a_summary_reads_as_a_table():
    rows = [
        Repetition({"layout": name}, k, k, {"height": value})
        for name, values in {"dense": (1.0, 2.0, 3.0), "none": (10.5, 12.5)}.items()
        for k, value in enumerate(values)
    ]
    rows.append(Repetition({"layout": "none"}, 2, 2, {}, "DatumError", "no datum"))
    text = str(Results("heights", ("layout",), tuple(rows)).summary())
    assert text == PRINTED


def test_a_summary_says_why_repetitions_failed():
    """Each message once with the seed of the first; three of them, long ones cut."""
    messages = ["a", "b", "a", "c\nd", "e", "f", "x" * 500]
    rows = [Repetition({}, k, 10 + k, {}, "Oops", m) for k, m in enumerate(messages)]
    summary = Results("bad", (), tuple(rows)).summary()
    assert [(f.message, f.n, f.seed) for f in summary.failures[:2]] == [("a", 2, 10), ("b", 1, 11)]
    assert str(summary).splitlines() == [
        "bad: intervals of 95 % confidence",
        "7 of 7 repetitions failed",
        "  2 × Oops: a (first with seed 10)",
        "  1 × Oops: b (first with seed 11)",
        "  1 × Oops: c d (first with seed 13)",
        "  … and 3 other messages",
    ]
    (last,) = str(Results("bad", (), (rows[-1],)).summary()).splitlines()[2:]
    assert last == f"  1 × Oops: {'x' * 199}… (first with seed 16)"


def test_a_trial_that_returns_nothing_is_named_in_the_summary():
    text = str(run(Experiment("bad", lambda seed: None), 2).summary())
    assert "2 × TypeError: a trial returns a mapping of names to numbers, not NoneType" in text


# -- a real one -----------------------------------------------------------------------------------


@pytest.mark.slow("a whole study of adjustments; short tests repeat trials that only draw numbers")
def test_distances_make_the_industry_block_more_precise():
    """Errors / σ are standard normal in both cells; bounds at 99.9 % for 4 figures."""
    experiment = Experiment("industry", trials.check_heights, {"distances": [40, 150]}, SEED)
    results = run(experiment, 12)
    summary = results.summary(confidence=1 - 0.001 / 8)
    for row in summary.rows:
        if row.figure in ("x", "y"):
            assert row.mean_interval[0] < 0 < row.mean_interval[1]
            assert row.standard_deviation_interval[0] < 1 < row.standard_deviation_interval[1]
    few, many = (summary.of("sigma x", distances=n).mean for n in (40, 150))
    assert few > many
