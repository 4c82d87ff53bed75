"""What Python says of wrong names: no command line, and which names there are."""

import copy
import pickle

import gymnasium as gym
import pytest

import embodichain
from embodichain.utils.errors import ConfigError
from embodichain.utils.named import Named

WRONG_CALLS = [
    ({"task": "cart_pol"}, "task: unknown option 'cart_pol'"),
    ({"task": "cart_pole", "num_envs": -1}, "num_envs: must be at least 1"),
    ({"task": "cart_pole", "overrides": ["tsk=1"]}, "tsk: unknown key"),
    ({"task": "cart_pole", "overrides": ["a b="]}, "malformed override"),
    ({"task": "cart_pole", "overrides": ["task.rewards.aliv.weight=2"]}, "there is no 'aliv'"),
]


@pytest.mark.parametrize(("arguments", "part"), WRONG_CALLS)
def test_there_is_no_command_line_in_python(arguments: dict[str, object], part: str) -> None:
    with pytest.raises(ConfigError) as caught:
        embodichain.make(**arguments)  # type: ignore[arg-type]
    text = str(caught.value)
    assert text.startswith("embodichain.make: ")
    assert part in text
    assert "command line" not in text


def test_gymnasium_says_the_same() -> None:
    with pytest.raises(ConfigError, match=r"^embodichain\.make: tsk: unknown key"):
        gym.make("embodichain/cart_pole-v0", overrides=["tsk=1"])


def test_a_mistake_found_by_building_is_in_the_call() -> None:
    with pytest.raises(ConfigError) as caught:
        embodichain.make("cart_pole", overrides=["task.robot.fpath=no_such_file.xml"])
    assert "command line" not in str(caught.value)


def test_a_wrong_name_is_answered_with_those_that_exist() -> None:
    env = embodichain.make("lift_cube", num_envs=1)
    try:
        obs, _ = env.reset()
        with pytest.raises(KeyError, match="no rigid object 'cub'; .*: cube, goal. Did you mean"):
            env.sim.rigid_objects["cub"]
        with pytest.raises(KeyError, match="no sensor 'fingrs'; there are: fingers"):
            env.sim.sensors["fingrs"]
        with pytest.raises(KeyError, match="no robot 'r2'; there are: robot"):
            env.sim.robots["r2"]
        with pytest.raises(KeyError, match="no control part 'arms'; there are: arm, "):
            env.robot.control_parts["arms"]
        with pytest.raises(KeyError, match="no reward 'crry'; .*Did you mean 'carry'"):
            env.reward_manager.set_weight("crry", 1.0)
        with pytest.raises(KeyError, match="no observation 'qpso'; .*Did you mean 'qpos'"):
            env.observation_manager.terms["qpso"]
        with pytest.raises(KeyError, match="no command 'speed'; there are: none"):
            env.command_manager.get_command("speed")
        with pytest.raises(KeyError, match="no entry 'qpso'; .*Did you mean 'qpos'"):
            obs["robot", "qpso"]
        assert env.sim.get_rigid_object("cub") is None  # as in EmbodiChain
        _, _, _, _, info = env.step(env.action_space.sample() * 0)
        with pytest.raises(KeyError, match="no term 'crry'; .*Did you mean 'carry'"):
            info["rewards"]["crry"]
    finally:
        env.close()


def test_named_is_a_dict() -> None:
    named = Named("robot", {"a": 1})
    assert named == {"a": 1}
    assert named.get("b") is None
    for twin in (copy.deepcopy(named), pickle.loads(pickle.dumps(named))):
        assert twin == named and twin.noun == "robot"
