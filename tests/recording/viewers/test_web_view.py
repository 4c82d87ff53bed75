"""A running environment on the page: what is sent when the environment looks different."""

from embodichain.lab.gym.envs.cfg import EventCfg
from embodichain.recording.viewers.web import WebView
from tests.helpers.ur10_task import builder
from tests.recording.viewers.test_web_page import crc_of, until, visit

PAINT = {"entity_cfg": {"uid": "cube"}, "base_color_range": [[0, 0, 0], [1, 1, 1]]}


def test_the_model_is_sent_again_when_the_environment_shown_is_painted():
    with builder() as build:
        painting = EventCfg(func="randomize_visual_material", mode="reset", params=PAINT)
        env = build(events={"paint": painting})
        env.reset()
        view = WebView(env, realtime=False)
        env.add_observer(view)
        with visit(view._page) as state:
            assert until(lambda: view.watched)
            first = crc_of(state)
            env.reset(options={"env_ids": [1]})
            env.reset(options={"env_ids": [0]})
            assert until(lambda: crc_of(state) != first)
            second, before = crc_of(state), view._page._looks
            env.reset(options={"env_ids": [1, 2]})
            assert view._page._looks == before
            assert crc_of(state) == second
