"""One signed column is a reward, a metric and a termination; several need a reducer."""

import numpy as np
import pytest
import torch

import embodichain
from embodichain.lab.gym.envs.cfg import MetricCfg, RewardCfg, TerminationCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.judging import put
from tests.helpers.ur10_task import HOME

CUBE = {"of": {"uid": "cube"}}
JOINT = {"of": {"uid": "ur10", "joint_names": ["Joint2"]}}
PLACES = [(-0.7, 3, 9), (0.0, -2, 0.5), (1.5, 0, 9)]


def play(env):
    env.reset()
    put(env, "cube", PLACES)
    return env.step(torch.tensor([HOME]).repeat(3, 1))


def test_a_column_keeps_its_sign(make) -> None:
    along = {**CUBE, "axes": "x"}
    env = make(
        rewards={
            "x": RewardCfg(func="position", weight=2.0, params=along),
            "vx": RewardCfg(func="linear_velocity", params=along),
            "joint": RewardCfg(func="joint_velocity", params=JOINT),
            "third": RewardCfg(func="position", shape={"column": 2}, params=CUBE),
        },
        metrics={"y": MetricCfg(func="position", params={**CUBE, "axes": "y"})},
        terminations={
            "left": TerminationCfg(func="position", shape={"below": -0.5}, params=along),
        },
    )
    _, reward, terminated, _, info = play(env)
    given = info["rewards"]
    np.testing.assert_allclose(given["x"], [-0.7, 0.0, 1.5], atol=1e-3)
    np.testing.assert_allclose(info["metrics"]["y"], [3, -2, 0], atol=1e-3)
    assert terminated.tolist() == [True, False, False]
    total = 2 * given["x"] + given["vx"] + given["joint"] + given["third"]
    np.testing.assert_allclose(reward, total, rtol=1e-6)
    assert given["joint"].abs().max() > 0  # the arm sinks a little under its weight
    qvel = info["final_obs"]["robot"]["qvel"][0, 1]
    np.testing.assert_allclose(given["joint"][0], qvel, rtol=1e-6)


@pytest.mark.parametrize("name", ["Joint2", 1])
def test_a_column_is_picked_by_name_or_number(make, name) -> None:
    cfg = {"func": "joint_velocity", "params": {"of": {"uid": "ur10"}}}
    env = make(rewards={"one": RewardCfg(**cfg, shape={"column": name})})
    info = play(env)[4]
    np.testing.assert_allclose(info["rewards"]["one"], env.robot.get_qvel()[:, 1], rtol=1e-6)
    assert info["rewards"]["one"].abs().max() > 0


@pytest.mark.parametrize(
    ("cfg", "parts"),
    [
        (
            {"func": "position", "params": CUBE},
            [
                "rewards.bad.shape: position has 3 columns; a reward is one number",
                "are x, y, z.",
                "l2",
            ],
        ),
        (
            {"func": "joint_velocity", "params": {"of": {"uid": "ur10"}}},
            ["joint_velocity has 6 columns; a", "They are Joint1, Joint2,", "norm", "{column: 0}"],
        ),
        (
            {"func": "position", "params": CUBE, "shape": {"column": 3}},
            ["rewards.bad.shape.column: there are 3 columns, numbered from 0; got 3"],
        ),
        (
            {
                "func": "joint_velocity",
                "params": {"of": {"uid": "ur10"}},
                "shape": {"column": "Joint9"},
            },
            ["rewards.bad.shape.column.which: no column is called 'Joint9'", "Joint1"],
        ),
    ],
)
def test_several_columns_are_an_error_that_names_them_and_the_reducers(make, cfg, parts) -> None:
    with pytest.raises(ConfigError) as caught:
        make(rewards={"bad": RewardCfg(**cfg)})
    for part in parts:
        assert part in str(caught.value)


def test_run_forward_needs_no_python() -> None:
    params = "{of: {uid: robot}, frame: body, axes: x}"
    forward = f"{{func: linear_velocity, weight: 1.5, params: {params}}}"
    env = embodichain.make(
        "quadruped_velocity", num_envs=2, seed=1, overrides=[f"+task.rewards.forward={forward}"]
    )
    env.reset()
    info = env.step(torch.zeros(2, *env.single_action_space.shape))[4]
    assert info["rewards"]["forward"].shape == (2,)
    env.close()
