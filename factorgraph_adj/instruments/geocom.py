"""GeoCOM: answers of Leica total stations to requests that another program sends.

A listener at the line sees requests ``%R1Q,2108,7:5000,1`` and answers ``%R1P,0,7:0,1.5,1.6,45.1``:
after ``%R1P,`` the return code of the communication, the number of the transaction (and a checksum,
where it is on), after the colon the return code of the procedure and its values, angles in radians,
lengths in metres. An answer does not say to what: the request of its transaction does, or the
option ``answers`` where requests do not pass the line. `PROCEDURES` has those that are read;
answers of others have no reading. A code other than 0 refuses the answer with its meaning, except
1285 (angles alone are valid) and those of ``accept_codes``.

No answer names its target: ``aims`` has circle and zenith reading of each, near which it is aimed
at; the circle is not turned.

Grammar: Leica Geosystems, GeoCOM Reference Manual (TPS1200, TS30/TM30), ASCII protocol; return
codes and values of procedures as in the documentation of DMPACK (dm_geocom_error) and geocompy.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ..errors import InputError, Problem, counted, known
from ..io.numbers import parse_quantity
from ..units import ANGLE
from .grammars import GrammarRecord
from .readings import Reading, ReceivedLine, Sight

_REQUEST = re.compile(r"\n?%R1Q,(\d{1,5})(?:,(\d{1,5}))?(?:,\d+)?:(.*)")
_ANSWER = re.compile(r"\n?%R1P,(\d{1,5}),(\d{1,5})(?:,\d+)?:(\d{1,5})(?:,(.*))?")


@dataclass(frozen=True)
class Procedure:
    """Values of an answer: which of them are readings."""

    name: str
    values: int
    """Number of its values."""
    direction: int = 0
    zenith: int = 1
    distance: int | None = None
    """Places of the readings among the values; None: there is none."""


PROCEDURES = {
    "2003": Procedure("TMC_GetAngle1", 9),
    "2107": Procedure("TMC_GetAngle5", 2),
    "2108": Procedure("TMC_GetSimpleMea", 3, distance=2),
    "2117": Procedure("TMC_QuickDist", 3, distance=2),
    "2167": Procedure("TMC_GetFullMeas", 8, distance=6),
    "17017": Procedure("BAP_MeasDistanceAngle", 4, distance=2),
}
"""Procedures by the number of their request."""
ANGLES_ALONE = 1285
RETURN_CODES = {
    0: "completed",
    1: "unknown error",
    2: "invalid parameter",
    3: "invalid result",
    4: "fatal error",
    6: "timed out",
    8: "aborted",
    12: "the subsystem is down",
    13: "busy",
    14: "fault of the hardware",
    16: "not enough power",
    18: "the battery is empty",
    21: "out of the range of temperature",
    22: "the instrument is tilted",
    25: "sleep mode",
    26: "not completed",
    27: "not available: no licence",
    257: "angles and inclinations are not valid",
    258: "inclinations are not valid",
    259: "accuracy not reached",
    260: "accuracy of angles not reached",
    261: "accuracy of inclinations not reached",
    514: "several targets",
    516: "the background is too bright",
    517: "no target",
    518: "less accurate than asked for",
    519: "the spot is at the edge",
    769: "fault of the distance meter",
    771: "echo of a distance",
    772: "the signal is too weak",
    774: "the signal is too strong",
    775: "measuring a distance took too long",
    776: "too much turbulence",
    818: "the distance is out of range",
    819: "too little signal for the noise",
    820: "too much noise",
    823: "more than one target",
    825: "no precise measurement",
    1283: "measured without full correction",
    1284: "the accuracy is not guaranteed",
    ANGLES_ALONE: "only the angles are valid",
    1288: "only the angles are valid, and not fully corrected",
    1289: "only the angles are valid, and their accuracy is not guaranteed",
    1290: "no angles",
    1291: "wrong setting of ppm or mm",
    1292: "no distance: nothing aimed at",
    1293: "busy",
    1294: "no signal",
    3077: "the request timed out",
    3078: "wrong format of the packet",
    3081: "unknown procedure",
    3101: "wrong checksum of the request",
    3102: "wrong checksum of the answer",
    3108: "the instrument sleeps",
    3109: "the instrument is off",
    8704: "position not reached",
    8706: "no angles for positioning",
    8707: "fault of the motors",
    8708: "position not exactly reached",
    8710: "no target",
    8711: "several targets",
    8712: "bad conditions",
    8716: "target not exactly reached",
}
"""Meanings of return codes."""
ANGLE_CODES = (ANGLES_ALONE, 1288, 1289)
"""Codes with which the values have angles and no distance."""
MAX_REQUESTS = 64
"""Number of requests whose answers may still come."""


def meaning(code: int) -> str:
    """Return a return code with its meaning."""
    return f"{code} ({RETURN_CODES.get(code, 'unknown')})"


class GeoCom:
    """Parser of GeoCOM."""

    def __init__(
        self,
        *,
        aims: Mapping[str, Sequence[float]],
        aim_tolerance_gon: float = 0.5,
        answers: int | None = None,
        accept_codes: Sequence[int] = (),
    ) -> None:
        """Take the options of [[instrument]].

        Args:
            aims: circle and zenith reading in face 1, gon, by name of the target.
            aim_tolerance_gon: largest difference of a reading from its aim.
            answers: number of the procedure to whose requests the answers belong, where the
                requests themselves do not pass the line.
            accept_codes: return codes besides 0 with which values count, such as 1284.

        Raises:
            InputError: all problems of the options.
        """
        problems = [
            f"aims: {name} needs circle and zenith reading, gon, 0 < zenith < 200: {list(aim)}"
            for name, aim in aims.items()
            if len(aim) != 2 or not 0.0 < aim[1] < 200.0
        ]
        if not aims:
            problems.append("aims must name the targets: { D1 = [12.345, 98.7] }")
        if not 0.0 < aim_tolerance_gon < 100.0:
            problems.append(f"aim_tolerance_gon must be between 0 and 100, not {aim_tolerance_gon}")
        if answers is not None and str(answers) not in PROCEDURES:
            problems.append(f"answers must be one of {known(PROCEDURES)}, not {answers}")
        problems += [f"accept_codes: {c} has no values" for c in accept_codes if c in NO_VALUES]
        if problems:
            raise InputError([Problem(p) for p in problems])
        self.aims = {name: (float(a[0]), float(a[1])) for name, a in aims.items()}
        self.tolerance, self.accepted = aim_tolerance_gon, {0, *accept_codes}
        self.answers = None if answers is None else str(answers)
        self._asked: dict[str, str] = {}
        """Procedure of a transaction that has no answer yet."""

    def read(self, line: ReceivedLine) -> Sequence[Reading]:
        """Return the reading of an answer."""
        text = line.decoded().strip()
        if request := _REQUEST.fullmatch(text):
            self._asked[request[2] or "0"] = request[1]
            if len(self._asked) > MAX_REQUESTS:
                del self._asked[next(iter(self._asked))]
            return []
        answer = _ANSWER.fullmatch(text)
        if answer is None:
            what = "is neither a request %R1Q,number,transaction:… nor an answer %R1P,code,"
            raise InputError(f"{what}transaction:code,…")
        asked = self._asked.pop(answer[2], None) or self.answers
        if int(answer[1]) != 0:
            raise InputError(f"the communication failed: {meaning(int(answer[1]))}")
        if asked is None:
            raise InputError(
                "no request before it says to what it answers: give answers = NUMBER of the "
                f"procedure; valid: {known(PROCEDURES)}"
            )
        procedure, code = PROCEDURES.get(asked), int(answer[3])
        if procedure is None:
            return []
        if code not in self.accepted and code != ANGLES_ALONE:
            raise InputError(f"{procedure.name} returned {meaning(code)}")
        return [self._sight(procedure, code, (answer[4] or "").split(","))]

    def _sight(self, procedure: Procedure, code: int, values: Sequence[str]) -> Sight:
        """Return the sight of the values of an answer."""
        if len(values) != procedure.values:
            what = f"{procedure.name} has {counted(procedure.values, 'value')}, not {len(values)}"
            raise InputError(what)
        numbers = []
        for value in values:
            try:
                numbers.append(parse_quantity(value.strip()))
            except ValueError as error:
                raise InputError(f"{procedure.name}: {error}") from None
        direction, zenith = numbers[procedure.direction], numbers[procedure.zenith]
        distance = None if procedure.distance is None else numbers[procedure.distance]
        problems = [
            f"{name} must be from 0 to 2π rad, not {angle:g}"
            for name, angle in (("direction", direction), ("zenith", zenith))
            if not 0.0 <= angle <= 2.0 * math.pi
        ]
        if distance is not None and distance < 0.0:
            problems.append(f"a distance cannot be negative: {distance:g}")
        if problems:
            raise InputError(f"{procedure.name}: {'; '.join(problems)}")
        if code in ANGLE_CODES:
            distance = None
        return Sight(
            target=self._target(direction, zenith),
            direction=direction,
            zenith=zenith,
            distance=distance or None,
        )

    def _target(self, direction: float, zenith: float) -> str:
        """Return the target that was aimed at."""
        second = zenith > math.pi
        hz = (direction - math.pi * second) / ANGLE["gon"]
        z = (2.0 * math.pi - zenith if second else zenith) / ANGLE["gon"]
        off = {
            name: math.hypot((hz - a + 200.0) % 400.0 - 200.0, z - b)
            for name, (a, b) in self.aims.items()
        }
        near = sorted((d, name) for name, d in off.items() if d <= self.tolerance)
        at = f"{hz % 400.0:.4f} {z:.4f} gon"
        if not near:
            name = min(off, key=lambda n: off[n])
            raise InputError(f"no target is aimed at by {at}: {name!r} is {off[name]:.3f} gon away")
        if len(near) > 1:
            names = known([name for _, name in near])
            raise InputError(f"{at} may aim at {names}: aim_tolerance_gon must be smaller")
        return near[0][1]


NO_VALUES = (1, 2, 3, 4, 6, 8, 257, 1290, 1292, 1293, 1294)
"""Codes with which an answer has no values that mean anything."""
GRAMMAR = GrammarRecord(
    "geocom", "answers of Leica total stations to requests of GeoCOM (ASCII)", GeoCom
)
