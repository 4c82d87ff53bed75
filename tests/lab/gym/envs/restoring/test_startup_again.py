"""`reset(seed=)` of all environments runs startup events again, from the values that they found."""

from typing import Any

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs import BaseEnv
from embodichain.lab.gym.envs.cfg import EventCfg
from embodichain.recording import McapRecorder, verify
from embodichain.recording import open as open_log
from tests.helpers.local_shards import sharded
from tests.helpers.randomizers import CASES
from tests.helpers.ur10_task import HOME, builder
from tests.lab.gym.conftest import task


def acts(env: Any, step: int = 0) -> torch.Tensor:
    wave = HOME + 0.3 * np.sin(0.7 * step + np.arange(env.num_envs)[:, None] + np.arange(6))
    return torch.from_numpy(wave.astype(np.float32))


def simulation(env: Any) -> dict[str, bytes]:
    """All that a simulation is: rows, model fields, properties of entities."""
    state = env.sim.state_dict()
    found = {"rows": state["engine"]["rows"].tobytes()}
    found |= {k: v.tobytes() for k, v in state["engine"]["model"].items()}
    for part in ("drives", "objects", "lights"):
        for uid, values in state[part].items():
            found |= {f"{part}.{uid}.{k}": v.tobytes() for k, v in values.items()}
    return found


def everything() -> dict[str, EventCfg]:
    return {f"e{i}": case.event(mode="startup") for i, case in enumerate(CASES)}


@pytest.mark.parametrize("count", [1, 3])
def test_a_seed_gives_the_same_environment_however_it_is_given(count: int) -> None:
    """Every randomizer at the start: all model fields are those of an environment of that seed."""
    with builder() as make:
        env, other = (make(num_envs=count, events=everything(), seed=s) for s in (7, 3))
        first, _ = env.reset(seed=7)
        wanted = simulation(env)
        assert env.sim.state_dict()["engine"]["model"].keys() & {"body_mass", "geom_friction"}
        before = simulation(other)
        for step in range(5):
            other.step(acts(other, step)) if step else other.reset()
        assert simulation(other).keys() == before.keys() == wanted.keys()
        assert simulation(other)["body_mass"] == before["body_mass"] != wanted["body_mass"]
        obs, _ = other.reset(seed=7)
        assert simulation(other) == wanted
        assert all(torch.equal(obs[k], v) for k, v in first.items() if isinstance(v, torch.Tensor))
        other.reset()
        assert simulation(other)["body_mass"] == wanted["body_mass"]


def heavier(env: Any, env_ids: Any) -> None:
    """Of a user: changes what is there, by a factor that is drawn."""
    cube = env.sim.get_rigid_object("cube")
    factor = env.rand("heavier", (1,), 1.5, 2.5, env_ids).squeeze(-1)
    cube.set_mass((cube.get_mass().reshape(-1) * factor).numpy())


HEAVIER = {"more": EventCfg(func=heavier, mode="startup")}


def masses(env: Any) -> list[float]:
    found: list[float] = env.sim.get_rigid_object("cube").get_mass().reshape(-1).tolist()
    return found


def solid(num_envs: int, first: int = 0, **sections: Any) -> Any:
    cfg = task(num_envs=num_envs, seed=5, **sections)
    cfg.objects["cube"].body_type = "dynamic"
    cfg.first_env = first
    return cfg


def test_events_start_from_the_values_that_they_found(make_env: Any) -> None:
    env = make_env(solid(3, events=HEAVIER))
    compiled = float(env.sim.engine.model.body_mass[-1])
    env.reset(seed=9)
    first = masses(env)
    assert all(1.5 <= mass / compiled <= 2.5 for mass in first) and len(set(first)) == 3
    for _ in range(5):  # from what they left, the mass would be 32 times as large or more
        env.reset(seed=9)
        assert masses(env) == first
    env.reset(seed=10)
    assert not set(masses(env)) & set(first)


def test_only_all_environments_with_a_seed_start_again(make_env: Any) -> None:
    env = make_env(solid(3, events=HEAVIER))
    env.reset(seed=9)
    first = masses(env)
    env.reset()
    env.reset(seed=10, options={"reset_ids": [0, 2]})
    env.reset()
    assert masses(env) == first


def test_what_no_startup_event_writes_stays(make_env: Any) -> None:
    env = make_env(solid(2, events=HEAVIER))
    robot = env.sim.get_robot("ur10")
    env.sim.engine.write_model("dof_frictionloss", 0.25)
    robot.set_joint_drive(stiffness=torch.full((2, 6), 123.0))
    env.reset(seed=9)
    assert (env.sim.engine.model_field("dof_frictionloss") == 0.25).all()
    assert (robot.drives.stiffness[:, :6] == 123.0).all()


def test_the_writes_are_in_the_log_and_verify(tmp_path: Any) -> None:
    with builder() as make:
        env = make(num_envs=3, max_episode_steps=7, events=everything())
        env.add_observer(McapRecorder(tmp_path / "log.mcap", env))
        env.reset()
        for step in range(20):
            if step in (6, 11):
                env.reset(seed=40 + step)
            env.step(acts(env, step))
    assert verify(tmp_path / "log.mcap").ok
    for i in range(3):
        assert verify(tmp_path / "log.mcap", env=i).ok
    with open_log(tmp_path / "log.mcap") as log:
        again = [e for e in log.events() if e.mode == "startup"]
    assert len(again) == 2 * len(CASES)


def test_shards_start_again_as_one_batch_does(make_env: Any) -> None:
    def build(first: int, count: int) -> BaseEnv:
        return BaseEnv(solid(count, first, events=HEAVIER))

    whole = make_env(solid(4, events=HEAVIER))
    with sharded(build, 4, 2) as (parts, source):
        for options in (None, {"reset_ids": [0, 1]}, None):
            for seed in (11, 12):
                whole.reset(seed=seed, options=options)
                parts.reset(seed=seed, options=options)
                there = [masses(shard.shard.env) for shard in source.running.values()]
                assert [m for part in there for m in part] == masses(whole)
