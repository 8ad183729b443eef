"""A stream that is told objects, and everything that a line could change."""

from __future__ import annotations

import json
from pathlib import Path

from factorgraph_adj.incremental.adjustment import IncrementalAdjustment
from factorgraph_adj.io.project import load_project
from factorgraph_adj.io.project_writer import network_files
from factorgraph_adj.service.stream import Stream
from tests.networks.projects import write
from tests.networks.yard import YARD


class Told:
    """A stream that is told objects, and numbers its lines."""

    def __init__(self, told: Stream) -> None:
        self.stream, self.number = told, 0

    @property
    def inc(self) -> IncrementalAdjustment:
        return self.stream.adjustment

    def raw(self, line: str | bytes) -> dict:
        self.number += 1
        answer = self.stream.answer(line, self.number)
        assert answer["line"] == self.number
        assert answer["seconds"] > 0
        json.dumps(answer, allow_nan=False)
        return answer

    def __call__(self, *fields: dict, **command: object) -> dict:
        """Return the answer to the last of some lines, or to a command; all must be fine."""
        for line in (*fields, *([command] if command else ())):
            answer = self.raw(json.dumps(line))
            assert answer["ok"], answer["error"]
        return answer

    def refused(self, line: object) -> list[dict]:
        """Return what is wrong with a line, which changes nothing."""
        before = state(self.inc)
        answer = self.raw(line if isinstance(line, str | bytes) else json.dumps(line))
        assert answer["ok"] is False
        assert answer["error"]
        assert state(self.inc) == before
        return answer["error"]


def state(inc: IncrementalAdjustment) -> tuple:
    """Return all that a line could change, every number to the bit."""
    network = inc.network()
    determined = [n for n in network.points if n in inc.described.points]
    return (
        network_files(network),
        network_files(inc.described),
        [(w.id, w.lacks) for w in inc.waiting],
        [v.id for v in inc.suspects],
        [v.id for v in inc.rejected],
        [inc.estimate(n).tolist() for n in determined],
        [inc.covariance(n).tolist() for n in determined],
        inc.redundancy,
        repr(inc.vtpv),
    )


def open_stream(folder: Path, files: dict[str, str] = YARD, **options) -> Told:
    project = load_project(write(folder, files))
    inc = IncrementalAdjustment(project.network, **options)
    return Told(Stream(inc, context=project.context))
