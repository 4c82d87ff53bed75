"""One meaning of success: a task's metric `success` above 0, else a termination of that kind."""

import gymnasium as gym
import numpy as np
import pytest
import torch

import embodichain
import embodichain.recording as recording
from embodichain.lab.gym.envs import BaseEnv
from embodichain.lab.gym.envs.cfg import MetricCfg, RewardCfg, TerminationCfg
from embodichain.learning.evaluation.evaluation import evaluate
from embodichain.learning.sb3.vec_env import SB3VecEnv
from embodichain.recording import McapRecorder
from tests.lab.gym.conftest import home, jumping


def odd(env, obs, action, info):
    """1 in every second step, from the second: of environment 1, in no step."""
    count = torch.as_tensor(env.episodes.elapsed)
    return ((count % 2 == 0) & (torch.arange(env.num_envs) != 1)).float()


def third(env, obs, action, info):
    """Whether it is the third step."""
    return torch.as_tensor(env.episodes.elapsed) == 3


METRIC = {"success": MetricCfg(func=odd, reduce="mean")}
FALLEN = {"fallen": TerminationCfg(func=third, kind="fail")}


def steps(env, count):
    env.reset()
    found = []
    for _ in range(count):
        found.append(env.step(home(env)))
    return found


def test_the_metric_is_success_and_ends_no_episode(make_env):
    env = make_env(metrics=METRIC, max_episode_steps=10)
    told = steps(env, 4)
    shares = [[0, 0, 0], [1 / 2, 0, 1 / 2], [1 / 3, 0, 1 / 3], [1 / 2, 0, 1 / 2]]
    for (_, _, terminated, truncated, info), share in zip(told, shares, strict=True):
        assert info["metrics"]["success"].tolist() == pytest.approx(share)
        assert info["success"].dtype == torch.bool
        assert info["success"].tolist() == [value > 0 for value in share]
        assert not (terminated.any() or truncated.any() or info["success_terminated"].any())
    assert env.is_task_success().tolist() == [True, False, True]


def test_a_failure_with_the_metric_set_is_a_success_that_failed_by_its_end(make_env, tmp_path):
    """The cause of an end and the success of the episode are two things, and stay apart."""
    rewards = {
        "end": RewardCfg(func="is_terminated", weight=-1.0),
        "alive": RewardCfg(func="is_alive", weight=1.0),
        "bonus": RewardCfg(func="success_reward", weight=10.0),
    }
    env = make_env(metrics=METRIC, terminations=FALLEN, rewards=rewards)
    env.add_observer(McapRecorder(tmp_path / "run.mcap", env))
    told = steps(env, 3)
    assert [reward.tolist() for _, reward, *_ in told] == [[1, 1, 1], [11, 1, 11], [9, -1, 9]]
    assert told[2][2].all() and told[2][4]["fail"].all()
    env.close()
    with recording.open(tmp_path / "run.mcap") as log:
        ended = [e for e in log.episodes if e.terminated]
    assert [e.success for e in ended] == [True, False, True]
    assert {e.reasons for e in ended} == {("fallen", "fail")}
    vec = SB3VecEnv(make_env(metrics=METRIC, terminations=FALLEN, **jumping()))
    vec.reset()
    for _ in range(3):
        infos = vec.step(np.zeros((3, vec.action_space.shape[0]), np.float32))[3]
    assert [i["is_success"] for i in infos] == [True, False, True]
    assert {i["ended_by"] for i in infos} == {"fail"}
    result = evaluate(make_env(metrics=METRIC, terminations=FALLEN), lambda obs, env: home(env), 3)
    assert result.per_episode["success"] == [True, False, True]


def test_the_metric_wins_over_a_termination_of_kind_success(make_env, tmp_path):
    never = {"success": MetricCfg(func="constant", params={"value": -1.0})}
    there = {"there": TerminationCfg(func=third, kind="success")}
    env = make_env(metrics=never, terminations=there)
    env.add_observer(McapRecorder(tmp_path / "run.mcap", env))
    *_, terminated, _, info = steps(env, 3)[-1]
    assert terminated.all() and info["success_terminated"].all() and not info["success"].any()
    env.close()
    with recording.open(tmp_path / "run.mcap") as log:
        ended = [e for e in log.episodes if e.terminated]
    assert {(e.success, e.reasons) for e in ended} == {(False, ("there", "success"))}


def test_without_the_metric_it_is_the_termination(make_env, tmp_path):
    there = {"there": TerminationCfg(func=third, kind="success")}
    env = make_env(terminations=there)
    told = steps(env, 3)
    assert [info["success"].tolist() for *_, info in told] == [[False] * 3, [False] * 3, [True] * 3]


def test_a_metric_of_a_class_is_success_too(make_env):
    class Judged(BaseEnv):
        def compute_task_state(self, **kwargs):
            ends = self._elapsed_steps == 1
            share = torch.tensor([0.25, 0.0, float("nan")])
            return ends, torch.zeros(3), {"success": share}

    told = steps(make_env(cls=Judged), 2)
    assert [info["success"].tolist() for *_, info in told] == [[True, False, False]] * 2
    assert told[1][2].all()  # by the class's success, which still ends episodes


def test_a_task_without_success_has_none_in_its_log(make_env, tmp_path):
    env = make_env(terminations=FALLEN)
    assert not env.judges_success
    env.add_observer(McapRecorder(tmp_path / "run.mcap", env))
    steps(env, 3)
    env.close()
    with recording.open(tmp_path / "run.mcap") as log:
        assert {e.success for e in log.episodes} == {None}


@pytest.mark.parametrize(("below", "reached"), [(100.0, True), (1e-9, False)])
def test_single_environments_tell_it_by_the_name_that_others_read(below, reached):
    override = f"task.metrics.success.shape.below={below}"
    env = gym.make("embodichain/reach-v0", overrides=[override])
    env.reset(seed=0)
    info = env.step(env.action_space.sample())[4]
    assert info["is_success"] is info["success"] is reached
    env.close()
    env = gym.make("embodichain/reach-v0", overrides=["~task.metrics.success"])
    env.reset(seed=0)
    assert "is_success" not in env.step(env.action_space.sample())[4]
    env.close()


def test_shipped_pick_place_says_the_same_in_both():
    from embodichain.lab.gym.policies import resolve_policy

    env = embodichain.make("pick_place", num_envs=2, overrides=["seed=1"])
    obs, _ = env.reset()
    policy = resolve_policy("expert")
    for _ in range(200):
        obs, *_, info = env.step(policy(obs, env))
        assert torch.equal(info["success"], info["metrics"]["success"] > 0)
    assert info["success"].all()
    env.close()
