"""Evaluations judge at the stage of the curriculum that a training reached, and stay there."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from embodichain.cli import main
from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.cfg import CurriculumCfg, MetricCfg, RewardCfg
from embodichain.learning.checkpoints.curriculum_stage import read_stage
from embodichain.learning.evaluation.evaluation import evaluate
from embodichain.learning.sb3.vec_env import SB3VecEnv
from tests.helpers.local_shards import sharded
from tests.lab.gym.conftest import home, jumping, task
from tests.lab.gym.envs.mdp.test_terrain import levels
from tests.lab.gym.envs.mdp.test_terrain import task as terrain_task

pytestmark = pytest.mark.slow

STAGE = """
max_episode_steps: 5
robot: {uid: cart, fpath: CartPole/cart_pole.urdf, init_pos: [0, 0, 1], drive_pros: {drive_type: none}}
actions:
  push: {func: joint_action, params: {of: {uid: cart, joint_names: [slider_to_cart]}, control: effort}}
observations: {x: {func: joint_position, params: {of: {uid: cart}}}}
rewards: {one: {func: constant}}
metrics:
  success: {func: joint_speed, shape: {above: -1.0}, params: {of: {uid: cart, joint_names: [slider_to_cart]}}}
curriculum:
  last:
    func: modify_term_param
    params: {section: metrics, term_name: success, param: shape.above, value: 1000.0, num_steps: 20}
  more: {func: modify_reward_weight, params: {term_name: one, weight: 3.0, num_steps: 40}}
"""  # noqa: E501  (lines of YAML)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A training of 64 control steps; from its 20th on success is impossible."""
    root = tmp_path_factory.mktemp("stage")
    (root / "task").mkdir()
    (root / "task" / "stage.yaml").write_text(STAGE)
    keys = ["num_envs=2", "total_timesteps=128", "algo.n_steps=16", "algo.batch_size=32", "seed=0"]
    keys += ["eval.episodes=4", f"output_dir={root}/out", "checkpoint.every_steps=32"]
    assert main(["train", "task=stage", "--quiet", f"--config-dir={root}", *keys]) == 0
    return next(path.parent for path in (root / "out").glob("*/*/config.yaml"))


def judged(trained: Path, out: str, *keys: str) -> dict[str, Any]:
    words = ["record=none", f"output_dir={trained.parents[1]}/{out}", *keys]
    conf = f"--config-dir={trained.parents[2]}"
    assert main(["eval", str(trained), conf, "--quiet", *words]) == 0
    found = next((trained.parents[1] / out).glob("*/*/eval.json"))
    data: dict[str, Any] = json.loads(found.read_text())
    return data


@pytest.mark.parametrize("num_envs", [1, 4, 6])
def test_an_evaluation_is_at_the_trainings_stage_for_any_number_of_environments(
    trained: Path, num_envs: int
) -> None:
    found = judged(trained, f"n{num_envs}", f"num_envs={num_envs}", "episodes=6")
    assert found["success"]["count"] == 0
    assert found["returns"]["mean"] == 15.0  # 5 steps, weight 3
    values = {"last": 1000.0, "more": 3.0}
    assert found["curriculum"] == {"control_step": 64, "training": True, "values": values}


def test_the_evaluation_at_the_end_of_a_training_says_the_same(trained: Path) -> None:
    summary = json.loads((trained / "summary.json").read_text())
    assert summary["eval"]["curriculum"]["control_step"] == 64
    assert summary["objective"] == 0.0


def test_a_checkpoint_has_its_own_stage(trained: Path) -> None:
    saved = sorted((trained / "checkpoints").glob("step_*.zip"))
    stages = [read_stage(path) for path in saved]
    steps = [int(path.stem.removeprefix("step_")) for path in saved]
    assert [s["control_step"] for s in stages if s is not None] == [n // 2 for n in steps]
    assert len(list(saved[0].parent.glob("*.curriculum.npz"))) == len(saved) + 2  # final, best


def test_run_is_there_too(trained: Path, capsys: pytest.CaptureFixture[str]) -> None:
    conf = f"--config-dir={trained.parents[2]}"
    keys = ["num_envs=1", "episodes=3", "record=none", f"output_dir={trained.parents[1]}/run"]
    assert main(["run", "task=stage", f"policy={trained}", conf, "--json", *keys]) == 0
    assert json.loads(capsys.readouterr().out)["success_rate"] == 0.0


def test_without_a_stage_the_first_one_is_judged_and_said(
    trained: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    alone = tmp_path / "alone.zip"
    shutil.copyfile(trained / "checkpoints" / "final.zip", alone)
    from embodichain.config import resolve
    from embodichain.config.environments.factory import make_batch

    words = ["task=stage", "num_envs=1"]
    env = make_batch(resolve(words, config_dir=trained.parents[2]))
    found = evaluate(env, alone, 12)  # 60 control steps: three times as many as the first stage has
    env.close()
    assert found.success is not None and found.success.rate == 1.0
    assert found.curriculum == {
        "control_step": 0,
        "training": False,
        "values": {"last": -1.0, "more": 1.0},
    }
    assert "alone.zip has no stage of the curriculum: it stays at control step 0" in caplog.text


def one(env: Any, obs: Any, action: Any, info: Any) -> torch.Tensor:
    return torch.ones(env.num_envs)


def size(env: Any, obs: Any, action: Any, info: Any, value: float = 1.0) -> torch.Tensor:
    return torch.full((env.num_envs,), value)


class Harder:
    """A curriculum of a user's: it counts resets, and sets a weight and a parameter by them."""

    def __init__(self, env: Any) -> None:
        self.resets = np.zeros(1)

    def __call__(self, env: Any, env_ids: Any) -> float:
        self.resets += 1
        env.reward_manager.set_weight("r", float(self.resets[0]))
        env.managers["metrics"].set_params("m", {"value": 10.0 * float(self.resets[0])})
        return float(self.resets[0])

    def state_dict(self) -> dict[str, Any]:
        return {"resets": self.resets.copy()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.resets[...] = state["resets"]


def harder(num_envs: int) -> BaseEnv:
    sections = {
        "rewards": {"r": RewardCfg(func=one)},
        "metrics": {"m": MetricCfg(func=size)},
        "curriculum": {"c": CurriculumCfg(func=Harder)},
    }
    return BaseEnv(task(num_envs=num_envs, max_episode_steps=2, **sections))


def test_terms_of_a_user_are_taken_over_by_weights_parameters_and_state() -> None:
    there, here = harder(3), harder(1)
    there.reset()
    for _ in range(8):
        there.step(home(there))
    stage = there.curriculum_stage()
    here.hold_curriculum(stage)
    here.reset()
    for _ in range(5):
        _, reward, _, _, info = here.step(home(here))
        assert (reward.tolist(), info["metrics"]["m"].tolist()) == ([5.0], [50.0])
        assert info["curriculum"] == {"c": 5.0}
    assert here.curriculum_manager.terms["c"].instance.resets == 5
    here.release_curriculum()
    here.step(home(here))  # ends an episode
    assert here.step(home(here))[1].tolist() == [6.0]
    there.close()
    here.close()


def test_an_evaluation_does_not_advance_the_environment_that_it_is_given() -> None:
    env = harder(2)
    env.reset()
    found = evaluate(env, lambda obs, env: home(env), 10)
    assert found.returns is not None and found.returns.max == found.returns.min == 2.0
    assert not env.curriculum_manager.held
    env.close()


def test_levels_of_a_terrain_are_drawn_from_those_of_the_training() -> None:
    """Columns 0, 1, 2 had levels {0, 2}, {1}, and one that was above the highest: any."""
    cfg = terrain_task(4, curriculum=levels(), max_episode_steps=1)
    env = BaseEnv(cfg)
    state = {"level": np.array([0, 1, 3, 2]), "column": np.array([0, 1, 2, 0])}
    stage = {"control_step": 70, "values": {"level/mean": 1.25}, "names": ["level"]}
    env.hold_curriculum({**stage, "terms": {"level": state}})
    obs, _ = env.reset(seed=0)
    drawn = [obs["level"].reshape(-1).tolist()]
    for _ in range(150):
        obs, *_, info = env.step(torch.zeros(4, 0))
        assert info["curriculum"] == {"level/mean": 1.25}
        drawn.append(obs["level"].reshape(-1).tolist())
    columns = [np.array(column) for column in zip(*drawn, strict=True)]
    assert [sorted({*map(int, column)}) for column in columns] == [[0, 2], [1], [0, 1, 2], [0, 2]]
    # 151 draws of a half: 75 +- 6.
    assert 55 < int((columns[0] == 2).sum()) < 96
    assert columns[0].tolist() != columns[3].tolist()
    env.close()


def later(first: int, count: int) -> BaseEnv:
    """Weight 1, and 7 from the second control step on."""
    change = {"term_name": "r", "weight": 7.0, "num_steps": 2}
    sections = {
        "rewards": {"r": RewardCfg(func=one)},
        "curriculum": {"c": CurriculumCfg("modify_reward_weight", change)},
    }
    cfg = task(num_envs=count, max_episode_steps=2, seed=0, **sections, **jumping())
    cfg.first_env = first
    return BaseEnv(cfg)


def test_shards_and_learners_environments_are_held_too() -> None:
    with sharded(later, 4, 2) as (parts, _):
        found = evaluate(parts, lambda obs, env: home(env), 12)
        assert found.returns is not None and found.returns.max == 2.0
        parts.reset()
        for _ in range(2):
            parts.step(home(parts))
        stage = parts.curriculum_stage()
    assert stage["values"] == {"c": 7.0}
    vec = SB3VecEnv(later(0, 3))
    vec.env_method("hold_curriculum", stage)
    vec.reset()
    assert vec.step(np.zeros((3, 6), np.float32))[1].tolist() == [7.0] * 3
    assert vec.get_attr("curriculum_manager")[0].values == {"c": 7.0}
    vec.close()
