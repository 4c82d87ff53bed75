"""What randomizers must not do: change a bit when neutral, touch others, depend on N, get lost."""

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import EventCfg
from embodichain.lab.sim.cfg import JointDrivePropertiesCfg, RigidBodyAttributesCfg, RobotCfg
from tests.helpers.randomizers import ARM, CASES, CUBE, IDS, default
from tests.helpers.ur10_task import HOME, UR10

LIMITED = RobotCfg(
    uid="ur10",
    fpath=UR10,
    init_pos=(0.0, 0.0, 1.0),
    init_qpos=HOME,
    attrs=RigidBodyAttributesCfg(dynamic_friction=0.1),
    drive_pros=JointDrivePropertiesCfg(
        stiffness=500.0, damping=50.0, max_effort="file", friction=1.0, armature=0.02
    ),
)


def wave(step: int, count: int) -> torch.Tensor:
    found = np.sin(0.7 * step + np.arange(count)[:, None] + np.arange(6)) * 0.3 + HOME
    return torch.from_numpy(found.astype(np.float32))


def rollout(env, steps: int = 12) -> list[bytes]:
    """Everything physical, step by step, through an automatic reset."""
    engine = env.sim.engine
    found = []
    env.reset()
    for step in range(steps):
        env.step(wave(step, env.num_envs))
        fields = [engine.acceleration(n) for n in ("qfrc_actuator", "qacc", "qfrc_constraint")]
        fields += [engine.derived(n) for n in ("xpos", "xipos", "cvel")]
        found += [f.tobytes() for f in (engine.rows, *fields)]
    return found


@pytest.mark.parametrize("mode", ["startup", "reset"])
@pytest.mark.parametrize("case", CASES, ids=IDS)
def test_nothing_added_or_times_one_changes_no_bit(make, case, mode) -> None:
    def build(**sections):
        return make(num_envs=2, robot=LIMITED, max_episode_steps=8, **sections)

    plain, env = build(), build(events={"e": case.neutral_event(mode)})
    assert rollout(env) == rollout(plain)
    engine = env.sim.engine
    # Of all fields of the model: `model_field` would hide one that nobody should have written.
    fields = engine._fields.expanded()
    assert fields, "nothing was written: the test lost its point"
    for name in engine._fields._views:
        compiled = default(engine.model, name).astype(fields[name].dtype)
        for row in fields[name].reshape(2, -1):
            assert row.tobytes() == compiled.tobytes(), name


@pytest.mark.parametrize("case", CASES, ids=IDS)
def test_a_reset_of_one_environment_leaves_the_others(make, case) -> None:
    env = make(num_envs=3, events={"e": case.event()})
    env.reset()
    before = case.values(env).copy()
    model = {k: v.copy() for k, v in env.sim.engine._fields.expanded().items()}
    env.reset(options={"reset_ids": [1]})
    after = case.values(env)
    assert (after[1] != before[1]).any()
    # All fields that differ between environments, also those that nobody should have written.
    for name, values in env.sim.engine._fields.expanded().items():
        assert values[[0, 2]].tobytes() == model[name][[0, 2]].tobytes(), name
    assert len({row.tobytes() for row in after}) == 3


@pytest.mark.parametrize("case", CASES, ids=IDS)
def test_modes(make, case) -> None:
    start = make(num_envs=2, events={"e": case.event(mode="startup")})
    drawn = case.values(start).copy()
    assert drawn.min() > case.low and drawn.max() < case.high
    start.reset()
    start.reset(options={"reset_ids": [0]})
    assert case.values(start).tobytes() == drawn.tobytes()

    often = make(num_envs=2, events={"e": case.event(mode="interval", interval_step=2)})
    often.reset()
    seen = [case.values(often).copy()]
    for step in range(4):
        often.step(wave(step, 2))
        seen.append(case.values(often).copy())
    same = [bool((a == b).all()) for a, b in zip(seen, seen[1:], strict=False)]
    assert same == [True, False, True, False]


def everything() -> dict[str, EventCfg]:
    """Every randomizer at once; some fire at resets, some every few steps, one at the start."""
    events = {}
    for i, case in enumerate(CASES):
        if i % 3 == 0:
            events[f"{i}"] = case.event(mode="interval", interval_step=2 + i % 4)
        else:
            events[f"{i}"] = case.event(mode="startup" if i == 4 else "reset")
    return events


def test_bytes_do_not_depend_on_the_number_of_environments(make) -> None:
    def run(count: int) -> list[bytes]:
        env = make(num_envs=count, max_episode_steps=5, events=everything())
        env.reset()
        found = []
        for step in range(12):
            if step == 3:
                env.reset(options={"reset_ids": [0]})
            env.step(wave(step, count))
            found.append(env.sim.engine.rows[0].tobytes())
        model = env.sim.engine.state_dict()["model"]
        return found + [model[name][0].tobytes() for name in sorted(model)]

    alone = run(1)
    assert run(5) == alone
    assert run(33) == alone


def test_a_restored_environment_continues_to_the_byte(make) -> None:
    def build():
        return make(num_envs=3, max_episode_steps=7, events=everything())

    env, other = build(), build()

    def run(env) -> list[bytes]:
        found = []
        for step in range(10):
            env.step(wave(step, 3))
            found.append(env.sim.engine.rows.tobytes())
        drives = [v.numpy().tobytes() for v in env.robot.get_joint_drive()]
        cube = env.sim.get_rigid_object("cube")
        limits = env.robot.get_qpos_limits().numpy().tobytes()
        sizes = cube.get_body_scale().numpy().tobytes(), cube.get_mass().numpy().tobytes()
        return [*found, *drives, limits, *sizes]

    env.reset()
    for step in range(3):
        env.step(wave(step, 3))
    saved = env.state_dict()
    first = run(env)
    run(env)
    env.load_state_dict(saved)
    assert run(env) == first
    other.reset()
    other.load_state_dict(saved)  # another process would do no other thing
    assert run(other) == first


def test_constants_are_recomputed_once_a_reset(make) -> None:
    class Ear:
        ops: list[str] = []

        def on_write(self, write) -> None:
            self.ops.append(write.op)

        def on_physics(self, event) -> None:
            pass

    events = {f"{i}": case.event() for i, case in enumerate(CASES)}
    env = make(num_envs=3, events=events)
    env.sim.engine.listeners.append(ear := Ear())
    env.reset()
    assert ear.ops.count("set_const") == 1
    assert ear.ops.index("set_const") > max(i for i, op in enumerate(ear.ops) if op == "model")


def test_gains_and_mass_do_not_ask_for_constants_they_do_not_change(make) -> None:
    class Ear:
        ops: list[str] = []

        def on_write(self, write) -> None:
            self.ops.append(write.op)

        def on_physics(self, event) -> None:
            pass

    gains = EventCfg(func="randomize_actuator_gains", params={**ARM, "stiffness_range": [9, 99]})
    slide = EventCfg(
        func="randomize_rigid_body_material", params={**CUBE, "friction_range": [0.1, 1]}
    )
    env = make(num_envs=3, events={"gains": gains, "slide": slide})
    env.sim.engine.listeners.append(ear := Ear())
    env.reset()
    assert "model" in ear.ops and "set_const" not in ear.ops
