"""Archives of sites: written while served, restored into either database, the chain goes on."""

from __future__ import annotations

import json
import threading
import zipfile

import pytest

from factorgraph_adj.errors import InputError
from factorgraph_adj.site.site_archive import CONTENTS, restore_archive, write_archive
from tests.networks.yard import ARRIVALS
from tests.support.sites import STORES, database_of, new_database, site_of, storing_in, yard_of

pytestmark = pytest.mark.usefixtures("store")
REQUESTED = [{**a, "request": f"r{n}"} for n, a in enumerate(ARRIVALS)]


def posted(live, *records):
    return [f.result(30) for f in [live.submit(r) for r in records]]


@pytest.fixture
def archive(tmp_path):
    """An archive of a site with four readings, written while it is served."""
    folder = tmp_path / "site"
    folder.mkdir()
    with site_of(folder) as site:
        for reading in REQUESTED[:4]:  # each a line: what waits together is one
            posted(yard_of(site), reading)
        site.access.add("office", "viewer")
        counts = write_archive(folder, tmp_path / "site.zip")
        posted(yard_of(site), *REQUESTED[4:])
    assert (counts["networks"], counts["journal"], counts["requests"]) == (1, 5, 4)
    return tmp_path / "site.zip"


@pytest.mark.parametrize("target", STORES)
def test_a_restored_site_goes_on_where_its_archive_was_written(archive, tmp_path, target):
    restored = tmp_path / "restored"
    with storing_in(target):
        database = new_database(restored)
        restore_archive(archive, restored, database=database)
        with site_of(restored) as site:
            answers = posted(yard_of(site), *REQUESTED)
            assert [a.get("repeated", False) for a in answers] == [True] * 4 + [False] * 3
            assert [t["name"] for t in site.access.listed()] == ["office"]
            numbers = [e.id for e in site.events.after(0)]
            assert numbers == sorted(set(numbers)) and len(numbers) == len(ARRIVALS)
            with yard_of(site).reading() as epoch:
                assert len(epoch.stream.adjustment) == len(ARRIVALS)
        assert ("://" in database_of(restored)) == (target == "postgresql")


def test_an_archive_is_of_one_moment_while_postings_come(tmp_path):
    with site_of(tmp_path) as site:
        live, enough = yard_of(site), threading.Event()
        rise = {"kind": "height_difference", "station": "A", "target": "C", "value": 1.4996}

        def post():
            n = 0
            while not enough.is_set():
                n += 1
                posted(live, {**rise, "id": f"h{n}", "request": f"q{n}"})

        thread = threading.Thread(target=post)
        thread.start()
        try:
            for k in range(3):
                counts = write_archive(tmp_path, tmp_path / f"{k}.zip")
                assert counts["journal"] == counts["requests"] + 1 == counts["events"] + 1
        finally:
            enough.set()
            thread.join()


def test_nothing_is_overwritten(archive, tmp_path):
    with pytest.raises(InputError, match="replaces no file"):
        write_archive(tmp_path / "site", archive)
    with pytest.raises(InputError, match="not empty"):
        restore_archive(archive, tmp_path / "site")
    taken = database_of(tmp_path / "site")
    with pytest.raises(InputError, match="replaces no database"):
        restore_archive(archive, tmp_path / "other", database=taken)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("tables/journal.jsonl", lambda data: data.replace(b"58.3268", b"58.3269"), "was changed"),
        ("tables/events.jsonl", None, "lacks tables/events.jsonl"),
        (CONTENTS, None, "no archive of a site"),
        (CONTENTS, lambda data: data[:50], "not whole"),
        (CONTENTS, lambda data: data.replace(b'"archive": 1', b'"archive": 2'), "upgrade"),
        (CONTENTS, lambda data: data.replace(b'"revision": "', b'"revision": "9'), "then upgrade"),
    ],
)
def test_a_damaged_archive_is_refused(archive, tmp_path, name, change, message):
    damaged = tmp_path / "damaged.zip"
    with zipfile.ZipFile(archive) as source, zipfile.ZipFile(damaged, "w") as target:
        for member in source.namelist():
            data = source.read(member)
            if member == name and change is None:
                continue
            target.writestr(member, change(data) if member == name else data)
    with pytest.raises(InputError, match=message):
        restore_archive(damaged, tmp_path / "restored", database=new_database(tmp_path))
    assert not (tmp_path / "restored").exists()


def test_an_archive_that_leaves_its_folder_is_refused(archive, tmp_path):
    wrong = tmp_path / "wrong.zip"
    with zipfile.ZipFile(archive) as source, zipfile.ZipFile(wrong, "w") as target:
        for member in source.namelist():
            if member != CONTENTS:
                target.writestr(member, source.read(member))
        contents = json.loads(source.read(CONTENTS))
        contents["sha256"]["files/../../evil"] = "0"
        target.writestr(CONTENTS, json.dumps(contents))
    with pytest.raises(InputError, match="outside the site"):
        restore_archive(wrong, tmp_path / "restored")
    assert not (tmp_path / "evil").exists()


def test_what_is_no_archive_is_refused(tmp_path):
    (tmp_path / "x.zip").write_text("name,x,y\n")
    with pytest.raises(InputError, match="archive of a site"):
        restore_archive(tmp_path / "x.zip", tmp_path / "restored")
