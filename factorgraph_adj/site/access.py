"""Who may do what: tokens with roles, of which only digests are kept; limits of rate.

Without any token a service that listens on a loopback address alone takes everybody as ``admin``;
on any other address it refuses to start.
"""

from __future__ import annotations

import hashlib
import secrets
import threading
import time as clock
from dataclasses import dataclass
from typing import Any, Literal, get_args

from ..control_characters import refuse_control_characters
from ..errors import AdjustmentError, InputError, known
from .database import Database

Role = Literal["instrument", "viewer", "surveyor", "admin"]
"""Roles of tokens."""
Right = Literal["post", "read", "decide", "manage"]
"""Rights: post observations; read; decide about observations, epochs and alarms; manage tokens."""
RIGHTS: dict[Role, frozenset[Right]] = {
    "instrument": frozenset(("post",)),
    "viewer": frozenset(("read",)),
    "surveyor": frozenset(("post", "read", "decide")),
    "admin": frozenset(("post", "read", "decide", "manage")),
}
"""Rights of the roles."""
TOKEN_BYTES = 32
"""Random bytes of a token."""
TOKEN_PREFIX = "fga_"
"""How tokens begin, so that programs that look for secrets find them."""
TOKENS_LAST = 10.0
"""Time for which a token is remembered before the database is asked again, seconds."""


class NotAllowed(AdjustmentError):
    """The caller is unknown (401) or may not do this (403)."""

    def __init__(self, what: str, status: int) -> None:
        """Take the message and the status of HTTP."""
        super().__init__(what)
        self.status = status


class TooFast(AdjustmentError):
    """The caller asks too often."""


@dataclass(frozen=True)
class Caller:
    """Who asks."""

    name: str
    """Name of the token."""
    role: Role
    """Its role."""

    def may(self, right: Right) -> bool:
        """Return whether the caller has a right."""
        return right in RIGHTS[self.role]


ANYBODY = Caller("loopback", "admin")
"""The caller of a service without tokens on a loopback address."""


class Access:
    """The tokens of a site."""

    def __init__(self, database: Database, *, per_second: float = 200.0) -> None:
        """Take the database.

        Args:
            database: the database.
            per_second: requests that one caller may make in a second, averaged over ten.
        """
        self._database, self.per_second = database, per_second
        self._known: dict[str, tuple[float, Caller | None]] = {}
        self._tokens: dict[str, tuple[float, float]] = {}
        self._lock = threading.Lock()
        self.open = not self.listed()
        """Whether nobody needs a token, as there is none."""

    def caller(self, token: str | None) -> Caller:
        """Return who has a token.

        Raises:
            NotAllowed: there is no token, or it is unknown, has expired or was revoked.
        """
        caller = self.remembered(token)
        if caller is not None:
            return caller
        assert token is not None
        digest, now = digest_of(token), clock.time()
        found = self._read(digest, now)
        with self._lock:
            if len(self._known) > 10_000:
                self._known.clear()
            self._known[digest] = now + TOKENS_LAST, found
        return _known_caller(found)

    def remembered(self, token: str | None) -> Caller | None:
        """Return who has a token, without the database; None where that has to be asked.

        Raises:
            NotAllowed: as `caller`.
        """
        if self.open:
            return ANYBODY
        if not token:
            raise NotAllowed("a token is needed: Authorization: Bearer TOKEN", 401)
        with self._lock:
            until, found = self._known.get(digest_of(token), (0.0, None))
        return None if clock.time() >= until else _known_caller(found)

    def require(self, caller: Caller, right: Right) -> None:
        """Refuse what a caller may not do.

        Raises:
            NotAllowed: the role lacks the right.
        """
        if not caller.may(right):
            roles = ", ".join(r for r, rights in RIGHTS.items() if right in rights)
            raise NotAllowed(
                f"the role {caller.role} may not {right}; roles that may: {roles}", 403
            )

    def slow_down(self, caller: Caller, cost: float = 1.0) -> None:
        """Count requests of a caller.

        Without tokens nothing is counted: all programs of the machine would share one limit, and
        one that would do harm may do everything anyway. What is too much then waits, each sender
        for its answer, and beyond a number of postings that wait the network refuses further ones.

        Raises:
            TooFast: the caller makes too many requests.
        """
        if self.open:
            return
        now = clock.monotonic()
        with self._lock:
            rate = self.per_second
            left, then = self._tokens.get(caller.name, (10.0 * rate, now))
            left = min(10.0 * rate, left + (now - then) * rate) - cost
            if left < 0.0:
                raise TooFast(f"{caller.name} makes more than {rate:g} requests a second")
            self._tokens[caller.name] = left, now

    def _read(self, digest: str, now: float) -> Caller | None:
        from sqlalchemy import select

        from .tables import tokens

        with self._database.reading() as connection:
            row = connection.execute(select(tokens).where(tokens.c.digest == digest)).first()
        if row is None or row.revoked is not None:
            return None
        if row.expires is not None and row.expires <= now:
            return None
        return Caller(row.name, row.role)

    # -- tokens -----------------------------------------------------------------------------------

    def listed(self) -> list[dict[str, Any]]:
        """Return the tokens that were not revoked, without their texts."""
        from sqlalchemy import select

        from .tables import tokens

        names = ("id", "name", "role", "created", "expires")
        wanted = select(*(tokens.c[n] for n in names)).where(tokens.c.revoked.is_(None))
        with self._database.reading() as connection:
            return [dict(r._mapping) for r in connection.execute(wanted.order_by(tokens.c.id))]

    def add(self, name: str, role: str, *, days: float | None = None) -> str:
        """Make a token, and return its text, which is nowhere else.

        Args:
            name: name of who will have it.
            role: its role.
            days: after how many days it expires; None: never.

        Raises:
            InputError: the name is taken, empty or has control characters, the role is unknown, or
                days are not positive.
        """
        from sqlalchemy import insert
        from sqlalchemy.exc import IntegrityError

        from .tables import MAX_LETTERS_OF_NAME, tokens

        roles = get_args(Role)
        if role not in roles:
            raise InputError(f"unknown role {role!r}; valid: {known(roles, meant=role)}")
        if not 0 < len(name.strip()) <= MAX_LETTERS_OF_NAME:
            raise InputError(f"a token needs a name of at most {MAX_LETTERS_OF_NAME} characters")
        refuse_control_characters([name.strip()], "token")
        if days is not None and not 0.0 < days < 1e5:
            raise InputError(f"{days:g} days: a token lasts a positive number of days")
        text, now = TOKEN_PREFIX + secrets.token_urlsafe(TOKEN_BYTES), clock.time()
        row = {"name": name.strip(), "role": role, "digest": digest_of(text), "created": now}
        row |= {"expires": None if days is None else now + days * 86400.0}
        try:
            with self._database.writing() as connection:
                connection.execute(insert(tokens).values(**row))
        except IntegrityError:
            raise InputError(f"there is a token of the name {name!r} already") from None
        self.open = False
        return text

    def refuse_other_first_token(self, role: str, days: float | None) -> None:
        """Refuse a first token after which nobody could make others.

        Args:
            role: its role.
            days: after how many days it expires; None: never.

        Raises:
            InputError: there is no token yet, and it is not that of an admin, or expires.
        """
        if self.open and (role != "admin" or days is not None):
            raise InputError(
                "the first token must be that of an admin and not expire: with it everything needs "
                "a token, and admins alone make others"
            )

    def refuse_last_admin(self, token: int) -> None:
        """Refuse that a token is revoked after which nobody could make others.

        Args:
            token: its id.

        Raises:
            InputError: it is the last one of an admin that does not expire.
        """
        admins = [t["id"] for t in self.listed() if t["role"] == "admin" and t["expires"] is None]
        if admins == [token]:
            raise InputError(
                f"token {token} is the last one of an admin that does not expire: make another "
                "first"
            )

    def revoke(self, token: int) -> str:
        """Revoke a token, which is refused at once; return its name.

        Raises:
            InputError: there is no such token.
        """
        from sqlalchemy import update

        from .tables import tokens

        listed = {t["id"]: t["name"] for t in self.listed()}
        if token not in listed:
            raise InputError(f"no token {token}; known: {known(map(str, listed))}")
        # The name becomes free again.
        values = {"revoked": clock.time(), "name": f"{listed[token][:150]} (revoked {token})"}
        with self._database.writing() as connection:
            connection.execute(update(tokens).where(tokens.c.id == token).values(**values))
        with self._lock:
            self._known.clear()
        return str(listed[token])


def _known_caller(found: Caller | None) -> Caller:
    if found is None:
        raise NotAllowed("the token is unknown, has expired or was revoked", 401)
    return found


def digest_of(token: str) -> str:
    """Return what is kept of a token."""
    return hashlib.sha256(token.encode()).hexdigest()
