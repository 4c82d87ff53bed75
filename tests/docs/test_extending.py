"""docs/extending.md: what each example computes, and that `env` has what the page says."""

import importlib
import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch

import embodichain
from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.managers.terms.registry import KINDS, LEADING, TERMS
from embodichain.lab.gym.policies import resolve_policy

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

PAGE = (Path(__file__).parents[2] / "docs" / "extending.md").read_text(encoding="utf-8")


def block(file: str) -> str:
    found = re.search(rf"^<!-- {file} -->\n```\w+\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    assert found is not None
    return found[1]


@pytest.fixture(scope="module")
def terms(tmp_path_factory: pytest.TempPathFactory):
    """The page's module, and a function that builds its task."""
    root = tmp_path_factory.mktemp("page")
    (root / "my_cart.py").write_text(block("my_cart.py"), encoding="utf-8")
    (root / "task").mkdir()
    (root / "task/my_cart.yaml").write_text(block("conf/task/my_cart.yaml"), encoding="utf-8")
    sys.path.insert(0, str(root))
    made: list[BaseEnv] = []

    def make(num_envs: int = 3, *overrides: str) -> BaseEnv:
        made.append(embodichain.make("my_cart", num_envs, ["seed=1", *overrides], config_dir=root))
        made[-1].reset()
        return made[-1]

    yield importlib.import_module("my_cart"), make
    for env in made:
        env.close()
    sys.path.remove(str(root))
    sys.modules.pop("my_cart")


def test_every_kind_has_its_row_and_its_signature() -> None:
    rows = dict(re.findall(r"^\| (\w+) \| (.*?) \|", PAGE, re.MULTILINE))
    assert {*KINDS, "policy"} <= rows.keys()
    for kind in (*KINDS, "policy"):
        if kind not in ("action", "command") and rows[kind] != "as a reward":
            assert rows[kind] == f"`f({', '.join(LEADING[kind])}, **params)`"
    assert LEADING["termination"] == LEADING["metric"] == LEADING["reward"]


def test_env_has_what_the_page_lists(terms) -> None:
    _, make = terms
    env = make()
    section = PAGE[PAGE.index("## What `env` offers") : PAGE.index("## An example of each")]
    names = re.findall(r"`env\.([\w.]+)", section)
    assert len(names) > 20
    for name in names:
        value = env
        for part in name.split("."):
            assert hasattr(value, part), name
            value = getattr(value, part)
    handle = env.robot
    for name in re.findall(r"`(get_\w+)\(", section):
        assert hasattr(handle, name) or hasattr(env, name), name


def test_the_action_pushes(terms) -> None:
    _, make = terms
    env = make()
    assert env.action_manager.names == ("push/slider_to_cart",)
    env.step(torch.tensor([[0.0], [0.5], [-1.0]]))
    applied = env.sim.engine.state("qfrc_applied")[:, 0]
    np.testing.assert_allclose(applied, [0.0, 5.0, -10.0])


def test_event_and_command_draw_for_the_environments_that_are_meant(terms) -> None:
    _, make = terms
    env = make(3)
    angle = env.robot.get_qpos()[:, 1].clone()
    place = env.command_manager.get_command("place").clone()
    assert (angle.abs() <= 0.05).all()
    assert (place.abs() <= 1.0).all()
    assert len(set(angle.tolist())) == len(set(place[:, 0].tolist())) == 3
    env.reset(options={"reset_ids": [1]})
    changed = env.robot.get_qpos()[:, 1] != angle
    assert changed.tolist() == [False, True, False]
    assert (env.command_manager.get_command("place") != place)[:, 0].tolist() == [
        False,
        True,
        False,
    ]
    more = make(5)  # environment i is the same whatever N is
    assert torch.equal(more.robot.get_qpos()[:3, 1], angle)


def test_observation_reward_and_curriculum(terms) -> None:
    _, make = terms
    env = make(2)
    env.command_manager.values("place")[:] = [[0.5], [-0.25]]
    obs, reward, *_, info = env.step(torch.zeros(2, 1))
    x = env.robot.get_qpos()[:, 0]
    torch.testing.assert_close(obs["to_place"][:, 0], torch.tensor([0.5, -0.25]) - x)
    expected = torch.exp(-torch.tensor([0.5, 0.25]) / 0.5)  # the cart has hardly moved
    torch.testing.assert_close(info["rewards"]["near"], expected, atol=2e-3, rtol=0)
    torch.testing.assert_close(reward, info["rewards"]["near"])
    env.control_step = 500  # half of the way from 1 to 3
    env.reset()
    assert env.reward_manager.weights["near"] == 2.0
    assert env.curriculum_manager.values == {"stricter": 2.0}


def test_termination_and_the_metric_with_a_memory(terms) -> None:
    _, make = terms
    env = make(2)
    env.robot.set_qpos(torch.tensor([[2.39], [2.41]]), [0], target=False)
    env.robot.set_qvel(torch.tensor([[-1.0], [0.5]]), [0], target=False)
    _, _, terminated, _, info = env.step(torch.zeros(2, 1))
    assert terminated.tolist() == [False, True]
    torch.testing.assert_close(
        info["metrics"]["fastest"], torch.tensor([1.0, 0.5]), atol=0.02, rtol=0
    )
    env.robot.set_qvel(torch.zeros(2, 1), [0], target=False)
    metric = env.metric_manager.terms["fastest"].instance
    saved = metric.state_dict()
    info = env.step(torch.zeros(2, 1))[-1]
    assert info["metrics"]["fastest"][0] > 0.98  # of the same episode
    assert info["metrics"]["fastest"][1] < 0.02  # a new one began
    metric.load_state_dict(saved)
    assert torch.equal(metric.state_dict()["most"], saved["most"])


def test_policies(terms) -> None:
    my_cart, make = terms
    env = make(2)
    assert isinstance(my_cart, ModuleType)
    obs = {"to_place": torch.tensor([[0.25], [-3.0]])}
    assert resolve_policy("my_cart:towards")(obs, env).tolist() == [[0.25], [-1.0]]
    strong = resolve_policy({"func": "my_cart:towards", "params": {"gain": 2}})
    assert strong(obs, env).tolist() == [[0.5], [-1.0]]
    patient = resolve_policy({"func": "my_cart:Patient", "params": {"wait": 2}})
    assert [patient(obs, env)[0].item() for _ in range(3)] == [0.0, 0.0, 0.25]
    patient.reset(np.array([1]))
    assert patient(obs, env).tolist() == [[0.25], [0.0]]
    patient.reset(None)
    assert patient(obs, env).tolist() == [[0.0], [0.0]]


def test_the_compiler_reckons_with_the_stiffness_that_the_event_draws(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "my_gains.py").write_text(block("my_gains.py"), encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    largest = []
    for stiffest in (1e4, 8e4):
        params = f"{{of: {{uid: robot}}, stiffness: [1e4, {stiffest:g}]}}"
        term = f"{{func: my_gains:draw_stiffness, mode: reset, params: {params}}}"
        drives = "task.robot.drive_pros={stiffness: 1e4, max_effort: file, armature: null}"
        env = embodichain.make("reach", 2, [drives, f"+task.events.gains={term}"])
        env.reset()
        drawn = env.robot.get_joint_drive()[0]
        assert ((drawn >= 1e4) & (drawn <= stiffest)).all()
        largest.append(max(env.robot.parsed.armature))
        env.close()
    assert largest[1] > largest[0]
    sys.modules.pop("my_gains")
    TERMS["event"].pop("draw_stiffness")
