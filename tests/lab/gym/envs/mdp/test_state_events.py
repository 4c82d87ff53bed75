"""Roots, joints, pushes and forces, against what was drawn and cases worked by hand."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from embodichain.lab.gym.envs.cfg import EventCfg
from embodichain.lab.sim.cfg import RobotCfg
from embodichain.utils.errors import ConfigError
from embodichain.utils.math import quat_rotate
from tests.helpers.ur10_task import CUBE_POS, HOME
from tests.lab.gym.envs.mdp.test_events import build, poses

CUBE = {"entity_cfg": {"uid": "cube"}}
ARM = {"entity_cfg": {"uid": "ur10"}}


def event(func: str, mode: str = "reset", **params) -> EventCfg:
    step = {"interval_step": 1} if mode == "interval" else {}
    return EventCfg(func=func, mode=mode, params=params, **step)


def hold(env):
    return env.robot.get_qpos(target=True)


def velocity(env) -> np.ndarray:
    return np.concatenate(env.sim.get_asset("cube").read_velocity(), axis=1)


def test_root_state_is_the_default_plus_the_draw(make) -> None:
    # The cube starts at a yaw of 90 degrees: its own x axis is the environment's y axis.
    exact = {"x": [0.1, 0.1], "z": [0.5, 0.5], "roll": [math.pi / 2, math.pi / 2]}
    speed = {"y": [2.0, 2.0], "yaw": [3.0, 3.0]}
    env, _ = build(
        make, event("reset_root_state_uniform", **CUBE, pose_range=exact, velocity_range=speed)
    )
    pos, quat = poses(env, "cube")
    assert np.allclose(pos, np.add(CUBE_POS, [0.1, 0, 0.5]), atol=1e-12)
    up = quat_rotate(quat, np.tile([0.0, 0, 1], (3, 1)))
    # Turned by 90 degrees about its x axis (the world's y), its z axis points along the world's +x.
    assert np.allclose(up, np.tile([1.0, 0, 0], (3, 1)), atol=1e-12)
    assert np.allclose(velocity(env), np.tile([0, 2, 0, 0, 0, 3.0], (3, 1)), atol=1e-12)


def test_root_angles_are_roll_pitch_yaw(make) -> None:
    angles = {"roll": [0.3, 0.3], "pitch": [0.4, 0.4], "yaw": [0.5, 0.5]}
    env, _ = build(make, event("reset_root_state_uniform", **CUBE, pose_range=angles))
    turned = Rotation.from_euler("z", 90, degrees=True) * Rotation.from_euler(
        "xyz", [0.3, 0.4, 0.5]
    )
    found = Rotation.from_quat(poses(env, "cube")[1], scalar_first=True)
    assert np.allclose(found.as_matrix(), turned.as_matrix(), atol=1e-12)


def test_root_draws_are_uniform_and_do_not_drift(make) -> None:
    ranges = {"x": [-0.2, 0.1], "y": [0.0, 0.3], "z": [0.1, 0.1], "yaw": [-3.0, 3.0]}
    env, drawn = build(
        make, event("reset_root_state_uniform", **CUBE, pose_range=ranges), num_envs=256
    )
    for _ in range(30):
        env.reset()
    low, high = np.array([-0.2, 0.0, 0.1]), np.array([0.1, 0.3, 0.1])
    offset = poses(env, "cube")[0] - CUBE_POS
    assert (offset >= low - 1e-12).all() and (offset <= high + 1e-12).all()
    error = 4 * (high - low) / np.sqrt(12 * 256) + 1e-12
    assert (np.abs(offset.mean(0) - (low + high) / 2) < error).all()
    assert len(np.unique(drawn.last["pose"][:, 5])) == 256
    correlation = np.corrcoef(drawn.last["pose"][:, [0, 1, 5]].T)
    assert np.abs(correlation[~np.eye(3, dtype=bool)]).max() < 4 / np.sqrt(256)


def test_empty_ranges_leave_every_bit(make) -> None:
    plain = make()
    plain.reset()
    zero = {"x": [0, 0], "roll": [0, 0]}
    env, _ = build(make, event("reset_root_state_uniform", **CUBE, pose_range=zero))
    assert np.array_equal(env.sim.engine.rows, plain.sim.engine.rows)


def test_the_scene_goes_back_within_an_episode(make) -> None:
    env = make(events={"back": event("reset_scene_to_default", "interval")})
    env.reset()
    start = env.sim.engine.rows.copy()
    env.sim.get_asset("cube").set_velocity(np.ones((3, 3)))
    env.step(hold(env) + 0.1)
    assert np.array_equal(env.sim.engine.rows, start)


@pytest.mark.parametrize("scale", [False, True])
def test_joints_near_their_default(make, scale: bool) -> None:
    if scale:
        what = event("reset_joints_by_scale", **ARM, position_range=[0.5, 1.5])
    else:
        speeds = [-0.3, 0.2]
        what = event(
            "reset_joints_by_offset", **ARM, position_range=[-0.1, 0.2], velocity_range=speeds
        )
    env, drawn = build(make, what, num_envs=64)
    home, position = np.array(HOME), drawn.last["position"]
    expected = home * position if scale else home + position
    qpos = env.robot.read_qpos()
    assert np.allclose(qpos, expected, atol=1e-12)
    assert np.array_equal(env.robot.drives.read_target_qpos(), qpos)
    low, high = (0.5, 1.5) if scale else (-0.1, 0.2)
    assert position.min() >= low and position.max() <= high
    assert abs(position.mean() - (low + high) / 2) < 4 * (high - low) / np.sqrt(12 * 64 * 6)
    qvel = env.robot.read_qvel()
    if scale:
        assert not qvel.any()
    else:
        assert np.array_equal(qvel, drawn.last["velocity"])
        assert qvel.min() >= -0.3 and qvel.max() <= 0.2 and np.ptp(qvel) > 0.45


SPINNING = """
<mujoco>
  <worldbody>
    <body name="base"><geom size="0.1"/>
      <body name="wheel" pos="0 0 1"><joint name="spin" axis="0 0 1" range="-90 90"/>
        <geom size="0.1"/></body>
      <body name="fan" pos="0 0 2"><joint name="turn" axis="0 0 1" range="-90 90"/>
        <geom size="0.1"/></body>
    </body>
  </worldbody>
  <keyframe><key name="home" qpos="0.2 -0.1" qvel="3 -2"/></keyframe>
</mujoco>
"""


@pytest.mark.parametrize(("how", "expected"), [("scale", [1.5, -1.0]), ("offset", [3.5, -1.5])])
def test_velocities_are_about_those_of_the_keyframe(make, tmp_path, how, expected) -> None:
    """Isaac Lab's and mjlab's default velocities: times 0.5, or plus 0.5."""
    (tmp_path / "spin.xml").write_text(SPINNING)
    robot = RobotCfg(uid="two", fpath=str(tmp_path / "spin.xml"))
    params = {"entity_cfg": {"uid": "two"}, "velocity_range": [0.5, 0.5]}
    position = [1.0, 1.0] if how == "scale" else [0.0, 0.0]
    what = event(f"reset_joints_by_{how}", **params, position_range=position)
    env = make(robot=robot, events={"joints": what})
    env.reset()
    assert env.robot.read_qpos() == pytest.approx(np.tile([0.2, -0.1], (3, 1)))
    assert env.robot.read_qvel() == pytest.approx(np.tile(expected, (3, 1)))


def test_joints_stop_at_their_limits(make) -> None:
    some = {"entity_cfg": {"uid": "ur10", "joint_names": "Joint3"}}
    env, _ = build(make, event("reset_joints_by_offset", **some, position_range=[99, 99]))
    upper = np.asarray(env.robot.parsed.qpos_limits)[2, 1]
    qpos = env.robot.read_qpos()
    assert (qpos[:, 2] == upper).all()
    assert np.allclose(qpos[:, [0, 1, 3, 4, 5]], np.array(HOME)[[0, 1, 3, 4, 5]])


def test_a_push_is_added_to_the_velocity(make) -> None:
    env = make()
    env.reset()
    cube = env.sim.get_asset("cube")
    cube.set_velocity(np.tile([1.0, 0, 0], (3, 1)), np.tile([0, 0, 2.0], (3, 1)))
    push = event(
        "push_by_setting_velocity",
        **CUBE,
        velocity_range={"x": [0.5, 0.5], "roll": [-1.0, -1.0]},
    )
    manager = type(env.event_manager)(env, {"push": push})
    env.event_manager = manager
    manager.apply("reset", np.array([0, 2]))
    pushed, left = [1.5, 0, 0, -1, 0, 2.0], [1.0, 0, 0, 0, 0, 2.0]
    assert np.allclose(velocity(env), [pushed, left, pushed], atol=1e-12)


def test_pushes_come_on_their_own_schedule(make) -> None:
    # A control step is 0.04 s: 0.12 s is every third step of an episode, in each environment.
    push = event(
        "push_articulation_by_setting_velocity",
        "interval",
        **CUBE,
        interval_range_s=[0.12, 0.12],
        velocity_range={"z": [5.0, 5.0]},
    )
    env = make(events={"push": push})
    env.reset()
    seen = []
    for step in range(8):
        if step == 4:
            env.reset(options={"reset_ids": [1]})
        before = velocity(env)[:, 2]
        env.step(hold(env))
        seen.append(velocity(env)[:, 2] - before > 3.0)
    expected = np.zeros((8, 3), bool)
    expected[[2, 5], 0] = expected[[2, 5], 2] = True
    expected[[2, 6], 1] = True
    assert np.array_equal(np.array(seen), expected)


def test_an_external_force_accelerates_until_the_next_draw(make) -> None:
    force = event(
        "apply_external_force_torque", **CUBE, force_range=[20.0, 20.0], torque_range=[-0.0, 0.0]
    )
    env, _ = build(make, force)
    # 1 kg, 20 N along every axis and gravity; damping 0.7/s takes under 3 % in 0.04 s.
    env.step(hold(env))
    lifted = velocity(env)[:, :3]
    assert np.allclose(lifted, np.tile([0.8, 0.8, 0.04 * (20 - 9.81)], (3, 1)), rtol=0.03)
    env.step(hold(env))
    assert np.allclose(velocity(env)[:, 0], 1.6, rtol=0.04)
    assert (env.sim.engine.state("xfrc_applied").sum(axis=1) == 60.0).all()
    env.sim.reset_objects_state(np.array([1]))
    assert env.sim.engine.state("xfrc_applied")[1].sum() == 0.0


def test_forces_on_links_reach_those_links(make) -> None:
    links = {"uid": "ur10", "link_names": ["forearm_link", "wrist_.*"]}
    env, drawn = build(
        make,
        event(
            "apply_external_force_torque",
            entity_cfg=links,
            force_range=[-5, 5],
            torque_range=[0.1, 0.2],
        ),
        num_envs=64,
    )
    wrench = drawn.last["wrench"].reshape(64, 4, 6)
    assert np.abs(wrench[..., :3]).max() <= 5 and np.abs(wrench[..., :3]).max() > 4.5
    assert wrench[..., 3:].min() >= 0.1 and wrench[..., 3:].max() <= 0.2
    applied = env.sim.engine.state("xfrc_applied").reshape(64, -1, 6)
    bodies = [env.robot.body_of(f) for f in ("forearm_link", "wrist_1_link", "wrist_3_link")]
    assert np.array_equal(applied[:, bodies], wrench[:, [0, 1, 3]])
    assert np.count_nonzero(applied.any(axis=(0, 2))) == 4


def test_an_impulse_begins_and_ends(make) -> None:
    # Control steps of 0.04 s: a rest of two steps, a push of three, and so on.
    push = event(
        "apply_body_impulse",
        "interval",
        **CUBE,
        force_range=[2.0, 3.0],
        torque_range=[0.0, 0.0],
        duration_s=[0.12, 0.12],
        cooldown_s=[0.08, 0.08],
    )
    env = make(events={"push": push})
    env.reset()
    body = env.sim.get_asset("cube").entity.root_body_id
    seen = []
    for step in range(9):
        if step == 4:
            env.reset(options={"reset_ids": [2]})
        env.step(hold(env))
        seen.append(env.sim.engine.state("xfrc_applied")[:, 6 * body : 6 * body + 6].copy())
    forces = np.array(seen)
    on = forces[:, :, 0] > 0
    assert on[:, 0].tolist() == [False, True, True, True, False, False, True, True, True]
    assert on[:, 2].tolist() == [False, True, True, True, False, True, True, True, False]
    assert (forces[on][:, :3] >= 2).all() and (forces[on][:, :3] < 3).all()
    assert not forces[..., 3:].any() and not forces[~on].any()


@pytest.mark.parametrize(
    ("what", "part"),
    [
        (
            event("reset_root_state_uniform", **CUBE, pose_range={"w": [0, 1]}),
            "expected one of 'x', 'y', 'z', 'roll', 'pitch', 'yaw'",
        ),
        (event("reset_root_state_uniform", **CUBE, pose_range={"x": [1, 0]}), "low 1.0 exceeds"),
        (
            event("reset_root_state_uniform", **ARM, velocity_range={"x": [0, 1]}),
            "'ur10' cannot get a velocity",
        ),
        (
            event(
                "push_by_setting_velocity",
                entity_cfg={"uid": "goal"},
                velocity_range={"x": [0, 1]},
            ),
            "'goal' cannot get a velocity",
        ),
        (event("push_by_setting_velocity", **CUBE, velocity_range={}), "names no axis"),
        (
            event(
                "push_articulation_by_setting_velocity",
                **CUBE,
                interval_range_s=[0, 1],
                velocity_range={"x": [0, 1]},
            ),
            "needs 0 < low",
        ),
        (
            event(
                "apply_body_impulse",
                **CUBE,
                force_range=[0, 1],
                torque_range=[0, 0],
                duration_s=[0, 1],
                cooldown_s=[1, 1],
            ),
            "duration_s: needs 0 < low",
        ),
        (event("apply_external_force_torque", **ARM), "the root of 'ur10' does not move"),
        (event("reset_joints_by_offset", **CUBE, position_range=[0, 1]), "'cube' has no joints"),
        (event("reset_joints_by_scale", **ARM, position_range=[2, 1]), "low 2.0 exceeds"),
    ],
)
def test_wrong_parameters(make, what, part) -> None:
    with pytest.raises(ConfigError) as caught:
        make(events={"e": what})
    assert part in str(caught.value)
