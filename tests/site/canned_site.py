"""A site with generated data that answers as the API of the service does, for tests of its page.

Three networks: ``small`` (seven points), ``tunnel`` (rings of points and photos) and ``large``
(10 000 points). Nothing is adjusted here: σ, ellipses, displacements and verdicts are drawn by
chance, and commands only move observations between their states.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, field
from threading import Condition
from time import time
from typing import Any

from factorgraph_adj.site.site_instruments import shown_state

Record = dict[str, Any]
CRITICAL = 3.29
DAY = 86400.0
AXES = "xyz"
EN = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
NE = ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
HORIZON = ((-0.17365, 0.98481, 0.0), (-0.75441, -0.13302, 0.64279), (0.63302, 0.11162, 0.76604))
"""East, north and up in geocentric axes at 50° N, 10° E."""
LAG = 45.0
"""Time between the measurement of an observation and its arrival, seconds."""
UNITS = {"length": "m", "angle": "gon", "sigma_length": "mm", "sigma_angle": "mgon"}


class Refused(Exception):
    """A command that the site does not take."""

    def __init__(self, what: str, where: str = "", status: int = 422) -> None:
        super().__init__(what)
        self.problem = {"where": where, "what": what}
        self.status = status


@dataclass
class CannedNetwork:
    """A network: its records as the API states them."""

    name: str
    title: str
    points: list[Record]
    sights: list[Record]
    photos: list[Record]
    epochs: list[Record]
    observations: dict[str, Record] = field(default_factory=dict)
    """Rows of observations that have been posted or decided, by id."""
    sigma0: float | None = 0.98
    length_m: float = 1.0
    """Unit of coordinates, metres."""
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Origin of the plane of drawings in the axes of the frame, metres."""
    plane: tuple[tuple[float, float, float], ...] = EN
    """East, north and up in the axes of the frame."""
    heights_only: bool = False
    """Whether there is no plan."""
    compared: str = AXES
    """Axes of the frame in which epochs are compared."""

    displaced: dict[str, Record] = field(default_factory=dict)
    """Displacements that are other than those drawn by chance, by names of points."""

    def of_epoch(self, number: int | None = None) -> list[Record]:
        """Return the rows of observations of an epoch; None: of the present one."""
        wanted = self.epochs[-1]["number"] if number is None else number
        return [o for o in self.observations.values() if o["epoch"] == wanted]

    def counts(self, number: int | None = None) -> Record:
        states = [o["state"] for o in self.of_epoch(number)]
        n = len(self.sights) + states.count("accepted")
        return {
            "observations": n,
            "waiting": states.count("waiting"),
            "suspects": states.count("suspect"),
            "rejected": states.count("rejected"),
            "doubts": 0,
            "redundancy": 0 if self.sigma0 is None else max(n - 3 * len(self.points), 7),
            "sigma0": self.sigma0,
        }

    def listed_epochs(self) -> list[Record]:
        """Return the epochs; those that have ended have counts."""
        ended = [{"counts": self.counts(e["number"])} | e for e in self.epochs[:-1]]
        return [*ended, self.epochs[-1] | {"counts": None}]

    def summary(self) -> Record:
        return {
            "name": self.name,
            "title": self.title,
            "units": UNITS | {"length": "m" if self.length_m == 1.0 else "mm"},
            "length_m": self.length_m,
            "plane": {"origin": self.origin, "axes": self.plane, "note": ""},
            "heights_only": self.heights_only,
            "counts": self.counts(),
            "points": len(self.points),
            "photos": len(self.photos),
            "sigma0": self.sigma0,
            "sigma0_limits": None if self.sigma0 is None else [0.87, 1.14],
            "redundancy": self.counts()["redundancy"],
            "epoch": {k: self.epochs[-1][k] for k in ("number", "begin", "end", "state")},
            "policy": "flag",
            "alpha": 0.001,
            "critical_w": CRITICAL,
            "datum": "given",
            "crs": None,
            "dimension": 3,
            "last_arrival": time() - 3,
        }


def _point(draw: random.Random, name: str, x: float, y: float, z: float, **more: Any) -> Record:
    fixed = more.get("fixed", "")
    size = 0.0 if fixed else draw.uniform(0.6, 2.4)
    out: Record = {"name": name, "x": x, "y": y, "z": z, "fixed": fixed, "determined": True}
    out |= {f"sigma_{a}_mm": size * draw.uniform(0.4, 0.9) for a in AXES}
    if not fixed:
        ellipse = {"a_mm": size, "b_mm": size * draw.uniform(0.3, 0.95)}
        out["ellipse"] = ellipse | {"azimuth_deg": draw.uniform(0, 180), "level": 0.95}
    return out | {"object": not fixed, "datum": bool(fixed), "sigma_height_mm": size} | more


def _sight(draw: random.Random, number: int, a: str, b: str) -> Record:
    w = None if draw.random() < 0.04 else draw.gauss(0, 1)
    kind = draw.choice(("slope_distance", "direction", "zenith_angle"))
    return {"id": f"{number}", "kind": kind, "from": a, "to": b, "state": "accepted"} | {
        "w": w,
        "r": draw.uniform(0.2, 0.9),
    }


def _epochs(points: list[Record], n: int, now: float) -> list[Record]:
    out = []
    for k in range(n):
        begin = now - (n - k) * DAY / 4
        last = k == n - 1
        moved = ["D3", "D4"] if k >= n - 3 and not last else []
        moved = [p for p in moved if any(q["name"] == p for q in points)]
        tested: Record | None = None
        if k > 0 and not last:
            tested = {"test": 0.6, "critical": 1.0, "outcome": "congruent", "moved": moved}
            if k == 4:
                tested |= {"test": 1.4, "outcome": "changed"}
        out.append(
            {
                "number": k,
                "begin": begin,
                "end": None if last else begin + DAY / 4,
                "state": "open" if last else "closed",
                "revision": 2 if k == 2 else 1,
                "sigma0": 1 + 0.08 * math.sin(k),
                "redundancy": 120 + k,
                "problem": "",
                "time": begin + DAY / 8,
                "congruence": tested,
            }
        )
    return out


def small(now: float) -> CannedNetwork:
    """Return a dam with seven points."""
    draw = random.Random(1)
    places = {
        "P1": (0, 0, 100),
        "P2": (180, 20, 102),
        "P3": (90, -90, 98),
        "D1": (40, 60, 120),
        "D2": (80, 75, 121),
        "D3": (120, 72, 121),
        "D4": (160, 61, 120),
    }
    points = [
        _point(draw, n, *map(float, at), fixed="xyz" if n in ("P1", "P2") else "")
        for n, at in places.items()
    ]
    points[2]["object"] = False
    points.append({"name": "D9", "x": None, "y": None, "z": None, "fixed": "", "object": True})
    points[-1] |= {"determined": False, "datum": False}
    pairs = [(a, b) for a in ("P1", "P2", "P3") for b in places if a != b]
    sights = [_sight(draw, i, a, b) for i, (a, b) in enumerate(pairs)]
    sights[5]["w"], sights[7]["w"] = 2.6, -4.4
    made = CannedNetwork("small", "Dam crest", points, sights, [], _epochs(points, 12, now))
    for k, (state, lacks) in enumerate(
        [("suspect", None), ("suspect", None), ("rejected", None), ("waiting", "coordinates of D9")]
    ):
        made.observations[f"s{k}"] = verdict_row(draw, f"s{k}", state, "P1", f"D{k + 1}", lacks)
    return made


def framed(now: float, name: str, title: str, **frame: Any) -> CannedNetwork:
    """Return the dam in another frame, see the fields of `CannedNetwork`."""
    made = small(now)
    made.name, made.title = name, title
    for field_name, value in frame.items():
        setattr(made, field_name, value)
    for p in made.points:
        if p["x"] is not None:
            place = [p[a] for a in AXES]
            for i, axis in enumerate(AXES):
                turned = sum(row[i] * v for row, v in zip(made.plane, place, strict=True))
                p[axis] = (turned + made.origin[i]) / made.length_m
    return made


def levelling(now: float) -> CannedNetwork:
    """Return the dam where heights alone are known, and have been observed."""
    made = framed(now, "levelling", "Levelling", heights_only=True, compared="z")
    for p in made.points:
        p |= {"x": 0.0, "y": 0.0, "sigma_x_mm": 0.0, "sigma_y_mm": 0.0, "ellipse": None}
    for s in made.sights:
        s["kind"] = "height_difference"
    return made


def tunnel(now: float) -> CannedNetwork:
    """Return a tunnel with rings of eight points, and photos."""
    draw = random.Random(2)
    points, photos = [], []
    for ring in range(30):
        for k in range(8):
            a = math.pi * k / 7
            x, y = 5 * math.cos(a), 6.0 * ring
            points.append(_point(draw, f"T{ring:02}{k}", x, y, 5 * math.sin(a)))
    for n, y in (("S1", -10.0), ("S2", 60.0), ("S3", 120.0), ("S4", 190.0)):
        points.append(_point(draw, n, 0.0, y, 1.5, fixed="xyz" if n in ("S1", "S4") else ""))
    sights = []
    for p in points[:-4]:
        for s in ("S1", "S2", "S3", "S4"):
            at = next(q for q in points if q["name"] == s)
            if abs(at["y"] - p["y"]) < 70:
                sights.append(_sight(draw, len(sights), s, p["name"]))
    for ring in range(0, 30, 3):
        rays = [f"T{r:02}{k}" for r in range(ring, min(ring + 2, 30)) for k in range(8)]
        photos.append(photo(f"F{ring:02}", 0.0, 6.0 * ring - 4, 2.0, rays))
    return CannedNetwork("tunnel", "Tunnel", points, sights, photos, _epochs(points, 4, now))


def photo(name: str, x: float, y: float, z: float, rays: list[str]) -> Record:
    """Return a photo and the points that it shows."""
    return {"name": name, "x": x, "y": y, "z": z, "camera": "c1", "rays": rays}


def large(now: float, n: int = 10_000) -> CannedNetwork:
    """Return a network of many points with three sights each."""
    draw = random.Random(3)
    side = math.isqrt(n)
    points = [
        _point(
            draw,
            f"N{i:05}",
            20.0 * (i % side) + draw.uniform(-8, 8),
            20.0 * (i // side) + draw.uniform(-8, 8),
            draw.uniform(90, 110),
            fixed="xyz" if i % 997 == 0 else "",
        )
        for i in range(n)
    ]
    sights = [
        _sight(draw, 3 * i + k, f"N{i:05}", f"N{(i + step) % n:05}")
        for i in range(n)
        for k, step in enumerate((1, side, side + 1))
    ]
    return CannedNetwork("large", "Large", points, sights, [], _epochs(points[:20], 3, now))


def verdict_row(
    draw: random.Random,
    ident: str,
    state: str,
    a: str,
    b: str,
    lacks: str | None = None,
    epoch: int = 11,
) -> Record:
    """Return an observation of an epoch with its verdict, as the stream tells it."""
    kind = draw.choice(("slope_distance", "horizontal_distance"))
    record = {"kind": kind, "station": a, "target": b, "value": 123.4567, "sigma_mm": 1.5}
    out: Record = {
        "id": ident,
        "kind": kind,
        "label": f"{kind} {a} {b}",
        "verdict": state,
        "state": state,
        "epoch": epoch,
        "points": [a, b],
        "record": record,
        "value": "123.4567 m",
    }
    if state == "waiting":
        return out | {"lacks": lacks or "coordinates of D9"}
    w = draw.gauss(0, 1) if state == "accepted" else draw.choice((-1, 1)) * draw.uniform(4, 9)
    test = abs(w) / CRITICAL
    return out | {
        "test": test,
        "t2": w * w,
        "dof": 1,
        "critical": CRITICAL**2,
        "controlled": True,
        "components": ["value"],
        "innovation": [1.7 * w],
        "innovation_sigma": [1.7],
        "small_unit": "mm",
        "w": [w],
        "redundancy_number": [0.62],
        "gains": [],
    }


class CannedSite:
    """The whole site: networks, alarms, instruments, tokens and the log of events."""

    def __init__(self) -> None:
        now = time()
        self.changed = Condition()
        every = (small(now), tunnel(now), large(now), levelling(now))
        every += (
            framed(now, "heights", "Heights compared", compared="z"),
            framed(now, "north", "North first, mm", plane=NE, length_m=1e-3),
            framed(now, "world", "Geocentric", plane=HORIZON, origin=(4.04e6, 7.13e5, 4.86e6)),
        )
        self.networks = {n.name: n for n in every}
        self.log: list[Record] = []
        self.requests: dict[str, Record] = {}
        self.draw = random.Random(4)
        self.number = 0
        self.away = False
        """Whether the database is away."""
        self.hanging = "?"
        """End of the path of requests that get no answer."""
        self.pace = 0.0
        """Time between two events of a stream, seconds."""
        self.beating = True
        """Whether beats are sent; a connection without them hangs."""
        self.doubts: list[str] = []
        self.jumped: set[str] = set()
        """Points that do not move as the motion model says."""
        self.decisions: dict[int, list[Record]] = {}
        """Decisions about observations of an epoch, by its number."""
        self.causes: Record = {"most_probable": None, "undecided": [], "causes": []}
        self.alarms: list[Record] = []
        self.instruments = [
            instrument("ts1", "small", "ok", now - 2),
            instrument("level", "small", "ok", now - 40),
            instrument("ts2", "tunnel", "silent", now - 4000),
        ]
        self.instruments[2]["problem"] = "no line for 66 min; connection refused by 10.0.0.12:4001"
        self.tokens = {
            f"{role}-token": {"id": f"k{i}", "name": role, "role": role, "created": now - 3 * DAY}
            | {"last_used": None}
            for i, role in enumerate(("instrument", "viewer", "surveyor", "admin"))
        }

    # -- events -----------------------------------------------------------------------------------

    def tell(self, event: str, network: str | None, **data: Any) -> Record:
        """Write an event into the log, where all pages that listen read it."""
        with self.changed:
            entry = {"id": len(self.log) + 1, "event": event}
            entry["data"] = {"network": network, "at": time(), **data}
            self.log.append(entry)
            self.changed.notify_all()
        return entry

    def after(self, last: int, network: str | None) -> list[Record]:
        """Return the events of a network, and of the whole site, after a number."""
        return [e for e in self.log[last:] if e["data"]["network"] in (None, network)]

    # -- what happens -----------------------------------------------------------------------------

    def arrive(self, network: str = "small", state: str = "accepted", **more: Any) -> Record:
        """Let an observation arrive, with this verdict."""
        net = self.networks[network]
        self.number += 1
        object_points = [p["name"] for p in net.points if p["object"] and p["determined"]] or ["?"]
        target = more.pop("target", None) or self.draw.choice(object_points)
        present = net.epochs[-1]["number"]
        row = verdict_row(self.draw, f"o{self.number}", state, "P1", target, epoch=present) | more
        net.observations[row["id"]] = row
        point = next((p for p in net.points if p["name"] == target), None)
        points = []
        if point and state == "accepted":
            point["x"] += self.draw.gauss(0, 1e-4)
            point["sigma_x_mm"] *= 0.98
            points = [{k: point[k] for k in point if k != "ellipse"}]
        answer = {"line": self.number, "ok": True, **row, "points": points, "entered": []}
        self.tell(
            "arrival",
            network,
            epoch=present,
            time=time() - LAG,
            by="ts1",
            do="add",
            **without(answer),
            counts=net.counts(),
        )
        return row

    def leave_out(self, number: int = 10) -> None:
        """Let an epoch that has ended have left observations out, for various reasons."""
        net, draw = self.networks["small"], random.Random(number)
        rows = [
            verdict_row(draw, f"e{k}", state, "P2", f"D{k + 1}", epoch=number)
            for k, state in enumerate(("rejected", "rejected", "rejected", "suspect", "waiting"))
        ]
        tested = {k: rows[1].pop(k) for k in ("test", "t2", "dof", "critical", "w", "innovation")}
        tested |= {k: rows[1].pop(k) for k in ("innovation_sigma", "redundancy_number")}
        rows[1] |= {"cause": "snooping", "now": tested | {"small_unit": "mm"}}
        decision = {"at": time() - 900, "by": "office", "do": "discard", "ids": ["e2"]}
        former = {**rows[2], "state": "accepted", "verdict": "accepted"}
        rows[2] |= {"cause": "discarded", "decision": decision | {"labels": {}}}
        rows[2] |= {"revocable": True, "former": former}
        rows[0]["now"] = {k: rows[0][k] for k in (*tested, "small_unit")} | {
            "test": 0.4,
            "w": [1.3],
        }
        net.observations |= {r["id"]: r for r in rows}
        self.decisions[number] = [
            {"at": time() - 9000, "by": "site", "do": "snoop", "ids": [], "labels": {}},
            decision | {"labels": {}, "revocable": ["e2"]},
            {"at": time() - 800, "by": "office", "do": "accept", "ids": ["e9"]}
            | {"labels": {"e9": "slope_distance P2 D4"}, "revocable": ["e9"]},
        ]

    def raise_alarm(self, rule: str = "crest", **more: Any) -> Record:
        """Raise an alarm."""
        alarm = {
            "id": len(self.alarms) + 1,
            "rule": rule,
            "network": "small",
            "test": "displacement",
            "points": ["D3"],
            "state": "open",
            "since": time() - 60,
            "until": None,
            "value": 31.25,
            "limit": 25.56,
            "size_mm": 12.31,
            "epoch": 10,
            "text": "crest: D3 lies 12.3 mm from its place of reference",
            "false_alarms_per_month": 0.1,
            "by": None,
            "acknowledged": None,
            "silenced_until": None,
            "silenced_by": None,
            "epoch_seconds": DAY / 4,
        } | more
        if alarm["epoch"] is not None and alarm["epoch_seconds"]:
            half = 0.5 * alarm["epoch_seconds"]
            alarm |= {"epoch_begin": alarm["since"] - half, "epoch_end": alarm["since"] + half}
        self.alarms.append(alarm)
        self.tell("alarm", alarm["network"], alarm=alarm)
        return alarm

    def decide_alarm(
        self, number: int, what: str, by: str, hours: float = 0.0, remark: str = ""
    ) -> Record:
        """Acknowledge or silence an alarm; one that is silent stays so when it is acknowledged."""
        found = next(a for a in self.alarms if a["id"] == number)
        if what == "acknowledge":
            found |= {"acknowledged": time(), "by": by} | ({"remark": remark} if remark else {})
        else:
            found |= {"silenced_until": time() + 3600 * hours, "silenced_by": by}
        silent = (found["silenced_until"] or 0.0) > time()
        known = "open" if found["acknowledged"] is None else "acknowledged"
        if found["state"] != "closed":
            found["state"] = "silenced" if silent else known
        self.tell("alarm", found["network"], alarm=found)
        return found

    def fail_instrument(self, name: str, connection: str, problem: str | None) -> None:
        """Change the health of an instrument, by the state of its connection."""
        found = next(i for i in self.instruments if i["name"] == name)
        found |= {"connection": connection, "problem": problem}
        found["state"] = shown_state(connection)
        self.tell("instrument", found["network"], instrument=found)

    def add_photo(self, network: str, name: str, at: tuple[float, float, float]) -> None:
        """Let a photo arrive with rays to the points that are near."""
        net = self.networks[network]
        near = sorted(net.points, key=lambda p: math.dist(at, [p[a] for a in AXES]))[:12]
        net.photos.append(photo(name, *at, [p["name"] for p in near]))
        answer = {"ok": True, "do": "add", "verdicts": [], "entered": [], "points": []}
        self.tell("arrival", network, epoch=net.epochs[-1]["number"], **answer, counts=net.counts())

    # -- commands ---------------------------------------------------------------------------------

    def post(self, network: str, posting: Record, by: str) -> Record:
        """Answer a posting; one that repeats a request is not done again."""
        if (name := posting.get("request")) in self.requests:
            return self.requests[name] | {"repeated": True}
        net = self.networks[network]
        do = posting.get("do")
        if do is None:
            row = self.arrive(network, posting.get("verdict", "accepted"))
            return {"ok": True, **row}
        answer = self._command(net, do, posting, by)
        answer |= {"ok": True, "do": do, "points": [], "entered": [], "counts": net.counts()}
        ids = posting.get("ids", [posting.get("id")])
        number = posting.get("epoch", net.epochs[-1]["number"])
        self.tell("arrival", network, by=by, ids=ids, epoch=number, **answer)
        if number < net.epochs[-1]["number"]:
            self._revise(net, number, {"at": time(), "by": by, "do": do, "ids": ids})
        if name:
            self.requests[name] = answer
        return answer

    def _revise(self, net: CannedNetwork, number: int, decision: Record) -> None:
        """Give an epoch that has ended another result after a decision about it."""
        labels = {i: net.observations[i]["label"] for i in decision["ids"]}
        earlier, ids = self.decisions.setdefault(number, []), set(decision["ids"])
        for d in earlier:
            d["revocable"] = [i for i in d.get("revocable", ()) if i not in ids]
        own = decision["ids"] if decision["do"] in ("accept", "discard") else []
        earlier.append(decision | {"labels": labels, "revocable": own})
        next(e for e in net.epochs if e["number"] == number)["revision"] += 1
        for epoch in (e["number"] for e in net.epochs if number <= e["number"] and e["congruence"]):
            what = "result" if epoch == number else "revised"
            self.tell("epoch", net.name, epoch=epoch, what=what)

    @staticmethod
    def _decided(rows: list[Record], do: str, by: str, more: Record) -> Record:
        """Give rows another state by a decision that can be revoked."""
        decision = {"at": time(), "by": by, "do": do, "ids": [r["id"] for r in rows]}
        for row in rows:
            own = {"former": dict(row), "state": more["verdict"], "decision": decision}
            row |= more | own | {"revocable": True}
        return {"verdicts": [{k: v for k, v in r.items() if k != "former"} for r in rows]}

    def _command(self, net: CannedNetwork, do: str, posting: Record, by: str) -> Record:
        ids = posting.get("ids", [posting["id"]] if "id" in posting else [])
        unknown = [i for i in ids if i not in net.observations]
        if unknown:
            raise Refused(f"unknown observation {unknown[0]}", do)
        rows = [net.observations[i] for i in ids]
        if do == "accept":
            return self._decided(rows, do, by, {"verdict": "accepted", "cause": ""})
        if do == "discard":
            return self._decided(rows, do, by, {"verdict": "rejected", "cause": "discarded"})
        if do == "revoke":
            for row in rows:
                if "former" not in row:
                    raise Refused("no decision by hand about it stands", do)
                former = row.pop("former")
                row.clear()
                row |= former
            return {"verdicts": [dict(r) | {"verdict": r["state"]} for r in rows]}
        if do == "remove":
            for row in rows:
                row["state"] = "gone"
            return {"verdicts": []}
        if do == "reweight":
            if not posting["factor"] > 0:
                raise Refused("the factor must be positive", do)
            for row in rows:
                row["record"]["sigma_mm"] /= math.sqrt(posting["factor"])
            return {"verdicts": [dict(r) for r in rows]}
        if do == "replace":
            net.observations[posting["id"]]["state"] = "gone"
            new = verdict_row(self.draw, f"{posting['id']}b", "accepted", *rows[0]["points"])
            new["record"] = posting["observation"]
            net.observations[new["id"]] = new
            return {"verdicts": [new]}
        raise Refused(f"unknown command {do}", "do")

    def close_epoch(self, network: str) -> None:
        """End the present epoch and begin the next."""
        net = self.networks[network]
        last, now = net.epochs[-1], time()
        last |= {"end": now, "state": "closed"}
        last["congruence"] = {"test": 0.7, "critical": 1.0, "outcome": "congruent", "moved": []}
        begun = {"number": last["number"] + 1, "begin": now, "end": None, "state": "open"}
        begun |= {"sigma0": None, "redundancy": None, "time": None}
        net.epochs.append(last | begun | {"revision": 0, "congruence": None})
        self.tell("epoch", network, epoch=last["number"], what="closed")

    # -- what is computed for the page ------------------------------------------------------------

    def epoch(self, network: str, number: int) -> Record:
        """Return an epoch with displacements and blocks."""
        net, draw = self.networks[network], random.Random(number)
        found = next((e for e in net.epochs if e["number"] == number), None)
        if found is None:
            raise Refused(f"no epoch {number}", "epoch", 404)
        moved = (found["congruence"] or {}).get("moved", [])
        rows = []
        for p in net.points[:200]:
            if p["fixed"] or not p["determined"] or not found["congruence"]:
                continue
            size = 9.0 if p["name"] in moved else 0.8
            d = {f"d{a}_mm": draw.gauss(size if p["name"] in moved else 0, 0.7) for a in AXES}
            rows.append(
                {"name": p["name"]}
                | {k: v if k[1] in net.compared else None for k, v in d.items()}
                | {f"sigma_d{a}_mm": 1.1 if a in net.compared else None for a in AXES}
                | {"T": 6.2 if p["name"] in moved else 0.8, "critical": 3.8}
                | {"moved": p["name"] in moved, "detectable_mm": 4.4, "alarm_detectable_mm": 5.1}
                | net.displaced.get(p["name"], {})
            )
        counts = net.counts(number) if found["state"] != "open" else None
        return found | {
            "counts": counts,
            "doubts": [],
            "decisions": self.decisions.get(number, []),
            "points": net.points[:200],
            "displacements": rows,
            "against": 0,
            "blocks": block(moved, net.compared, turned=number == 9) if moved else [],
        }

    def series(self, network: str, name: str) -> Record:
        """Return the time series of a point."""
        net, draw = self.networks[network], random.Random(name)
        p = next((q for q in net.points if q["name"] == name), None)
        if p is None:
            raise Refused(f"unknown point {name}", "points", 404)
        epochs = [e for e in net.epochs if e["state"] == "closed"] if p["determined"] else []
        n, creep = len(epochs), 6e-4 if name == "D3" else 0.0
        out: Record = {"name": name, "epochs": [e["number"] for e in epochs]}
        out["times"] = [e["time"] for e in epochs]
        motion: Record = {"times": out["times"][1:]}
        for a in AXES:
            one = net.length_m
            out[a] = [p[a] + (creep * k + draw.gauss(0, 6e-4)) / one for k in range(n)]
            out[f"sigma_{a}_mm"] = [0.6] * n
            of_epochs = [1e3 * one * (x - out[a][0]) for x in out[a][1:]]
            if a not in net.compared:
                # Not compared, not observed: the place stays.
                out[a] = [p[a]] * n
                out[f"d{a}_mm"] = out[f"sigma_d{a}_mm"] = [None] * n
                continue
            out[f"d{a}_mm"], out[f"sigma_d{a}_mm"] = [None, *of_epochs], [None, *[0.8] * (n - 1)]
            motion[f"displacement_{a}_mm"] = [1e3 * creep * k for k in range(1, n)]
            motion[f"velocity_{a}_mm_per_day"] = [4e3 * creep] * (n - 1)
            motion[f"sigma_velocity_{a}_mm_per_day"] = [0.3] * (n - 1)
        motion["T_of_model"] = [900.0 if name in self.jumped else 2.5 * k for k in range(1, n)]
        motion["critical_of_model"] = [16.3 + 5.0 * k for k in range(n - 1)]
        out["detectable_mm"] = [None, *[2.6] * (n - 1)]
        out["alarm_detectable_mm"] = [None, *[3.1] * (n - 1)]
        alarms = [a for a in self.alarms if name in a["points"]]
        told = [
            {"rule": a["rule"], "epoch": e["number"], "time": e["time"]}
            for a in alarms
            for e in epochs
            if e["number"] >= a["epoch"] - 1
        ]
        return out | {"motion": motion, "alarms": told}

    def next_sights(self, target: str) -> Record:
        """Return the sights that would improve a point most."""
        what = {"item": target, "what": "position error"}
        sights = [
            {
                "sentence": f"aim at {target} from {station}",
                "name": f"{station} to {target}",
                "station": station,
                "target": target,
                "kinds": ["direction", "slope_distance"],
                "gain": gain,
                "cost": 1.0,
                "incomplete": False,
                "figures": [what | {"before_mm": 1.8, "after_mm": 1.8 * (1 - gain)}],
            }
            for station, gain in (("P2", 0.31), ("P3", 0.18))
        ]
        figures = [what | {"now_mm": 1.8}]
        return {"ok": True, "examined": 9, "figures": figures, "sights": sights} | {
            "determining": []
        }

    def protection_levels(self, network: str, wanted: list[str]) -> Record:
        """Return bounds of the errors of points; nothing controls those of D4."""
        rows = [
            {"name": p["name"], "weakest": [f"slope_distance P1 {p['name']} (id s0)"]}
            | {"horizontal_mm": 7.1, "space_mm": 10.4}
            | {"vertical_mm": None if p["name"] == "D4" else 9.3}
            for p in self.networks[network].points
            if not p["fixed"] and p["determined"] and (not wanted or p["name"] in wanted)
        ]
        return {"risk": 1e-3, "faults": 2, "accepted": True, "rows": rows}


def block(points: list[str], compared: str, *, turned: bool) -> list[Record]:
    """Return the common motion of points, which is not that of a rigid block where it turns."""
    out: Record = {"points": points, "moved": True, "test": 41.7, "critical": 3.1}
    out |= {"rigid": not turned, "fit": 5.2 if turned else 0.8, "fit_critical": 3.7}
    for what, unit, values, sigma in (
        ("translation", "mm", (9.1, 8.8, 9.4), 0.9),
        ("rotation", "mgon", (None, None, 12.4 if turned else 0.3), 3.3),
    ):
        known = [
            v if a in compared and v is not None else None
            for a, v in zip(AXES, values, strict=True)
        ]
        out[f"{what}_{unit}"] = known
        out[f"sigma_{what}_{unit}"] = [None if v is None else sigma for v in known]
    return [out]


def without(answer: Record) -> Record:
    """Return an answer without what the event has anyway."""
    return {k: v for k, v in answer.items() if k not in ("epoch", "at")}


def instrument(name: str, network: str, state: str, last: float) -> Record:
    """Return the health of an instrument."""
    return {
        "name": name,
        "network": network,
        "state": state,
        "connection": "receiving" if state == "ok" else state,
        "last_message": last,
        "lines": 41_233,
        "messages": 41_233,
        "readings": 41_100,
        "refused": 2,
        "clock_offset": -0.4,
        "clock_offset_s": -0.4,
        "lag": 45.0,
        "lag_s": 45.0,
        "gaps": 1,
        "late": 0,
        "problem": "",
        "problem_time": None,
        "events": [{"time": last - 7, "count": "gaps", "what": "no line for 61 s"}],
    }
