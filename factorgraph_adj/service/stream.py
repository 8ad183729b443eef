"""Protocol of ``factorgraph-adj stream``: observations and commands line by line, with answers.

Every line, also an empty one, gets exactly one answer; answers keep the order of the lines. A
faulty line changes nothing, and the stream continues.

**Units.** Plain fields (``value``, ``x``, ``omega`` …) are in the units of the project, as in
its files; every other field has its unit in its name (``sigma_mm``, ``before_x_mm``) or beside
it (``small_unit``). The first line of the stream states the units. Numbers that are not finite,
such as σ of a new point before the observation, are null.

**A line is an observation**: the fields of a row of observations.csv or images.csv,

    {"kind": "slope_distance", "station": "A", "target": "B", "value": 12.3, "sigma_mm": 2}
    {"kind": "image", "photo": "12", "point": "P3", "x": 4.071, "y": -22.913}

**or a command**, named by ``do``:

====================  =======================================================================
``do``                fields, and content of the answer
====================  =======================================================================
``add``               ``observations``, ``points``, ``photos``, ``cameras``, ``unknowns``: lists of
                      records with the fields of the tables and of [[camera]]; at least one of
                      them. ``kind`` tells the table of an unknown: frame, mount, drift, …
                      ``time``: seconds at which they came, where ``--keep`` counts seconds;
                      what has none counts as coming with the latest that has one.
                      One error refuses all. Observations with a joint covariance are one record
                      ``{"kind": "correlated", "observations": […], "covariance_si": [[…]]}``
``solution``          figures of the adjustment, ``ambiguous_places`` (why a converged result is in
                      doubt), ``points``, ``photos``, ``calibrations``
``estimate``          one of ``point``, ``photo``, ``camera``: a name; present estimate and σ
``reliability``       ``alpha``, ``power``, ``most`` (10): Σr (``sum``), ``uncontrolled``,
                      ``weakest`` (smallest r), ``largest_mdb`` of each kind, ``suspects``
``waiting``           all waiting observations, with the support that they lack
``suspects``          verdicts of doubtful observations that wait for a decision
``rejected``          verdicts of rejected observations
``doubts``            sentences: why there is no minimum, which suspects agree and what they
                      contradict, which observations alone tell the side of a point, and which
                      blocks of them repeat earlier ones in all digits (also at the end of the
                      stream, on standard error)
``causes``            what several observations may have in common that misfits, suspects among
                      them, such as a wrong height of an instrument: ``most_probable`` and
                      ``undecided``, sentences; ``causes``: ``cause``, ``where``, ``error`` and
                      ``sigma`` (SI), ``t2``, ``dof``, ``critical``, ``ids``; takes adjustments
``next_sights``       ``points``: names, whose position errors are to become small, or ``targets``:
                      records as those of [[target]] in a file of wishes; ``stations``, ``to`` and
                      ``kinds`` limit the candidates, ``reach`` their lengths (unit of lengths);
                      ``singly``: true takes each reading by itself, ``sequence``: true the sights
                      one after the other; ``most`` (10). ``sights``, the best first: ``sentence``,
                      ``name``, ``station``, ``target``, ``kinds``, ``gain``, ``cost``,
                      ``incomplete`` (a reading says nothing yet), ``figures`` (``item``, ``what``,
                      ``before_mm``, ``after_mm``); ``examined``, ``figures`` (``now_mm``) and
                      ``determining``: sights to points that are new
``accept``            ``ids``: put suspect or rejected observations into the graph
``discard``           ``ids``: reject suspect or accepted observations
``revoke``            ``ids``: take the last ``accept`` or ``discard`` of each back, with what it
                      let come back: earlier verdicts stand again
``remove``            ``ids``: remove observations; those that lose their support wait again
``replace``           ``id``, ``observation``: replace an observation by another one
``reweight``          ``ids``, ``factor``: multiply weights by the factor
``snoop``             reject gross errors: ``set_aside``, ``rejected_points``,
                      ``readmitted``, ``unresolved``, ``entered`` (verdicts on what fits then)
``settle``            iterate to convergence; the result is that of a batch adjustment; with
                      ``all``: true everything that was retired is taken back first
``retire``            ``points``, ``photos``: names, ``before``: an id: let these, and what nothing
                      has touched since before the id came, leave with their observations:
                      ``points_retired``, ``photos_retired``, ``observations_retired``, and
                      ``held_points_retired``, names of points that no new observation can use
``write``             ``project``: a .toml file, or a folder; write the graph as a project.
                      Existing files are replaced only with ``overwrite``: true
``stop``              end the stream
====================  =======================================================================

``ids`` is a list, or one id. Image coordinates of a camera that arrives have y up, and each
states its σ or takes that of [sigma.image]; only a project can state other axes. Answers have
``line`` (number of the line, from 1), ``ok``, for commands ``do``, and

- ``counts``: ``observations`` in the graph, ``waiting``, ``suspects``, ``rejected``, ``doubts``,
  ``redundancy``, ``sigma0``;
- ``seconds``: duration of the command.

Answers to observations, ``add``, ``accept``, ``discard``, ``revoke``, ``remove``, ``replace`` and
``reweight`` also have

- the verdict, for a line with one observation; otherwise ``verdicts``, a list of verdicts:
  ``id``, ``kind``, ``label``, ``verdict`` (accepted, suspect, rejected, waiting), ``test``
  (√(T²/critical value): above 1 the observation is in doubt), ``t2``, ``dof``, ``critical``,
  ``controlled`` (false: no other observation tests it), and for each of its ``components``
  ``innovation`` (computed − observed), ``innovation_sigma``, ``w``, ``redundancy_number`` that
  the component would have in the graph; ``gains``: σ of points ``before_x_mm`` …,
  ``after_x_mm`` …. A waiting observation has ``lacks`` instead; ``cause`` tells that an
  observation was discarded, rejected by snooping, or came back, and after which command;
  ``doubt`` says that an accepted observation alone determines the side of a point, or that one
  that failed fits without such an observation;
- ``entered``: verdicts of observations that waited or were left out, and have entered now;
- ``points``: affected free points, ``name``, ``x``, ``y``, ``z``, ``sigma_x_mm`` …;
  ``points_lost``: points that are no longer determined; ``waits_again``: ids of observations
  that lost their support;
- ``waiting``: the waiting observations, ``id``, ``kind``, ``lacks``, the latest first, 20 at most.

A faulty line is answered with ``"ok": false`` and ``error``, a list of ``where`` and ``what``.
The first line, before any input is read, has ``ready``, ``name``, ``units``, numbers of
``points``, ``photos`` and ``observations`` in the graph, ``policy``, ``alpha``, ``power``,
``resumed`` (note about a torn end of the journal), ``waiting`` and ``counts``.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from threading import RLock
from time import perf_counter
from typing import Any

from ..blas_threads import one_at_a_time
from ..errors import AdjustmentError, InputError, Problem, known
from ..incremental.adjustment import IncrementalAdjustment
from ..incremental.arrival import Arrival
from ..io.csv_tables import FieldRow
from ..io.file_transaction import write_files
from ..io.json_records import photo_of, point_of, unknown_of
from ..io.observation_fields import RecordContext
from ..io.project_writer import network_files
from ..observations import Correlated
from ..report.layout import finite_json
from ..statistical_tests import POWER_OF_TEST
from . import requests
from .answers import Answer, Answers, fault, fields_of, refusal

CHANGED_WITHOUT_ANSWER = "the graph has changed, and the answer failed"
"""What is said instead of calling a line refused that was not."""
DEFAULT_LIST_LENGTH = 10
"""Default number of observations in the lists of ``reliability``."""


@dataclass(frozen=True)
class StreamCommand:
    """A command: a value of ``do``."""

    run: Callable[[Stream, FieldRow], Answer]
    """Function that executes the command; it notes problems in the row or raises them."""
    fields: tuple[str, ...] = ()
    """Fields of the command."""


class Stream:
    """An incremental adjustment that is controlled line by line."""

    def __init__(
        self,
        adjustment: IncrementalAdjustment,
        *,
        context: RecordContext | None = None,
        power: float = POWER_OF_TEST,
    ) -> None:
        """Start a stream for an adjustment.

        Args:
            adjustment: the adjustment to which the lines are applied.
            context: units, and defaults of the project for records.
            power: power of the test for the smallest detectable errors in ``reliability``.
        """
        self._lock = RLock()
        self.adjustment = adjustment
        described = adjustment.entities
        self.frame = described.frame
        self.power = power
        self.context = requests.context_with_image_axes(context or RecordContext(), described)
        self.answers = Answers(adjustment, self.context.units)
        self.stopped = False
        """Whether the stream was asked to stop."""

    @one_at_a_time
    def ready(self) -> Answer:
        """Return the first line."""
        inc, units = self.adjustment, self.context.units
        network = inc.network()
        out: Answer = {
            "ready": True,
            "name": network.name,
            "units": fields_of(units, "length", "angle", "sigma_length", "sigma_angle"),
            "points": len(network.points),
            "photos": len(network.photos),
            "observations": len(inc),
            "policy": inc.policy,
            "alpha": inc.alpha,
            "power": self.power,
            "resumed": inc.resumed,
            "waiting": self.answers.latest_waiting(),
            "counts": self.answers.counts(),
        }
        return dict(finite_json(out))

    @one_at_a_time
    def answer(self, line: str | bytes, number: int) -> Answer:
        """Answer a line; a faulty line raises nothing and changes nothing.

        Args:
            line: one JSON object; bytes are UTF-8.
            number: number of the line, from 1.

        Returns:
            The answer, ready for `json.dumps`.
        """
        return self._answer(lambda: requests.parse_line(line), number)

    @one_at_a_time
    def answer_record(
        self, fields: Mapping[str, Any], number: int, *, time: float | None = None
    ) -> Answer:
        """Answer the fields of a line, as `answer` does.

        Args:
            fields: the fields.
            number: number of the line.
            time: when an observation came, seconds, where the adjustment keeps seconds.

        Raises:
            RuntimeError: the line has changed the graph, and its answer failed: it must not be
                called refused.
        """
        before = self.adjustment.latest
        answer = self._answer(partial(dict, fields), number, time)
        if not answer["ok"] and self.adjustment.latest is not before:
            raise RuntimeError(f"{CHANGED_WITHOUT_ANSWER}: {answer['error']}")
        return answer

    @one_at_a_time
    def answer_together(
        self, records: Sequence[Mapping[str, Any]], number: int, *, time: float | None = None
    ) -> list[Answer]:
        """Answer the fields of lines that came together: observations, groups, ``add`` of such.

        They are one arrival: each is tested against everything that is there, the others among
        them. A faulty one refuses itself alone.

        Args:
            records: the fields of the lines.
            number: number of the first one.
            time: when they came, seconds, where the adjustment keeps seconds.

        Raises:
            RuntimeError: observations have entered, and their answers failed: they must not be
                called refused.
        """
        before, begun = self.adjustment.latest, perf_counter()
        try:
            if len(records) > 1:
                told = self._arrivals(records, time)
                counts = self.answers.counts()
                after = {"counts": counts, "seconds": round(perf_counter() - begun, 6)}
                lines = enumerate(told, number)
                return [dict(finite_json({"line": n, "ok": True, **a, **after})) for n, a in lines]
        except Exception as error:
            if self.adjustment.latest is not before:
                raise RuntimeError(CHANGED_WITHOUT_ANSWER) from error
        return [
            self.answer_record(fields, n, time=time) for n, fields in enumerate(records, number)
        ]

    def _answer(
        self, given: Callable[[], dict[str, Any]], number: int, time: float | None = None
    ) -> Answer:
        begun = perf_counter()
        try:
            fields = given()
            if "do" not in fields:
                (said,) = self._arrivals([fields], time)
            else:
                at = {} if time is None or fields["do"] != "add" else {"time": time}
                said = self._command(fields | at)
            out: Answer = {"line": number, "ok": True, **said}
        except AdjustmentError as error:
            out = refusal(number, error)
        except Exception as error:
            if os.environ.get("FACTORGRAPH_ADJ_DEBUG"):
                raise
            out = fault(number, error)
        out["counts"] = self.answers.counts()
        out["seconds"] = round(perf_counter() - begun, 6)
        return dict(finite_json(out))

    # -- lines --------------------------------------------------------------------------------

    def _command(self, fields: dict[str, Any]) -> Answer:
        do = fields["do"]
        command = STREAM_COMMANDS.get(do) if isinstance(do, str) else None
        if command is None:
            valid = known(STREAM_COMMANDS, meant=do, most=40)
            what = f"unknown command {requests.shown_value(do)}; valid: {valid}"
            raise InputError(Problem(what, "do"))
        row = FieldRow(fields, str(do), [])
        for name in row.fields:
            if name not in ("do", "remark", *command.fields):
                takes = known(command.fields, meant=name) if command.fields else "no further fields"
                row.wrong(f"unknown field {requests.shown_value(name)}; it takes: {takes}")
        if not command.fields:
            requests.refuse_noted_problems(row)
        return {"do": do, **command.run(self, row)}

    def _arrivals(self, records: Sequence[Mapping[str, Any]], time: float | None) -> list[Answer]:
        """Add the observations of lines as one arrival, and return their answers."""
        read = [requests.observations_of_line(fields, self.context) for fields in records]
        sizes = [
            sum(len(o.observations) if isinstance(o, Correlated) else 1 for o in of_line)
            for of_line in read
        ]
        arrival = self.adjustment.add([o for of_line in read for o in of_line], time=time)
        told = self.answers.arrivals(arrival, sizes, ["do" in fields for fields in records])
        return [
            {"do": "add", **said} if "do" in fields else said
            for fields, said in zip(records, told, strict=True)
        ]

    # -- commands that change the graph ---------------------------------------------------------

    def _add(self, row: FieldRow) -> Answer:
        context = self.context
        cameras = requests.records_of_list(row, "cameras", requests.new_camera)
        axes = {**context.cameras, **{c.name: requests.image_axes_of_camera(c) for c in cameras}}
        only = {"camera": next(iter(axes))} if len(axes) == 1 else {}
        photos = requests.records_of_list(
            row, "photos", lambda f: photo_of({**only, **f}, context=context, frame=self.frame)
        )
        images = {p.name: axes[p.camera] for p in photos if p.camera in axes}
        context = replace(context, cameras=axes, images={**context.images, **images})
        points = requests.records_of_list(
            row, "points", lambda f: point_of(f, context=context, frame=self.frame)
        )
        stated = requests.records_of_list(row, "unknowns", lambda f: unknown_of(f, context=context))
        given = requests.records_of_list(
            row, "observations", lambda f: requests.observation_of_record(f, context)
        )
        if not row.problems and not (given or points or photos or cameras or stated):
            row.wrong("nothing to add: give observations, points, photos, cameras or unknowns")
        unknowns, time = requests.unknowns_by_kind(row, stated), row.number("time")
        requests.refuse_noted_problems(row)
        arrival = self.adjustment.add(
            given, points=points, photos=photos, cameras=cameras, unknowns=unknowns, time=time
        )
        self.context = context
        return self.answers.arrival(arrival)

    def _accept(self, row: FieldRow) -> Answer:
        return self.answers.arrival(self.adjustment.accept(requests.listed_ids(row)))

    def _without(self, row: FieldRow, command: Callable[[Sequence[str]], Arrival]) -> Answer:
        """Answer a command after which observations may have left the graph."""
        ids = requests.listed_ids(row)
        points, _ = self.answers.points(self.answers.points_of(ids))  # only these can be lost
        touched = [str(p["name"]) for p in points]
        return self.answers.arrival(command(ids), touched=touched)

    def _replace(self, row: FieldRow) -> Answer:
        ident = row.text("id", required=True)
        record = row.take("observation", required=True)
        requests.refuse_noted_problems(row)
        given = requests.observation_of_record(
            requests.checked_object(record, "observation"), self.context
        )
        if isinstance(given, Correlated):
            raise InputError("a correlated group cannot stand in the place of one observation")
        assert ident is not None
        return self.answers.arrival(self.adjustment.replace(ident, given))

    def _reweight(self, row: FieldRow) -> Answer:
        factor = row.number("factor", required=True, positive=True)
        ids = requests.listed_ids(row)
        assert factor is not None
        return self.answers.arrival(self.adjustment.reweight(ids, factor))

    def _snoop(self, row: FieldRow) -> Answer:
        found = self.adjustment.snoop()
        return self.answers.snooping(found, self.adjustment.latest)

    def _settle(self, row: FieldRow) -> Answer:
        everything = row.flag("all")
        requests.refuse_noted_problems(row)
        self.adjustment.settle(all=everything)
        return {}

    def _retire(self, row: FieldRow) -> Answer:
        points, photos = (requests.listed_ids(row, n, required=False) for n in ("points", "photos"))
        before = row.text("before")
        requests.refuse_noted_problems(row)
        was, held = self._numbers_retired(), self._held_points_retired()
        self.adjustment.retire(points=points, photos=photos, before=before)
        now = self._numbers_retired()
        answer: Answer = {name: now[name] - was[name] for name in now}
        return answer | {"held_points_retired": self._held_points_retired()[len(held) :]}

    def _numbers_retired(self) -> dict[str, int]:
        names, retired = ("points", "photos", "observations"), self.adjustment.retired
        return {f"{n}_retired": 0 if retired is None else getattr(retired, n) for n in names}

    def _held_points_retired(self) -> list[str]:
        return [] if self.adjustment.retired is None else [*self.adjustment.retired.held_points]

    # -- queries --------------------------------------------------------------------------------

    def _solution(self, row: FieldRow) -> Answer:
        return self.answers.solution(self.adjustment.solution())

    def _estimate(self, row: FieldRow) -> Answer:
        inc = self.adjustment
        asked = {n: row.text(n) for n in ("point", "photo", "camera") if n in row}
        if len(asked) != 1:
            row.wrong("give one of point, photo, camera")
        requests.refuse_noted_problems(row)
        (what, name), *_ = asked.items()
        assert name is not None
        if what == "point":
            return self.answers.estimate(name)
        if what == "photo":
            return self.answers.photo(name, inc.pose(name))
        return self.answers.calibration(name, inc.calibration(name))

    def _reliability(self, row: FieldRow) -> Answer:
        alpha, power = (row.number(n, positive=True) for n in ("alpha", "power"))
        most = row.number("most", positive=True)
        requests.refuse_noted_problems(row)
        inc = self.adjustment
        found = inc.reliability(
            alpha=inc.alpha if alpha is None else alpha,
            power=self.power if power is None else power,
        )
        return self.answers.reliability(found, DEFAULT_LIST_LENGTH if most is None else int(most))

    def _all_waiting(self, row: FieldRow) -> Answer:
        return {"waiting": [self.answers.waiting(w) for w in self.adjustment.waiting]}

    def _suspects(self, row: FieldRow) -> Answer:
        return {"suspects": [self.answers.verdict(v) for v in self.adjustment.suspects]}

    def _rejected(self, row: FieldRow) -> Answer:
        return {"rejected": [self.answers.verdict(v) for v in self.adjustment.rejected]}

    def _doubts(self, row: FieldRow) -> Answer:
        return {"doubts": list(self.adjustment.doubts)}

    def _causes(self, row: FieldRow) -> Answer:
        return self.answers.causes(self.adjustment.causes())

    def _next_sights(self, row: FieldRow) -> Answer:
        targets, options = requests.sight_query(row, self.context.units)
        return self.answers.next_sights(self.adjustment.next_sights(targets, **options))

    def _write(self, row: FieldRow) -> Answer:
        name = row.text("project", required=True)
        overwrite = row.take("overwrite")
        if overwrite not in (None, True, False):
            row.wrong(f"overwrite must be true or false, not {requests.shown_value(overwrite)}")
        requests.refuse_noted_problems(row)
        path = Path(name or "")
        path = path if path.suffix == ".toml" else path / "project.toml"
        network = self.adjustment.network()
        files = network_files(network, units=self.context.units, toml=path.name)
        there = [f for f in files if (path.parent / f).exists()]
        if there and not overwrite:
            what = (
                f"it would replace {', '.join(there)}, and a project written here holds only what "
                'is determined: name another folder, or say "overwrite": true'
            )
            raise InputError(Problem(what, str(path)))
        write_files(path.parent, files)
        return {"project": str(path)}

    def _stop(self, row: FieldRow) -> Answer:
        self.stopped = True
        return {}


STREAM_COMMANDS: dict[str, StreamCommand] = {
    "add": StreamCommand(
        Stream._add, ("observations", "points", "photos", "cameras", "unknowns", "time")
    ),
    "solution": StreamCommand(Stream._solution),
    "estimate": StreamCommand(Stream._estimate, ("point", "photo", "camera")),
    "reliability": StreamCommand(Stream._reliability, ("alpha", "power", "most")),
    "waiting": StreamCommand(Stream._all_waiting),
    "suspects": StreamCommand(Stream._suspects),
    "rejected": StreamCommand(Stream._rejected),
    "doubts": StreamCommand(Stream._doubts),
    "causes": StreamCommand(Stream._causes),
    "next_sights": StreamCommand(Stream._next_sights, requests.SIGHT_FIELDS),
    "accept": StreamCommand(Stream._accept, ("ids",)),
    "discard": StreamCommand(lambda s, r: s._without(r, s.adjustment.discard), ("ids",)),
    "revoke": StreamCommand(lambda s, r: s._without(r, s.adjustment.revoke), ("ids",)),
    "remove": StreamCommand(lambda s, r: s._without(r, s.adjustment.remove), ("ids",)),
    "replace": StreamCommand(Stream._replace, ("id", "observation")),
    "reweight": StreamCommand(Stream._reweight, ("ids", "factor")),
    "snoop": StreamCommand(Stream._snoop),
    "settle": StreamCommand(Stream._settle, ("all",)),
    "retire": StreamCommand(Stream._retire, ("points", "photos", "before")),
    "write": StreamCommand(Stream._write, ("project", "overwrite")),
    "stop": StreamCommand(Stream._stop),
}
"""Commands by name."""
