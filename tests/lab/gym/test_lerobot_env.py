"""`LeRobotVectorEnv`: LeRobot's observations, success and attributes, of one batch."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from gymnasium.vector import SyncVectorEnv

from embodichain.cli import main
from embodichain.config import make_env as make_task
from embodichain.config import resolve
from embodichain.lab.gym.envs.cfg import ObservationCfg, TerminationCfg
from embodichain.lab.gym.lerobot_env import LeRobotVectorEnv, image_key, lerobot_parts
from embodichain.recording.export.episodes import export_episodes
from embodichain.utils.errors import ConfigError
from tests.lab.gym.conftest import jumping, marker

LIMIT = 4


def test_entries_are_of_the_robot_or_of_the_scene():
    task = {
        "robot": {"uid": "arm"},
        "objects": {"cube": {}},
        "commands": {"goal": {}},
        "observations": {
            "qpos": {"params": {"of": {"uid": "arm"}}},
            "to_cube": {"params": {"from": {"uid": "arm"}, "to": {"uid": "cube"}}},
            "target": {"name": "extra/goal", "params": {"of": ["goal"]}},
        },
    }
    names = ["to_cube", "robot/qpos", "qpos", "extra/goal"]
    assert lerobot_parts(task, names) == {
        "observation.state": ["robot/qpos", "qpos"],
        "observation.environment_state": ["to_cube", "extra/goal"],
    }
    assert lerobot_parts({}, ["qpos"]) == {"observation.state": ["qpos"]}
    assert image_key("wrist/color") == "wrist_color"


def _second_succeeds(env, obs, action, info):
    return (torch.arange(3) == 1) & (env.elapsed_steps == 2)


def _picture(env, obs):
    """(N, 1, 4, 6) the number of the environment."""
    return torch.arange(3, dtype=torch.uint8).reshape(3, 1, 1, 1).expand(3, 1, 4, 6).contiguous()


@pytest.fixture
def vector(make_env):
    sections = jumping()
    sections["observations"] = {
        "at": ObservationCfg(func=marker, group="policy", name="at"),
        "eye": ObservationCfg(func=_picture, group="policy", name="wrist/eye"),
    }
    ends = {"there": TerminationCfg(func=_second_succeeds, kind="success")}
    task = {"objects": {"cube": {}}, "observations": {"at": {"params": {"of": "cube"}}}}
    task["description"] = "Reach it."
    env = make_env(**sections, max_episode_steps=LIMIT, terminations=ends)
    made = LeRobotVectorEnv(env, task, "small")
    yield made
    made.close()


def test_observations_success_and_attributes(vector):
    assert isinstance(vector, SyncVectorEnv)  # LeRobot films no other
    shapes = {"observation.environment_state": ("float32", (3,))}
    assert vector.features == shapes | {"observation.images.wrist_eye": ("uint8", (4, 6, 3))}
    obs, _ = vector.reset(seed=[7, 8, 9], options={"lerobot_new_rollout": True})
    assert vector.observation_space.contains(obs)
    eye = obs["pixels"]["wrist_eye"]
    assert (eye == np.arange(3)[:, None, None, None]).all() and eye.flags["C_CONTIGUOUS"]
    again, _ = vector.reset(seed=7)
    assert np.array_equal(obs["environment_state"], again["environment_state"])
    other, _ = vector.reset(seed=8)
    assert not np.array_equal(obs["environment_state"], other["environment_state"])
    vector.reset(seed=7)
    low, high = vector.action_space.low, vector.action_space.high
    action = np.float32(0.5) * (low + high)
    ends = []
    for step in range(LIMIT):
        *_, terminated, truncated, info = vector.step(action)
        done = terminated | truncated
        assert ("final_info" in info) == done.any(), step
        ends.append((done.tolist(), info["final_info"]["is_success"].tolist() if done.any() else 0))
        assert "is_success" not in info and "final_obs" not in info
    none = [False] * 3
    assert ends[0] == (none, 0)
    assert ends[1] == ([False, True, False], [False, True, False])
    assert ends[2] == (none, 0)
    assert ends[3][0][::2] == [True, True] and ends[3][1][::2] == [False, False]
    assert vector.call("_max_episode_steps") == (LIMIT,) * 3
    assert vector.get_attr("task_description") == ("Reach it.",) * 3
    assert vector.call("task") == ("small",) * 3
    assert vector.envs[0].render() is None and vector.call("render") == ()
    assert type(vector.metadata["render_fps"]) is int  # PyAV takes no float


def test_an_environment_that_lerobot_cannot_use_is_refused(make_env):
    group = ObservationCfg(func=marker, group="policy")
    with pytest.raises(ConfigError, match=r"small: LeRobot needs a limit: task\.max_episode_steps"):
        LeRobotVectorEnv(make_env(max_episode_steps=-1, observations={"at": group}), {}, "small")
    with pytest.raises(ConfigError, match="needs observations in the group policy"):
        LeRobotVectorEnv(make_env(), {}, "small")


def test_features_and_first_frames_are_those_of_the_exported_data(tmp_path):
    eye = "{sensor_type: camera, observe: true, width: 32, height: 24, data_types: [color, depth]}"
    keys = ["task=press_button", "task.max_episode_steps=2", "seed=5", "num_envs=2"]
    keys.append(f"+task.sensors.eye={eye}")
    job = ["run", *keys, "episodes=1", "scene_png=false", "-q", f"output_dir={tmp_path}"]
    assert main(job) == 0
    log = (tmp_path / "latest").resolve() / "rollout.mcap"
    root = export_episodes(log, "lerobot", tmp_path / "set", failures=True)
    features = json.loads((root / "meta/info.json").read_text())["features"]
    frames = pq.read_table(root / "data/chunk-000/file-000.parquet").to_pydict()
    resolved = resolve(keys)
    vector = LeRobotVectorEnv(
        make_task(resolved, render_mode="rgb_array"), resolved.tree["task"], "b"
    )
    obs, _ = vector.reset(seed=5)
    for key, name in (("state", "agent_pos"), ("environment_state", "environment_state")):
        kind, shape = vector.features[f"observation.{key}"]
        about = features[f"observation.{key}"]
        assert (about["dtype"], tuple(about["shape"])) == (kind, shape)
        starts = [0, frames["episode_index"].index(1)]
        recorded = np.array([frames[f"observation.{key}"][i] for i in starts], np.float32)
        assert np.array_equal(obs[name], recorded)
    eye = "observation.images.eye"
    assert tuple(features[eye]["shape"]) == vector.features[eye][1] == (24, 32, 3)
    # LeRobot's interface has no sensors: the picture itself, from the environment inside.
    seen = vector._batch.env.get_sensor("eye").read("color")
    assert np.array_equal(obs["pixels"]["eye"], np.asarray(seen)[..., :3])
    assert vector.single_observation_space["pixels"]["eye"].shape == (24, 32, 3)
    assert vector.single_action_space.shape == tuple(features["action"]["shape"])
    pictures = vector.call("render")
    assert len(pictures) == 2 and np.array_equal(vector.envs[1].render(), pictures[1])
    assert vector.render_one(0).shape == (480, 640, 3)
    vector.close()
