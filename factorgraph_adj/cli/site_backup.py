"""Commands ``backup`` and ``restore``: a site as one archive, and an archive as a site."""

from __future__ import annotations

import argparse

from .messages import EXIT_FINE


def add_backup(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("site", metavar="SITE", help="site file, folder or project")
    parser.add_argument("file", metavar="FILE", help="archive (.zip), which must not exist")
    parser.set_defaults(run=_backup)


def add_restore(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("file", metavar="FILE", help="archive that `backup` wrote")
    parser.add_argument("folder", metavar="FOLDER", help="folder of the site, empty or new")
    parser.add_argument(
        "--database",
        metavar="ADDRESS",
        help="another database than the site file says, such as postgresql+psycopg://USER@HOST/NAME",
    )
    parser.set_defaults(run=_restore)


def _backup(options: argparse.Namespace) -> int:
    from ..site.site_archive import write_archive

    print(f"{options.file}: {_said(write_archive(options.site, options.file))}")
    return EXIT_FINE


def _restore(options: argparse.Namespace) -> int:
    from ..site.site_archive import restore_archive

    rows = restore_archive(options.file, options.folder, database=options.database)
    print(f"{options.folder}: {_said(rows)}")
    return EXIT_FINE


def _said(rows: dict[str, int]) -> str:
    return ", ".join(f"{number} {name}" for name, number in rows.items() if number)
