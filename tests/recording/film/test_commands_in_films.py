"""A velocity command is an arrow in pictures for people: orange, and green while it is followed."""

from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

import embodichain
import embodichain.recording as recording
from embodichain.lab.gym.envs import BaseEnv
from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer
from embodichain.lab.sim.drawing.views import view_of
from embodichain.recording import McapRecorder
from embodichain.recording.film.frames import FilmCamera, frames
from embodichain.recording.film.moments import Moment, draw_moments
from embodichain.recording.read.playback import Playback, Span
from tests.helpers.walker import MJCF

pytestmark = pytest.mark.slow

TASK = """
description: A walker is to move forward with 0.8 m/s, and to turn with 0.5 rad/s.
max_episode_steps: 50
robot: {uid: go, fpath: FILE, fix_base: false, init_pos: [0, 0, 2], drive_pros: {stiffness: 100}}
scene:
  ground: {type: plain, colors: [[0.5, 0.5, 0.5]]}
  sky: {top: [0.5, 0.5, 0.5], horizon: [0.5, 0.5, 0.5]}
views: {default: {eye: [0.1, -2, 2.2], target: [0.1, 0, 2.15], fovy: 24}}
actions: {legs: {func: joint_action, params: {of: {uid: go}}}}
commands:
  velocity:
    func: uniform_velocity
    params: {of: {uid: go}, ranges: {lin_vel_x: [0.8, 0.8], ang_vel_z: [RATE, RATE]}}
events:
  base:
    func: reset_root_state_uniform
    mode: reset
    params: {of: {uid: go}, velocity_range: {x: [SPEED, SPEED], yaw: [0.5, 0.5]}}
observations: {velocity: {func: linear_velocity, params: {of: {uid: go}}}}
metrics:
  success:
    func: follows_velocity
    reduce: last
    params:
      {of: {uid: go}, command_name: velocity, linear_threshold: 0.3, angular_threshold: 0.2}
"""
SIZE = (96, 72)
Make = Callable[..., BaseEnv]


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """A function that makes two environments whose robots begin with a speed, m/s.

    They are to turn with a rate, rad/s.
    """
    (tmp_path / "walker.xml").write_text(MJCF, encoding="utf-8")
    (tmp_path / "task").mkdir()

    def build(speed: float, rate: float = 0.5) -> BaseEnv:
        text = TASK.replace("FILE", str(tmp_path / "walker.xml")).replace("SPEED", str(speed))
        text = text.replace("RATE", str(rate))
        (tmp_path / "task" / "walk.yaml").write_text(text, encoding="utf-8")
        env = embodichain.make("walk", num_envs=2, seed=1, config_dir=tmp_path)
        env.reset()
        return env

    return build


def shares(picture: NDArray[Any]) -> tuple[float, float]:
    """How much of a picture is orange, and green."""
    red, green, blue = np.moveaxis(picture[..., :3].astype(int), -1, 0)
    is_orange = (red - blue > 60) & (red - green > 30)
    is_green = (green - red > 40) & (green - blue > 20)
    return float(is_orange.mean()), float(is_green.mean())


@pytest.mark.parametrize("renderer", ["layered", "classic"])
def test_an_arrow_is_green_while_the_command_is_followed(make, monkeypatch, renderer) -> None:
    monkeypatch.setenv("EMBODICHAIN_RENDERER", renderer)
    for speed, expected in ((0.0, "orange"), (0.7, "green")):
        with closing(make(speed)) as env:
            orange, green = shares(env.sim.render(1, width=SIZE[0], height=SIZE[1]))
            assert (orange > 0.002) == (expected == "orange")
            assert (green > 0.002) == (expected == "green")
            # Who acts on pictures sees none of it.
            (seen,) = env.sim.draw([view_of(env.sim.engine, "default", *SIZE, look="full")])
            assert max(shares(seen["color"][1])) < 0.001


def test_arrows_point_where_the_robot_is_to_go(make) -> None:
    with closing(make(0.0)) as env:
        picture = env.sim.render(0, width=SIZE[0], height=SIZE[1]).astype(int)
    rows, columns = np.nonzero(picture[..., 0] - picture[..., 2] > 60)
    trunk = SIZE[0] / 2 - 8  # x = 0 is 10 cm left of the middle
    assert columns.max() > trunk + 14  # forward, to the right
    assert columns.min() > trunk - 5
    assert np.ptp(rows) > 3  # the turning rate, upwards


def test_the_arrow_of_turning_clockwise_is_above_the_robot_too(make) -> None:
    lowest = []
    for rate in (1.5, -1.5):
        with closing(make(0.0, rate)) as env:
            picture = env.sim.render(0, width=SIZE[0], height=SIZE[1]).astype(int)
        rows, _ = np.nonzero(picture[..., 0] - picture[..., 2] > 60)
        assert np.ptp(rows) > 12  # 18 cm
        lowest.append(int(rows.max()))
    assert lowest[1] == pytest.approx(lowest[0], abs=3)


def test_films_and_pictures_of_a_log_show_commands(make, tmp_path: Path) -> None:
    with closing(make(0.0)) as env:
        task = yaml.safe_load((tmp_path / "task" / "walk.yaml").read_text(encoding="utf-8"))
        config = yaml.safe_dump({"task": task})
        env.add_observer(McapRecorder(tmp_path / "log.mcap", env, task="walk", config=config))
        env.reset()
        for _ in range(6):
            env.step(np.zeros((2, 3), np.float32))
    with recording.open(tmp_path / "log.mcap") as log:
        moments = [Moment(env=0, step=5), Moment(env=1, step=5)]
        viewed, not_viewed = draw_moments(log, moments, SIZE)
        assert shares(viewed)[0] > 0.002
        assert shares(not_viewed)[0] < 0.001  # `record.view_envs` are [0]
        camera = FilmCamera("default", SIZE, marks=True)
        with closing(OffscreenRenderer(log.model)) as renderer:
            film = [*frames(renderer, Playback(log, 0), [camera], Span(0, 5), every=5)]
    assert len(film) == 2
    assert all(shares(frame.pictures[0])[0] > 0.002 for frame in film)
