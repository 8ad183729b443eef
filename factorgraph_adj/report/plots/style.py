"""Common parts of figures: matplotlib style, titles, doubts, round factors, scale keys, legends."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from functools import wraps
from math import floor, isfinite, log10
from textwrap import fill
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from ...errors import InputError
from ...quality.reliability import Reliability
from ...solve.solution import Solution
from ..doubtful_results import doubts_of_network, doubts_of_solution, exceedance_doubts

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MATPLOTLIB_MISSING = (
    'plots need matplotlib, which is not installed: pip install "factorgraph_adj[plot]"'
)

DOUBTFUL_RESULT = "DOUBTFUL RESULT"
"""Begin of the line over the figure of a result that is not to be trusted."""
LETTER_WIDTH_INCHES = 0.073
"""Mean width of a letter of that line, inches."""
MAX_SIGMA0_OF_COMPUTED = 1e-6
"""Largest σ̂0 of computed readings, whose residuals are rounding errors. σ in wrong units make σ̂0
1e-3 at least, which remains a doubt."""

P = ParamSpec("P")
R = TypeVar("R")

BLACK, GREY, PALE = "#000000", "#8c8c8c", "#d9d9d9"
ORANGE, SKY, GREEN = "#e69f00", "#56b4e9", "#009e73"
BLUE, VERMILLION, PURPLE = "#0072b2", "#d55e00", "#cc79a7"
"""Colours of Okabe & Ito, which colour-blind readers can distinguish."""

FIGURE_STYLE: dict[str, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.labelsize": 9.0,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlelocation": "left",
    "axes.axisbelow": True,
    "axes.grid": False,
    "axes.unicode_minus": True,
    "text.usetex": False,
    # Names of points and projects may contain "$"; they are plain text.
    "text.parse_math": False,
    # Room at the edges, inches.
    "figure.constrained_layout.w_pad": 0.08,
    "figure.constrained_layout.h_pad": 0.08,
    "figure.facecolor": "white",
    "axes.facecolor": "white",
}


def in_package_style(make: Callable[P, R]) -> Callable[P, R]:
    """Make a function draw in the style of this package instead of the user's style.

    Raises:
        InputError: matplotlib is not installed.
    """

    @wraps(make)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            import matplotlib
        except ImportError:
            raise InputError(MATPLOTLIB_MISSING) from None
        # DejaVu Sans, part of matplotlib, has σ̂, ᵀ and ∇; the user's font may have other scripts.
        fonts = ["DejaVu Sans", *matplotlib.rcParams["font.family"]]
        style: Any = FIGURE_STYLE | {"font.family": list(dict.fromkeys(fonts))}
        with matplotlib.rc_context(style), warnings.catch_warnings():
            # Names in scripts without a font are drawn as boxes; the adjustment is still valid.
            warnings.filterwarnings("ignore", message="Glyph .* missing from font")
            found = make(*args, **kwargs)
            _mark(found, (*args, *kwargs.values()))
            return found

    return wrapped


def _mark(figure: Any, drawn_from: Sequence[object]) -> None:
    """Write over a figure why its adjustment is not to be trusted; nothing if it is.

    Args:
        figure: what a function has drawn.
        drawn_from: all its arguments; a solution, or a reliability, among them has the doubts.
    """
    from matplotlib.figure import Figure

    if not isinstance(figure, Figure):
        return
    rel = next((each for each in drawn_from if isinstance(each, Reliability)), None)
    solution = next((each for each in drawn_from if isinstance(each, Solution)), None)
    solution = rel.solution if solution is None and rel is not None else solution
    if solution is not None:
        write_doubts(figure, doubts_of_result(solution, rel))


def write_doubts(figure: Figure, doubts: Sequence[str]) -> None:
    """Write doubts over a figure, beside a legend at its right; once, however often it is asked."""
    before = figure.get_suptitle()
    if not doubts or DOUBTFUL_RESULT in before:
        return
    legends = [each for each in figure.legends if getattr(each, "_outside_loc", None) == "right"]
    if legends:
        figure.draw_without_rendering()
    ends = [each.get_window_extent().x0 / figure.dpi for each in legends]
    room = min([figure.get_figwidth(), *ends])
    text = fill(f"{DOUBTFUL_RESULT}: {'; '.join(doubts)}", max(int(room / LETTER_WIDTH_INCHES), 30))
    text = f"{before}\n{text}" if before else text
    figure.suptitle(text, x=0.01, ha="left", color=VERMILLION, fontsize=9.0)


def write_cause(figure: Figure, cause: str) -> None:
    """Write the most probable cause under the doubts over a figure, if there are doubts."""
    before = figure.get_suptitle()
    if cause and DOUBTFUL_RESULT in before:
        width = max(len(line) for line in before.splitlines())
        text = f"{before}\n{fill(cause, width)}"
        figure.suptitle(text, x=0.01, ha="left", color=VERMILLION, fontsize=9.0)


def doubts_of_result(solution: Solution, rel: Reliability | None) -> list[str]:
    """Return why a result is doubtful; with its reliability, test values count too.

    Computed readings, those of a design, raise no doubts: that they fit too well is known.
    """
    if has_computed_readings(solution):
        return []
    doubts = [*doubts_of_solution(solution), *doubts_of_network(solution.network)]
    if rel is not None:
        doubts += exceedance_doubts(rel.w, rel.critical_w, "w", rel.alpha)
    return doubts


def has_computed_readings(solution: Solution) -> bool:
    """Return whether all readings are computed from the coordinates, as those of a design are."""
    return bool(solution.converged and solution.sigma0 < MAX_SIGMA0_OF_COMPUTED)


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure, size in inches, without a change to the state of pyplot."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def empty_figure(title: str, why: str) -> Figure:
    """Return a figure with a message that explains why it is empty."""
    figure = new_figure(7.0, 2.5)
    axes = figure.add_subplot()
    axes.set_axis_off()
    write_headline(axes, title)
    axes.text(0.5, 0.5, fill(why, 80), ha="center", va="center", transform=axes.transAxes)
    return figure


def write_headline(axes: Axes, title: str, below: str = "", *, width: float | None = None) -> None:
    """Write a title over axes, and a line that describes the content under the title.

    Args:
        axes: the axes of the title.
        title: the name; a long name is shortened.
        below: the line under the title.
        width: room for the title, inches, if a scale key stands beside the title.
    """
    name = shortened(title) if width is None else shortened(title, max(int(width / 0.085), 16))
    axes.set_title(f"{name}\n{below}" if below else name)


def shortened(text: str, most: int = 70) -> str:
    """Shorten a long name to ``most`` characters."""
    return text if len(text) <= most else text[: most - 1] + "…"


def wrapped(text: str) -> str:
    """Break an entry of a legend into lines."""
    return fill(text, 34, subsequent_indent="  ")


def readable_number(value: float) -> float:
    """Return the largest number, 1, 2 or 5 times a power of ten, up to a positive value."""
    power = 10.0 ** floor(log10(value))
    # The tolerance accepts an exact power that rounding has made slightly smaller.
    return float(
        max(m for m in (0.5, 1.0, 2.0, 5.0, 10.0) if m * power <= value * (1 + 1e-9)) * power
    )


def checked_positive(value: float, what: str) -> float:
    """Return a number greater than zero; InputError names a number that is not."""
    if not (value > 0 and isfinite(value)):
        raise InputError(f"{what} must be a number greater than zero, not {value}")
    return value


def factor_text(factor: float) -> str:
    """Write a factor of exaggeration or reduction: × 2 000, ÷ 5."""
    sign, value = ("×", factor) if factor >= 1 else ("÷", 1 / factor)
    return f"{sign} {value:,.10g}".replace(",", "\u202f")


def exaggeration_text(factor: float) -> str:
    """Describe the factor of exaggeration in words."""
    if factor == 1:
        return "in true size"
    return f"{'exaggerated' if factor > 1 else 'reduced'} {factor_text(factor)}"


def length_text(metres: float) -> str:
    """Write a length in a readable unit."""
    for unit, size in (("km", 1e3), ("m", 1.0), ("mm", 1e-3), ("µm", 1e-6)):
        if metres >= size * (1 - 1e-9):
            value = metres / size
            text = f"{value:,.0f}" if value >= 1000 else f"{value:.4g}"
            return f"{text} {unit}".replace(",", "\u202f")
    return f"{metres / 1e-9:.3g} nm"


def draw_scale_key(
    axes: Axes, size: float, label: str, *, upright: bool = False, above: bool = True
) -> None:
    """Draw a bar of known length with a label, outside the axes at their right end.

    Args:
        axes: the axes of the key.
        size: length of the bar in data units of x, or of y if it is upright.
        label: meaning of the bar.
        upright: whether the bar is vertical.
        above: whether the key is above the axes; otherwise it is below.
    """
    from matplotlib.lines import Line2D
    from matplotlib.offsetbox import AnchoredOffsetbox, AuxTransformBox, HPacker, TextArea, VPacker

    bar = AuxTransformBox(axes.transData)
    x, y = ([0.0, 0.0], [0.0, size]) if upright else ([0.0, size], [0.0, 0.0])
    ends = "_" if upright else "|"
    bar.add_artist(Line2D(x, y, color=BLACK, lw=1.5, marker=ends, ms=6, gid="scale key"))
    packer = HPacker if upright else VPacker
    text = TextArea(label, textprops={"fontsize": 8.0})
    axes.add_artist(
        AnchoredOffsetbox(
            "lower right" if above else "upper right",
            child=packer(children=[bar, text], align="center", pad=0, sep=4),
            bbox_to_anchor=(1.0, 1.0 if above else 0.0),
            bbox_transform=axes.transAxes,
            frameon=False,
            pad=0.2,
            borderpad=0.2,
        )
    )


def legend_at_right(figure: Figure, axes: Axes, lines: Sequence[str]) -> None:
    """Put the legend and some lines of text to the right of the axes."""
    from matplotlib.lines import Line2D

    handles, labels = axes.get_legend_handles_labels()
    blank = [Line2D([], [], lw=0) for _ in lines]
    figure.legend([*handles, *blank], [*labels, *lines], loc="outside right upper")
