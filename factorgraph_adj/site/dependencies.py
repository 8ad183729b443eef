"""What every route needs: the site, the caller with a right, a network."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

from fastapi import Depends, Request

from .access import Caller, Right
from .live_network import LiveNetwork
from .site import Site

COOKIE = "fga_session"
"""Cookie with the token of a browser."""


def site_of(request: Request) -> Site:
    """Return the site."""
    site: Site = request.app.state.site
    return site


def token_of(request: Request) -> str | None:
    """Return the token of a request: of its header, or of the cookie of a browser."""
    kind, _, text = request.headers.get("authorization", "").partition(" ")
    if kind.lower() == "bearer" and text.strip():
        return text.strip()
    return request.cookies.get(COOKIE)


def caller_with(right: Right) -> Callable[[Request], Caller]:
    """Return a function that gives the caller of a request, who must have a right."""

    def found(request: Request) -> Caller:
        access = site_of(request).access
        caller = access.caller(token_of(request))
        access.require(caller, right)
        access.slow_down(caller)
        return caller

    return found


def network_of(name: str, request: Request) -> LiveNetwork:
    """Return the network of an address."""
    return site_of(request).network(name)


TheSite = Annotated[Site, Depends(site_of)]
Network = Annotated[LiveNetwork, Depends(network_of)]
Reader = Annotated[Caller, Depends(caller_with("read"))]
Poster = Annotated[Caller, Depends(caller_with("post"))]
Decider = Annotated[Caller, Depends(caller_with("decide"))]
Manager = Annotated[Caller, Depends(caller_with("manage"))]
