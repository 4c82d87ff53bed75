"""The symmetry of a task: its reflection is that of physics, policies have it, mistakes."""

import dataclasses

import numpy as np
import pytest
import torch
from stable_baselines3.common.running_mean_std import RunningMeanStd

import embodichain
from embodichain.config import resolve
from embodichain.lab.gym.envs.cfg import SymmetryCfg
from embodichain.learning import export_policy, load_policy
from embodichain.learning.policies.exported import load_exported
from embodichain.learning.sb3.symmetry import Columns, Mirror, MirroredMeanStd
from embodichain.learning.training.train import train
from embodichain.utils.errors import ConfigError

pytestmark = pytest.mark.slow

TASK = ["task.enable_corruption=false", "task.max_episode_steps=20", "sim.num_threads=1"]
TRAIN = ["task=quadruped_velocity", *TASK, "num_envs=4", "seed=1", "eval.episodes=0"]
TRAIN += ["total_timesteps=64", "algo.n_steps=8", "algo.batch_size=16", "algo.n_epochs=2"]


@pytest.fixture(scope="module")
def quadruped():
    env = embodichain.make("quadruped_velocity", num_envs=2, seed=3, overrides=TASK)
    yield env.unwrapped
    env.close()


@pytest.fixture(scope="module")
def mirror(quadruped):
    return Mirror.of(quadruped, "policy")


def flat(env, obs):
    return env.observation_manager.flatten(obs, "policy").numpy()


@pytest.mark.parametrize("task", ["quadruped_velocity", "humanoid_velocity"])
def test_the_mirrored_simulation_has_the_mirrored_observations(task):
    """Environment 1 begins as the image of environment 0 and gets mirrored actions."""
    env = embodichain.make(task, num_envs=2, seed=3, overrides=TASK).unwrapped
    mirror, engine = Mirror.of(env, "policy"), env.sim.engine
    env.reset(seed=3)
    state = {name: engine.rows[:1, engine.component(name)].copy() for name in ("qpos", "qvel")}
    # Position and wxyz orientation; velocities in the world, rotation in the body's frame.
    for name, signs in (("qpos", [1, -1, 1, 1, -1, 1, -1]), ("qvel", [1, -1, 1, -1, 1, -1])):
        count = len(signs)
        image = [state[name][:, :count] * signs, mirror.actions(state[name][:, count:])]
        engine.write(name, np.concatenate(image, axis=1), np.array([1]))
    command = env.command_manager.terms["velocity"].instance
    command.values[:] = [[0.5, 0.4, -0.3], [0.5, -0.4, 0.3]]
    rng = np.random.default_rng(0)
    for _ in range(8):
        action = rng.uniform(-1, 1, (1, 12)).astype(np.float32)
        obs = env.step(torch.from_numpy(np.concatenate([action, mirror.actions(action)])))[0]
        seen = flat(env, obs)
        # The meshes of left and right legs, and their inertias, differ by a tenth of a millimetre.
        image = mirror.observations(seen[0])
        np.testing.assert_allclose(seen[1, :48], image[:48], atol=0.02)
        # The clock of the gait, which both have, is that of the image half a period later.
        np.testing.assert_array_equal(image[48:], -seen[1, 48:])
    assert np.abs(seen[0, :48] - image[:48]).max() > 0.2
    env.close()


@pytest.fixture(scope="module")
def rough():
    """The quadruped on rough ground; environments 1 and 7 are on the same pyramid."""
    steep = "task.scene.terrain.patches.slope_up.slope=[0.4,0.4]"
    level = "task.events.terrain.params.max_init_level=0"
    env = embodichain.make("quadruped_rough", num_envs=8, seed=3, overrides=[*TASK, steep, level])
    yield env.unwrapped
    env.close()


def test_the_image_of_a_height_scan_is_the_scan_at_the_image_of_the_pose(rough):
    """Environment 7 is the image of 1 in the plane y = 0, and so is its pyramid."""
    env, engine, mirror = rough, rough.sim.engine, Mirror.of(rough, "policy")
    env.reset(seed=3)
    both = engine.rows[:, engine.component("qpos")][[1, 7]].copy()
    both[:, :7] = [1.2, 0.7, 0.3, np.cos(0.2), 0, 0, np.sin(0.2)]  # turned by 0.4 rad
    both[1, [1, 6]] *= -1
    both[1, 7:] = mirror.actions(both[0, 7:])
    engine.write("qpos", both, np.array([1, 7]))
    engine.write("qvel", 0.0 * engine.rows[[1, 7], engine.component("qvel")], np.array([1, 7]))
    env.command_manager.terms["velocity"].instance.values[:] = 0.0
    obs = flat(env, env.step(torch.zeros(8, 12))[0])
    image = mirror.observations(obs)
    # Patches are even to half a cell, here 0.05 m x 0.4.
    np.testing.assert_allclose(image[7, 50:], obs[1, 50:], atol=0.04)
    assert np.abs(obs[7, 50:] - obs[1, 50:]).max() > 0.1
    # Six rows along x, of nine points each: the last one is the image of the first.
    np.testing.assert_array_equal(mirror.observations.index[50:59], np.arange(95, 104))
    assert (mirror.observations.sign[50:] == 1).all()


def test_only_a_symmetric_height_scan_has_an_image(rough):
    sensor, rules = rough.cfg.sensors["scan"], rough.cfg.symmetry.observations
    found = wrong(rough, observations={**rules, "lin_vel": "scan"})
    assert found.keys() == {"observations.lin_vel"}
    assert "scan is for observations of a height scan" in found["observations.lin_vel"]
    for name, value, words in (
        ("alignment", "world", "does not turn with the robot"),
        ("pos", (0.1, 0.1, 0.0), "pos[1], quat[1], quat[3] and pattern.grid.direction[1]"),
    ):
        before = getattr(sensor, name)
        setattr(sensor, name, value)
        found = wrong(rough)
        setattr(sensor, name, before)
        assert words in found["observations.scan"]


def test_the_reflection_is_its_own_inverse_and_swaps_legs(mirror):
    rows = np.arange(50, dtype=np.float32)[None]
    np.testing.assert_array_equal(mirror.observations(mirror.observations(rows)), rows)
    # Front left hip, thigh, calf <- front right; hips turn the other way.
    np.testing.assert_array_equal(mirror.actions(rows[:, :12])[0, :6], [-3, 4, 5, 0, 1, 2])
    again = Mirror.from_list(mirror.to_list())
    np.testing.assert_array_equal(again.observations(rows), mirror.observations(rows))


def test_moments_are_those_of_observations_and_their_images():
    columns = Columns(np.array([1, 0, 2]), np.array([1, 1, -1], np.float32))
    found, wanted = MirroredMeanStd(Mirror(columns, columns)), RunningMeanStd(shape=(3,))
    rng = np.random.default_rng(0)
    for count in (5, 9):
        rows = rng.normal([1, 2, 3], [1, 2, 3], (count, 3))
        found.update(rows)
        wanted.update(np.concatenate([rows, columns(rows)]))
    np.testing.assert_allclose(found.mean, wanted.mean, rtol=1e-4, atol=1e-12)
    np.testing.assert_allclose(found.var, wanted.var, rtol=1e-3)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The checkpoint of a short training of a symmetric policy."""
    folder = tmp_path_factory.mktemp("training") / "run"
    folder.mkdir()
    return folder / train(resolve([*TRAIN, "algo.symmetric=true"], "train"), folder).checkpoint


def test_a_trained_policy_has_the_symmetry_in_every_file(trained, quadruped, mirror, tmp_path):
    policy = load_policy(trained, quadruped)
    rows = np.random.default_rng(0).normal(size=(5, 50)).astype(np.float32)
    for acting in (policy, *written(policy, quadruped, tmp_path)):
        done = acting.act(rows)
        np.testing.assert_allclose(
            acting.act(mirror.observations(rows)), mirror.actions(done), atol=1e-4
        )
    network = policy.model.policy
    seen = torch.from_numpy(rows)
    image = torch.from_numpy(mirror.observations(rows))
    with torch.no_grad():
        torch.testing.assert_close(network.predict_values(seen), network.predict_values(image))
        there = network.get_distribution(image).log_prob(torch.from_numpy(mirror.actions(done)))
        torch.testing.assert_close(
            network.get_distribution(seen).log_prob(torch.from_numpy(done)), there
        )
    assert np.abs(done).max() > 0.01


def written(policy, env, folder):
    export_policy(policy, env, folder / "p.pt", "torchscript")
    found = load_exported(folder / "p.pt")
    found.check(env)
    return [found]


def test_the_action_is_the_average_worked_out_from_the_networks(trained, quadruped, mirror):
    network = load_policy(trained, quadruped).model.policy
    rows = torch.randn(3, 50, generator=torch.Generator().manual_seed(0))
    image = torch.from_numpy(mirror.observations(rows.numpy()))

    def mean(x):
        return network.action_net(network.mlp_extractor.policy_net(x)).detach().numpy()

    wanted = 0.5 * (mean(rows) + mirror.actions(mean(image)))
    with torch.no_grad():
        found = network.get_distribution(rows).mode().numpy()
    np.testing.assert_allclose(found, wanted, atol=1e-6)


def wrong(env, **fields):
    before, env.cfg.symmetry = env.cfg.symmetry, dataclasses.replace(env.cfg.symmetry, **fields)
    try:
        with pytest.raises(ConfigError) as caught:
            Mirror.of(env, "policy")
    finally:
        env.cfg.symmetry = before
    return {p.path.removeprefix("task.symmetry."): str(p) for p in caught.value.problems}


def test_every_mistake_is_reported_at_its_place(quadruped):
    good = quadruped.cfg.symmetry
    legs = r"(F|R)L_(.*)"
    found = wrong(quadruped, swap={legs: r"\1X_\2"}, opposite=["hip"])
    assert "has no counterpart 'FX_hip_joint'" in found[f"swap.{legs}"]
    assert "no joint matches 'hip'" in found["opposite"]
    found = wrong(quadruped, swap={legs: r"\1R_\2", r"FR_(.*)": r"FL_\1"})
    assert "'FR_hip_joint' and 'FL_hip_joint' are not a new pair" in found["swap.FR_(.*)"]
    assert r"malformed '\\9'" in wrong(quadruped, swap={legs: r"\9"})[f"swap.{legs}"]
    found = wrong(quadruped, opposite="FL_hip_joint")
    assert "FL_hip_joint, FR_hip_joint" in found["opposite"]
    seen = {**good.observations, "lin_vel": [1, -1], "gravty": [1, -1, 1]}
    del seen["gravity"]
    found = wrong(quadruped, observations=seen, actions={"legs": [1]})
    assert "[1, -1] has 2 columns, the observation has 3" in found["observations.lin_vel"]
    assert "Did you mean 'gravity'?" in found["observations.gravty"]
    assert "joints, scan, or a sign" in found["observations.gravity"]
    assert "which are 3" in found["observations.gravity"]
    assert "robot" in wrong(quadruped, robot="go1")


def test_a_symmetric_policy_needs_a_symmetry_and_an_algorithm_that_can_have_one(tmp_path):
    with pytest.raises(ConfigError, match=r"algo.symmetric: the task declares no symmetry"):
        train(
            resolve(["task=reach", "algo.symmetric=true", "total_timesteps=8"], "train"), tmp_path
        )
    for line in ("algo=sac", "algo=recurrent_ppo", "algo.use_sde=true"):
        config = resolve([*TRAIN[:4], line, "algo.symmetric=true", "total_timesteps=8"], "train")
        with pytest.raises(ConfigError, match=r"algo.symmetric: "):
            train(config, tmp_path)
    assert SymmetryCfg().observations == {}
