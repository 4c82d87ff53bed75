"""Figures of pages, as SVG: curves, distributions, bars, an interval. They need no package.

Every function returns HTML in which text is escaped. Colours are classes of `page.css`, so that a
figure is readable in the dark and on paper too.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike, NDArray

from embodichain.cli.pages.axes import (
    LARGEST,
    Axis,
    count_axis,
    step_axis,
    tick_step,
    ticks_between,
    value_axis,
)
from embodichain.cli.terminal.output import number

__all__ = ["Line", "ValueGroup", "bar", "distribution", "interval_mark", "line_chart"]

F64 = NDArray[np.float64]

_WIDTH = 400.0
_HEIGHT = 210.0
_LEFT = 46.0
_RIGHT = 10.0
_TOP = 10.0
_BOTTOM = 38.0
"""Margins around the axes, with room for the labels of ticks."""
_MOST_POINTS = 400
"""Points of a line; more would be closer to each other than pixels."""
_FEWEST_IN_LINE = 3
"""Points below which there is no line: two points are not a trend."""
_MOST_DOTS = 30
"""Points up to which each is marked."""
_COLORS = 8
"""Classes `c0` to `c7` of `page.css`."""
_MOST_BINS = 24
_LARGEST_WHOLE = 1e12
"""Numbers up to here have a bar each if they are whole."""
_SAME = 1e-9
"""Relative difference below which values are the same."""
_INTERVAL_WIDTH = 220


@dataclass(frozen=True, slots=True)
class Line:
    """A curve of a chart.

    Attributes:
        name: For the legend; lines with the same name have one entry.
        x: (n,) ascending.
        y: (n,) values; those that are not finite are left out.
        low: (n,) lower end of a band around the curve, such as an interval; None has no band.
        high: (n,) upper end.
        color: Number of its colour; from 8 on, colours repeat with dashes.
        is_faint: Whether it is thin, as one of several that a mean is made of.
    """

    name: str
    x: F64
    y: F64
    low: F64 | None = None
    high: F64 | None = None
    color: int = 0
    is_faint: bool = False


def line_chart(
    title: str,
    lines: Sequence[Line],
    *,
    x_label: str = "environment steps",
    is_share: bool = False,
) -> Markup:
    """Draw curves in one pair of axes, with a legend if there are several.

    Fewer than three points are dots without a line, and a constant has an axis that begins at 0.

    Args:
        title: Above the axes.
        lines: The curves.
        x_label: Below the axes.
        is_share: Whether values are shares, such as success rates.
    """
    drawn = [_finite(line) for line in lines]
    drawn = [line for line in drawn if len(line.x)]
    if not drawn:
        return _figure(title, "no finite values", Markup(""), Markup(""))
    x_axis = step_axis(max(float(line.x[-1]) for line in drawn))
    y_axis = value_axis(np.concatenate([_values_of(line) for line in drawn]), is_share=is_share)
    marks = Markup("").join(_draw_line(line, x_axis, y_axis) for line in drawn)
    content = _frame(x_axis, y_axis, x_label) + marks
    names = {line.name: line.color for line in lines}
    note = ""
    legend = Markup("")
    if len(names) > 1:
        legend = _legend({name: _color(color) for name, color in names.items()})
    elif len(drawn) == 1:
        note = _note(drawn[0], is_share=is_share)
    return _figure(title, note, _svg(content, title), legend)


def _note(line: Line, *, is_share: bool) -> str:
    """What a chart of one line says in words: its value, if it has only one, or its last."""
    text = f"{line.y[-1]:.1%}" if is_share else number(float(line.y[-1]))
    if len(line.y) > 1 and line.y.min() == line.y.max():
        return f"constant {text}"
    return f"last {text}" if len(line.y) > 1 else text


def _finite(line: Line) -> Line:
    """A line without the points that are not finite, and thinned out to what can be seen."""
    is_finite = np.isfinite(line.x) & np.isfinite(line.y)
    indices = np.flatnonzero(is_finite)
    if len(indices) > _MOST_POINTS:
        chosen = np.linspace(0, len(indices) - 1, _MOST_POINTS).round().astype(np.int64)
        indices = indices[chosen]
    return Line(
        name=line.name,
        x=line.x[indices],
        y=line.y[indices],
        low=None if line.low is None else line.low[indices],
        high=None if line.high is None else line.high[indices],
        color=line.color,
        is_faint=line.is_faint,
    )


def _values_of(line: Line) -> F64:
    bands = [values for values in (line.low, line.high) if values is not None]
    return np.concatenate([line.y, *bands])


def _draw_line(line: Line, x_axis: Axis, y_axis: Axis) -> Markup:
    x = _x_place(x_axis, line.x)
    y = _y_place(y_axis, line.y)
    color = _color(line.color)
    if line.is_faint:
        color += " faint"
    marks = Markup("")
    if line.low is not None and line.high is not None:
        low = _y_place(y_axis, line.low)
        high = _y_place(y_axis, line.high)
        outline = [*zip(x, high, strict=True), *zip(x[::-1], low[::-1], strict=True)]
        marks += Markup('<path class="band {}" d="{}Z"/>').format(color, _path(outline))
    points = list(zip(x, y, strict=True))
    if len(points) >= _FEWEST_IN_LINE:
        marks += Markup('<path class="line {}" d="{}"/>').format(color, _path(points))
    if len(points) <= _MOST_DOTS and not line.is_faint:
        radius = 3.5 if len(points) < _FEWEST_IN_LINE else 2.2
        for point_x, point_y in points:
            marks += Markup('<circle class="dot {}" cx="{:.1f}" cy="{:.1f}" r="{}"/>').format(
                color, point_x, point_y, radius
            )
    return marks


def _path(points: Sequence[tuple[float, float]]) -> str:
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points)


# -- distributions ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ValueGroup:
    """Values of a distribution that have a colour of their own.

    Attributes:
        values: (n,) those that are not finite are left out.
        label: For the legend; empty has none.
        color: A class of `page.css`: ``plain``, ``good`` or ``bad``.
    """

    values: ArrayLike
    label: str = ""
    color: str = "plain"


def distribution(title: str, groups: Sequence[ValueGroup], *, note: str = "") -> Markup:
    """Draw how often values occur, as bars, with those of several groups on top of each other.

    Args:
        title: Above the axes.
        groups: The values.
        note: A text beside the title, such as how many there are.
    """
    columns = [np.asarray(group.values, np.float64) for group in groups]
    columns = [values[np.isfinite(values)].clip(-LARGEST, LARGEST) for values in columns]
    everything = np.concatenate([*columns, np.zeros(0)])
    if not everything.size:
        return _figure(title, "no finite values", Markup(""), Markup(""))
    edges = _bin_edges(everything)
    x_axis = _bin_axis(edges)
    y_axis = count_axis(int(np.histogram(everything, edges)[0].max()))
    content = _frame(x_axis, y_axis, "", x_is_centered=False)
    base = np.zeros(len(edges) - 1)
    legend: dict[str, str] = {}
    for group, values in zip(groups, columns, strict=True):
        counts = np.histogram(values, edges)[0]
        content += _draw_bars(group, edges, base, counts, x_axis=x_axis, y_axis=y_axis)
        base = base + counts
        if group.label and values.size:
            legend[group.label] = group.color
    content += _draw_mean(float(everything.mean()), x_axis)
    return _figure(title, note, _svg(content, title), _legend(legend))


def _draw_mean(mean: float, x_axis: Axis) -> Markup:
    x = float(_x_place(x_axis, mean))
    return Markup(
        '<path class="mean" d="M{0:.1f} {1:.1f}V{2:.1f}"/>'
        '<text class="axis" text-anchor="middle" x="{3:.1f}" y="{4:.1f}">mean {5}</text>'
    ).format(
        x,
        _TOP,
        _HEIGHT - _BOTTOM,
        min(max(x, _LEFT + 30), _WIDTH - _RIGHT - 30),
        _HEIGHT - 6,
        number(mean),
    )


def _bin_edges(values: F64) -> F64:
    """Edges of bars with a nice width; a bar for each number if these are few and whole."""
    low = float(values.min())
    high = float(values.max())
    largest = max(abs(low), abs(high))
    are_whole = largest < _LARGEST_WHOLE and bool((values == np.round(values)).all())
    if are_whole and high - low < _MOST_BINS:
        return np.arange(low - 0.5, high + 1.0, dtype=np.float64)
    if high - low <= _SAME * largest:
        half = largest * 0.05 or 0.5
        center = (low + high) / 2
        return np.array([center - half, center + half])
    bins = int(np.clip(math.ceil(2 * math.sqrt(values.size)), 5, _MOST_BINS))
    step = tick_step(high - low, bins + 1)
    first = math.floor(low / step + 1e-9)
    last = max(math.ceil(high / step - 1e-9), first + 1)
    edges = np.arange(first, last + 1, dtype=np.float64) * step
    # A value that rounding would put beside its bar.
    edges[0] = min(edges[0], low)
    edges[-1] = max(edges[-1], high)
    return edges


def _bin_axis(edges: F64) -> Axis:
    """An axis as long as the bars are wide."""
    low = float(edges[0])
    high = float(edges[-1])
    if len(edges) == 2:
        # A single bar, in the middle: one that fills the width looks like a range of values.
        center = (low + high) / 2
        return Axis(center - 3 * (high - low), center + 3 * (high - low), (center,))
    return Axis(low, high, ticks_between(low, high))


def _draw_bars(
    group: ValueGroup,
    edges: F64,
    base: F64,
    counts: NDArray[np.int64],
    *,
    x_axis: Axis,
    y_axis: Axis,
) -> Markup:
    left = _x_place(x_axis, edges)
    bottom = _y_place(y_axis, base)
    top = _y_place(y_axis, base + counts)
    bars = Markup("")
    for i, count in enumerate(counts.tolist()):
        if not count:
            continue
        gap = min(1.0, 0.1 * (left[i + 1] - left[i]))
        what = "1 episode" if count == 1 else f"{count} episodes"
        bounds = f"{number(float(edges[i]))} to {number(float(edges[i + 1]))}"
        bars += Markup(
            '<rect class="{}" x="{:.1f}" y="{:.1f}" width="{:.1f}" height="{:.1f}">'
            "<title>{}{}, {}</title></rect>"
        ).format(
            group.color,
            left[i] + gap,
            top[i],
            left[i + 1] - left[i] - 2 * gap,
            bottom[i] - top[i],
            what,
            f", {group.label}" if group.label else "",
            bounds,
        )
    return bars


# -- small ones ------------------------------------------------------------------------------------


def bar(value: float, largest: float, *, is_signed: bool = False) -> Markup:
    """Draw a bar for a cell of a table.

    Args:
        value: Its length.
        largest: The length that fills the cell, positive.
        is_signed: Whether 0 is in the middle, for tables with negative values.
    """
    length = 100 * min(abs(value) / largest, 1.0) if largest else 0.0
    start = 0.0
    if is_signed:
        length /= 2
        start = 50 - length if value < 0 else 50.0
    return Markup(
        '<svg class="bar" viewBox="0 0 100 8" preserveAspectRatio="none" aria-hidden="true">'
        '<rect class="{}" x="{:.1f}" y="0" width="{:.1f}" height="8"/></svg>'
    ).format("bad" if value < 0 else "plain", start, max(length, 0.4))


def interval_mark(value: float, low: float, high: float) -> Markup:
    """Draw a share with its interval on a line from 0 to 1."""
    ends = np.clip([low, high, value], 0.0, 1.0) * _INTERVAL_WIDTH
    return Markup(
        '<svg class="interval" viewBox="-5 0 {} 12" aria-hidden="true">'
        '<path class="track" d="M0 6H{}"/><path class="range" d="M{:.1f} 6H{:.1f}"/>'
        '<circle class="value" cx="{:.1f}" cy="6" r="4.5"/></svg>'
    ).format(_INTERVAL_WIDTH + 10, _INTERVAL_WIDTH, *ends.tolist())


# -- parts -----------------------------------------------------------------------------------------


def _x_place(axis: Axis, values: ArrayLike) -> F64:
    return _LEFT + axis.place(values) * (_WIDTH - _LEFT - _RIGHT)


def _y_place(axis: Axis, values: ArrayLike) -> F64:
    return _HEIGHT - _BOTTOM - axis.place(values) * (_HEIGHT - _TOP - _BOTTOM)


def _frame(x_axis: Axis, y_axis: Axis, x_label: str, *, x_is_centered: bool = True) -> Markup:
    """Grid, ticks and labels."""
    bottom = _HEIGHT - _BOTTOM
    right = _WIDTH - _RIGHT
    parts = Markup("")
    for tick, label in zip(y_axis.ticks, y_axis.labels, strict=True):
        y = float(_y_place(y_axis, tick))
        parts += Markup(
            '<path class="grid" d="M{0} {1:.1f}H{2}"/>'
            '<text class="axis" text-anchor="end" x="{3}" y="{4:.1f}">{5}</text>'
        ).format(_LEFT, y, right, _LEFT - 6, y + 4, label)
    for tick, label in zip(x_axis.ticks, x_axis.labels, strict=True):
        x = float(_x_place(x_axis, tick))
        anchor = "end" if x > right - 14 and x_is_centered else "middle"
        parts += Markup(
            '<path class="tick" d="M{0:.1f} {1}v4"/>'
            '<text class="axis" text-anchor="{2}" x="{0:.1f}" y="{3}">{4}</text>'
        ).format(x, bottom, anchor, bottom + 16, label)
    parts += Markup('<path class="tick" d="M{} {}H{}"/>').format(_LEFT, bottom, right)
    if x_label:
        middle = (_LEFT + right) / 2
        parts += Markup('<text class="axis" text-anchor="middle" x="{}" y="{}">{}</text>').format(
            middle, _HEIGHT - 6, x_label
        )
    return parts


def _color(number_of_color: int) -> str:
    """The classes of a colour."""
    color = f"c{number_of_color % _COLORS}"
    return color if number_of_color < _COLORS else f"{color} dashed"


def _svg(content: Markup, title: str) -> Markup:
    return Markup('<svg viewBox="0 0 {:.0f} {:.0f}" role="img" aria-label="{}">{}</svg>').format(
        _WIDTH, _HEIGHT, title, content
    )


def _legend(classes: Mapping[str, str]) -> Markup:
    """The names of colours, given as text -> classes; empty without any."""
    if not classes:
        return Markup("")
    entries = Markup("").join(
        Markup(
            '<li><svg viewBox="0 0 14 10" aria-hidden="true">'
            '<path class="sample {}" d="M0 5H14"/></svg>{}</li>'
        ).format(css_class, name)
        for name, css_class in classes.items()
    )
    return Markup('<ul class="legend">{}</ul>').format(entries)


def _figure(title: str, note: str, svg: Markup, legend: Markup) -> Markup:
    caption = Markup("<figcaption><b>{}</b><span>{}</span></figcaption>").format(title, note)
    return Markup('<figure class="chart">{}{}{}</figure>').format(caption, svg, legend)
