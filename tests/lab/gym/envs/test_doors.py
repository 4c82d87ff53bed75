"""What an environment says after `close`, in a forked process, and when it is copied."""

import copy
import inspect
import os
import pickle
import signal
import subprocess
import sys

import cloudpickle
import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.error import ClosedEnvironmentError

import embodichain
from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.observers import StepObserver
from embodichain.learning import SB3VecEnv
from embodichain.utils.errors import ConfigError
from tests.helpers.local_shards import sharded

THREADS = ["sim.num_threads=2"]


def cart_pole(num_envs=2, **kwargs):
    return embodichain.make("cart_pole", num_envs=num_envs, overrides=THREADS, **kwargs)


def torch_batch():
    env = cart_pole(render_mode="rgb_array")
    return env, torch.zeros(2, 1), env


def single():
    env = gym.make("embodichain/cart_pole-v0", render_mode="rgb_array")
    return env, np.zeros(1, np.float32), env.unwrapped.env


def vector():
    env = gym.make_vec("embodichain/cart_pole-v0", num_envs=2, render_mode="rgb_array")
    return env, np.zeros((2, 1), np.float32), env.unwrapped.env


def stable_baselines3():
    env = SB3VecEnv(cart_pole(render_mode="rgb_array"))
    return env, np.zeros((2, 1), np.float32), env.base


DOORS = [torch_batch, single, vector, stable_baselines3]


@pytest.mark.parametrize("door", DOORS)
def test_a_closed_environment_says_so(door):
    env, action, batch = door()
    env.reset()
    state = batch.state_dict()
    observer = StepObserver()
    batch.add_observer(observer)
    env.close()
    env.close()
    assert batch.is_closed
    uses = [
        lambda: env.step(action),
        lambda: env.reset(),
        lambda: batch.step(torch.zeros(batch.num_envs, 1)),
        lambda: batch.reset(seed=1),
        lambda: batch.render(),
        lambda: batch.state_dict(),
        lambda: batch.load_state_dict(state),
        lambda: batch.restore(None),
        lambda: batch.reseed(1, startup=False),
        lambda: batch.scene_entity({"uid": "cart"}),
        lambda: batch.add_observer(object()),
        lambda: batch.hold_curriculum(),
        lambda: batch.truncate([0]),
        lambda: batch.get_obs(),
        lambda: batch.remove_observer(observer),
        lambda: batch.log_event("push", "interval", None),
        lambda: batch.add_detached_uids_for_reset(["cart"]),
        lambda: setattr(batch, "max_episode_steps", 9),
        lambda: setattr(batch, "elapsed_steps", torch.zeros(batch.num_envs)),
        lambda: batch.revision,
    ]
    if env.render_mode == "rgb_array":  # else it warns that it draws nothing
        uses.append(env.render)
    for use in uses:
        with pytest.raises(ClosedEnvironmentError, match="the environment was closed"):
            use()
    # Numbers that do not need the simulation stay.
    assert batch.elapsed_steps.tolist() == [0] * batch.num_envs
    assert batch.curriculum_stage()["control_step"] == 0


NEED_NOTHING = {
    "close",
    "add_camera_group_id",  # has no effect
    "get_sensor",
    "set_affordance",
    "get_affordance",
    "is_task_success",
    "curriculum_stage",
    "rand",
    "randn",
    "read_last_action",
    "read_elapsed_steps",
    # Hooks of a subclass.
    "get_info",
    "compute_task_state",
    "evaluate",
    "get_reward",
    "check_truncated",
}
"""Methods that work after `close`."""


def test_every_method_works_after_close_or_says_so():
    env = cart_pole()
    obs, info = env.reset()
    action = torch.zeros(2, 1)
    arguments = {
        "step": (action,),
        "step_arrays": (action,),
        "reseed": (1,),
        "restore": (None,),
        "load_state_dict": ({},),
        "scene_entity": ({"uid": "cart"},),
        "add_observer": (StepObserver(),),
        "remove_observer": (StepObserver(),),
        "log_event": ("push", "reset", None),
        "truncate": ([0],),
        "add_detached_uids_for_reset": (["cart"],),
        "get_sensor": ("camera",),
        "rand": ("mine",),
        "randn": ("mine",),
        "get_reward": (obs, action, info),
        "check_truncated": (obs, info),
        "set_affordance": ("grasp", 1),
        "get_affordance": ("grasp",),
        "add_camera_group_id": (1,),
    }
    env.close()
    names = [
        name
        for name, value in vars(BaseEnv).items()
        if inspect.isfunction(value) and not name.startswith("_")
    ]
    assert {"truncate", "step", "reset"} <= set(names)
    for name in names:
        options = {"startup": False} if name == "reseed" else {}
        try:
            getattr(env, name)(*arguments.get(name, ()), **options)
        except ClosedEnvironmentError:
            assert name not in NEED_NOTHING
        except ConfigError:
            assert name == "get_sensor"  # there is none of this name
        else:
            assert name in NEED_NOTHING, name


def test_a_closed_batch_in_shards_says_so():
    def build(first, count):
        lines = [f"sim.first_env={first}", "sim.num_threads=1"]
        return embodichain.make("cart_pole", num_envs=count, seed=1, overrides=lines)

    with sharded(build, 4, 2) as (env, _):
        env.reset()
        with pytest.raises(TypeError, match="BaseEnv cannot be copied or pickled"):
            copy.deepcopy(env)
        state = env.state_dict()
        env.close()
        for use in (
            lambda: env.step(torch.zeros(4, 1)),
            lambda: env.reset(seed=1),
            lambda: env.render(),
            lambda: env.state_dict(),
            lambda: env.load_state_dict(state),
            lambda: env.hold_curriculum(),
        ):
            with pytest.raises(ClosedEnvironmentError, match="the environment was closed"):
                use()


@pytest.mark.parametrize("door", DOORS)
def test_a_copy_is_refused_with_what_to_do_instead(door):
    env, _, batch = door()
    env.reset()
    for attempt in (copy.deepcopy, pickle.dumps, cloudpickle.dumps):
        with pytest.raises(TypeError, match=r"BaseEnv cannot be copied or pickled.*state_dict\(\)"):
            attempt(env)
    for part in (batch.sim, batch.sim.engine):
        with pytest.raises(TypeError, match="cannot be copied or pickled"):
            copy.deepcopy(part)
    with pytest.raises(TypeError, match="cannot be copied or pickled"):
        copy.copy(batch)
    env.close()


def in_fork(act):
    """What a forked process's attempt raises, and how the process ends; -14 if it hangs."""
    read, write = os.pipe()
    child = os.fork()
    if not child:
        signal.alarm(20)
        try:
            act()
            os.write(write, b"nothing")
        except Exception as error:  # noqa: BLE001  (sent to the parent)
            os.write(write, str(error).encode())
        finally:
            os._exit(0)
    os.close(write)
    with os.fdopen(read) as said:
        text = said.read()
    return text, os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_forked_process_gets_a_sentence_where_threads_are_missing():
    env = cart_pole()
    env.reset(seed=1)
    action = torch.zeros(2, 1)
    env.step(action)

    def own():
        other = cart_pole()
        other.reset(seed=1)
        other.step(action)
        other.close()

    for act in (
        lambda: env.step(action),
        lambda: env.reset(seed=1),
        lambda: env.sim.update(),
    ):
        text, status = in_fork(act)
        assert "this process was forked" in text and "spawn" in text
        assert status == 0
    for act in (env.close, own):
        assert in_fork(act) == ("nothing", 0)
    one = embodichain.make("cart_pole", num_envs=1)  # one environment has no threads
    one.reset()
    assert in_fork(lambda: one.step(torch.zeros(1, 1))) == ("nothing", 0)
    again = cart_pole()
    again.reset(seed=1)
    again.step(action)
    torch.testing.assert_close(
        env.step(action)[0]["robot"]["qpos"], again.step(action)[0]["robot"]["qpos"], rtol=0, atol=0
    )


FORKS_AND_ENDS = """
import os, sys, embodichain
env = embodichain.make("cart_pole", num_envs=2, overrides=["sim.num_threads=2"])
env.reset()
child = os.fork()
if not child:
    sys.exit(3)  # frees everything
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_forked_process_ends_by_itself():
    done = subprocess.run(
        [sys.executable, "-c", FORKS_AND_ENDS], capture_output=True, text=True, timeout=120
    )
    assert done.stdout == "3\n", done.stderr
