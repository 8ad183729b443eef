"""Published epochs, played as sites: the figures of their reports come out of the API."""

from __future__ import annotations

import re

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.io.observation_records import observation_record
from tests.loaders.gama import gama_epoch
from tests.loaders.hanna import read_hanna
from tests.support.places import data_dir
from tests.support.sites import served_project

pytestmark = pytest.mark.published


def records(network):
    return [observation_record(o, id=i) for i, o in network.observations.items()]


def posted(client, name, network):
    """Post the observations of a network one after the other, and end the epoch."""
    answers = client.post(f"/api/v1/networks/{name}/postings", json=records(network)).json()
    assert all(a["ok"] for a in answers), next(a for a in answers if not a["ok"])
    assert {a["verdict"] for a in answers} <= {"accepted", "waiting"}
    closed = client.post(f"/api/v1/networks/{name}/epochs", json={"close": True}).json()
    return closed["result"]


def test_shifts_of_gama(tmp_path):
    """data-1.gkf is epoch 0; the readings of data-2.gkf arrive (GNU Gama, data-1-2.txt)."""
    text = (data_dir("gama_deformation") / "data-1-2.txt").read_text(encoding="utf-8")
    rows = [t.split() for t in text.splitlines() if re.match(r"\w+ +\d+ +\d+ +\d+ ", t)]
    first, second = (fga.read_gama(gama_epoch(f"data-{i}.gkf", tmp_path)) for i in (1, 2))
    fga.write_project(first, tmp_path / "project" / "project.toml")
    objects = [r[0] for r in rows]
    with served_project(tmp_path, "shifts", objects=objects, policy="accept") as client:
        address = "/api/v1/networks/shifts"
        client.post(f"{address}/epochs", json={"close": True})
        new = [
            {"name": n, "x": p.coordinates[0], "y": p.coordinates[1], "z": 0.0, "fixed": "z"}
            for n, p in second.points.items()
            if n not in first.points
        ]
        added = client.post(f"{address}/postings", json={"do": "add", "points": new}).json()
        assert added["ok"], added
        posted(client, "shifts", second)
        epoch = client.get(f"{address}/epochs/1").json()
        found = {d["name"]: d for d in epoch["displacements"]}
        for name, _, _, _, dx, dy, *_ in rows:
            shown = found[name]["dx_mm"], found[name]["dy_mm"]
            assert shown == pytest.approx((1e3 * float(dx), 1e3 * float(dy)), abs=0.006)


def test_the_lock_of_uelzen(tmp_path):
    """304 readings of both epochs in one free adjustment (HANNA, avdgem.out)."""
    found = read_hanna(data_dir("hanna_lock") / "avdgem.out")
    empty = fga.without(found.network, list(found.network.observations))
    fga.write_project(empty, tmp_path / "project" / "project.toml")
    with served_project(tmp_path, "lock", policy="accept") as client:
        address = "/api/v1/networks/lock"
        result = posted(client, "lock", found.network)
        assert result["redundancy"] == 244
        assert result["sigma0"] == pytest.approx(np.sqrt(255.838 / 244), abs=1e-3)
        points = {p["name"]: p for p in client.get(f"{address}/points").json()}
        for name, (y, x) in found.coordinates.items():
            assert (points[name]["x"], points[name]["y"]) == pytest.approx((y, x), abs=1.5e-4)
        rows = client.get(f"{address}/observations", params={"limit": 400}).json()["rows"]
        assert sum(r["r"] for r in rows) == pytest.approx(244.0, abs=1e-6)
        w = {int(r["id"]): abs(r["w"]) for r in rows}
        printed = {n: p.w for n, p in enumerate(found.printed, 1)}
        assert max(abs(w[n] - printed[n]) for n in printed) < 0.031
        names = ["101", "102", "103", "104", "0101", "0102", "0103", "0104"]
        q = client.get(f"{address}/covariance", params={"points": ",".join(names)}).json()
        q = np.array(q["covariance"])
        d = np.array([[points[n[1:]][a] - points[n][a] for a in "xy"] for n in names[4:]]).ravel()
        plan = [3 * i + j for i in range(8) for j in (0, 1)]
        difference = np.hstack([np.eye(8), -np.eye(8)])
        q = difference @ q[np.ix_(plan, plan)] @ difference.T
        f = d @ np.linalg.solve(q, d) / (8 * result["sigma0"] ** 2)
        assert f == pytest.approx(25.65, rel=0.03)  # from the printed coordinates and cofactors
