"""A training whose networks are not finite says so, and keeps its last good checkpoint."""

import json

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO

from embodichain.cli import main
from embodichain.config import resolve
from embodichain.learning.policies.policy import load_model
from embodichain.learning.training.finite import NotFiniteError, check_finite, told_apart
from embodichain.learning.training.train import train

pytestmark = pytest.mark.slow

REACH = ("task=reach", "num_envs=4", "seed=1", "task.max_episode_steps=7", "eval.episodes=0")
ALGORITHMS = {
    "ppo": (("algo.n_steps=8", "algo.batch_size=16"), "update 1, after 32"),
    "a2c": (("algo=a2c", "algo.n_steps=8"), "update 1, after 32"),
    "sac": (
        ("algo=sac", "algo.learning_starts=8", "algo.batch_size=8"),
        "after 12 environment steps",
    ),
    "rsl_rl_ppo": (("algo=rsl_rl_ppo", "algo.num_steps_per_env=8"), "update 1, after 32"),
    "skrl_ppo": (("algo=skrl_ppo", "algo.rollouts=8"), "update 1, after 32"),
}


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_rate_that_is_far_too_large_is_named(algorithm, tmp_path, capsys):
    keys, when = ALGORITHMS[algorithm]
    line = [*REACH, *keys, "total_timesteps=256", "algo.learning_rate=1e20", "--quiet"]
    assert main(["train", *line, f"output_dir={tmp_path}"]) == 1
    said = capsys.readouterr().err
    assert "finite in " in said and when in said and "(algo.learning_rate)" in said
    assert "1e+20" in said
    summary = json.loads(next(tmp_path.glob("*/*/summary.json")).read_text())
    assert summary["status"] == "failed" and when in summary["error"]
    assert not list(tmp_path.rglob("*.zip"))


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_a_training_without_a_valid_step_ends(algorithm, tmp_path, capsys):
    """A reward that is always NaN: there is nothing to learn from."""
    (tmp_path / "bad_reward.py").write_text(
        "import torch\n\n\ndef bad(env, obs, action, info):\n"
        "    return torch.full((env.num_envs,), float('nan'))\n"
    )
    keys, _ = ALGORITHMS[algorithm]
    reward = "+task.rewards.bad={func: 'bad_reward:bad', weight: 1}"
    line = [*REACH, *keys, "total_timesteps=256", reward, "--quiet"]
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(tmp_path)
        assert main(["train", *line, f"output_dir={tmp_path}"]) == 1
    said = capsys.readouterr().err
    assert "error: no step of any environment was valid in 10 control steps in a row" in said
    assert "(task.rewards.bad not finite), after 40 environment steps" in said
    summary = json.loads(next(tmp_path.glob("*/*/summary.json")).read_text())
    assert summary["status"] == "failed" and "in a row" in summary["error"]


def test_checkpoints_of_before_stay(tmp_path, monkeypatch):
    """The third update spoils one weight: what the second made stays, and nothing else does."""
    learn, calls = PPO.train, []

    def spoiled(model):
        learn(model)
        calls.append(model.num_timesteps)
        if len(calls) == 3:
            with torch.no_grad():
                next(model.policy.parameters()).view(-1)[0] = float("inf")

    # No setting makes a network infinite in a certain update.
    monkeypatch.setattr(PPO, "train", spoiled)
    keys = ("algo.n_steps=8", "algo.batch_size=16", "total_timesteps=256")
    resolved = resolve([*REACH, *keys, "checkpoint.every_steps=32"], "train")
    with pytest.raises(NotFiniteError, match=r"networks .* in update 3, after 96 environment"):
        train(resolved, tmp_path)
    assert calls == [32, 64, 96]
    zips = sorted(path.name for path in (tmp_path / "checkpoints").glob("step_*.zip"))
    assert zips == ["step_000000000032.zip", "step_000000000064.zip"]
    for path in (tmp_path / "checkpoints").glob("*.zip"):
        weights = [p.detach().numpy() for p in load_model(path).model.policy.parameters()]
        assert all(np.isfinite(w).all() for w in weights), path


class Training:
    """What `check_finite` looks at."""

    env_steps, updates = 4096, 2

    def __init__(self, value, losses=None):
        self._value, self._losses = value, losses or {}

    def parameters(self):
        return [torch.ones(3), torch.tensor([0.0, self._value])]

    def losses(self):
        return self._losses


def test_what_is_finite():
    check_finite(Training(1.0, {"loss": -3.0, "explained_variance": float("nan")}))
    check_finite(Training(1e17))
    with pytest.raises(NotFiniteError, match=r"weights of 1e\+20, .* not finite in update 2"):
        check_finite(Training(-1e20))  # its square is not
    with pytest.raises(NotFiniteError, match="the networks are not finite in update 2"):
        check_finite(Training(float("nan")))
    losses = {"value_loss": float("inf"), "policy_gradient_loss": 0.1}
    with pytest.raises(NotFiniteError, match=r"^value_loss is not finite in update 2, after 4,096"):
        check_finite(Training(1.0, losses))


def test_other_errors_stay():
    with pytest.raises(ValueError, match="something else"), told_apart(Training(1.0)):
        raise ValueError("something else")
    with pytest.raises(NotFiniteError), told_apart(Training(float("inf"))):
        raise RuntimeError("something else")
