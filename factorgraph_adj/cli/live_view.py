"""Terminal view of the stream (extra ``cli``): counts, verdicts, weakest points, latency.

The view receives only the answers of `factorgraph_adj.service.stream`; it therefore shows exactly
the information that a program at the other end of the pipe has.
"""

from __future__ import annotations

import heapq
import threading
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from math import inf
from statistics import median
from typing import TYPE_CHECKING, Any, TextIO

from ..errors import InputError
from ..report.layout import decimals, short

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderResult
    from rich.table import Table
    from rich.text import Text

RICH_MISSING = "the live view needs rich: pip install 'factorgraph_adj[cli]'"
MAX_VERDICTS_KEPT = 200
"""Number of latest verdicts and errors that are kept; enough lines for a tall terminal."""
MAX_LATENCIES_KEPT = 1000
"""Number of latest lines whose latencies give the median."""
GAP_BETWEEN_FIGURES = "   "
PICTURES_PER_SECOND = 4
"""Number of pictures in a second."""
MIN_COLUMNS_SIDE_BY_SIDE = 110
"""Smallest width of a terminal, columns, that shows both lists side by side."""
COLUMNS_OF_WEAKEST_LIST = 42
"""Width of the list of weakest points, columns, when it stands beside the verdicts."""
FIXED_LINES = {True: 8, False: 10}
"""Number of lines outside the rows of the lists, by whether the lists stand side by side."""
COUNT_LABELS = (
    ("observations", "in the graph", "in the graph", "bold"),
    ("waiting", "waiting", "waiting", "cyan"),
    ("suspects", "suspect", "suspects", "yellow"),
    ("rejected", "rejected", "rejected", "red"),
)
VERDICT_STYLES = {"accepted": "green", "suspect": "yellow", "rejected": "red", "waiting": "cyan"}

StreamAnswer = Mapping[str, Any]


class LiveView:
    """Terminal view of a stream, which rich can draw."""

    def __init__(self) -> None:
        """Start an empty view."""
        self._lock = threading.Lock()  # rich draws in a thread of its own
        self._name = ""
        self._unit = ""
        self._counts: StreamAnswer = {}
        self._verdicts: deque[tuple[str, str, str, str]] = deque(maxlen=MAX_VERDICTS_KEPT)
        self._sigma: dict[str, tuple[float, ...]] = {}
        self._seconds: deque[float] = deque(maxlen=MAX_LATENCIES_KEPT)
        self._longest = 0.0
        self._lines = 0

    # -- answers --------------------------------------------------------------------------------

    def take(self, answer: StreamAnswer) -> None:
        """Take in an answer of the stream."""
        with self._lock:
            self._counts = answer["counts"]
            if answer.get("ready"):
                self._name = answer["name"]
                self._unit = answer["units"]["sigma_length"]
            else:
                self._take_line(answer)

    def _take_line(self, answer: StreamAnswer) -> None:
        self._lines += 1
        self._verdicts.extend(_verdict_rows(answer))
        for point in answer.get("points", ()):
            sigma = (point[f"sigma_{a}_{self._unit}"] for a in "xyz")
            self._sigma[point["name"]] = tuple(inf if s is None else s for s in sigma)
        for name in answer.get("points_lost", ()):
            self._sigma.pop(name, None)
        if "verdict" in answer or "verdicts" in answer:
            self._seconds.append(answer["seconds"])
            self._longest = max(self._longest, answer["seconds"])

    # -- picture --------------------------------------------------------------------------------

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Draw the view in the width and within the height of the terminal."""
        from rich.console import Group
        from rich.table import Table

        with self._lock:
            wide = options.max_width >= MIN_COLUMNS_SIDE_BY_SIDE
            room = max(console.size.height - FIXED_LINES[wide], 6)
            low = room if wide else room // 3
            verdicts = self._verdict_table(room if wide else room - low)
            weakest = self._weakest_table(low)
            parts: list[Any] = [self._heading(), self._summary()]
            if wide:
                both = Table.grid(expand=True, padding=(0, 2, 0, 0))
                both.add_column(ratio=1)
                both.add_column(width=COLUMNS_OF_WEAKEST_LIST)
                both.add_row(verdicts, weakest)
                parts.append(both)
            else:
                parts += [verdicts, "", weakest]
            parts += ["", self._figures()]
        yield Group(*parts)

    def _heading(self) -> Text:
        from rich.text import Text

        out = Text(self._name or "stream", style="bold", no_wrap=True, overflow="ellipsis")
        return out.append(f"   {self._lines} lines", style="dim")

    def _summary(self) -> Text:
        from rich.text import Text

        out = Text(no_wrap=True, overflow="ellipsis")
        for key, one, many, style in COUNT_LABELS:
            number = self._counts.get(key, 0)
            out.append(str(number), style=style if number else "dim")
            out.append(f" {one if number == 1 else many}{GAP_BETWEEN_FIGURES}")
        return out.append("\n")

    def _verdict_table(self, rows: int) -> Table:
        from rich.text import Text

        table = _table("latest verdicts")
        table.add_column("", no_wrap=True)
        table.add_column("test/critical", justify="right", no_wrap=True)
        latest = list(self._verdicts)[-rows:][::-1]
        for what, verdict, test, lacks in latest:
            name = Text(what)
            if lacks:
                name.append(f"  {lacks}", style="dim")
            table.add_row(name, Text(verdict, style=VERDICT_STYLES.get(verdict, "red")), test)
        _fill(table, rows - len(latest))
        return table

    def _weakest_table(self, rows: int) -> Table:
        from rich.text import Text

        table = _table("weakest points")
        for axis in "xyz":
            table.add_column(f"σ{axis} {self._unit}", justify="right", no_wrap=True)
        weakest = heapq.nlargest(rows, self._sigma.items(), key=lambda item: max(item[1]))
        places = decimals((max(sigma) for _, sigma in weakest), default=2, most=4)
        for name, sigma in weakest:
            table.add_row(Text(name), *(f"{s:.{places}f}" for s in sigma))
        _fill(table, rows - len(weakest))
        return table

    def _figures(self) -> Text:
        from rich.text import Text

        found = []
        if self._counts.get("sigma0") is not None:
            found += [
                f"σ̂0 {self._counts['sigma0']:.3f}",
                f"redundancy {self._counts['redundancy']}",
            ]
        if self._seconds:
            found.append(f"last {_milliseconds(self._seconds[-1])}")
            found.append(f"median {_milliseconds(median(self._seconds))}")
            found.append(f"maximum {_milliseconds(self._longest)}")
        text = GAP_BETWEEN_FIGURES.join(found) or "no observation has arrived yet"
        return Text(text, style="dim", no_wrap=True, overflow="ellipsis")


@contextmanager
def live_view(stream: TextIO) -> Iterator[LiveView]:
    """Show a view on a terminal while it takes answers; the last picture stays on the screen.

    Args:
        stream: the terminal, such as ``sys.stderr``; a file gets the last picture only.

    Raises:
        InputError: rich is not installed.
    """
    try:
        from rich.console import Console
        from rich.live import Live
    except ImportError:
        raise InputError(RICH_MISSING) from None
    view = LiveView()
    # Standard output is reserved for the lines that programs read.
    with Live(
        get_renderable=lambda: view,
        console=Console(file=stream),
        refresh_per_second=PICTURES_PER_SECOND,
        redirect_stdout=False,
        redirect_stderr=False,
    ):
        yield view


def _verdict_rows(answer: StreamAnswer) -> Iterator[tuple[str, str, str, str]]:
    """Iterate over observation, verdict, test value, and lacking support."""
    if answer.get("ok") is False:
        first = answer["error"][0]
        more = len(answer["error"]) - 1
        what = first["what"] + (f" (and {more} more)" if more else "")
        yield (f"line {answer['line']}", "error", "", what)
        return
    given = answer.get("verdicts", [answer] if "verdict" in answer else [])
    for v in (*given, *answer.get("entered", ())):
        test = v.get("test")
        yield (v["label"], v["verdict"], "" if test is None else f"{test:.2f}", v.get("lacks", ""))


def _table(title: str) -> Table:
    """Return a table whose first column takes the remaining width."""
    from rich.table import Table

    out = Table(box=None, expand=True, padding=(0, 2, 0, 0), header_style="italic dim")
    out.add_column(title, ratio=1, no_wrap=True, overflow="ellipsis")
    return out


def _fill(table: Table, rows: int) -> None:
    """Add empty rows to a table, so that the picture keeps its height."""
    for _ in range(max(rows, 0)):
        table.add_row(*("" for _ in table.columns))


def _milliseconds(seconds: float) -> str:
    return f"{short(1000 * seconds)} ms"
