"""Behaviour cloning: it does what demonstrations do, from state and from images."""

import csv
import functools
import logging

import numpy as np
import pytest

from embodichain.config import make_env, resolve
from embodichain.learning import evaluate, export_policy, load_policy
from embodichain.learning.cloning.chunks import blend
from embodichain.learning.training.train import train
from embodichain.utils.errors import ConfigError
from tests.learning.interrupted import interrupt_and_resume
from tests.learning.recorded import record
from tests.learning.training.test_resume import content, everything

pytestmark = pytest.mark.slow

STEPS = 12
REACH = (
    *("task=reach", f"task.max_episode_steps={STEPS}", "num_envs=8", "sim.num_threads=1"),
    *("seed=1", f"dataset={__file__}", "algo=bc", "algo.chunk_size=3", "algo.batch_size=64"),
    "algo.policy_kwargs={net_arch: [64]}",
)
GAIN = np.random.default_rng(0).normal(size=(3, 6))


def towards(obs):
    """(N, 6) actions of the demonstrator: a function of the way to the goal."""
    return np.tanh(3 * obs["to_goal"] @ GAIN)


def demonstrations(env):
    return record(env, towards, STEPS)


def config(*overrides):
    return resolve([*REACH, *overrides], "train")


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A training of 300 updates, and its log."""
    run = tmp_path_factory.mktemp("bc")
    resolved = config("total_timesteps=19_200", "checkpoint.every_steps=6_400")
    messages = []
    handler = logging.Handler()
    handler.emit = lambda note: messages.append(note.getMessage())
    logging.getLogger("embodichain").addHandler(handler)
    level = logging.getLogger("embodichain").level
    logging.getLogger("embodichain").setLevel(logging.INFO)
    try:
        summary = train(resolved, run, episodes=demonstrations)
    finally:
        logging.getLogger("embodichain").setLevel(level)
        logging.getLogger("embodichain").removeHandler(handler)
    return resolved, run, summary, messages


def rows(run, column):
    with (run / "progress.csv").open(newline="") as stream:
        return [float(row[column]) for row in csv.DictReader(stream) if row[column]]


def test_it_acts_as_the_demonstrator(trained):
    resolved, run, summary, messages = trained
    assert (summary.algo, summary.demonstrations, summary.env_steps) == ("bc", 8, 19_200)
    assert "8 demonstrations of 96 steps to learn from" in messages
    losses = rows(run, "train/validation_loss")
    assert len(losses) == 150 and losses[-1] < 0.2 * losses[0]
    assert len(rows(run, "rollout/ep_rew_mean")) == 3  # before each checkpoint and at the end
    assert summary.episodes == 3 * 8
    env = make_env(resolved)
    try:
        policy = load_policy(run, env)
        obs, _ = env.reset(seed=9)
        wanted = towards({"to_goal": obs["to_goal"].numpy()})
        # Goals that were never seen, of eight demonstrations.
        assert np.corrcoef(policy(obs, env).numpy().ravel(), wanted.ravel())[0, 1] > 0.8
        assert evaluate(env, run, 4).episodes == 4
    finally:
        env.close()


def test_the_last_action_is_not_read_unless_asked_for(trained):
    resolved, run, _, messages = trained
    assert "bc does not read action: algo.ignore=[] would" in messages
    env = make_env(resolved)
    try:
        policy = load_policy(run, env)
        obs = policy.observed(env.reset()[0], env)
        plan, other = policy.plan(obs), obs.copy()
        other[:, -6:] += 3.0
        np.testing.assert_array_equal(policy.plan(other), plan)
        other[:, :6] += 3.0
        assert np.abs(policy.plan(other) - plan).max() > 0.01
    finally:
        env.close()


def test_a_file_without_python_acts_alike_over_an_episode(trained, tmp_path):
    resolved, run, _, _ = trained
    env = make_env(resolved)
    try:
        policy = load_policy(run, env)
        export_policy(policy, env, tmp_path / "policy.onnx", "onnx")
        exported = load_policy(tmp_path / "policy.onnx", env)
        assert exported.metadata.chunk_size == 3
        obs, _ = env.reset(seed=4)
        for one in (policy, exported):
            one.reset(None)
        for step in range(STEPS + 3):  # beyond a reset
            action = policy(obs, env)
            np.testing.assert_allclose(exported(obs, env), action, atol=1e-5, err_msg=str(step))
            obs, _, _, truncated, _ = env.step(action)
            if truncated.any():
                for one in (policy, exported):
                    one.reset(np.flatnonzero(truncated.numpy()))
    finally:
        env.close()


def test_resumed_cloning_equals_uninterrupted(tmp_path):
    here = functools.partial(config, "total_timesteps=1_920", "checkpoint.every_steps=640")
    runs = interrupt_and_resume(here, tmp_path, at=700, episodes=demonstrations)
    np.testing.assert_array_equal(everything(runs.second), everything(runs.whole))
    resumed = here(f"resume={runs.first}")
    with pytest.raises(ConfigError, match="dataset: it has other demonstrations than those"):
        train(resumed, tmp_path, episodes=lambda env: demonstrations(env)[:5])
    train(resumed, runs.first, episodes=demonstrations)
    for path in ("progress.csv", "checkpoints/best.zip"):  # judged at the same moments
        np.testing.assert_equal(content(runs.first / path), content(runs.whole / path))


def test_blend_averages_what_was_predicted_for_the_step():
    draw = np.random.default_rng(2)
    chunks = draw.normal(size=(10, 3, 4, 2)).astype(np.float32)  # steps, environments, H, actions
    starts = np.zeros((10, 3), bool)
    starts[6, 1] = True
    memory = None
    for t in range(10):
        found, memory = blend(chunks[t], memory, starts[t] if t else None, 0.3)
        for i in range(3):
            begun = 6 if i == 1 and t >= 6 else 0
            made = range(max(begun, t - 3), t + 1)  # the oldest first
            weights = np.exp(-0.3 * np.arange(len(made)))
            wanted = np.average([chunks[s, i, t - s] for s in made], axis=0, weights=weights)
            np.testing.assert_allclose(found[i], wanted, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (("dataset=null",), "dataset: bc learns from demonstrations: dataset=FOLDER"),
        (
            ("algo=ppo", "~algo.chunk_size"),
            "dataset: ppo learns from its own steps alone; these take",
        ),
        (("dataset=nowhere",), "dataset: there is no file or folder 'nowhere'"),
        (
            ("algo.ignore=[qpo]",),
            "algo.ignore: there is no observation 'qpo'; there are: qpos, ",
        ),
        (("algo.ignore=[qpos,qvel,to_goal,action]",), "algo.ignore: no observation remains"),
        (("algo.critic_groups=[policy]",), "algo.critic_groups: "),
        (("algo.policy_kwargs={chunk_size: 2}",), "chunk_size: cannot be set here: use algo.chunk"),
        (("algo.validation_share=0.01",), "algo.validation_share: 0.01 of 8 episodes leaves none"),
    ],
)
def test_mistakes(tmp_path, overrides, message):
    with pytest.raises(ConfigError) as caught:
        train(config("total_timesteps=640", *overrides), tmp_path, episodes=demonstrations)
    assert message in str(caught.value)
    assert not (tmp_path / "summary.json").exists()


def test_demonstrations_of_another_task(tmp_path):
    def cut(env):
        found = demonstrations(env)
        for one in found:
            del one.observations["qvel"]
        return found

    def narrow(env):
        found = demonstrations(env)
        for one in found:
            one.actions = one.actions[:, :4]
        return found

    for episodes, message in (
        (cut, "dataset: its episodes are not of this task: no observation 'qvel', there are: qpos"),
        (narrow, "dataset: its episodes are not of this task: actions (4,) instead of (6,)"),
        (lambda env: [], "dataset: it has no successful episode"),
    ):
        with pytest.raises(ConfigError) as caught:
            train(config("total_timesteps=640"), tmp_path, episodes=episodes)
        assert message in str(caught.value)
