"""Environments in one process do not touch each other, and leave nothing behind when closed."""

import gc
import json
import os
import platform
import subprocess
import sys
import weakref
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from embodichain.lab.gym.envs.cfg import CommandCfg, CurriculumCfg, NoiseCfg, ObservationCfg
from tests.lab.gym.conftest import flat, jumping, targets, task

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

ROBOT = {"entity_cfg": {"uid": "ur10"}}


def one(**sections: Any) -> Any:
    """A task with draws everywhere."""
    terms = jumping()
    terms["observations"]["q"] = ObservationCfg(
        func="joint_position_relative",
        params=dict(ROBOT),
        noise=NoiseCfg(std=0.1),
        delay=[0, 2],
        history_length=2,
    )
    commands = {
        "q": CommandCfg(
            func="uniform_joint_position", params=dict(ROBOT), resampling_time_s=[0.04, 0.2]
        )
    }
    return task(**terms, commands=commands, max_episode_steps=5, **sections)


def two(**sections: Any) -> Any:
    """Another robot's place, other terms under the same names, another clock."""
    later = {"section": "commands", "term_name": "q", "param": "position_range", "num_steps": 3}
    cfg = one(num_envs=2, seed=5, decimation=2, **sections)
    cfg.commands["q"].params["position_range"] = [-0.2, 0.2]
    cfg.observations["q"].history_length = 5
    cfg.curriculum["q"] = CurriculumCfg(
        func="modify_term_param", params={**later, "value": [0.3, 0.3]}
    )
    assert cfg.robot is not None
    cfg.robot.init_pos = (0.5, 0.0, 0.2)
    return cfg


def advance(env: Any, step: int) -> np.ndarray:
    obs = env.reset()[0] if step == 0 else env.step(targets(env, step))[0]
    return np.concatenate([flat(obs), env.command_manager.values("q")], axis=1)


def test_two_environments_do_not_touch_each_other(make_env) -> None:
    alone = {}
    for name, cfg in (("one", one()), ("two", two())):
        env = make_env(cfg)
        alone[name] = [advance(env, step) for step in range(12)]
        env.close()
    first, second = make_env(one()), make_env(two())
    for step in range(12):
        assert advance(first, step).tobytes() == alone["one"][step].tobytes()
        assert advance(second, step).tobytes() == alone["two"][step].tobytes()


def test_a_part_of_a_batch_has_its_rows(make_env) -> None:
    """Environments from `first_env` on draw, observe and end as in the whole batch."""
    whole = make_env(one(num_envs=5, seed=2))
    first = make_env(one(num_envs=2, seed=2))
    rest = make_env(one(num_envs=3, seed=2, first_env=2))
    for env in (whole, first, rest):
        env.reset()
    for step in range(12):
        action = targets(whole, step)
        for env, part in ((whole, action), (first, action[:2]), (rest, action[2:])):
            env.step(part)
        seen = [env.observation_buffer.last for env in (first, rest)]
        assert np.concatenate(seen).tobytes() == whole.observation_buffer.last.tobytes()
    for env in (whole, rest):
        env.streams.reseed(7)  # environments keep their numbers
    assert (rest.rand("mine", (2,)) == whole.rand("mine", (2,))[2:]).all()


def test_the_same_config_can_be_built_from_twice(make_env) -> None:
    cfg = one()
    first = make_env(cfg)
    cfg.commands["q"].params["position_range"] = [9.0, 9.0]
    cfg.observations.pop("noise")
    second = make_env(one())
    for step in range(8):
        assert advance(first, step).tobytes() == advance(second, step).tobytes()
    assert "noise" in first.cfg.observations


def test_a_closed_environment_is_freed() -> None:
    from embodichain.lab.gym.envs.base_env import BaseEnv

    env = BaseEnv(one())
    advance(env, 0)
    advance(env, 1)
    gone = weakref.ref(env), weakref.ref(env.sim), weakref.ref(env.command_manager)
    env.close()
    del env
    gc.collect()
    assert [ref() for ref in gone] == [None] * 3


LEAK = """
import ctypes, gc, json, os, sys
sys.path.insert(0, sys.argv[1])
from tests.lab.gym.envs.test_many_environments import advance, two
from embodichain.lab.gym.envs.base_env import BaseEnv

def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")

def measure():
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)  # what is free goes back to the system: the rest is in use
    threads = len(os.listdir("/proc/self/task"))
    return resident(), threads, len(os.listdir("/proc/self/fd"))

def build(count):
    for number in range(count):
        if number % 10 == 0:
            gc.collect()
        env = BaseEnv(two())
        for step in range(3):
            advance(env, step)
        env.close()
    return measure()

print(json.dumps([build(30), build(90)]))
"""


@pytest.mark.slow
@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="asks Linux and glibc")
def test_building_and_closing_many_leaks_nothing() -> None:
    root = Path(__file__).parents[4]
    done = subprocess.run(
        [sys.executable, "-c", LEAK, str(root)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(root)},
    )
    assert done.returncode == 0, done.stderr
    (before, threads, files), (after, more_threads, more_files) = json.loads(done.stdout)
    assert (more_threads, more_files) == (threads, files)
    # One environment's model and states take more than a megabyte: 90 of them would show.
    assert (after - before) / 90 < 0.1 * 2**20
