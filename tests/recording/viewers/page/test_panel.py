"""The panel of the page, without a page: where it is, and what its plot leaves out."""

import math

import pytest

from embodichain.recording.viewers.page.web_page import Controls, Facts, PageOptions
from embodichain.recording.viewers.page.web_process import Panel, panel_place


def facts(step, value):
    return Facts(step=step, seconds=0.0, rewards={"near": value})


def plotted(panel):
    # What the plot draws; the picture of it is looked at by people.
    return [(past.step, past.rewards["near"]) for past in panel._history]


@pytest.fixture
def panel():
    return Panel(PageOptions(), 1, Controls())


def test_where_nobody_watched_the_plot_has_a_gap(panel):
    panel.begin_part()  # the first page: nothing was plotted before
    panel.add(facts(1, 0.5))
    panel.add(facts(2, 0.6))
    panel.begin_part()
    panel.add(facts(900, 0.7))
    steps = plotted(panel)
    assert [step for step, _ in steps] == [1, 2, 2, 900]
    assert [math.isnan(value) for _, value in steps] == [False, False, True, False]


def test_a_log_that_begins_again_is_plotted_from_its_start(panel):
    panel.add(facts(1, 0.5))
    panel.add(facts(2, 0.6))
    panel.add(facts(0, 0.4))
    assert plotted(panel) == [(0, 0.4)]


@pytest.mark.parametrize(
    ("width", "height"), [(1400, 900), (1000, 500), (800, 1000), (420, 800), (360, 640), (520, 300)]
)
def test_the_panel_leaves_the_scene_free(width, height):
    place = panel_place(width, height)
    assert place.x > 0 and place.x + place.width < width
    assert place.y > 0 and place.y + place.height < height
    assert place.width * place.height < width * height / 2
