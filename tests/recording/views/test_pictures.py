"""Hashes of the first pictures of episodes, and their comparison."""

import hashlib

import numpy as np
import pytest
import torch

import embodichain
from embodichain.cli.app import main
from embodichain.recording import McapRecorder, inspect, verify
from embodichain.recording.format.messages.schema import PICTURES_TOPIC, message_class
from embodichain.utils.errors import ConfigError
from tests.recording.rewrite import rewrite
from tests.recording.runs import messages

FRONT = (
    "+task.sensors.front={sensor_type: camera, width: 48, height: 32, fovy: 45, "
    "extrinsics: {eye: [0, -3, 1.5], target: [0, 0, 1.2]}, data_types: [color, depth], "
    "observe: OBSERVE}"
)
COLORS = (
    "+task.events.paint={func: randomize_visual_material, mode: reset, params: "
    "{entity_cfg: {uid: left_post}, base_color_range: [[0.1, 0, 0], [1, 0.5, 0.5]]}}"
)


def recorded(folder, observe=True, num_envs=3, steps=25):
    """A log of cart poles, and the digests of the pictures that begin each episode."""
    overrides = [
        FRONT.replace("OBSERVE", str(observe).lower()),
        COLORS,
        "task.max_episode_steps=10",
    ]
    env = embodichain.make("cart_pole", num_envs, overrides)
    env.add_observer(McapRecorder(folder / "log.mcap", env))
    seen, begins = {}, np.ones(num_envs, np.bool_)
    obs, _ = env.reset(seed=0)
    for step in range(steps):
        for env_id in np.flatnonzero(begins).tolist() if observe else ():
            images = obs["sensor"]["front"]
            both = images["color"][env_id].numpy(), images["depth"][env_id].numpy()
            seen[step, env_id] = hashlib.sha256(both[0].tobytes() + both[1].tobytes()).digest()
        action = torch.full((num_envs, 1), 0.1 * (step % 3))
        obs, _, terminated, truncated, _ = env.step(action)
        begins = (terminated | truncated).numpy()
    env.close()
    return folder / "log.mcap", seen


def hashes(path):
    """Step and environment to digest."""
    found = {}
    for _, data in messages(path, PICTURES_TOPIC):
        message = message_class("Pictures").FromString(data)
        assert (message.camera, message.width, message.height) == ("front", 48, 32)
        assert "OpenGL" in message.renderer
        for i, env_id in enumerate(message.env_ids):
            found[message.step, env_id] = message.sha256[32 * i : 32 * i + 32]
    return found


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return recorded(tmp_path_factory.mktemp("pictures"))


def test_the_hashes_are_of_the_pictures_that_were_observed(log):
    path, seen = log
    assert [*seen] == [(step, env_id) for step in (0, 10, 20) for env_id in range(3)]
    assert len(set(seen.values())) == 9
    assert hashes(path) == seen


def test_the_pictures_are_drawn_again_from_the_file(log):
    path, _ = log
    report = verify(path, images=True)
    assert report.ok
    assert report.notes == ["the first pictures of episodes: 9 are identical to the byte"]
    assert verify(path, env=1, images=True).notes[0].endswith("3 are identical to the byte")


def test_the_command_compares_them(log, capsys):
    assert main(["replay", str(log[0]), "--verify", "--images"]) == 0
    assert "9 are identical to the byte" in capsys.readouterr().out
    assert main(["replay", str(log[0]), "--images"]) == 2
    assert "--images needs --verify" in capsys.readouterr().err


def changed(log, tmp_path, **fields):
    """The log with something else in the hashes of step 10."""

    def message(topic, data):
        if topic != PICTURES_TOPIC:
            return data
        found = message_class("Pictures").FromString(data)
        if found.step == 10:
            for name, value in fields.items():
                setattr(found, name, value)
        return found.SerializeToString()

    return rewrite(log[0], tmp_path / "changed.mcap", message=message)


def test_another_picture_is_named(log, tmp_path):
    digests = b"".join(log[1][10, env_id] for env_id in (0, 0, 2))
    report = verify(changed(log, tmp_path, sha256=digests), images=True)
    assert not report.ok
    assert report.steps == 25
    assert report.problems == [
        "step 10, environment 1, camera front: the picture differs from the recorded one"
    ]


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"renderer": "layered: a card, OpenGL 9"}, "drawn by layered: a card, OpenGL 9; here by"),
        ({"camera": "rear"}, "no camera 'rear'"),
        ({"width": 2**31}, "hashes of pictures are damaged"),
        ({"sha256": bytes(32)}, "hashes of pictures are damaged"),
        ({"near": float("nan")}, "hashes of pictures are damaged"),
        ({"look": "bright"}, "hashes of pictures are damaged"),
    ],
)
def test_hashes_that_cannot_be_compared_say_why(log, tmp_path, fields, message):
    report = verify(changed(log, tmp_path, **fields), images=True)
    assert not report.ok
    assert message in report.problems[0]


def test_a_camera_that_nothing_reads_has_no_hashes(tmp_path):
    path, _ = recorded(tmp_path, observe=False)
    assert not hashes(path)
    assert {c.topic: c.messages for c in inspect(path).channels}.get(PICTURES_TOPIC, 0) == 0
    assert verify(path).ok
    report = verify(path, images=True)
    assert report.problems == ["the log has no hashes of pictures: no camera was read"]


def test_episodes_are_compared_together(log):
    with pytest.raises(ConfigError, match="leave the episode out"):
        verify(log[0], env=0, episode=1, images=True)
