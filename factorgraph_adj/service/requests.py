"""Requests of the stream, parsed and checked: JSON lines, ids, new unknowns, observations.

The `FieldRow` of a line collects all problems, so that one answer lists them together.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from ..control_characters import refuse_half_characters
from ..entities import Camera, Key, Parameter, parameter_name
from ..errors import MEANT, InputError, Problem, known, similar
from ..io.csv_tables import FieldRow
from ..io.json_records import camera_of, observation_of
from ..io.numbers import Units
from ..io.observation_fields import ImageAxes, RecordContext
from ..io.observation_records import record_label
from ..models.unknown_registry import UNKNOWNS, VariableKind
from ..network.network import Network
from ..observations import AnyObservation
from ..observations.registry import KINDS, in_image_table
from ..planning.target_files import target_of
from ..planning.targets import Target
from ..units import LENGTH

MAX_LINE_BYTES = 1 << 26
"""Largest length of a line: 64 MB, bytes."""
MAX_LETTERS_SHOWN = 60
"""Largest number of characters of a faulty line in a message."""

FIELDS_WITH_NEW_NAMES = ("id", "name", "set")
"""Fields with names that may be new."""

Found = TypeVar("Found")


def parse_line(line: str | bytes) -> dict[str, Any]:
    """Return the object of a line.

    Numbers that are not JSON (NaN, Infinity) are accepted here; the reader of the field refuses
    them, as its message can name the field.

    Args:
        line: text, or bytes of UTF-8; a byte order mark is ignored.

    Raises:
        InputError: the line is not UTF-8, empty, not JSON or not an object, has a key twice, or
            has a lone surrogate.
    """
    if len(line) > MAX_LINE_BYTES:
        raise InputError(f"the line is longer than {MAX_LINE_BYTES >> 20} MB")
    if isinstance(line, bytes):
        try:
            line = line.decode("utf-8")
        except UnicodeDecodeError as error:
            raise InputError(f"the line is not UTF-8 text (byte {error.start + 1})") from None
    text = line.removeprefix("\ufeff").strip()
    if not text:
        raise InputError("the line is empty: write one JSON object {…}")
    try:
        found = json.loads(text, object_pairs_hook=_once)
        refuse_half_characters(text, found, "line")
    except json.JSONDecodeError as error:
        what = f"the line is not JSON: {error.msg} (character {error.pos + 1})"
        raise InputError(what) from None
    except RecursionError:
        raise InputError("the line is not JSON that can be read: nested too deeply") from None
    except ValueError as error:  # a whole number has thousands of digits
        raise InputError(f"the line is not JSON that can be read: {error}") from None
    if not isinstance(found, dict):
        raise InputError(f"the line must be one JSON object {{…}}, not {shown_value(found)}")
    return found


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object; refuse duplicate keys, as neither of the two values can be trusted."""
    out = dict(pairs)
    if len(out) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(n for n in names if names.count(n) > 1)
        raise InputError(f"{twice!r} stands twice in one object")
    return out


def shown_value(value: object) -> str:
    """Return the text of a value for a message."""
    text = repr(value)
    return text if len(text) <= MAX_LETTERS_SHOWN else text[:MAX_LETTERS_SHOWN] + "…"


# -- fields ---------------------------------------------------------------------------------------


def refuse_noted_problems(row: FieldRow) -> None:
    """Continue only if no problem was noted so far.

    Raises:
        InputError: problems were noted.
    """
    if row.problems:
        raise InputError(row.problems)


def listed_ids(row: FieldRow, name: str = "ids", *, required: bool = True) -> tuple[str, ...]:
    """Return a field with a list of ids, or a single id. Raises as `refuse_noted_problems` does."""
    given = row.take(name, required=required)
    listed: Sequence[object] = given if isinstance(given, list) else [given]
    found = []
    for ident in listed if given is not None else ():
        if isinstance(ident, bool) or not isinstance(ident, str | int) or ident == "":
            row.wrong(f"{name} must be a list of ids, or one id, not {shown_value(given)}")
            break
        found.append(str(ident))
    if given == []:
        row.wrong(f"{name} is empty: name one or more")
    refuse_noted_problems(row)
    return tuple(found)


def checked_object(given: object, name: str) -> Mapping[str, Any]:
    """Return a value that must be an object.

    Raises:
        InputError: the value is not an object.
    """
    if not isinstance(given, Mapping):
        raise InputError(f"{name} must be an object {{…}}, not {shown_value(given)}")
    return given


def records_of_list(
    row: FieldRow, name: str, read: Callable[[Mapping[str, Any]], Found]
) -> list[Found]:
    """Read every record of a list; problems are noted with the number of the record.

    Args:
        row: the line.
        name: field of the list; an absent field counts as an empty list.
        read: function that converts a record, or raises InputError.
    """
    given = row.take(name)
    if given is None:
        return []
    if not isinstance(given, list):
        row.wrong(f"{name} must be a list of records, not {shown_value(given)}")
        return []
    found = []
    for number, record in enumerate(given, start=1):
        which = f"{name.removesuffix('s')} {number}"
        try:
            fields = checked_object(record, which)
            refuse_unwritable_names(fields)
            found.append(read(fields))
        except InputError as error:
            row.problems += [
                Problem(p.what, f"{which}: {p.where}" if p.where else which) for p in error.problems
            ]
    return found


def unknowns_by_kind(
    row: FieldRow, stated: Sequence[tuple[VariableKind, Key, Parameter]]
) -> dict[VariableKind, dict[Key, Parameter]]:
    """Return unknowns by kind and key; those that stand twice are noted as problems."""
    out: dict[VariableKind, dict[Key, Parameter]] = {}
    for kind, key, parameter in stated:
        of_kind = out.setdefault(kind, {})
        if key in of_kind:
            row.wrong(f"unknowns: {UNKNOWNS[kind].noun} {parameter_name(key)!r} stands twice")
        of_kind[key] = parameter
    return out


def without_kind(fields: Mapping[str, Any]) -> str:
    """Return what is wrong with a line that is neither an observation nor a command."""
    what = f"neither an observation (kind) nor a command (do); fields: {known(fields, most=6)}"
    for name, value in fields.items():
        text = value if isinstance(value, str) else ""
        kind = text if text in KINDS else similar(text, KINDS)[len(MEANT) :].strip(" '?")
        if kind:
            return f'{what}{MEANT} "kind": "{kind}" for {shown_value(name)}?'
    return what


def refuse_unwritable_names(fields: Mapping[str, Any]) -> None:
    """Refuse new names that cannot be written to the files of a project.

    Raises:
        InputError: a new name has blanks or line breaks at its ends. Control characters inside
            are refused for every name of a network.
    """
    for field in FIELDS_WITH_NEW_NAMES:
        name = fields.get(field)
        if isinstance(name, str) and name != name.strip():
            what = f"{field} {shown_value(name)} has blanks or line breaks at its ends"
            raise InputError(Problem(what, record_label(fields)))
    members = fields.get("observations")
    for member in members if isinstance(members, list) else ():
        if isinstance(member, Mapping):
            refuse_unwritable_names(member)


SIGHT_FIELDS = (
    "points", "targets", "stations", "to", "kinds", "reach", "singly", "sequence", "most"
)  # fmt: skip
"""Fields of ``next_sights``."""


def sight_query(row: FieldRow, units: Units) -> tuple[list[str | Target], dict[str, Any]]:
    """Return the targets of ``next_sights``, and its options.

    Raises:
        InputError: problems of the fields.
    """
    names = listed_ids(row, "points", required=False)
    problems: list[Problem] = []

    def read(fields: Mapping[str, Any]) -> Target:
        found = target_of(fields, "", problems)
        if found is None:
            raise InputError(problems)
        return found

    targets = records_of_list(row, "targets", read)
    options: dict[str, Any] = {}
    for name in ("stations", "to", "kinds"):
        if name in row:
            options[name] = listed_ids(row, name)
    reach, most = row.number("reach", positive=True), row.number("most", positive=True)
    if reach is not None:
        options["reach"] = reach * LENGTH[units.length]
    if most is not None:
        if most != int(most):
            row.wrong(f"most must be a whole number, not {most}")
        options["most"] = int(most)
    options |= {name: row.flag(name) for name in ("singly", "sequence")}
    if not row.problems and not (names or targets):
        row.wrong("give points, whose errors are to become small, or targets")
    refuse_noted_problems(row)
    return [*names, *targets], options


# -- defaults of the project -----------------------------------------------------------------------


def context_with_image_axes(context: RecordContext, network: Network) -> RecordContext:
    """Return a context with the image axes of every camera and photo.

    A network that was not read from a project states no σ of image coordinates.
    """
    cameras = {
        n: context.cameras.get(n, image_axes_of_camera(c)) for n, c in network.cameras.items()
    }
    images = {n: context.images.get(n, cameras[p.camera]) for n, p in network.photos.items()}
    return replace(context, cameras=cameras, images=images)


def image_axes_of_camera(camera: Camera) -> ImageAxes:
    """Return the axes of a camera's image coordinates in files, without a default of σ."""
    return ImageAxes(camera.unit, camera.y_down_in_files)


def new_camera(fields: Mapping[str, Any]) -> Camera:
    """Return a camera that arrives.

    A default of σ is part of a project and cannot be kept in a journal.
    """
    camera = camera_of(fields)
    stated = [n for n in fields if n.startswith("sigma_")]
    if stated:
        raise InputError(
            Problem(
                f"{stated[0]} can only be stated in a project; each image coordinate of a camera "
                "that arrives states its σ or takes that of [sigma.image]",
                f"camera {camera.name!r}",
            )
        )
    return camera


def observations_of_line(fields: Mapping[str, Any], context: RecordContext) -> list[AnyObservation]:
    """Return the observations of a line: of one without a command, or of ``add`` of nothing else.

    Raises:
        InputError: it is another command, adds other things too, or an observation is wrong.
    """
    if "do" not in fields:
        if "kind" not in fields:
            raise InputError(without_kind(fields))
        return [observation_of_record(fields, context)]
    if not adds_observations_alone(fields):
        raise InputError("is no line of observations alone")
    row = FieldRow(fields, "add", [])
    found = records_of_list(row, "observations", lambda f: observation_of_record(f, context))
    refuse_noted_problems(row)
    return found


def adds_observations_alone(fields: Mapping[str, Any]) -> bool:
    """Return whether a line is the command ``add`` with observations and nothing else."""
    given = fields.get("observations")
    own = {*fields} - {"remark"} == {"do", "observations"}
    return own and fields["do"] == "add" and isinstance(given, list) and len(given) > 0


def observation_of_record(fields: Mapping[str, Any], context: RecordContext) -> AnyObservation:
    """Return the observation of a record.

    Raises:
        InputError: the record has problems, or its photo is unknown and therefore also the image
            axes of the photo in files.
    """
    refuse_unwritable_names(fields)
    photo = fields.get("photo")
    if (
        in_image_table(str(fields.get("kind")))
        and photo is not None
        and str(photo) not in context.images
    ):
        what = f"unknown photo {shown_value(photo)}; known: {known(context.images, meant=photo)}"
        raise InputError(Problem(what, record_label(fields)))
    return observation_of(fields, context=context)
