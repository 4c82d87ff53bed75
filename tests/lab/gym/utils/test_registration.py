import gymnasium as gym
import numpy as np
import pytest

from embodichain.lab.gym.envs import BaseEnv
from embodichain.lab.gym.utils import registration
from embodichain.lab.gym.utils.registration import REGISTERED_ENVS, build_env, register_env
from embodichain.lab.gym.vector import NumpyVectorEnv
from embodichain.utils.errors import ConfigError
from tests.lab.gym.conftest import home, task


@pytest.fixture
def uid():
    """An id that is free again after the test."""
    yield "RegistrationTest-v0"
    REGISTERED_ENVS.pop("RegistrationTest-v0", None)
    gym.registry.pop("RegistrationTest-v0", None)


class Registered(BaseEnv):
    def __init__(self, num_envs=1, cfg=None, colour="red", **kwargs):
        self.colour = colour
        super().__init__(cfg=cfg if cfg is not None else task(num_envs=num_envs), **kwargs)


def test_gym_make_returns_the_batched_environment(uid):
    assert register_env(uid)(Registered) is Registered
    env = gym.make(uid, num_envs=4, render_mode="rgb_array")
    try:
        assert isinstance(env.unwrapped, Registered) and env.get_wrapper_attr("num_envs") == 4
        assert str(env.get_wrapper_attr("device")) == "cpu" and env.action_space.shape == (4, 6)
        names = []
        while env is not env.unwrapped:
            names.append(type(env).__name__)
            env = env.env
        assert names == ["OrderEnforcing"]  # no scalar time limit, no checker
        assert env.render_mode == "rgb_array" and env.spec.id == uid
    finally:
        env.close()


def test_gym_make_hands_out_tensors_and_plain_dicts(uid):
    register_env(uid)(Registered)
    env = gym.make(uid, num_envs=2)
    try:
        assert env.unwrapped.metadata["autoreset_mode"] is gym.vector.AutoresetMode.SAME_STEP
        obs, info = env.reset(seed=1)
        assert obs["robot"]["qpos"].shape == (2, 6) and type(info) is dict
        _, reward, terminated, truncated, info = env.step(home(env.unwrapped))
        assert all(x.shape == (2,) for x in (reward, terminated, truncated, info["elapsed_steps"]))
        assert type(info) is dict
    finally:
        env.close()


def test_gym_make_vec_returns_numpy(uid):
    register_env(uid, max_episode_steps=7)(Registered)
    env = gym.make_vec(uid, num_envs=2, autoreset_mode="SAME_STEP", flatten=False)
    assert isinstance(env, NumpyVectorEnv) and env.env.max_episode_steps == 7
    assert env.metadata["autoreset_mode"] is gym.vector.AutoresetMode.SAME_STEP
    obs, _ = env.reset(seed=1)
    assert obs["robot"]["qpos"].shape == (2, 6) and obs["robot"]["qpos"].dtype == np.float32
    env.close()
    env = gym.make_vec(uid, num_envs=2, max_episode_steps=3)
    assert env.env.max_episode_steps == 3 and env.observation_space.shape == (2, 18)
    assert env.metadata["autoreset_mode"] is gym.vector.AutoresetMode.NEXT_STEP
    env.close()


def test_a_registered_limit_is_the_environments_own(uid):
    register_env(uid, max_episode_steps=2)(Registered)
    env = gym.make(uid, num_envs=3)
    env.reset()
    env.step(home(env.unwrapped))
    env.reset(options={"env_ids": [0]})
    truncated = env.step(home(env.unwrapped))[3]
    assert truncated.tolist() == [False, True, True]
    env.close()


def test_defaults_are_handed_over_and_can_be_changed(uid):
    register_env(uid, colour="blue")(Registered)
    for kwargs, colour in (({}, "blue"), ({"colour": "green"}, "green")):
        env = registration.make(uid, **kwargs)
        assert env.colour == colour
        env.close()
    with pytest.raises(TypeError, match="JSON"):
        register_env("Other-v0", colour=object())


def test_a_second_environment_of_the_same_id_is_skipped_with_a_warning(uid, caplog):
    class Second(Registered):
        pass

    register_env(uid)(Registered)
    assert register_env(uid)(Second) is Second
    assert "registered already" in caplog.text and REGISTERED_ENVS[uid].cls is Registered
    caplog.clear()
    register_env(uid, override=True)(Second)
    assert caplog.text == "" and REGISTERED_ENVS[uid].cls is Second
    env = gym.make(uid)
    assert isinstance(env.unwrapped, Second)
    env.close()


def test_build_env_copies_the_config(uid):
    register_env(uid)(Registered)
    cfg = task(num_envs=2)
    env = build_env(uid, cfg)
    assert env.num_envs == 2 and env.cfg is not cfg
    env.cfg.robot.uid = "changed"
    assert cfg.robot.uid == "ur10"
    env.close()


def test_an_unknown_id_lists_what_exists(uid):
    register_env(uid)(Registered)
    with pytest.raises(ConfigError, match=f"Did you mean '{uid}'"):
        registration.make("RegistrationTest-v1")
