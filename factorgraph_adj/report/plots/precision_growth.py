"""Figure of σ of points after each arrival of observations, with the gross errors caught."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...errors import InputError
from ...solve.solution import Solution
from ...types import Array
from .style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PALE,
    PURPLE,
    SKY,
    VERMILLION,
    empty_figure,
    in_package_style,
    length_text,
    new_figure,
    write_headline,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CURVE_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, SKY, BLACK)
CURVE_DASHES = ("-", "--", ":", "-.")
"""Line styles; the next style is used after all colours are used once."""
MAX_ARRIVALS_NAMED = 40
"""Largest number of arrivals of which each is named."""
LETTERS_PER_LINE = 120
"""Number of letters in a line of text below the axes."""
MIN_DISTANCE_OF_NAMES = 0.045
"""Smallest distance of names at the ends of the curves, as a fraction of the axes' height."""


@in_package_style
def plot_growth(
    arrivals: Sequence[str],
    sigmas: Mapping[str, Array],
    *,
    caught: Mapping[int, str] | None = None,
    title: str = "network",
    solution: Solution | None = None,
) -> Figure:
    """Draw standard deviations of points after every arrival, on a logarithmic scale.

    A curve begins where its point is first determined, and is interrupted where the point is not
    determined.

    Args:
        arrivals: names of the arrivals in order: ``station P1``, ``photo 7``.
        sigmas: standard deviations of each point after each arrival, metres, (n arrivals,);
            not finite while the point is not determined.
        caught: gross errors detected on arrival, by the number of the arrival, from 0.
        title: title of the figure.
        solution: the solution at the end; the title says why it is doubtful, if it is.

    Returns:
        A figure; if no point is determined, it shows a message.

    Raises:
        InputError: the numbers of standard deviations and arrivals differ, a gross error refers
            to an unknown arrival, or matplotlib is not installed.
    """
    n = len(arrivals)
    curves = {name: np.array(values, dtype=float) for name, values in sigmas.items()}
    events = dict(caught or {})
    problems = [
        f"point {name!r} has standard deviations of shape {values.shape} for {n} arrivals"
        for name, values in curves.items()
        if values.shape != (n,)
    ]
    problems += [f"arrival {k} is not among the {n} (from 0)" for k in events if not 0 <= k < n]
    if problems:
        raise InputError("; ".join(problems))
    for values in curves.values():
        values[~(np.isfinite(values) & (values > 0))] = np.nan
    curves = {name: v for name, v in curves.items() if np.isfinite(v).any()}
    if not curves:
        return empty_figure(title, "No point is determined: there are no standard deviations.")
    figure = new_figure(max(7.5, min(12.0, 2.5 + 0.35 * n)), 5.0)
    axes = figure.add_subplot()
    axes.set_yscale("log")
    axes.margins(y=0.1)  # room for the numbers of gross errors
    edges = np.arange(n + 1) + 0.5
    for i, (name, values) in enumerate(curves.items()):
        colour = CURVE_COLOURS[i % len(CURVE_COLOURS)]
        dash = CURVE_DASHES[i // len(CURVE_COLOURS) % len(CURVE_DASHES)]
        axes.step(
            edges, np.append(values, values[-1]), where="post", color=colour, ls=dash, label=name
        )
    write_headline(axes, title, "standard deviation of points after each arrival")
    axes.set_ylabel("σ (logarithmic)")
    axes.set_xlim(0.5, n + 0.5)
    _lengths(axes)
    _names(axes, arrivals)
    _events(axes, events)
    _ends(axes, curves, n + 0.5)
    return figure


def _lengths(axes: Axes) -> None:
    """Write σ with units; if few decades are shown, label the ticks 1, 2 and 5 of each."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

    low, high = axes.get_ylim()
    few = np.log10(high / low) < 3
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: length_text(value)))
    if few:
        axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.grid(axis="y", color=PALE, lw=0.6)


def _names(axes: Axes, arrivals: Sequence[str]) -> None:
    """Name the arrivals below the axes, as many as have room."""
    step = -(-len(arrivals) // MAX_ARRIVALS_NAMED)
    at = list(range(0, len(arrivals), step))
    axes.set_xticks([i + 1 for i in at], [arrivals[i] for i in at], rotation=90)
    axes.tick_params(axis="x", length=0)
    if step == 1:
        for edge in np.arange(1, len(arrivals)) + 0.5:
            axes.axvline(edge, color=PALE, lw=0.4, zorder=0)


def _events(axes: Axes, events: Mapping[int, str]) -> None:
    """Number gross errors at the upper edge, and describe them below the axes."""
    from textwrap import fill

    if not events:
        return
    order = sorted(events)
    for number, at in enumerate(order, start=1):
        axes.axvline(at + 1, color=VERMILLION, lw=0.8, ls=":", zorder=0.5)
        axes.annotate(
            f"{number}",
            (at + 1, 1.0),
            xycoords=axes.get_xaxis_transform(),
            xytext=(0, -2),
            textcoords="offset points",
            color=VERMILLION,
            ha="center",
            va="top",
            bbox={"boxstyle": "circle,pad=0.15", "facecolor": "white", "edgecolor": VERMILLION},
        )
    listed = "; ".join(f"{number} {events[at]}" for number, at in enumerate(order, start=1))
    axes.set_xlabel(
        fill(f"gross errors caught: {listed}", LETTERS_PER_LINE), color=VERMILLION, loc="left"
    )


def _ends(axes: Axes, curves: Mapping[str, Array], right: float) -> None:
    """Write each name and its last σ at the end of its curve without overlap."""
    last = {name: float(v[np.isfinite(v)][-1]) for name, v in curves.items()}
    low, high = np.log(axes.get_ylim())
    order = sorted(last, key=last.__getitem__)
    wanted = np.array([(np.log(last[name]) - low) / (high - low) for name in order])
    place = _apart(wanted, MIN_DISTANCE_OF_NAMES)
    colour = {line.get_label(): line.get_color() for line in axes.get_lines()}
    for name, y in zip(order, place, strict=True):
        axes.annotate(
            f"{name}  {length_text(float(f'{last[name]:.3g}'))}",
            (right, np.exp(low + wanted[order.index(name)] * (high - low))),
            xytext=(1.015, y),
            textcoords="axes fraction",
            color=colour[name],
            va="center",
            annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": GREY, "lw": 0.5, "shrinkA": 0, "shrinkB": 0},
        )


def _apart(wanted: Array, distance: float) -> Array:
    """Return increasing places as near to the wanted ones as the given distance allows."""
    groups: list[tuple[float, int]] = []
    for y in wanted.tolist():
        mean, n = y, 1
        while (
            groups
            and mean - (n - 1) / 2 * distance < groups[-1][0] + (groups[-1][1] + 1) / 2 * distance
        ):
            other, m = groups.pop()
            mean, n = (mean * n + other * m) / (n + m), n + m
        groups.append((mean, n))
    parts = [mean + distance * (np.arange(n) - (n - 1) / 2) for mean, n in groups]
    return np.concatenate(parts)
