"""A running environment on the page: what is sent of it, and when it looks different."""

import pytest
import torch

from embodichain.lab.gym.envs.cfg import EventCfg, RewardCfg
from embodichain.recording.viewers.web import PageOptions, WebView
from tests.helpers.ur10_task import builder
from tests.recording.viewers.page.test_web_page import crc_of, until, visit

PAINT = {"entity_cfg": {"uid": "cube"}, "base_color_range": [[0, 0, 0], [1, 1, 1]]}


def test_the_model_is_sent_again_when_the_environment_shown_is_painted():
    with builder() as build:
        painting = EventCfg(func="randomize_visual_material", mode="reset", params=PAINT)
        env = build(events={"paint": painting})
        env.reset()
        view = WebView(env, PageOptions(realtime=False))
        env.add_observer(view)
        # A browser's connection, without a browser.
        with visit(view._page) as state:
            assert until(lambda: view.watched)
            first = crc_of(state)
            env.reset(options={"env_ids": [1]})
            env.reset(options={"env_ids": [0]})
            assert until(lambda: crc_of(state) != first)
            # What is sent only if it has changed.
            second, before = crc_of(state), view._page._looks
            env.reset(options={"env_ids": [1, 2]})
            assert view._page._looks == before
            assert crc_of(state) == second


def test_terms_are_told_as_they_add_up_to_the_reward():
    def height(env, obs, action, info):
        return env.sim.get_rigid_object("cube").get_local_pose()[:, 2]

    def tries(env, obs, action, info):
        return torch.arange(3.0) + 4.0

    rewards = {
        "height": RewardCfg(func=height, weight=10.0),
        "tries": RewardCfg(func=tries, weight=-0.5),
    }
    with builder() as build:
        env = build(rewards=rewards)
        env.reset()
        view = WebView(env, PageOptions(env_id=1, realtime=False))
        env.add_observer(view)
        told = []
        view._page.show = lambda row, facts, commands: told.append(facts)
        # A browser's connection; facts are sent 20 times a second, or at once.
        with visit(view._page):
            assert until(lambda: view.watched)
            # The next step is due at once, not by the clock.
            view._next_facts = 0.0
            _, reward, *_ = env.step(env.action_space.sample())
        facts = [f for f in told if f is not None][-1]
    assert facts.rewards["tries"] == -2.5
    assert sum(facts.rewards.values()) == pytest.approx(reward[1].item())
    assert facts.sums == pytest.approx(facts.rewards)
