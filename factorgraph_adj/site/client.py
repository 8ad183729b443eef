"""Client of a site: postings that are executed once, queries, events that resume, downloads.

Every posting has a request of its own. The site executes a request once and answers it again, so
that the client can try again whatever went wrong on the way: a connection that broke, a service or
a database that is away (503), too many requests (429). It waits between tries, twice as long each
time, with a random part, or as long as the service says.
"""

from __future__ import annotations

import json
import random
import threading
import time as clock
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple, Self

from ..errors import AdjustmentError, InputError, Problem
from ..io.file_transaction import write_files
from .outbox import Kept, Outbox, requested

if TYPE_CHECKING:
    import httpx2

EXTRA_MISSING = "a client of a site needs httpx2: pip install 'factorgraph_adj[serve]'"
"""Message where the extra is missing."""
FIRST_WAIT, LONGEST_WAIT = 0.2, 30.0
"""Time before the first new try, and the longest between two, seconds."""
AGAIN = (429, 502, 503, 504)
"""Statuses after which a request is tried again."""
ANSWER_SECONDS = 150.0
"""Time after which an answer does not come any more, seconds."""
SILENCE_SECONDS = 45.0
"""Time without any event or beat after which a connection hangs, seconds."""
PAGE = 1000
"""Observations that are asked for at once."""
POSTINGS_AT_ONCE = 100
"""Postings of an outbox in one request."""
REQUEST_SECONDS = 0.1
"""Least time between the begins of two requests of an outbox that is filled, seconds."""
QUIET_SECONDS = 1.0
"""Time after which an outbox is looked at that another process may have filled, seconds."""

Answer = dict[str, Any]


class ServiceAway(AdjustmentError):
    """The site could not be reached, or did not answer, for the whole time that was allowed."""


class Event(NamedTuple):
    """Something that happened on the site."""

    id: int
    """Number in the log of the site."""
    kind: str
    """``arrival``, ``refused``, ``epoch``, ``alarm``, ``instrument`` or ``hello``."""
    data: dict[str, Any]
    """Its content, with ``network`` and ``at``."""


class Client:
    """A connection to a site; threads may share it."""

    def __init__(
        self,
        url: str,
        *,
        token: str | None = None,
        patience: float = 120.0,
        longest_wait: float = LONGEST_WAIT,
        certificate: str | Path | None = None,
        transport: httpx2.BaseTransport | None = None,
    ) -> None:
        """Take the address of a site; nothing is sent yet.

        Args:
            url: address of the site, such as ``https://site.example.org:8437/``.
            token: token of access; None: for a site that needs none.
            patience: time for which a request is tried again, seconds.
            longest_wait: longest time between two tries where the site states none, seconds.
            certificate: file with certificates to trust (PEM); None: those of the system.
            transport: another transport of httpx2.

        Raises:
            InputError: the extra is missing, or the address is none.
        """
        try:
            import httpx2
        except ImportError:
            raise InputError(EXTRA_MISSING) from None
        if not url.startswith(("http://", "https://")):
            raise InputError(Problem("is no address: http://HOST:PORT/ or https://…", url))
        headers = {} if token is None else {"Authorization": f"Bearer {token}"}
        verify: Any = True
        if certificate is not None:
            import ssl

            try:
                verify = ssl.create_default_context(cafile=str(certificate))
            except (OSError, ssl.SSLError) as error:
                raise InputError(Problem(str(error), str(certificate))) from None
        self.url, self.patience = url.rstrip("/"), patience
        self.longest_wait = longest_wait
        self._http = httpx2.Client(
            base_url=f"{self.url}/api/v1",
            headers=headers,
            timeout=httpx2.Timeout(ANSWER_SECONDS, connect=10.0),
            verify=verify,
            transport=transport,
        )
        self._stopped = threading.Event()

    def close(self) -> None:
        """End the connection, and all waiting for another try."""
        self._stopped.set()
        self._http.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    # -- requests ---------------------------------------------------------------------------------

    def _asked(
        self, method: str, path: str, *, patience: float | None = None, **options: Any
    ) -> httpx2.Response:
        """Return the answer to a request, which is tried again while the site is away."""
        import httpx2

        until = clock.monotonic() + (self.patience if patience is None else patience)
        wait, why = min(FIRST_WAIT, self.longest_wait), ""
        while True:
            stated = 0.0
            try:
                response = self._http.request(method, path, **options)
                if response.status_code not in AGAIN:
                    return self._checked(response)
                why = _said(response)
                stated = _seconds(response.headers.get("retry-after", ""))
            except httpx2.TransportError as error:
                why = str(error) or type(error).__name__
            pause = max(stated, wait * random.uniform(0.5, 1.0))
            if clock.monotonic() + pause > until or self._stopped.wait(pause):
                raise ServiceAway(f"{self.url} does not answer: {why}")
            wait = min(2.0 * wait, self.longest_wait)

    def _checked(self, response: httpx2.Response) -> httpx2.Response:
        if response.is_success:
            return response
        try:
            listed = [Problem(e["what"], e["where"]) for e in response.json()["error"]]
        except (ValueError, KeyError, TypeError):
            what = f"{response.status_code} {response.reason_phrase}: is this a site?"
            listed = [Problem(what, str(response.request.url))]
        raise InputError(listed)

    def _got(self, path: str, **query: Any) -> Any:
        given = {k: v for k, v in query.items() if v is not None}
        return self._asked("GET", path, params=given).json()

    # -- what there is ----------------------------------------------------------------------------

    def site(self) -> Answer:
        """Return name, version and networks of the site, and what the caller may do."""
        return dict(self._got("/site"))

    def network(self, name: str) -> Answer:
        """Return what there is of a network."""
        return dict(self._got(f"/networks/{name}"))

    def points(self, network: str) -> list[Answer]:
        """Return the points of a network, with coordinates, σ and ellipses."""
        return list(self._got(f"/networks/{network}/points"))

    def observations(self, network: str, *, state: str = "accepted") -> Iterator[Answer]:
        """Yield the observations of a network that are in a state."""
        after = ""
        while after is not None:
            found = self._got(
                f"/networks/{network}/observations", state=state, limit=PAGE, after=after
            )
            yield from found["rows" if "rows" in found else "observations"]
            after = found["next"]

    def epochs(self, network: str) -> list[Answer]:
        """Return the epochs of a network with their figures."""
        return list(self._got(f"/networks/{network}/epochs"))

    def epoch(self, network: str, number: int) -> Answer:
        """Return an epoch of a network with its result."""
        return dict(self._got(f"/networks/{network}/epochs/{number}"))

    def download(
        self, network: str, name: str, path: str | Path, *, epoch: int | None = None
    ) -> None:
        """Write a file of a network.

        Args:
            network: name of the network.
            name: ``report.html``, ``results.json``, ``network.gpkg`` or ``project.zip``.
            path: the file, which is replaced.
            epoch: number of the epoch; None: the present one.
        """
        query = {} if epoch is None else {"epoch": epoch}
        data = self._asked("GET", f"/networks/{network}/{name}", params=query).content
        write_files(Path(path).parent, {Path(path).name: data})

    # -- postings ---------------------------------------------------------------------------------

    def post(self, network: str, record: Mapping[str, Any]) -> Answer:
        """Send a posting, and return its answer, which is on the disk of the site then.

        Args:
            network: name of the network.
            record: an object of the stream protocol.

        Raises:
            ServiceAway: the site did not answer in time; what became of the posting is unknown.
            InputError: the token may not do this, or there is no such network.
        """
        return self.post_all(network, [record])[0]

    def post_all(
        self, network: str, records: Sequence[Mapping[str, Any]], *, patience: float | None = None
    ) -> list[Answer]:
        """Send postings in one request; they are executed in their order, each on its own."""
        sent = [requested(r) for r in records]
        path = f"/networks/{network}/postings"
        return list(self._asked("POST", path, json=sent, patience=patience).json())

    def close_epoch(self, network: str) -> Answer:
        """End the present epoch of a network, and return it with its ``result``.

        It is executed once, as a posting is, however often it has to be tried.

        Raises:
            ServiceAway: the site did not answer in time; whether the epoch ended is unknown.
            InputError: the epoch has ended before, the token may not end it, or there is no such
                network.
        """
        asked = requested({"close": True})
        return dict(self._asked("POST", f"/networks/{network}/epochs", json=asked).json())

    def send(
        self,
        outbox: Outbox,
        *,
        answered: Callable[[Kept, Answer], None] = lambda kept, answer: None,
        patience: float | None = None,
    ) -> int:
        """Send what an outbox holds, in order, until it is empty; return how many were sent.

        Args:
            outbox: the outbox; what was answered leaves it.
            answered: called with each posting and its answer.
            patience: time for which each request is tried again, seconds; None: that of the client.

        Raises:
            ServiceAway: the site did not answer in time; the rest stays in the outbox.
        """
        number = 0
        while kept := outbox.first(POSTINGS_AT_ONCE):
            self._send_kept(outbox, kept, answered, patience)
            number += len(kept)
        return number

    def _send_kept(
        self,
        outbox: Outbox,
        kept: Sequence[Kept],
        answered: Callable[[Kept, Answer], None],
        patience: float | None,
    ) -> None:
        """Send postings of an outbox in one request."""
        records = [k.record for k in kept]
        answers = self.post_all(kept[0].network, records, patience=patience)
        outbox.done(kept, answers)
        for posting, answer in zip(kept, answers, strict=True):
            answered(posting, answer)

    def forward(
        self,
        outbox: Outbox,
        ended: threading.Event,
        *,
        answered: Callable[[Kept, Answer], None] = lambda kept, answer: None,
    ) -> int:
        """Send what comes into an outbox until it is empty after ``ended`` was set.

        The postings of each network are sent in their order.

        What comes after a quiet time is sent at once; requests that follow begin at least
        `REQUEST_SECONDS` apart, so that readings that come fast share requests.

        Args:
            outbox: the outbox, which other threads fill; what was answered leaves it.
            ended: says that nothing more comes; `Outbox.wake` tells this soon.
            answered: called with each posting and its answer.

        Returns:
            How many postings were sent.

        Raises:
            ServiceAway: the site did not answer for the time that is allowed. While more may come
                to an outbox on a disk, it is tried again instead.
            InputError: the token may not do this, or there is no such network.
        """
        number = 0
        while True:
            last, begun = ended.is_set(), clock.monotonic()
            kept = outbox.oldest(POSTINGS_AT_ONCE)
            try:
                for network in dict.fromkeys(k.network for k in kept):
                    own = [k for k in kept if k.network == network]
                    self._send_kept(outbox, own, answered, None)
                    number += len(own)
            except ServiceAway:
                if last or not outbox.on_disk or self._stopped.is_set():
                    raise
                continue
            if last and not kept:
                return number
            if kept and len(kept) < POSTINGS_AT_ONCE:
                ended.wait(max(0.0, begun + REQUEST_SECONDS - clock.monotonic()))
            elif not kept and not last:
                outbox.wait(QUIET_SECONDS)

    # -- events -----------------------------------------------------------------------------------

    def events(self, *, networks: Sequence[str] = (), after: int | None = None) -> Iterator[Event]:
        """Yield what happens on the site, without end; a connection that breaks is made again.

        After a break the events that were missed come first. Where the site has them no more, an
        event ``hello`` says so: everything has to be read again.

        Args:
            networks: names of networks; none: all.
            after: number of the last event that is known; None: begin with the next one.

        Raises:
            ServiceAway: the site could not be reached again.
            InputError: the token may not read.
        """
        import httpx2

        timeout = httpx2.Timeout(SILENCE_SECONDS, connect=10.0)
        first = min(FIRST_WAIT, self.longest_wait)
        last, wait, until = after, first, clock.monotonic() + self.patience
        while not self._stopped.is_set():
            query: dict[str, Any] = {"network": list(networks)} if networks else {}
            headers = {} if last is None else {"Last-Event-ID": str(last)}
            why, stated = "the connection ended", 0.0
            try:
                with self._http.stream(
                    "GET", "/events", params=query, headers=headers, timeout=timeout
                ) as response:
                    if not response.is_success:
                        response.read()
                    if response.status_code in AGAIN:
                        why = _said(response)
                        stated = _seconds(response.headers.get("retry-after", ""))
                    else:
                        self._checked(response)
                        for event in _events(response.iter_lines()):
                            wait, until = first, clock.monotonic() + self.patience
                            if event is not None:
                                last = event.id
                                yield event
            except httpx2.TransportError as error:
                why = str(error) or type(error).__name__
            if clock.monotonic() > until:
                raise ServiceAway(f"{self.url} does not answer: {why}")
            self._stopped.wait(max(stated, wait * random.uniform(0.5, 1.0)))
            wait = min(2.0 * wait, self.longest_wait)


def _events(lines: Iterator[str]) -> Iterator[Event | None]:
    """Yield server-sent events; None for what only shows that the connection lives."""
    number, kind, data = "", "", []
    for line in lines:
        name, _, value = line.partition(":")
        value = value.removeprefix(" ")
        if line:
            number = value if name == "id" else number
            kind = value if name == "event" else kind
            data += [value] if name == "data" else []
            continue
        if number and data:
            yield Event(int(number), kind or "message", json.loads("\n".join(data)))
        else:
            yield None
        number, kind, data = "", "", []


def _seconds(text: str) -> float:
    return float(text) if text.isdigit() else 0.0


def _said(response: httpx2.Response) -> str:
    """Return what the site said with a refusal."""
    try:
        return "; ".join(str(e["what"]) for e in response.json()["error"])
    except (ValueError, KeyError, TypeError):
        return f"{response.status_code} {response.reason_phrase}"
