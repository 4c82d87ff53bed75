"""`encoder_bias`: one error a joint and environment, in what is observed and in the targets."""

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import ActionTermCfg, EventCfg, ObservationCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.ur10_task import HOME

ARM = {"entity_cfg": {"uid": "ur10"}}
SOME = {"entity_cfg": {"uid": "ur10", "joint_names": ["Joint[12]"]}}


def bias_of(env) -> np.ndarray:
    return env.robot.drives.encoder_bias.copy()


def test_encoders_differ_between_environments_and_joints(make) -> None:
    """mjlab's dr.encoder_bias: joint_pos_biased = joint_pos + bias, target = action - bias."""
    drawn = EventCfg(
        func="encoder_bias", mode="startup", params={**SOME, "bias_range": [-0.02, 0.01]}
    )
    observed = {
        "read": ObservationCfg(
            func="joint_position_relative", mode="add", params={**ARM, "biased": True}
        ),
        "true": ObservationCfg(func="joint_position_relative", mode="add", params=ARM),
    }
    act = ActionTermCfg(func="joint_action", params={**ARM, "centre": "home", "scale": 0.1})
    env = make(num_envs=64, events={"bias": drawn}, observations=observed, actions={"arm": act})
    obs, _ = env.reset()
    bias = bias_of(env)
    assert len(np.unique(bias[:, :2])) == 128 and not bias[:, 2:].any()
    assert bias[:, :2].min() >= -0.02 and bias[:, :2].max() <= 0.01
    assert abs(bias[:, :2].mean() + 0.005) < 4 * 0.03 / np.sqrt(12 * 128)
    assert np.allclose((obs["read"] - obs["true"]).numpy(), bias, atol=1e-6)
    env.step(torch.full((64, 6), 0.5))
    targets = env.robot.drives.read_target_qpos()
    assert np.allclose(targets, np.array(HOME) + 0.05 - bias, atol=1e-7)
    env.reset()
    assert np.array_equal(bias_of(env), bias)  # drawn at startup only


def test_it_is_saved_with_the_state(make) -> None:
    drawn = EventCfg(func="encoder_bias", mode="reset", params={**ARM, "bias_range": [-0.1, 0.1]})
    env = make(events={"bias": drawn})
    env.reset()
    saved, bias = env.state_dict(), bias_of(env)
    env.reset()
    assert not np.array_equal(bias_of(env), bias)
    env.load_state_dict(saved)
    assert np.array_equal(bias_of(env), bias)


def test_what_has_no_joints_is_refused(make) -> None:
    params = {"entity_cfg": {"uid": "cube"}, "bias_range": [0, 0.1]}
    with pytest.raises(ConfigError, match="'cube' has no joints"):
        make(events={"bias": EventCfg(func="encoder_bias", params=params)})
