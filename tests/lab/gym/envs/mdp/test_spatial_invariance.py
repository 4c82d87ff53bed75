"""Every event that places, pushes or paints gives environment i the same bytes for any N."""

import numpy as np
import pytest

from embodichain.lab.gym.envs.managers import TERMS
from tests.helpers.sensor_terms import SENSORS
from tests.helpers.spatial_events import EVENTS, LIGHTS

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

PACKAGES = ("embodichain.lab.gym.envs.mdp.events.", "embodichain.compat.terms.")
OTHERS = (".randomize",)
FIELDS = ("mat_rgba", "mat_specular", "geom_rgba", "light_pos", "light_diffuse", "cam_quat")
FIELDS += ("cam_fovy", "cam_intrinsic")
SCENE = {"events": EVENTS, "lights": LIGHTS, "sensors": {"front": SENSORS["front"]}}


def tensors(env) -> list[np.ndarray]:
    """(N, ...) what the events leave on the environment."""
    found = [env.lift, env.target_pose, *env.affordance_datas.values()]
    return [np.asarray(value) for value in found]


def rollout(make, num_envs: int) -> list[list[bytes]]:
    """Bytes of the first environment after resets and steps."""
    env = make(num_envs=num_envs, **SCENE)
    engine = env.sim.engine
    found = []

    def look() -> None:
        row = [engine.rows[0].tobytes(), *(value[0].tobytes() for value in tensors(env))]
        found.append(row + [engine.model_field(field)[0].tobytes() for field in FIELDS])

    env.reset()
    look()
    for step in range(10):
        if step == 4:
            env.reset(options={"reset_ids": [0]})
            look()
        env.step(env.robot.get_qpos(target=True))
        look()
    return found


def test_bytes_do_not_depend_on_the_number_of_environments(make) -> None:
    wide = rollout(make, 17)
    for num_envs in (1, 3):
        for step, (a, b) in enumerate(zip(rollout(make, num_envs), wide, strict=True)):
            for item, (x, y) in enumerate(zip(a, b, strict=True)):
                assert x == y, f"N={num_envs}, look {step}, item {item}"


def test_a_partial_reset_touches_nobody_else(make) -> None:
    env = make(num_envs=4, **SCENE)
    env.reset()
    engine = env.sim.engine

    def others() -> list[np.ndarray]:
        rows = [engine.rows, *tensors(env), *(engine.model_field(f) for f in FIELDS)]
        return [value[[0, 2, 3]].copy() for value in rows]

    before, own = others(), engine.rows[1].copy()
    for _ in range(5):
        env.reset(options={"reset_ids": [1]})
    assert all(np.array_equal(a, b) for a, b in zip(before, others(), strict=True))
    assert not np.array_equal(own, engine.rows[1])


def test_a_restored_environment_continues_to_the_byte(make) -> None:
    env = make(num_envs=3, max_episode_steps=4, **SCENE)
    env.reset()

    def run() -> list[bytes]:
        found = []
        for _ in range(9):
            env.step(env.robot.get_qpos(target=True))
            found += [env.sim.engine.rows.tobytes(), *(v.tobytes() for v in tensors(env))]
            found += [env.sim.engine.model_field(f).tobytes() for f in FIELDS]
        return found

    env.step(env.robot.get_qpos(target=True))
    saved = env.state_dict()
    first = run()
    env.load_state_dict(saved)
    assert run() == first


def test_every_event_of_these_modules_takes_part() -> None:
    names = {
        name
        for name, spec in TERMS["event"].items()
        if spec.func.__module__.startswith(PACKAGES) and not spec.func.__module__.endswith(OTHERS)
    }
    elsewhere = {"reset_joints", "randomize_robot_qpos"}
    elsewhere |= {"randomize_pose", "randomize_rigid_object_pose", "randomize_texture"}
    elsewhere |= {"randomize_shape"}  # test_shape_events: it needs an object with several shapes
    elsewhere |= {"arrange_objects"}  # test_arrange_objects: it needs something to be placed on
    assert {str(event.func) for event in EVENTS.values()} == names - elsewhere
