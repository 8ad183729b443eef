"""What every route needs: the site, the caller with a right, a network.

These functions are coroutines, as each plain one would run in a thread of its own. Only a token
that is not remembered is looked up in a thread: the database may be slow.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Annotated

from fastapi import Depends, Path, Query, Request
from fastapi.routing import APIRoute

from ..errors import InputError, Problem, known
from .access import Access, Caller, Right
from .epoch_schedule import MAX_EPOCH
from .live_network import LiveNetwork
from .site import Site

RowNumber = Annotated[int, Path(ge=0, le=1 << 62)]
"""Number in a path that the database has given: larger ones do not fit into its columns."""
EpochInPath = Annotated[int, Path(ge=0, le=MAX_EPOCH)]
"""Number of an epoch in a path."""
EpochNumber = Annotated[int | None, Query(ge=0, le=MAX_EPOCH)]
"""Number of an epoch that a query names; None: the present one."""
COOKIE = "fga_session"
"""Cookie with the token of a browser."""


async def site_of(request: Request) -> Site:
    """Return the site."""
    site: Site = request.app.state.site
    return site


def token_of(request: Request) -> str | None:
    """Return the token of a request: of its header, or of the cookie of a browser."""
    kind, _, text = request.headers.get("authorization", "").partition(" ")
    if kind.lower() == "bearer" and text.strip():
        return text.strip()
    return request.cookies.get(COOKIE)


async def caller_of(access: Access, token: str | None) -> Caller:
    """Return who has a token.

    Raises:
        NotAllowed: as `Access.caller`.
    """
    caller = access.remembered(token)
    return await asyncio.to_thread(access.caller, token) if caller is None else caller


def refuse_unknown_parameters(request: Request) -> None:
    """Refuse parameters that a route does not have: a misspelt one would say nothing.

    Raises:
        InputError: all parameters that are unknown.
    """
    route = request.scope.get("route")
    if not request.query_params or not isinstance(route, APIRoute):
        return
    valid = sorted(p.alias for p in route.dependant.query_params)
    wrong = [name for name in request.query_params if name not in valid]
    if wrong:
        raise InputError(
            Problem(f"unknown parameter {name!r}; valid: {known(valid, meant=name)}", name)
            for name in wrong
        )


def caller_with(right: Right) -> Callable[[Request], Awaitable[Caller]]:
    """Return a function that gives the caller of a request, who must have a right."""

    async def found(request: Request) -> Caller:
        access = (await site_of(request)).access
        caller = await caller_of(access, token_of(request))
        access.require(caller, right)
        access.slow_down(caller)
        refuse_unknown_parameters(request)
        return caller

    return found


async def network_of(name: str, request: Request) -> LiveNetwork:
    """Return the network of an address; strangers do not learn which there are."""
    site = await site_of(request)
    await caller_of(site.access, token_of(request))
    return site.network(name)


TheSite = Annotated[Site, Depends(site_of)]
Network = Annotated[LiveNetwork, Depends(network_of)]
Reader = Annotated[Caller, Depends(caller_with("read"))]
Poster = Annotated[Caller, Depends(caller_with("post"))]
Decider = Annotated[Caller, Depends(caller_with("decide"))]
Manager = Annotated[Caller, Depends(caller_with("manage"))]
