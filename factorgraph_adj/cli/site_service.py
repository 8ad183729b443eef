"""Command ``serve``: a site with its API and its page."""

from __future__ import annotations

import argparse
import ipaddress
import socket
import webbrowser
from threading import Timer

from ..errors import InputError, Problem, system_reason
from ..io.project import Project
from ..io.readers import READERS
from .messages import EXIT_FINE, print_warnings

DEFAULT_PORT = 8437
"""Port of the service where none is stated."""


def add_serve(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument(
        "site",
        metavar="PROJECT",
        help="a site file (site.toml), a folder that has one, or a project, which is a site of one "
        "network",
    )
    parser.add_argument("--host", default="127.0.0.1", help="address on which it listens")
    parser.add_argument("--port", type=int, default=DEFAULT_PORT, help="port (%(default)s)")
    parser.add_argument("--tls-certificate", metavar="FILE", help="certificate of TLS (PEM)")
    parser.add_argument("--tls-key", metavar="FILE", help="key of the certificate (PEM)")
    parser.add_argument(
        "--token",
        metavar="NAME:ROLE",
        action="append",
        default=[],
        help="make a token (instrument, viewer, surveyor, admin), print it, and end",
    )
    parser.add_argument("--no-browser", action="store_true", help="do not open the page")
    parser.add_argument(
        "--allow-outside", action="store_true", help="projects may name files elsewhere"
    )
    parser.set_defaults(run=_serve)


def _serve(options: argparse.Namespace) -> int:
    from ..site.database import EXTRA_MISSING, Database
    from ..site.site_file import read_site

    try:
        import uvicorn

        from ..site.api import application
        from ..site.site import Site
    except ImportError:
        raise InputError(EXTRA_MISSING) from None
    settings = read_site(options.site)
    if options.token:
        from ..site.access import Access

        database = Database(settings.database, serve=False)
        try:
            access = Access(database)
            for text in options.token:
                name, _, role = text.rpartition(":")
                print(f"{name} {role} {access.add(name, role)}")
        finally:
            database.close()
        return EXIT_FINE
    if bool(options.tls_certificate) != bool(options.tls_key):
        raise InputError("--tls-certificate and --tls-key belong together")
    listening = _socket(options.host, options.port)
    site = Site(settings, allow_outside=options.allow_outside)
    if site.access.open and not _is_loopback(options.host):
        site.database.close()
        what = "without tokens the service listens on a loopback address alone; make one first: "
        raise InputError(f"{what}factorgraph-adj serve {options.site} --token NAME:admin")
    scheme = "https" if options.tls_key else "http"
    port = listening.getsockname()[1]
    address = f"{scheme}://{options.host}:{port}/"
    print(f"{settings.name}: {address}", flush=True)
    print_warnings(site.unknown_points())
    if not options.no_browser:
        Timer(1.0, webbrowser.open, (address,)).start()
    config = uvicorn.Config(
        application(site),
        log_level="warning",
        access_log=False,  # of addresses and what was asked; a proxy in front can have one
        ssl_certfile=options.tls_certificate,
        ssl_keyfile=options.tls_key,
        timeout_graceful_shutdown=5,
        server_header=False,
    )
    uvicorn.Server(config).run(sockets=[listening])
    return EXIT_FINE


def checked_site(
    path: str, *, allow_outside: bool
) -> tuple[list[Project], list[Problem], list[Problem]]:
    """Return the projects of a site, names and patterns that match nothing, and what is wrong.

    Where the site file has problems, names and patterns are those of the projects that can be read.

    Args:
        path: a site file, or a folder that has one.
        allow_outside: whether projects may name files elsewhere.

    Raises:
        InputError: the site file is no TOML.
    """
    from ..io.text_files import read_toml
    from ..site.site_file import site_and_problems
    from ..site.unknown_points import unknown_points

    settings, problems = site_and_problems(path)
    projects: dict[str, Project] = {}
    of_projects: list[Problem] = []
    for network in settings.networks:
        try:
            projects[network.name] = READERS.load(
                str(network.project), allow_outside=allow_outside, options={}
            )
        except InputError as error:
            of_projects += error.noted
    points = {name: list(project.network.points) for name, project in projects.items()}
    _, places = read_toml(settings.path)
    unknown = places.in_order(unknown_points(settings, points))
    # A project that the file does not name rightly is not what is meant.
    return list(projects.values()), unknown, problems or of_projects


def _socket(host: str, port: int) -> socket.socket:
    """Return a listening socket, so that a port that is taken is told before anything else."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    made = socket.socket(family)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        made.bind((host, port))
    except (OSError, OverflowError) as error:
        made.close()
        why = system_reason(error) if isinstance(error, OSError) else "ports are 0 to 65535"
        raise InputError(Problem(f"cannot listen: {why}", f"{host}:{port}")) from None
    made.set_inheritable(True)
    return made


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
