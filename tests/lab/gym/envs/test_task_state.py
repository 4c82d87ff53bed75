"""`compute_task_state`: task classes of EmbodiChain's say there who succeeds and who fails."""

import pytest
import torch

from embodichain.lab.gym.envs import BaseEnv
from embodichain.lab.gym.envs.cfg import MetricCfg, RewardCfg, TerminationCfg
from embodichain.learning.evaluation.evaluation import evaluate
from embodichain.learning.sb3.vec_env import SB3VecEnv
from tests.lab.gym.conftest import home, jumping


class Judged(BaseEnv):
    """Environment 0 succeeds in its second step, environment 1 fails in its third."""

    def compute_task_state(self, **kwargs):
        steps, index = self._elapsed_steps, torch.arange(self.num_envs)
        success = (index == 0) & (steps == 1)
        fail = (index == 1) & (steps == 2)
        self.shared = getattr(self, "shared", torch.zeros(self.num_envs))
        self.shared[:] = steps  # reused: what was handed out must stay
        return success, fail, {"count": self.shared}


def test_it_ends_episodes_and_reports_metrics(make_env):
    env = make_env(cls=Judged, rewards={"bonus": RewardCfg(func="success_reward", weight=10.0)})
    env.reset()
    first = env.step(home(env))
    assert not first[2].any() and first[4]["metrics"]["count"].tolist() == [0, 0, 0]
    _, reward, terminated, _, info = env.step(home(env))
    assert terminated.tolist() == [True, False, False]
    assert reward.tolist() == [10.0, 0.0, 0.0]
    assert info["success"].tolist() == [True, False, False]
    assert info["final_info"]["metrics"]["count"].tolist() == [1, 1, 1]
    assert first[4]["metrics"]["count"].tolist() == [0, 0, 0]
    _, _, terminated, _, info = env.step(home(env))
    assert terminated.tolist() == [False, True, False] and info["fail"].tolist() == [
        False,
        True,
        False,
    ]


def test_declared_judges_are_added(make_env):
    late = {"late": TerminationCfg(func=lambda env, obs, a, info: info["metrics"]["count"] > 2)}
    still = {"still": MetricCfg(func=lambda env, obs, a, info: torch.ones(env.num_envs))}
    env = make_env(cls=Judged, terminations=late, metrics=still)
    env.reset()
    for _ in range(3):
        env.step(home(env))
    _, _, terminated, _, info = env.step(home(env))
    assert terminated.tolist() == [True, False, True]  # the first is in its second step again
    assert set(info["metrics"]) == {"count", "still"}


def test_evaluate_goes_over_it(make_env):
    class Both(Judged):
        def evaluate(self, **kwargs):
            return {"success": torch.tensor([False, False, True]), "more": torch.ones(3)}

    env = make_env(cls=Both)
    env.reset()
    _, _, terminated, _, info = env.step(home(env))
    assert terminated.tolist() == [False, False, True]
    assert {"more", "metrics"} <= set(info)


def test_learners_count_its_successes(make_env):
    env = make_env(cls=Judged, max_episode_steps=4)
    result = evaluate(env, lambda obs, env: home(env), episodes=3)
    assert result.success.rate == pytest.approx(1 / 3)
    vec = SB3VecEnv(make_env(cls=Judged, max_episode_steps=4, **jumping()))
    vec.reset()
    ends = []
    for _ in range(4):
        _, _, dones, infos = vec.step(vec.action_space.sample()[None].repeat(3, 0))
        ends += [(i, infos[i]["is_success"]) for i in range(3) if dones[i]]
    assert (0, True) in ends and (1, False) in ends


@pytest.mark.parametrize(
    ("state", "error", "words"),
    [
        ((torch.zeros(3), torch.zeros(3)), TypeError, "must return .success, fail, metrics."),
        ((torch.zeros(2), torch.zeros(3), {}), ValueError, r"success must have shape \(3,\)"),
        (
            (torch.zeros(3), torch.zeros(3), {"far": torch.zeros(3, 1)}),
            ValueError,
            r"metric 'far' must be \(3,\), got \(3, 1\)",
        ),
    ],
)
def test_what_it_returns_is_checked(make_env, state, error, words):
    class Wrong(BaseEnv):
        def compute_task_state(self, **kwargs):
            return state

    env = make_env(cls=Wrong)
    with pytest.raises(error, match=words):
        env.reset()
        env.step(home(env))


def test_what_tasks_hand_around(make_env):
    env = make_env()
    assert env.affordance_datas == {} and env.get_affordance("grasp", 1) == 1
    env.set_affordance("grasp", torch.eye(4))
    assert torch.equal(env.affordance_datas["grasp"], torch.eye(4))
    assert make_env().affordance_datas == {}
    assert (env.rollout_buffer, env.current_rollout_step, env.action_bank) == (None, 0, None)
