"""Archives of sites: the site file, its projects, and all tables, in one file, also while served.

An archive is a ZIP file: ``archive.json`` states versions and digests, ``files/`` has the site file
and the folders of its projects, ``tables/NAME.jsonl`` the rows of each table. All rows are those of
one moment (one transaction that reads), whatever is written meanwhile. Tables do not depend on the
kind of the database: an archive of SQLite is restored into PostgreSQL, and the other way round.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import time as clock
import zipfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import IO, TYPE_CHECKING, Any

from ..errors import InputError, Problem, system_reason
from ..files import keeping_inputs
from ..io.readers import READERS
from ..version import __version__
from .database import Database, at_one_moment
from .site_file import SITE_FILE, SiteSettings, read_site

if TYPE_CHECKING:
    from sqlalchemy import Connection

ARCHIVE_VERSION = 1
"""Version of the archives that are written and read."""
CONTENTS = "archive.json"
"""Name of the list of what an archive has."""
ROWS_AT_ONCE = 1000
"""Number of rows that are inserted at once."""
DATABASE_SUFFIXES = ("", "-wal", "-shm", "-journal", ".lock")
"""What SQLite and the service add to the name of a database file."""


def write_archive(site: str | Path, path: str | Path) -> dict[str, int]:
    """Write an archive of a site, and return the number of rows of each table.

    Args:
        site: site file, folder or project, as for `factorgraph_adj.site.site_file.read_site`.
        path: the archive, which must not exist.

    Raises:
        InputError: the archive exists or cannot be written, files of projects lie outside the
            folder of the site, or the database cannot be read.
    """
    settings, path = read_site(site), Path(path)
    files = _files(settings, leave_out=path)
    database = Database(settings.database, serve=False)
    try:
        with path.open("xb") as raw, zipfile.ZipFile(raw, "w", zipfile.ZIP_DEFLATED) as archive:
            digests: dict[str, str] = {}
            for name, file in files.items():
                digests[f"files/{name}"] = _stored(archive, f"files/{name}", [file.read_bytes()])
            with database.reading() as connection:
                at_one_moment(connection)
                revision, counts = database.revision(connection), dict[str, int]()
                for table in _tables():
                    counts[table.name] = 0
                    lines = _lines(connection, table, counts)
                    name = f"tables/{table.name}.jsonl"
                    digests[name] = _stored(archive, name, lines)
            own = {"archive": ARCHIVE_VERSION, "program": __version__, "at": clock.time()}
            own |= {"site": settings.name, "site_file": _site_file(settings)}
            own |= {"revision": revision, "rows": counts, "sha256": digests}
            archive.writestr(CONTENTS, json.dumps(own, indent=1))
        return counts
    except FileExistsError:
        raise InputError(Problem("exists: an archive replaces no file", str(path))) from None
    except BaseException as error:
        path.unlink(missing_ok=True)
        if isinstance(error, OSError):
            what = f"cannot be written: {system_reason(error)}"
            raise InputError(Problem(what, str(path))) from None
        raise
    finally:
        database.close()


def restore_archive(
    path: str | Path, folder: str | Path, *, database: str | None = None
) -> dict[str, int]:
    """Make a site of an archive, and return the number of rows of each table.

    Args:
        path: the archive.
        folder: folder of the site, which must be empty or absent.
        database: address of another database, which must be empty; None: as the site file says.

    Raises:
        InputError: the folder or the database is not empty; the archive is damaged, of a newer
            version, or no archive.
    """
    path, folder = Path(path), Path(folder)
    if folder.exists() and any(folder.iterdir()):
        raise InputError(Problem("is not empty: a site is restored into a new folder", str(folder)))
    try:
        with zipfile.ZipFile(path) as archive:
            contents = _contents(archive, path)
            _check(archive, contents, path)
            try:
                _extract(archive, contents, folder)
                if database is not None:
                    _state_database(folder / contents["site_file"], database)
                settings = read_site(folder / contents["site_file"])
                return _fill(archive, contents, settings, path)
            except BaseException:
                shutil.rmtree(folder)  # it was empty
                raise
    except (OSError, zipfile.BadZipFile) as error:
        why = system_reason(error) if isinstance(error, OSError) else str(error)
        what = f"cannot be read as an archive of a site: {why}"
        raise InputError(Problem(what, str(path))) from None


# -- writing ---------------------------------------------------------------------------------------


def _site_file(settings: SiteSettings) -> str:
    return "." if settings.path.is_dir() else settings.path.name


def _files(settings: SiteSettings, *, leave_out: Path) -> dict[str, Path]:
    """Return the files of a site by their names relative to its folder."""
    folder = (settings.path if settings.path.is_dir() else settings.path.parent).resolve()
    base = Path(settings.database) if "://" not in settings.database else None
    without = {leave_out.resolve()}
    if base is not None:
        without |= {Path(f"{base}{suffix}").resolve() for suffix in DATABASE_SUFFIXES}
    found = {settings.path.resolve()} if settings.path.is_file() else set()
    for network in settings.networks:
        found |= _files_of_project(network.project, folder)
    return {f.relative_to(folder).as_posix(): f for f in sorted(found - without)}


def _files_of_project(project: Path, folder: Path) -> set[Path]:
    """Return the files that a project names: whatever else lies beside it is nobody's affair.

    Raises:
        InputError: one of them lies outside the folder of the site.
    """
    with keeping_inputs() as run:
        network = READERS.load(str(project), allow_outside=True, options={}).network
    found = {f.resolve() for f in run.read}
    found |= {project.resolve()} if project.is_file() else set()
    geoid = None if network.crs is None else network.crs.geoid
    found |= {Path(geoid).resolve()} if isinstance(geoid, str) and Path(geoid).is_file() else set()
    outside = sorted(f for f in found if not f.is_relative_to(folder))
    if outside:
        what = "lies outside the folder of the site: an archive cannot hold it"
        raise InputError(Problem(what, str(f)) for f in outside)
    return found


def _stored(archive: zipfile.ZipFile, name: str, parts: Any) -> str:
    """Write a member in parts, and return its digest."""
    digest = hashlib.sha256()
    with archive.open(name, "w", force_zip64=True) as member:
        for part in parts:
            digest.update(part)
            member.write(part)
    return digest.hexdigest()


def _tables() -> list[Any]:
    """Return all tables, each after those to which it refers."""
    from .tables import metadata

    return list(metadata.sorted_tables)


def _lines(connection: Connection, table: Any, counts: dict[str, int]) -> Iterator[bytes]:
    """Yield the rows of a table as lines of JSON, in the order of its key."""
    from sqlalchemy import select

    wanted = select(table).order_by(*table.primary_key.columns)
    for row in connection.execution_options(yield_per=ROWS_AT_ONCE).execute(wanted):
        counts[table.name] += 1
        yield json.dumps(dict(row._mapping), ensure_ascii=False).encode() + b"\n"


# -- reading ---------------------------------------------------------------------------------------


def _contents(archive: zipfile.ZipFile, path: Path) -> dict[str, Any]:
    if CONTENTS not in archive.namelist():
        raise InputError(Problem(f"is no archive of a site: it lacks {CONTENTS}", str(path)))
    try:
        contents: dict[str, Any] = json.loads(archive.read(CONTENTS))
        version = contents["archive"]
        _ = contents["sha256"], contents["site_file"], contents["rows"], contents["revision"]
    except (ValueError, KeyError, TypeError):
        raise InputError(Problem(f"is damaged: {CONTENTS} is not whole", str(path))) from None
    if version != ARCHIVE_VERSION:
        what = f"is of version {version}; this program reads {ARCHIVE_VERSION}: upgrade it"
        raise InputError(Problem(what, str(path)))
    return contents


def _check(archive: zipfile.ZipFile, contents: dict[str, Any], path: Path) -> None:
    """Refuse an archive that is not as it was written."""
    problems = []
    there = set(archive.namelist())
    for name, wanted in contents["sha256"].items():
        if name not in there:
            problems.append(Problem(f"is damaged: it lacks {name}", str(path)))
            continue
        digest = hashlib.sha256()
        try:
            with archive.open(name) as member:
                while part := member.read(1 << 20):
                    digest.update(part)
        except zipfile.BadZipFile:
            digest.update(b"?")
        if digest.hexdigest() != wanted:
            problems.append(Problem(f"is damaged: {name} was changed", str(path)))
    for name in [*contents["sha256"], f"files/{contents['site_file']}"]:
        if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
            problems.append(Problem(f"names a file outside the site: {name}", str(path)))
    if problems:
        raise InputError(problems)


def _extract(archive: zipfile.ZipFile, contents: dict[str, Any], folder: Path) -> None:
    for name in contents["sha256"]:
        if name.startswith("files/"):
            target = folder / name.removeprefix("files/")
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(archive.read(name))


def _state_database(path: Path, database: str) -> None:
    """State another database in a site file."""
    path = path / SITE_FILE if path.is_dir() else path
    said = f"database = {json.dumps(database)}\n"
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True) if path.exists() else []
    if not any(line.strip() == "[site]" for line in lines):
        what = "states no [site]: name the database there"
        raise InputError(Problem(f"--database: the site file {what}", str(path)))
    kept, table = [], ""
    for line in lines:
        table = line.strip() if line.lstrip().startswith("[") else table
        if table == "[site]" and line.split("=")[0].strip() == "database":
            continue
        kept += [line, said] if line.strip() == "[site]" else [line]
    path.write_text("".join(kept), encoding="utf-8")


def _fill(
    archive: zipfile.ZipFile, contents: dict[str, Any], settings: SiteSettings, path: Path
) -> dict[str, int]:
    """Write all rows into the database of a site, in one transaction."""
    from sqlalchemy import func, insert, select

    database = Database(settings.database)
    try:
        with database.writing() as connection:
            for table in _tables():
                if connection.execute(select(func.count()).select_from(table)).scalar():
                    what = "is not empty: an archive replaces no database"
                    raise InputError(Problem(what, database.where))
            if database.revision(connection) != contents["revision"]:
                what = (
                    f"has tables of revision {contents['revision']}, this program those of "
                    f"{database.revision(connection)}: restore it with the version "
                    f"{contents.get('program')} that wrote it, then upgrade"
                )
                raise InputError(Problem(what, str(path)))
            counts = {}
            for table in _tables():
                counts[table.name] = 0
                with archive.open(f"tables/{table.name}.jsonl") as member:
                    for rows in _batches(member):
                        connection.execute(insert(table), rows)
                        counts[table.name] += len(rows)
            database.number_on(connection)
        return counts
    finally:
        database.close()


def _batches(member: IO[bytes]) -> Iterator[list[dict[str, Any]]]:
    rows: list[dict[str, Any]] = []
    for line in member:
        rows.append(json.loads(line))
        if len(rows) == ROWS_AT_ONCE:
            yield rows
            rows = []
    if rows:
        yield rows
