"""The database of a site: one schema in two stores, migrations, one process, away and back."""

from __future__ import annotations

import json
import subprocess
import sys
import threading

import pytest
from alembic import command
from alembic.config import Config
from sqlalchemy import create_engine, func, insert, inspect, select, text
from sqlalchemy.engine import make_url

from factorgraph_adj.errors import InputError
from factorgraph_adj.site import database as database_module
from factorgraph_adj.site.database import Database, DatabaseAway
from factorgraph_adj.site.tables import REVISION, events, journal, metadata, requests
from tests.networks.yard import ARRIVALS
from tests.support.places import ROOT
from tests.support.postgresql import server
from tests.support.processes import HANGS
from tests.support.sites import ADDRESS, ALARM, database_of, readings, served, site_of, yard_of

pytestmark = pytest.mark.usefixtures("store")


def test_one_process_serves_a_database(tmp_path):
    with site_of(tmp_path) as site, pytest.raises(InputError, match="another process"):
        Database(site.settings.database)


def test_migrations_make_the_tables_that_the_program_uses(tmp_path):
    from alembic.autogenerate import compare_metadata
    from alembic.migration import MigrationContext

    database = Database(database_of(tmp_path))
    with database.reading() as connection:
        context = MigrationContext.configure(connection)
        assert compare_metadata(context, metadata) == []
        assert context.get_current_revision() == database.revision(connection) == REVISION
    database.close()


BEGUN_AGAIN = """
import sys
from factorgraph_adj.site.api import application
from factorgraph_adj.site.site import Site
from factorgraph_adj.site.site_file import read_site
site = Site(read_site(sys.argv[1]))
application(site)
site.database.close()
slow = {"alembic", "scipy.stats", "scipy.optimize", "plotly", "pandas", "matplotlib"}
assert not slow & set(sys.modules), slow & set(sys.modules)
"""


def test_a_service_that_begins_again_loads_nothing_that_takes_long(tmp_path):
    Database(database_of(tmp_path)).close()  # which makes the tables
    command = [sys.executable, "-c", BEGUN_AGAIN, str(tmp_path)]
    ran = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    assert ran.returncode == 0, ran.stderr


def test_a_database_of_a_newer_version_is_refused(tmp_path):
    database = Database(database_of(tmp_path))
    with database.writing() as connection:
        connection.exec_driver_sql("update alembic_version set version_num = '9999'")
    database.close()
    with pytest.raises(InputError, match="newer version"):
        Database(database_of(tmp_path))


def test_only_who_serves_a_database_upgrades_it(tmp_path):
    database = Database(database_of(tmp_path))
    with database.writing() as connection:
        connection.exec_driver_sql("update alembic_version set version_num = '0000'")
    database.close()
    with pytest.raises(InputError, match="revision 0000"):
        Database(database_of(tmp_path), serve=False)


def test_a_value_that_breaks_a_rule_of_the_database_is_not_half_written(tmp_path):
    database = Database(database_of(tmp_path))
    with pytest.raises(DatabaseAway), database.writing() as connection:
        connection.execute(insert(events).values(at=1.0, kind="x", data="{}", network=None))
        connection.execute(insert(events).values(at=1.0, kind="x", data="{}", network=99))
    with database.reading() as connection:
        assert connection.execute(select(func.count()).select_from(events)).scalar() == 0
    database.close()


def engine_of(address):
    """Return an engine of a database, as another program has it."""
    return create_engine(make_url(address if "://" in address else f"sqlite:///{address}"))


def migrated(address, revision, *, down=False):
    """Bring a database to a revision."""
    config = Config()
    config.set_main_option("script_location", str(database_module.MIGRATIONS))
    engine = engine_of(address)
    with engine.connect() as connection:
        config.attributes["connection"] = connection
        (command.downgrade if down else command.upgrade)(config, revision)
        connection.commit()
    engine.dispose()


def tables_of(address):
    engine = engine_of(address)
    names = set(inspect(engine).get_table_names()) - {"alembic_version"}
    engine.dispose()
    return names


def test_migrations_go_both_ways(tmp_path):
    address = database_of(tmp_path)
    for _ in range(2):
        migrated(address, "head")
        assert tables_of(address) == set(metadata.tables)
        migrated(address, "base", down=True)
        assert tables_of(address) == set()


FIRST_COLUMNS = {
    "networks": "id, name, settings, begun",
    "epochs": 'id, network, number, "begin", "end", state, revision, result',
    "journal": "epoch, line, text",
    "requests": "id, network, request, digest, at, answer",
    "events": "id, network, at, kind, data",
}
"""Columns of revision 0001, which never change."""


def dumped(address):
    """Return the rows of a database as revision 0001 had them."""
    engine = engine_of(address)
    with engine.connect() as connection:
        out = {
            table: [
                dict(row._mapping) for row in connection.execute(text(f"select {c} from {table}"))
            ]
            for table, c in FIRST_COLUMNS.items()
        }
    engine.dispose()
    return out


def test_a_database_of_the_first_version_is_upgraded_with_its_journals(tmp_path):
    requested = [{**a, "request": f"r{n}"} for n, a in enumerate(ARRIVALS)]
    old, new = tmp_path / "old", tmp_path / "new"
    for folder in (old, new):
        folder.mkdir()
    with site_of(old) as site:
        first = [f.result(HANGS) for f in [yard_of(site).submit(r) for r in requested[:4]]]
        assert all(a["ok"] for a in first)
    dump = dumped(database_of(old))
    address = database_of(new)
    migrated(address, "0001")
    engine = engine_of(address)
    with engine.begin() as connection:
        for table, columns in FIRST_COLUMNS.items():
            names = [c.strip(' "') for c in columns.split(",")]
            values = ", ".join(f":{n}" for n in names)
            assert dump[table], table
            connection.execute(
                text(f"insert into {table} ({columns}) values ({values})"), dump[table]
            )
        if engine.dialect.name == "postgresql":
            for table in ("networks", "epochs", "requests", "events"):
                sequence = f"pg_get_serial_sequence('{table}', 'id')"
                connection.execute(
                    text(f"select setval({sequence}, (select max(id) from {table}))")
                )
    engine.dispose()
    with site_of(new) as site:
        answers = [f.result(HANGS) for f in [yard_of(site).submit(r) for r in requested]]
        assert [a.get("repeated", False) for a in answers] == [True] * 4 + [False] * 3
        with yard_of(site).reading() as epoch:
            assert len(epoch.stream.adjustment) == len(ARRIVALS)


ROUTES = ("epochs", "epochs/2", "epochs/4", "series?points=C,nobody", "variance-components")
"""Routes that read results of epochs."""


def results_in(address):
    """Return what the tables have of results, read as JSON."""
    engine = engine_of(address)
    with engine.connect() as connection:
        rows = connection.execute(text("select number, summary, result from epochs")).all()
        points = connection.execute(text("select epoch, point, data from point_results")).all()
    engine.dispose()
    read = lambda x: x if x is None else json.loads(x)  # noqa: E731
    columns = {row.number: (read(row.summary), read(row.result)) for row in rows}
    return columns, {(row.epoch, row.point): read(row.data) for row in points}


def test_results_of_epochs_are_parted_by_an_upgrade(tmp_path):
    """As a service of this version writes them; going back, each is whole in one column."""
    with served(tmp_path, epochs="1 h", more=ALARM) as client:
        for hour in range(6):
            client.post(f"{ADDRESS}/postings", json=readings(hour, 0.01 if hour == 3 else 0.0))
        answers = [client.get(f"{ADDRESS}/{route}").json() for route in ROUTES]
        rows = yard_of(client.app.state.site).epochs(results=True)
    address = database_of(tmp_path)
    parts = results_in(address)
    assert len(parts[1]) >= 12 and any(part.get("tests") for part in parts[1].values())
    migrated(address, "0003", down=True)
    engine = engine_of(address)
    with engine.connect() as connection:
        whole = connection.execute(text("select number, result from epochs")).all()
    engine.dispose()
    assert {n: r and json.loads(r) for n, r in whole} == {r["number"]: r["result"] for r in rows}
    with served(tmp_path, epochs="1 h", more=ALARM) as client:
        assert results_in(address) == parts
        assert [client.get(f"{ADDRESS}/{route}").json() for route in ROUTES] == answers


def test_lists_of_epochs_read_no_results(tmp_path):
    routes = [route for route in ROUTES if "epochs/" not in route]
    with served(tmp_path, epochs="1 h", more=ALARM) as client:
        for hour in range(4):
            client.post(f"{ADDRESS}/postings", json=readings(hour))
        answers = [client.get(f"{ADDRESS}/{route}").json() for route in routes]
        assert all(answers) and len(answers[1][0]["z"]) == 4
        engine = engine_of(database_of(tmp_path))
        with engine.begin() as connection:
            connection.execute(text("update epochs set result = 'is not JSON'"))
            connection.execute(text("update point_results set data = '' where point <> 'C'"))
        engine.dispose()
        assert [client.get(f"{ADDRESS}/{route}").json() for route in routes] == answers


def test_an_address_that_is_none_is_refused_without_its_password():
    for wrong in ("nothing://u:secret@h/d", "postgresql+psycopg://u:secret@127.0.0.1:9/d"):
        with pytest.raises(InputError) as refused:
            Database(wrong)
        assert "secret" not in str(refused.value)


def counted(address):
    """Return how often each observation is in the journal, and the requests."""
    engine = engine_of(address)
    with engine.connect() as connection:
        lines = connection.execute(select(journal.c.text)).scalars().all()
        asked = connection.execute(select(requests.c.request)).scalars().all()
    engine.dispose()
    ids = [f"h{n}" for n in range(1000)]
    whole = "\n".join(lines)
    return {
        i: n for i in ids if (n := whole.count(f'"id": "{i}"') + whole.count(f'"id":"{i}"'))
    }, asked


def test_a_server_that_goes_away_and_comes_back_loses_nothing(tmp_path, store):
    """Senders try again what was refused with 503; each posting is there once."""
    if store == "sqlite":
        pytest.skip("SQLite has no server that goes away")
    wanted = 40
    statuses, lock = [], threading.Lock()
    gone = threading.Event()

    def send(client, first):
        for n in range(first, wanted, 2):
            rise = {"kind": "height_difference", "station": "A", "target": "B", "value": 1.0}
            record = {**rise, "id": f"h{n}", "request": f"q{n}"}
            while True:
                answer = client.post(f"{ADDRESS}/postings", json=record)
                with lock:
                    statuses.append(answer.status_code)
                if answer.status_code == 200:
                    assert answer.json()["ok"]
                    break
                assert answer.status_code == 503 and answer.headers["retry-after"], answer.text
                assert answer.json()["error"][0]["what"]
                gone.set()
                threading.Event().wait(0.05)

    with served(tmp_path) as client:
        assert client.post(f"{ADDRESS}/postings", json=ARRIVALS[0]).status_code == 200
        threads = [threading.Thread(target=send, args=(client, k)) for k in range(2)]
        for thread in threads:
            thread.start()
        try:
            server().stop("immediate")
            assert gone.wait(HANGS)
            assert client.get("/api/v1/health").status_code == 503
        finally:
            server().start()
        for thread in threads:
            thread.join(HANGS)
        assert client.get("/api/v1/health").status_code == 200
        found, asked = counted(database_of(tmp_path))
        assert found == {f"h{n}": 1 for n in range(wanted)}
        assert sorted(asked) == sorted(f"q{n}" for n in range(wanted))


END_OTHERS = (
    "select pg_terminate_backend(pid) from pg_stat_activity "
    "where pid != pg_backend_pid() and datname = current_database()"
)


def test_another_process_that_took_the_database_meanwhile_is_left_alone(tmp_path, store):
    """The lock of PostgreSQL ends with its connection: who has lost it writes no more."""
    if store == "sqlite":
        pytest.skip("the lock of a file lasts as long as the process")
    with site_of(tmp_path) as site:
        assert yard_of(site).submit(ARRIVALS[0]).result(HANGS)["ok"]
        engine = engine_of(database_of(tmp_path))
        with engine.connect() as connection:
            connection.execute(text(END_OTHERS))
            connection.commit()
        engine.dispose()
        other = Database(database_of(tmp_path))
        with pytest.raises(DatabaseAway):  # the connection is gone
            yard_of(site).submit(ARRIVALS[1]).result(HANGS)
        with pytest.raises(DatabaseAway, match="another process serves it"):
            yard_of(site).submit(ARRIVALS[1]).result(HANGS)
        other.close()
        assert yard_of(site).submit(ARRIVALS[1]).result(HANGS)["ok"]


def test_a_database_that_another_program_locks_is_away_for_a_while(tmp_path, store, monkeypatch):
    monkeypatch.setattr(database_module, "BUSY_SECONDS", 0.2)
    with served(tmp_path) as client:
        assert client.post(f"{ADDRESS}/postings", json=ARRIVALS[0]).status_code == 200
        engine = engine_of(database_of(tmp_path))
        with engine.connect() as connection:
            if store == "sqlite":
                connection.connection.driver_connection.isolation_level = None
                connection.exec_driver_sql("BEGIN EXCLUSIVE")
            else:
                connection.execute(text("lock table journal in access exclusive mode"))
            refused = client.post(f"{ADDRESS}/postings", json=ARRIVALS[1])
            assert refused.status_code == 503 and refused.headers["retry-after"]
        engine.dispose()
        answer = client.post(f"{ADDRESS}/postings", json=ARRIVALS[1])
        counts = answer.json()["counts"]
        assert answer.status_code == 200 and counts["observations"] + counts["waiting"] == 2
