"""A task with cameras and without a robot, from YAML to steps, states, logs, films and exports."""

import json
import os
from pathlib import Path

import gymnasium as gym
import h5py
import numpy as np
import pytest
import torch
import yaml
from PIL import Image

import embodichain
from embodichain.cli import main
from embodichain.config.gymnasium_ids import register_task_ids
from embodichain.recording import McapRecorder, verify
from embodichain.utils.errors import RenderError
from tests.recording.film.test_film import pictures

pytestmark = pytest.mark.slow

TASK = """
description: A cube falls before a wall.
max_episode_steps: 12
physics: {physics_dt: 0.02}
sim_steps_per_control: 1
objects:
  wall: {shape: {shape_type: Cube, size: [0.2, 4, 4]}, body_type: static, init_pos: [1.6, 0, 1]}
  cube: {shape: {shape_type: Cube, size: [0.2, 0.2, 0.2]}, init_pos: [1.2, 0, 1.3]}
views:
  side: {eye: [1.2, -2, 1], target: [1.2, 0, 1], fovy: 60}
sensors:
  eye: &eye {sensor_type: camera, width: 24, height: 16, fovy: 60, observe: true,
             data_types: [color, depth, mask], extrinsics: {eye: [0, 0, 1], target: [1, 0, 1]}}
  slow: {<<: *eye, rate: 10}
  side: {sensor_type: camera, width: 16, height: 16, camera: side, data_types: [mask]}
observations:
  picture: {func: camera_image, params: {sensor: eye}}
  late: {func: camera_image, params: {sensor: slow}, delay: 1, history_length: 2}
  height: {func: position, params: {of: {uid: cube}}, group: critic}
events:
  jump:
    func: randomize_pose
    mode: reset
    params: {of: {uid: cube}, position_range: [[0, -0.4, 0], [0, 0.4, 0]]}
"""


@pytest.fixture
def make(tmp_path, monkeypatch):
    """Builds the task in an empty folder; environments are closed at the end."""
    monkeypatch.chdir(tmp_path)
    built = []

    def build(num_envs=2, overrides=()):
        tree = yaml.safe_load(TASK)
        Path("conf", "task").mkdir(parents=True, exist_ok=True)
        Path("conf", "task", "seen.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))
        env = embodichain.make("seen", num_envs, ["seed=1", *overrides])
        built.append(env)
        return env

    yield build
    for env in built:
        env.close()


def step(env):
    return env.step(np.zeros((env.num_envs, 0), np.float32))


def same(obs, image="color"):
    """(N,) environments in which the slow camera shows the present."""
    seen = obs["sensor"]
    return (seen["slow"][image] == seen["eye"][image]).flatten(1).all(1).tolist()


# -- steps -----------------------------------------------------------------------------------------


def test_a_camera_of_ten_hertz_shows_every_fifth_step_and_every_reset(make):
    env = make()
    obs, _ = env.reset()
    assert same(obs, "depth") == [True, True]
    fresh = []
    for _ in range(24):
        obs, _, _, truncated, _ = step(env)
        fresh.append(all(same(obs, "depth")))
    # 0.1 s are 5 steps; the 12th ends the episode, and time begins anew.
    assert [i + 1 for i, now in enumerate(fresh) if now] == [5, 10, 12, 17, 22, 24]
    assert truncated.all()


def test_a_partial_reset_draws_its_environments_alone(make):
    env = make(3)
    env.reset()
    for _ in range(3):
        obs, *_ = step(env)
    assert same(obs) == [False] * 3
    before = obs["sensor"]["slow"]["color"].clone()
    obs, _ = env.reset(options={"reset_ids": [1]})
    assert same(obs) == [False, True, False]
    torch.testing.assert_close(obs["sensor"]["slow"]["color"][[0, 2]], before[[0, 2]])


def test_delay_and_history_over_a_rate_and_a_reset(make):
    """Two images of three channels, the older first, each a step late."""
    env = make()
    obs, _ = env.reset()
    shown = [obs["sensor"]["slow"]["color"][..., :3].movedim(-1, 1).clone()]
    for number in range(1, 12):
        obs, *_ = step(env)
        shown.append(obs["sensor"]["slow"]["color"][..., :3].movedim(-1, 1).clone())
        old, new = shown[max(0, number - 2)], shown[number - 1]
        torch.testing.assert_close(obs["late"], torch.cat([old, new], dim=1))
    obs, *_ = step(env)  # a new episode: nothing of the last one is left
    first = obs["sensor"]["slow"]["color"][..., :3].movedim(-1, 1)
    torch.testing.assert_close(obs["late"], torch.cat([first, first], dim=1))


@pytest.mark.parametrize("threads", [1, 2])
def test_bytes_depend_on_neither_the_number_nor_the_place(make, threads):
    def hashes(num_envs):
        env = make(num_envs, [f"sim.num_threads={threads}"])
        env.reset()
        found = []
        for _ in range(14):
            obs, *_ = step(env)
            seen = obs["sensor"]
            found.append(
                [obs["late"][1].numpy().tobytes()]
                + [seen[uid][name][1].numpy().tobytes() for uid in seen for name in seen[uid]]
            )
        return found

    assert hashes(2) == hashes(3 + threads)


def test_a_state_continues_in_another_environment(make):
    env = make()
    env.reset()
    for _ in range(7):
        step(env)
    saved = env.state_dict()
    wanted = [step(env)[0] for _ in range(8)]
    wanted = [(obs["late"].clone(), obs["sensor"]["slow"]["mask"].clone()) for obs in wanted]
    other = make()
    for built in (env, other):
        built.load_state_dict(saved)
        for late, mask in wanted:
            obs, *_ = step(built)
            torch.testing.assert_close(obs["late"], late)
            torch.testing.assert_close(obs["sensor"]["slow"]["mask"], mask)


def test_masks_number_what_is_in_the_picture(make):
    env = make(1)
    obs, _ = env.reset()
    ids = {uid: env.sim.get_rigid_object(uid).entity.root_body_id for uid in ("wall", "cube")}
    assert len({-1, 0, *ids.values()}) == 4
    assert set(obs["sensor"]["eye"]["mask"].unique().tolist()) == set(ids.values())
    # From the side: the wall's edge, the cube, the ground (0) and the sky (-1).
    assert set(np.unique(env.get_sensor("side").read("mask"))) == {-1, 0, *ids.values()}


def test_groups_of_images_and_of_numbers(make):
    env = make()
    obs, _ = env.reset()
    assert set(env.observation_manager.image_terms()) == {"picture", "late"}
    assert env.observation_manager.image_terms("critic") == ()
    torch.testing.assert_close(obs["height"][:, 2], torch.full((2,), 1.3))
    with pytest.raises(ValueError, match="'policy' is not a flat vector: picture, late are images"):
        env.observation_manager.flatten(obs)
    numbers = env.observation_manager.flatten(obs, "critic")
    torch.testing.assert_close(numbers, obs["height"])


def test_gymnasium_has_images_in_a_dict(make):
    make().close()
    register_task_ids()
    env = gym.make("embodichain/seen-v0")
    obs, _ = env.reset(seed=3)
    assert obs["picture"].shape == (3, 16, 24) and obs["picture"].dtype == np.uint8
    assert obs["late"].shape == (6, 16, 24)
    assert env.observation_space.contains(obs)
    assert env.observation_space["picture"] == gym.spaces.Box(0, 255, (3, 16, 24), np.uint8)
    obs, reward, *_ = env.step(env.action_space.sample())
    assert env.observation_space.contains(obs) and reward == 0.0
    env.close()
    batch = gym.make_vec("embodichain/seen-v0", num_envs=3)
    obs, _ = batch.reset(seed=3)
    assert obs["late"].shape == (3, 6, 16, 24) and batch.observation_space.contains(obs)
    batch.close()


def test_a_forked_process_gets_an_error_and_the_parent_goes_on(make):
    env = make(1)
    before = env.reset()[0]["picture"].clone()
    read, write = os.pipe()
    child = os.fork()
    if not child:
        try:
            step(env)
        except RenderError as error:
            os.write(write, str(error).encode())
        finally:
            os._exit(0)
    os.close(write)
    with os.fdopen(read) as said:
        assert 'set_start_method("spawn")' in said.read()
    os.waitpid(child, 0)
    torch.testing.assert_close(env.get_obs()["picture"], before)


# -- logs ------------------------------------------------------------------------------------------


def test_a_log_of_cameras_at_a_rate_is_verified_with_its_pictures(make):
    env = make()
    env.add_observer(McapRecorder("log.mcap", env))
    env.reset()
    for _ in range(30):
        step(env)
    env.close()
    report = verify("log.mcap", images=True)
    assert report.ok and report.steps == 30
    # Two cameras that are observed, two environments; episodes begin at 0, 12 and 24. The third
    # camera is never read.
    assert report.notes == ["the first pictures of episodes: 12 are identical to the byte"]


def test_a_run_is_replayed_filmed_and_exported(make, capsys):
    make(1).close()
    words = ["task=seen", "num_envs=2", "seed=1", "episodes=1", "scene_png=true", "--json"]
    film = ["video.size=[64,48]", "video.every=3", "record.images={cameras: [eye], format: png}"]
    assert main(["run", *words, *film]) == 0
    said = json.loads(capsys.readouterr().out)
    log = next(Path("outputs").rglob("rollout.mcap"))
    about, shown = pictures(said["video"])
    assert about["size"] == (64, 48) and len(shown) == 4  # steps 0, 3, 6 and 9
    with Image.open(log.parent / "scene.png") as picture:
        assert picture.size == (1280, 960)
    assert main(["replay", str(log), "--verify", "--images"]) == 0
    assert "identical to the byte" in capsys.readouterr().out
    line = ["replay", str(log), "--video", "side.mp4", "--camera", "side", "--size", "32x32"]
    assert main([*line, "--quiet"]) == 0
    about, shown = pictures("side.mp4")
    assert about["size"] == (32, 32) and len(shown) == 12
    assert main(["export", str(log), "--format", "hdf5", "-o", "demos.hdf5"]) == 0
    with h5py.File("demos.hdf5") as file:
        assert {len(file[f"data/demo_{i}/actions"]) for i in range(2)} == {12}
        images = file["data/demo_1/obs/eye_image"][:]
    assert images.shape == (12, 16, 24, 3)
    env = make(2)
    obs, _ = env.reset()
    np.testing.assert_array_equal(images[0], obs["picture"][1].movedim(0, -1))
    for number in range(1, 12):
        obs, *_ = step(env)
        np.testing.assert_array_equal(images[number], obs["picture"][1].movedim(0, -1))
