"""Every public object of an environment says in one line what it is, also when it is closed."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import torch

import embodichain
from embodichain import recording


def runtime_objects(owner: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Public attributes of this package's classes, also those in maps, by their path."""
    for name in dir(owner):
        if name.startswith("_"):
            continue
        value = getattr(owner, name)
        entries = value.items() if isinstance(value, Mapping) else [("", value)]
        for key, entry in entries:
            if type(entry).__module__.startswith("embodichain."):
                yield f"{path}.{name}{f'[{key!r}]' if key else ''}", entry


def all_objects(env: Any) -> dict[str, Any]:
    found: dict[str, Any] = {"env": env}
    for owner, path in ((env, "env"), (env.sim, "env.sim"), (env.robot, "env.robot")):
        found |= dict(runtime_objects(owner, path))
    for owner in (env.sim.rigid_objects["cube"], *env.sim.sensors.values()):
        found |= dict(runtime_objects(owner, owner.uid))
    return found


def test_all_objects_of_an_environment_say_what_they_are(tmp_path: Path) -> None:
    env = embodichain.make("pick_place", 2)
    recorder = recording.McapRecorder(tmp_path / "rollout.mcap", env)
    env.add_observer(recorder)
    env.reset()
    env.step(torch.as_tensor(env.action_space.sample()))
    objects = all_objects(env)
    assert len(objects) > 40
    env.close()
    with recording.open(tmp_path / "rollout.mcap") as log:
        objects |= {"log": log, "recorder": recorder, "arrays": log.read(["qpos", "rewards"])}
        objects |= dict(runtime_objects(log, "log"))
        nameless = [path for path, value in objects.items() if " object at 0x" in repr(value)[:200]]
    assert nameless == []

    texts = {path: repr(value) for path, value in objects.items()}
    assert texts["env.sim.rigid_objects['cube']"] == (
        "RigidObject('cube', num_envs=2, body_type='dynamic', shape='Cube')"
    )
    robot = texts["env.robot"]
    assert robot.startswith("Robot('robot', num_envs=2, joints=[Joint1, ") and "\n" not in robot
    assert "control_parts={arm: 6, " in robot
    assert texts["arrays"] == (
        "LogArrays(steps=1, num_envs=2, fields={qpos: (1, 2, 15), rewards: (1, 2)})"
    )
    assert texts["env.sim"].startswith("SimulationManager(num_envs=2, device='cpu', physics_dt=0.0")
    assert "rigid_objects=[pedestal, table, cube, stand]" in texts["env.sim"]
    assert texts["env.sensors['fingers']"].startswith("ContactSensor('fingers', num_envs=2, of=[")
    assert texts["env.reward_manager"].startswith("RewardManager('rewards', num_envs=2, terms=[")


def test_policies_and_batches_of_learners_say_what_they_are(tmp_path: Path) -> None:
    from stable_baselines3 import PPO

    from embodichain.learning import SB3VecEnv, load_policy

    env = SB3VecEnv(embodichain.make("cart_pole", 2))
    assert repr(env) == "SB3VecEnv('cart_pole', num_envs=2, action=(1,), observation=(4,))"
    PPO("MlpPolicy", env, n_steps=8, batch_size=16, device="cpu").save(tmp_path / "made.zip")
    policy = load_policy(tmp_path / "made.zip", env.base)
    assert repr(policy).startswith("LearnedPolicy('") and "group='policy'" in repr(policy)
    env.close()
