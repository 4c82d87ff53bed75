"""Contacts that begin and end within a control step: who sees them, and who does not."""

from typing import Any

import numpy as np
import pytest
import torch

import embodichain
from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.cfg import (
    EnvCfg,
    EventCfg,
    MetricCfg,
    ObservationCfg,
    PhysicsTaskCfg,
    TerminationCfg,
)
from embodichain.lab.sim.cfg import (
    RigidBodyAttributesCfg,
    RigidObjectCfg,
    SimulationManagerCfg,
)
from embodichain.lab.sim.sensors import ContactSensorCfg, LinksCfg
from embodichain.lab.sim.shapes import SphereCfg
from embodichain.utils.errors import ConfigError

STEPS = 20
"""Physics steps of 1 ms in a control step."""
BUMPER = {"sensor": "bumper"}
STILL = RigidBodyAttributesCfg(mass=0.3)


def graze(sensor: dict[str, Any] | None = None, **sections: Any) -> BaseEnv:
    """Pucks fly by a post at 4 m/s and graze it for some milliseconds; they start x apart."""
    base: dict[str, Any] = {
        "num_envs": 40,
        "seed": 1,
        "sim_cfg": SimulationManagerCfg(headless=True, num_threads=1),
        "physics": PhysicsTaskCfg(physics_dt=0.001, gravity=[0.0, 0.0, 0.0]),
        "sim_steps_per_control": STEPS,
        "max_episode_steps": 20,
        "objects": {
            "puck": RigidObjectCfg(
                shape=SphereCfg(radius=0.05), init_pos=(-0.5, 0.0, 1.0), attrs=STILL
            ),
            "post": RigidObjectCfg(
                shape=SphereCfg(radius=0.05), init_pos=(0.0, 0.097, 1.0), body_type="static"
            ),
        },
        "events": {
            "go": EventCfg(
                "reset_root_state_uniform",
                {
                    "of": {"uid": "puck"},
                    "pose_range": {"x": [-0.2, 0.2]},
                    "velocity_range": {"x": [4.0, 4.0]},
                },
            )
        },
        "sensors": {
            "bumper": ContactSensorCfg(of=LinksCfg(uid="puck"), observe=True, **(sensor or {}))
        },
        "observations": {"f": ObservationCfg("contact_force", {**BUMPER, "norm": True})},
    }
    return BaseEnv(EnvCfg(**{**base, **sections}))


def fly(env: BaseEnv, steps: int = 12) -> list[Any]:
    env.reset()
    return [env.step(torch.zeros((env.num_envs, 0))) for _ in range(steps)]


def hits(name: str, **given: Any) -> MetricCfg:
    return MetricCfg(name, {**BUMPER, **given}, reduce="max", shape="l1")


def test_all_that_hit_end_by_illegal_contact() -> None:
    hit = TerminationCfg("illegal_contact", {**BUMPER, "threshold": 1.0}, kind="fail")
    with graze(terminations={"hit": hit}) as env:
        ended = np.zeros(env.num_envs, bool)
        seen = ended.copy()
        for _, _, terminated, _, info in fly(env):
            ended |= terminated.numpy()
            final = info.get("final_obs")
            if final is not None:
                seen |= terminated.numpy() & (final["f"][:, 0].numpy() > 1.0)
    assert ended.all()
    assert seen.mean() < 0.7  # an observation of the sensor is of the last physics step


@pytest.mark.parametrize("persistent", [False, True])
def test_the_largest_force_is_that_of_the_physics_steps(persistent) -> None:
    """Against the same simulations, of which each physics step is a control step."""
    force = {"f": MetricCfg("largest_contact_force", BUMPER, shape="l1")}
    sim_cfg = SimulationManagerCfg(headless=True, num_threads=1, persistent=persistent)
    with (
        graze(metrics=force, sim_cfg=sim_cfg) as env,
        graze(sim_steps_per_control=1, max_episode_steps=400) as single,
    ):
        env.reset()
        single.reset()
        none = torch.zeros((env.num_envs, 0))
        largest = 0.0
        for _ in range(11):
            info = env.step(none)[4]
            steps = [single.step(none)[0]["f"][:, 0].numpy() for _ in range(STEPS)]
            wanted = np.max(steps, axis=0)
            np.testing.assert_allclose(info["metrics"]["f"].numpy(), wanted, rtol=1e-6)
            largest = max(largest, wanted.max())
    assert largest > 20.0


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("contact_found", {}),
        ("contact_found", {"threshold": 1.0}),
        ("undesired_contacts", {"threshold": 1.0}),
        ("largest_contact_force", {}),
        ("contact_forces", {"threshold": 1.0}),
    ],
)
def test_terms_that_ask_for_contact_see_all_physics_steps(name, given) -> None:
    shape = None if name in ("undesired_contacts", "contact_forces") else "l1"
    term = MetricCfg(name, {**BUMPER, **given}, reduce="max", shape=shape)
    with graze(metrics={"hit": term}) as env:
        assert (fly(env)[-1][4]["metrics"]["hit"] > 0).all()
    with graze({"history_length": 1}, metrics={"hit": term}) as env:
        seen = (fly(env)[-1][4]["metrics"]["hit"] > 0).float().mean()
    assert 0.1 < seen < 0.7  # about the part of contacts that are there in a last physics step


def test_a_foot_that_touches_between_two_observations_has_landed() -> None:
    """Its flight is paid in the step of the contact: not before, and not twice."""
    air = {"air": MetricCfg("feet_air_time", {**BUMPER, "threshold": 0.0}, reduce="sum")}
    found = {"found": MetricCfg("contact_found", BUMPER, shape="l1")}
    with graze(metrics=air | found) as env:
        paid = np.zeros(env.num_envs)
        landed = np.zeros(env.num_envs, bool)
        for step, (*_, info) in enumerate(fly(env), start=1):
            touched = info["metrics"]["found"].numpy() > 0
            paid += np.where(touched & ~landed, step * env.step_dt, 0.0)
            landed |= touched
        assert landed.all()
        np.testing.assert_allclose(info["metrics"]["air"].numpy(), paid, rtol=1e-5)


def test_the_history_may_be_longer_than_a_control_step() -> None:
    """Of 60 physics steps: a contact is seen in three control steps."""
    one = {"n": MetricCfg("contact_found", BUMPER, shape="l1", reduce="sum")}
    with graze(metrics=one) as env:
        short = fly(env)[-1][4]["metrics"]["n"]
    with graze({"history_length": 3 * STEPS}, metrics=one) as env:
        long = fly(env)[-1][4]["metrics"]["n"]
    assert (long - short).tolist() == [2.0] * len(long)


def test_nothing_is_kept_for_who_does_not_ask() -> None:
    with graze() as env:
        # Whether contacts of physics steps are kept, which costs time and changes no other reading.
        assert not env.sim.engine._history
        plain = [step[0].rows for step in fly(env)]
    with graze(metrics={"hit": hits("contact_found")}) as env:
        assert env.sim.engine._history
        assert all((a == step[0].rows).all() for a, step in zip(plain, fly(env), strict=True))


def test_python_reads_it_too() -> None:
    with graze({"history_length": 5}) as env:
        assert env.sim.engine._history
        fly(env, 3)
        sensor = env.get_sensor("bumper")
        assert sensor.read_largest_force().shape == (40, 1)
        assert (sensor.read_largest_force()[:, 0] >= env.observation_buffer.last[:, 0] - 1e-4).all()
        assert sensor.read_touched().dtype == np.bool_
        assert list(sensor.get_data()) == ["found", "force"]


def test_a_saved_environment_goes_on_as_if_it_had_not_been_saved() -> None:
    force = {"f": ObservationCfg("largest_contact_force", BUMPER)}
    with (
        graze({"history_length": 50}, observations=force) as env,
        graze({"history_length": 50}, observations=force) as other,
    ):
        fly(env, 4)
        other.reset()
        other.load_state_dict(env.state_dict())
        for _ in range(5):
            none = torch.zeros((env.num_envs, 0))
            assert (env.step(none)[0].rows == other.step(none)[0].rows).all()


def test_a_sensor_with_a_rate_keeps_what_it_saw() -> None:
    """Every 40 ms it looks back at 20 of them."""
    term = {"n": MetricCfg("contact_found", BUMPER, shape="l1", reduce="max")}
    with graze({"rate": 25.0}, metrics=term) as env:
        seen = fly(env)[-1][4]["metrics"]["n"].mean()
    assert 0.2 < seen < 0.9


@pytest.mark.parametrize("length", [0, -1, 1.5, "all"])
def test_a_history_is_a_number_of_physics_steps(length) -> None:
    overrides = [
        "+task.sensors.touch={sensor_type: contact, of: {uid: cart_pole}, "
        f"history_length: {length}}}"
    ]
    with pytest.raises(ConfigError, match="sensors.touch.history_length"):
        embodichain.make("cart_pole", 1, overrides)
