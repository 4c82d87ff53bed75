"""Films of episodes: which files there are, how long they are, and what is in them."""

import importlib.util
from dataclasses import replace

import imageio_ffmpeg
import numpy as np
import pytest

from embodichain.lab.gym.envs.cfg import EventCfg
from embodichain.lab.gym.envs.mdp.events.record import filmed_from
from embodichain.lab.sim.drawing.views import Viewpoint
from embodichain.utils.errors import ConfigError

SIZE = [96, 64]


@pytest.fixture
def films(tmp_path):
    folder = tmp_path / "films"
    folder.mkdir()
    return folder


def film(folder, **params) -> dict[str, EventCfg]:
    given = {"resolution": SIZE, "save_path": str(folder), **params}
    return {
        "film": EventCfg(func="record_camera_data", mode="interval", interval_step=1, params=given)
    }


def pictures(path) -> tuple[dict, np.ndarray]:
    reader = imageio_ffmpeg.read_frames(str(path))
    about = next(reader)
    width, height = about["size"]
    frames = [np.frombuffer(f, np.uint8).reshape(height, width, 3) for f in reader]
    return about, np.array(frames)


def names(folder) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_every_episode_of_each_environment_is_a_file(make, films) -> None:
    env = make(num_envs=3, max_episode_steps=4, events=film(films, max_env_num=2, name="top"))
    env.reset()
    hold = env.robot.get_qpos(target=True)
    for step in range(6):
        if step == 2:
            env.reset(options={"reset_ids": [1]})
        env.step(hold)
    # Environment 0: 4 steps, then 2; environment 1: 2 steps, then 4, the last one just now.
    assert [n for n in names(films) if not n.startswith(".")] == [
        "top_env0_episode0.mp4",
        "top_env1_episode0.mp4",
        "top_env1_episode1.mp4",
    ]
    env.close()
    assert names(films) == [f"top_env{i}_episode{k}.mp4" for i in (0, 1) for k in (0, 1)]
    counts = [len(pictures(films / name)[1]) for name in names(films)]
    assert counts == [4, 2, 2, 4]
    about, frames = pictures(films / "top_env0_episode0.mp4")
    assert about["size"] == tuple(SIZE) and about["fps"] == 25.0  # a control step is 0.04 s
    assert frames.std() > 10


def test_a_file_that_exists_stays(make, films) -> None:
    (films / "default_env0_episode0.mp4").write_text("mine")
    env = make(num_envs=1, events=film(films, camera="default", fps=5))
    env.reset()
    env.step(env.robot.get_qpos(target=True))
    env.close()
    assert names(films) == ["default_env0_episode0.mp4", "default_env0_episode0_2.mp4"]
    assert (films / "default_env0_episode0.mp4").read_text() == "mine"
    assert pictures(films / "default_env0_episode0_2.mp4")[0]["fps"] == 5.0


def test_a_view_shows_what_it_looks_at(make) -> None:
    env = make(num_envs=1)
    env.reset()
    # The cube, 10 cm wide, from 1 m above it: focal length 64 pixels, so about 7 pixels wide.
    fovy = 2 * np.degrees(np.arctan(32 / 64))
    view = Viewpoint.look_at([0.5, 0.5, 1.1], [0.5, 0.5, 0.1], [0, 1, 0], fovy)
    seen = env.sim.render(0, view, *SIZE).astype(int)
    middle = seen[32, 48]
    same = (np.abs(seen - middle).max(axis=2) < 25) & (np.indices((64, 96))[0] > 0)
    assert 5 <= same[32, 40:56].sum() <= 9 and 5 <= same[24:40, 48].sum() <= 9


def test_a_lens_off_centre_with_two_focal_lengths(make) -> None:
    """The cube, 10 cm wide, from 1 m above it: 22.8 pixels wide, 11.4 high, around (30, 20)."""
    env = make(num_envs=1)
    env.reset()
    view = filmed_from((96, 64), [0.5, 0.5, 1.1], [0.5, 0.5, 0.1], [0, 1, 0], [228, 114, 30, 20])
    mask = env.sim.draw([replace(view, outputs=("mask",))])[0]["mask"][0]
    rows, columns = np.nonzero(mask == mask[20, 30])
    # Pixels whose centres are between 18.6 and 41.4, and between 14.3 and 25.7.
    assert (columns.min(), columns.max()) == (19, 40)
    assert (rows.min(), rows.max()) == (14, 25)


@pytest.mark.parametrize(
    ("params", "part"),
    [
        ({"resolution": [95, 64]}, "multiple of 2"),
        ({"intrinsics": [600, 0, 48, 32]}, "must be positive"),
        ({"eye": [0, 0, 1], "target": [0, 0, 1]}, "the eye is at the target"),
        ({"camera": "top"}, "there are: default"),
        ({"name": "a/b"}, "is not part of a file's name"),
    ],
)
def test_wrong_parameters(make, films, params, part) -> None:
    with pytest.raises(ConfigError) as caught:
        make(events=film(films, **params))
    assert part in str(caught.value)


def test_without_the_encoder_the_extra_is_named(make, films, monkeypatch) -> None:
    find = importlib.util.find_spec
    # As if the extra were not installed.
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda n, *a: None if n == "imageio_ffmpeg" else find(n, *a)
    )
    with pytest.raises(ConfigError, match=r"embodichain\[video\]"):
        make(events=film(films))
