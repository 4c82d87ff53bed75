"""`draw_moments`: single pictures of a log, each of the state that films show there."""

from pathlib import Path

import numpy as np
import pytest

from embodichain import recording
from embodichain.cli import main
from embodichain.lab.sim.drawing.offscreen import OffscreenRenderer
from embodichain.recording.film.filming import default_camera
from embodichain.recording.film.frames import FilmCamera, frames
from embodichain.recording.film.moments import Moment, draw_moments
from embodichain.recording.read.playback import Playback, Span
from embodichain.utils.errors import ConfigError

pytestmark = pytest.mark.slow
SIZE = (64, 48)


def record(folder: Path, *more: str) -> Path:
    task = ["run", "task=cart_pole", "num_envs=2", "max_steps=30", "task.max_episode_steps=10"]
    assert main([*task, "scene_png=false", f"output_dir={folder}", "-q", *more]) == 0
    return (folder / "latest").resolve()


@pytest.mark.parametrize("more", [[], ["record.state=keyframes", "record.keyframe_every=7"]])
def test_they_are_those_of_a_film(tmp_path: Path, more: list[str]) -> None:
    run = record(tmp_path, "episodes=3", *more)
    moments = [Moment(1, 29), Moment(0, 0), Moment(1, 12), Moment(0, 13), Moment(1, 3)]
    with recording.open(run) as log:
        drawn = draw_moments(log, moments, SIZE)
        renderer = OffscreenRenderer(log.model)
        for env in (0, 1):
            camera = FilmCamera(default_camera(log), SIZE)
            film = frames(renderer, Playback(log, env), [camera], Span(0, 29))
            by_step = {frame.step: frame.pictures[0] for frame in film}
            for moment, picture in zip(moments, drawn, strict=True):
                if moment.env == env:
                    assert picture is not None
                    np.testing.assert_array_equal(picture, by_step[moment.step])
        renderer.close()


def test_what_is_not_in_the_log_is_none(tmp_path: Path) -> None:
    """With `record.every=2` the second episode of each environment is left out."""
    run = record(tmp_path, "episodes=3", "record.every=2", "task.max_episode_steps=5")
    with recording.open(run) as log:
        assert draw_moments(log, [], SIZE) == []
        first, second, third, after = draw_moments(
            log, [Moment(0, 2), Moment(0, 7), Moment(0, 12), Moment(0, 4000)], SIZE
        )
        assert first is not None and third is not None
        assert second is None and after is None
        with pytest.raises(ConfigError, match="environment 7"):
            draw_moments(log, [Moment(7, 0)], SIZE)
