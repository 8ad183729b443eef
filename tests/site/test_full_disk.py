"""A disk that is really full: a small file system on which a site, an outbox or a backup lies."""

from __future__ import annotations

import os
import shutil
import subprocess
import zipfile
from contextlib import suppress

import pytest

from factorgraph_adj.errors import AdjustmentError
from factorgraph_adj.site.outbox import Outbox
from factorgraph_adj.site.site_archive import write_archive
from tests.networks.yard import ARRIVALS
from tests.support.sites import ADDRESS, served, site_of, yard_of, yard_site

SIZE = 8 << 20
"""Size of the file system, bytes."""


@pytest.fixture
def disk(tmp_path):
    """Return the folder of a small file system, or skip where nobody may mount one."""
    folder = tmp_path / "disk"
    folder.mkdir()
    if shutil.which("mount") is None or os.name != "posix":
        pytest.skip("this system has no mount")
    command = ["mount", "-t", "tmpfs", "-o", f"size={SIZE}", "none", str(folder)]
    if subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("a file system can be mounted by root alone")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def fill(folder):
    """Fill the file system to its last byte, and return the file that does."""
    path = folder / "ballast"
    with path.open("wb", buffering=0) as file, suppress(OSError):
        while True:
            file.write(bytes(4096))
    return path


def rise(n):
    """Return a posting with a request of its own."""
    reading = {"kind": "height_difference", "station": "A", "target": "B", "value": 1.0}
    return {**reading, "id": f"f{n}", "request": f"f{n}"}


def test_a_site_on_a_full_disk_says_so_and_goes_on_when_there_is_room(disk):
    with served(disk) as client:
        for record in ARRIVALS:
            assert client.post(f"{ADDRESS}/postings", json=record).json()["ok"]
        ballast, done, refused = fill(disk), [], None
        for n in range(400):  # room that the files of SQLite have already
            answer = client.post(f"{ADDRESS}/postings", json=rise(n))
            if answer.status_code != 200:
                refused = answer
                break
            assert answer.json()["ok"], answer.json()
            done.append(f"f{n}")
        assert refused is not None
        assert refused.status_code == 503 and int(refused.headers["retry-after"]) > 0
        assert "full" in refused.json()["error"][0]["what"], refused.json()
        assert client.get("/api/v1/health").status_code == 503
        ballast.unlink()
        answer = client.post(f"{ADDRESS}/postings", json=rise(len(done)))
        assert answer.status_code == 200 and "repeated" not in answer.json()
        assert client.post(f"{ADDRESS}/postings", json=rise(0)).json()["repeated"] is True
        assert client.get("/api/v1/health").status_code == 200
    with site_of(disk) as site, yard_of(site).reading() as epoch:  # its chain is whole
        there = [*epoch.stream.adjustment.network().observations]
    assert sorted(i for i in there if i.startswith("f")) == sorted([*done, f"f{len(done)}"])


def test_an_outbox_on_a_full_disk_keeps_what_it_took(disk):
    outbox, taken = Outbox(disk / "outbox.sqlite"), 0
    ballast = fill(disk)
    with pytest.raises(AdjustmentError, match="full"):
        for _ in range(2000):
            outbox.put("yard", rise(taken))
            taken += 1
    assert len(outbox) == taken
    ballast.unlink()
    outbox.put("yard", rise(taken))
    assert [k.record["request"] for k in outbox.first(5000)] == [f"f{n}" for n in range(taken + 1)]
    outbox.close()


def test_a_backup_to_a_full_disk_is_refused_and_leaves_nothing(disk, tmp_path):
    folder = tmp_path / "site"
    folder.mkdir()
    with site_of(yard_site(folder)) as site:
        assert all(yard_of(site).submit(r).result(60)["ok"] for r in ARRIVALS)
        ballast = fill(disk)
        with pytest.raises(AdjustmentError, match=r"(?i)space|full"):
            write_archive(folder, disk / "site.zip")
        assert [p.name for p in disk.iterdir()] == ["ballast"]
        ballast.unlink()
        write_archive(folder, disk / "site.zip")
    assert zipfile.ZipFile(disk / "site.zip").testzip() is None
