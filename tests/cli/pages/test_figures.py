"""Figures of pages: what they draw, and where their axes begin and end."""

import re

import numpy as np
import pytest

from embodichain.cli.pages.axes import count_axis, step_axis, tick_labels, value_axis
from embodichain.cli.pages.figures import Line, ValueGroup, bar, distribution, line_chart

STEPS = np.arange(1.0, 6.0) * 1000


@pytest.mark.parametrize(
    ("values", "ends", "labels"),
    [
        ([100.0, 100.0], (0, 100), ["0", "25", "50", "75", "100"]),
        ([99.5, 100.0], (0, 100), ["0", "25", "50", "75", "100"]),  # less than 1 %: a constant
        ([-5.0], (-6, 0), ["−6", "−4", "−2", "0"]),
        ([0.0], (0, 1), ["0", "0.25", "0.50", "0.75", "1.00"]),
        ([80.0, 100.0], (80, 100), ["80", "85", "90", "95", "100"]),
        ([96.0, 100.0], (95, 101), None),  # at least 5 % long
        ([1.0, 10.0], (0, 10), None),
        ([-24.0, 46.0], (-40, 60), ["−40", "−20", "0", "20", "40", "60"]),
        ([np.nan, np.inf], (0, 1), None),
    ],
)
def test_axes_of_values(
    values: list[float], ends: tuple[float, float], labels: list[str] | None
) -> None:
    axis = value_axis(values)
    assert axis.low <= ends[0] + 1e-9 and axis.high >= ends[1] - 1e-9
    assert labels is None or (axis.labels == labels and (axis.low, axis.high) == ends)


def test_other_axes() -> None:
    assert value_axis([0.3], is_share=True).labels == ["0%", "25%", "50%", "75%", "100%"]
    assert step_axis(131_072).labels == ["0", "50k", "100k"]
    assert step_axis(1).ticks == (0.0, 1.0)  # no step and a half
    assert count_axis(7).labels == ["0", "3", "6", "9"]
    assert tick_labels([0.0, 2e6, 4e6]) == ["0", "2M", "4M"]
    assert tick_labels([0.0, 2e-6]) == ["0", "2e-6"]
    assert tick_labels([2500.0, 5000.0]) == ["2500", "5000"]


def test_two_points_are_not_a_line() -> None:
    two = line_chart("return", [Line("return", STEPS[:2], np.array([1.0, 5.0]))])
    assert two.count("<circle") == 2 and 'class="line' not in two
    five = line_chart("return", [Line("return", STEPS, np.arange(5.0))])
    assert five.count('class="line c0"') == 1 and "last 4" in five
    many = np.arange(5000.0)
    long = line_chart("return", [Line("return", many, many)])
    assert "<circle" not in long and long.count("L") < 500
    assert "constant 100" in line_chart("length", [Line("length", STEPS, np.full(5, 100.0))])


def test_values_that_are_not_finite_are_left_out() -> None:
    values = np.array([1.0, np.nan, 3.0, np.inf, 5.0])
    assert line_chart("x", [Line("x", STEPS, values)]).count("<circle") == 3
    nothing = line_chart("x", [Line("x", STEPS, np.full(5, np.nan))])
    assert "no finite values" in nothing and "<svg" not in nothing
    assert "no finite values" in distribution("x", [ValueGroup([np.nan])])


def test_bands_and_legends() -> None:
    mean = np.arange(5.0)
    lines = [
        Line("a", STEPS, mean, low=mean - 20, high=mean + 20),
        Line("b", STEPS, mean, color=9),
        Line("b", STEPS, mean + 1, color=9, is_faint=True),
    ]
    chart = line_chart("x", lines)
    assert chart.count('class="band c0"') == 1 and "−20" in chart  # the axis contains the band
    assert re.findall(r"</svg>(\w)</li>", chart) == ["a", "b"]
    assert 'class="line c1 dashed"' in chart  # the tenth colour is the second, dashed


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_each_value_is_in_one_bar(scale: float) -> None:
    values = np.random.default_rng(0).normal(size=257) * scale + 1000 * scale
    groups = [ValueGroup(values[:200], "success", "good"), ValueGroup(values[200:], "rest", "bad")]
    drawn = distribution("return", groups)
    counts = {
        color: sum(map(int, re.findall(rf'<rect class="{color}"[^>]*><title>(\d+) ', drawn)))
        for color in ("good", "bad")
    }
    assert counts == {"good": 200, "bad": 57}
    assert re.findall(r"</svg>(\w+)</li>", drawn) == ["success", "rest"]


def test_whole_numbers_have_a_bar_each_and_a_constant_one() -> None:
    drawn = distribution("length", [ValueGroup([18, 18, 19, 25])])
    assert re.findall(r"<title>(\d+) episodes?, ([\d.]+) to", drawn) == [
        ("2", "17.5"),
        ("1", "18.5"),
        ("1", "24.5"),
    ]
    constant = distribution("length", [ValueGroup([100.0] * 7)])
    assert constant.count("<rect") == 1 and ">100<" in constant


def test_text_is_escaped_everywhere() -> None:
    wild = "<script>x</script>\"'&"
    figures = [
        line_chart(wild, [Line(wild, STEPS, STEPS), Line("b", STEPS, STEPS)], x_label=wild),
        distribution(wild, [ValueGroup([1.0], wild)], note=wild),
    ]
    for figure in figures:
        assert "<script" not in figure and "&lt;script&gt;" in figure
        assert 'aria-label="&lt;script&gt;x&lt;/script&gt;&#34;&#39;&amp;"' in figure


def test_bars_of_signed_values_begin_in_the_middle() -> None:
    assert 'x="0.0" y="0" width="100.0"' in bar(3.0, 3.0)
    assert 'class="bad" x="25.0" y="0" width="25.0"' in bar(-1.0, 2.0, is_signed=True)
    assert 'class="plain" x="50.0" y="0" width="50.0"' in bar(2.0, 2.0, is_signed=True)
    assert 'width="0.4"' in bar(0.0, 0.0)
