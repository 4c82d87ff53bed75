"""Where events put things, against what was drawn and what is declared."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from embodichain.lab.gym.envs.cfg import EventCfg
from embodichain.lab.gym.envs.observers import StepObserver
from embodichain.utils.errors import ConfigError
from tests.helpers.ur10_task import CUBE_POS, HOME

BOX = [[-0.1, -0.2, 0.1], [0.1, 0.2, 0.3]]


class Drawn(StepObserver):
    def __init__(self) -> None:
        self.last = {}

    def on_event(self, env, event) -> None:
        self.last = dict(event.drawn)


def pose_event(uid: str = "goal", **params) -> EventCfg:
    return EventCfg(
        func="randomize_rigid_object_pose",
        mode="reset",
        params={"entity_cfg": {"uid": uid}, **params},
    )


def build(make, event: EventCfg, **sections):
    env = make(events={"e": event}, **sections)
    drawn = Drawn()
    env.add_observer(drawn)
    env.reset()
    return env, drawn


def poses(env, uid: str) -> tuple[np.ndarray, np.ndarray]:
    pos, quat = env.sim.get_asset(uid).read_pose()
    return pos.copy(), quat.copy()


def test_absolute_position_is_what_was_drawn(make) -> None:
    env, drawn = build(make, pose_event(position_range=BOX, relative_position=False), num_envs=64)
    pos, quat = poses(env, "goal")
    assert np.array_equal(pos, drawn.last["position"])
    assert (pos >= BOX[0]).all() and (pos <= BOX[1]).all()
    # Uniform over the box: mean within 4 standard errors, and the range is nearly used up.
    size = np.subtract(BOX[1], BOX[0])
    assert (np.abs(pos.mean(0) - np.mean(BOX, 0)) < 4 * size / np.sqrt(12 * 64)).all()
    assert (np.ptp(pos, axis=0) > 0.85 * size).all()
    assert np.array_equal(quat, np.tile([1.0, 0, 0, 0], (64, 1)))


def test_relative_position_moves_the_declared_one(make) -> None:
    env, drawn = build(make, pose_event("cube", position_range=BOX))
    pos, quat = poses(env, "cube")
    offset = pos - CUBE_POS
    assert (offset >= np.array(BOX[0]) - 1e-12).all() and (offset <= BOX[1]).all()
    assert np.allclose(drawn.last["position"], pos, atol=0)
    assert np.allclose(np.abs(quat), np.sqrt(0.5) * np.array([1, 0, 0, 1]), atol=1e-12)


def test_no_drift_over_resets(make) -> None:
    env, _ = build(make, pose_event("cube", position_range=BOX))
    for _ in range(300):
        env.reset()
    offset = poses(env, "cube")[0] - CUBE_POS
    assert (offset >= np.array(BOX[0]) - 1e-12).all() and (offset <= BOX[1]).all()


def test_a_range_of_zero_changes_no_bit(make) -> None:
    plain = make()
    plain.reset()
    zero = [[0, 0, 0], [0, 0, 0]]
    env, _ = build(
        make,
        pose_event("cube", position_range=zero, rotation_range=zero, relative_rotation=True),
    )
    assert np.array_equal(env.sim.engine.rows, plain.sim.engine.rows)


def test_rotation_is_intrinsic_xyz_in_degrees(make) -> None:
    turn = [[30, 40, 50], [30, 40, 50]]
    env, drawn = build(make, pose_event("cube", rotation_range=turn))
    expected = Rotation.from_euler("XYZ", [30, 40, 50], degrees=True).as_quat(scalar_first=True)
    assert np.allclose(poses(env, "cube")[1], expected, atol=1e-12)
    assert np.allclose(drawn.last["rotation"], np.deg2rad([30, 40, 50]), atol=1e-12)


def test_relative_rotation_turns_in_the_objects_frame(make) -> None:
    turn = [[30, 40, 50], [30, 40, 50]]
    env, _ = build(make, pose_event("cube", rotation_range=turn, relative_rotation=True))
    first = Rotation.from_euler("z", 90, degrees=True)
    expected = first * Rotation.from_euler("XYZ", [30, 40, 50], degrees=True)
    found = Rotation.from_quat(poses(env, "cube")[1], scalar_first=True)
    assert np.allclose(found.as_matrix(), expected.as_matrix(), atol=1e-12)


def test_relative_to_a_link_where_it_stands_now(make) -> None:
    near = {"uid": "ur10", "link_names": ["ee_link"]}
    env, drawn = build(make, pose_event(position_range=BOX, relative_to=near))
    link = env.robot.get_link_pose("ee_link")[:, :3].numpy()
    pos = poses(env, "goal")[0]
    assert np.allclose(pos, link + drawn.last["position"], atol=1e-6)


def test_relative_to_an_object_alone(make) -> None:
    env, drawn = build(make, pose_event(relative_to={"uid": "cube"}))
    assert np.array_equal(poses(env, "goal")[0], np.tile(CUBE_POS, (3, 1)))
    assert drawn.last == {}


def test_some_environments_leave_the_others_alone(make) -> None:
    event = pose_event("cube", position_range=BOX, rotation_range=[[-9] * 3, [9] * 3])
    env, _ = build(make, event)
    before = env.sim.engine.rows.copy()
    env.reset(options={"reset_ids": [1]})
    after = env.sim.engine.rows
    assert np.array_equal(before[[0, 2]], after[[0, 2]])
    assert not np.array_equal(before[1], after[1])


def test_a_dynamic_object_stands_still_afterwards(make) -> None:
    env = make(events={"e": pose_event("cube", position_range=BOX)})
    env.reset()
    cube = env.sim.get_asset("cube")
    cube.set_velocity(np.ones((3, 3)), np.ones((3, 3)))
    env.event_manager.apply("reset", np.array([0, 2]))
    speed = cube.body_data.vel.abs().sum(1)
    assert speed[[0, 2]].tolist() == [0.0, 0.0]
    assert speed[1] > 1.0


@pytest.mark.parametrize(
    ("event", "part"),
    [
        (pose_event("ur10"), "'ur10' is not a rigid object"),
        (
            pose_event(relative_to={"uid": "cube"}, relative_position=False),
            "relative_to needs relative_position",
        ),
        (pose_event(position_range=[[0, 0], [1, 1]]), "at least 3 items"),
        (pose_event(position_range=[[0, 0, float("nan")], [1, 1, 1]]), "finite number"),
        (pose_event(rotation_range=[[0, 0, 0]]), "at least 2 items"),
    ],
)
def test_wrong_parameters_of_poses(make, event, part) -> None:
    with pytest.raises(ConfigError) as caught:
        make(events={"e": event})
    assert part in str(caught.value)


def qpos_event(**params) -> EventCfg:
    return EventCfg(
        func="randomize_robot_qpos",
        params={"entity_cfg": {"uid": "ur10", **params.pop("entity", {})}, **params},
    )


def test_joints_and_their_targets_move_around_home(make) -> None:
    env, drawn = build(make, qpos_event(qpos_range=[-0.1, 0.2]))
    qpos = env.robot.read_qpos()
    assert np.allclose(qpos, np.array(HOME) + drawn.last["position"], atol=1e-12)
    assert np.array_equal(env.robot.drives.read_target_qpos(), qpos)
    assert drawn.last["position"].min() >= -0.1 and drawn.last["position"].max() <= 0.2
    assert len(np.unique(qpos)) == 18


def test_some_joints_absolutely_and_clamped(make) -> None:
    event = qpos_event(
        entity={"joint_names": ["Joint2", "Joint3"]},
        qpos_range=[[-0.5, 99.0], [-0.4, 99.0]],
        relative_qpos=False,
    )
    env, _ = build(make, event)
    qpos = env.robot.read_qpos()
    upper = np.asarray(env.robot.parsed.qpos_limits)[2, 1]
    assert ((qpos[:, 1] >= -0.5) & (qpos[:, 1] < -0.4)).all()
    assert (qpos[:, 2] == upper).all()
    assert np.allclose(qpos[:, [0, 3, 4, 5]], np.array(HOME)[[0, 3, 4, 5]])


@pytest.mark.parametrize(
    ("event", "part"),
    [
        (qpos_event(qpos_range=[0.1, -0.1]), "low 0.1 exceeds high -0.1"),
        (qpos_event(qpos_range=[[0.0] * 5, [1.0] * 5]), "two rows of 6 values"),
        (qpos_event(qpos_range=[0.0, 1.0], joint_ids=[7]), "has 6 joints"),
        (
            EventCfg(
                func="randomize_robot_qpos",
                params={"entity_cfg": {"uid": "cube"}, "qpos_range": [0, 1]},
            ),
            "'cube' has no joints",
        ),
    ],
)
def test_wrong_parameters_of_joints(make, event, part) -> None:
    with pytest.raises(ConfigError) as caught:
        make(events={"e": event})
    assert part in str(caught.value)
