"""Where roots, tools and targets are put, against MuJoCo's own kinematics and what was drawn."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from embodichain.lab.gym.envs.cfg import EventCfg
from embodichain.lab.gym.envs.mdp._tools import arm_solver
from embodichain.lab.gym.envs.observers import StepObserver
from embodichain.utils.errors import ConfigError
from tests.helpers.ur10_task import CUBE_POS, GOAL_POS, HOME
from tests.lab.gym.envs.mdp.test_events import build, poses

BOX = [[-0.1, -0.2, 0.1], [0.1, 0.2, 0.3]]
ARM = {"entity_cfg": {"uid": "ur10"}}
TOOL = {"entity_cfg": {"uid": "ur10", "link_names": ["ee_link"]}}


def event(func: str, mode: str = "reset", **params) -> EventCfg:
    return EventCfg(func=func, mode=mode, params=params)


def tool(env) -> tuple[np.ndarray, np.ndarray]:
    engine, body = env.sim.engine, env.robot.body_of("ee_link")
    return engine.derived("xpos")[:, body].copy(), engine.derived("xquat")[:, body].copy()


def rotation(quat: np.ndarray) -> Rotation:
    return Rotation.from_quat(quat, scalar_first=True)


def test_a_robots_root_moves_with_its_links(make) -> None:
    plain = make()
    plain.reset()
    env, drawn = build(
        make,
        event(
            "randomize_articulation_root_pose",
            **ARM,
            position_range=BOX,
            rotation_range=[[0, 0, 90], [0, 0, 90]],
        ),
    )
    pos, quat = poses(env, "ur10")
    assert np.allclose(pos, drawn.last["position"]) and np.allclose(pos[:, 2], 1, atol=0.31)
    assert np.allclose(rotation(quat).as_euler("xyz", degrees=True), [0, 0, 90], atol=1e-9)
    home = tool(plain)[0] - poses(plain, "ur10")[0]
    turned = np.stack([-home[:, 1], home[:, 0], home[:, 2]], axis=1)
    assert np.allclose(tool(env)[0] - pos, turned, atol=1e-9)
    for _ in range(50):
        env.reset()
    offset = poses(env, "ur10")[0] - [0, 0, 1]
    assert (offset >= np.array(BOX[0]) - 1e-12).all() and (offset <= BOX[1]).all()


def test_physics_may_run_after_placing(make) -> None:
    params = {"entity_cfg": {"uid": "cube"}, "position_range": [[0, 0, 1], [0, 0, 1]]}
    env = make(events={"e": event("randomize_rigid_object_pose", **params, physics_update_step=10)})
    env.reset()
    # Free fall for 10 steps of 0.01 s, velocity first, damping 0.7/s: within 5 % of g t^2 / 2.
    fallen = CUBE_POS[2] + 1 - poses(env, "cube")[0][:, 2]
    assert np.allclose(fallen, 9.81 * 0.01**2 * 55, rtol=0.05)
    before = env.sim.engine.rows[[0, 2]].copy()
    env.reset(options={"reset_ids": [1]})
    assert np.array_equal(env.sim.engine.rows[[0, 2]], before)


@pytest.mark.parametrize("observed", [False, True])
def test_an_unchanged_orientation_is_not_written_for_observers(
    make, monkeypatch, observed: bool
) -> None:
    params = {"entity_cfg": {"uid": "goal"}, "position_range": BOX}
    move = EventCfg("randomize_rigid_object_pose", params, mode="interval", interval_step=1)
    env = make(events={"e": move})
    if observed:
        env.add_observer(StepObserver())
    engine, written = env.sim.engine, list[str]()
    turned = np.tile([0.0, 1.0, 0.0, 0.0], engine.state("mocap_quat").shape[1] // 4)
    action = torch.zeros(env.action_space.shape)
    write = engine.write

    def watched(field: str, *args: object) -> None:
        written.append(field)
        write(field, *args)

    vars(engine)["write"] = watched

    def fields_of_a_step() -> set[str]:
        written.clear()
        env.step(action)
        assert np.array_equal(poses(env, "goal")[1], np.tile([1.0, 0, 0, 0], (3, 1)))
        return {field for field in written if field.startswith("mocap")}

    both = {"mocap_pos", "mocap_quat"}
    unchanged = {"mocap_pos"} if observed else both
    env.reset()
    env.step(action)
    assert fields_of_a_step() == unchanged
    write("mocap_quat", turned, np.array([1]))
    assert fields_of_a_step() == both
    assert fields_of_a_step() == unchanged
    rows = engine.rows.copy()
    rows[:, engine.component("mocap_quat")] = turned
    write("row", rows)
    assert fields_of_a_step() == both
    env.reset(options={"reset_ids": [2]})
    assert fields_of_a_step() == unchanged  # the reset has turned it back


def test_the_tool_is_moved_and_turned_by_the_draw(make) -> None:
    plain = make(num_envs=32)
    plain.reset()
    env, drawn = build(
        make,
        event(
            "randomize_robot_eef_pose",
            **TOOL,
            position_range=[[-0.1] * 3, [0.1] * 3],
            rotation_range=[[-20] * 3, [20] * 3],
        ),
        num_envs=32,
    )
    (pos, quat), (pos0, quat0) = tool(env), tool(plain)
    assert np.abs(pos - pos0 - drawn.last["position"]).max() < 5e-4
    wanted = rotation(quat0) * Rotation.from_euler("XYZ", drawn.last["rotation"])
    assert (wanted.inv() * rotation(quat)).magnitude().max() < 5e-4
    assert np.array_equal(env.robot.drives.read_target_qpos(), env.robot.read_qpos())
    size = np.ptp(pos - pos0, axis=0)
    assert (size > 0.17).all() and (size < 0.2).all()


def test_out_of_reach_keeps_the_joints(make) -> None:
    far = [[3.0, 0, 0], [3.0, 0, 0]]
    env, _ = build(make, event("randomize_robot_eef_pose", **TOOL, position_range=far))
    assert np.array_equal(env.robot.read_qpos(), np.tile(HOME, (3, 1)))


def test_without_a_link_the_tool_is_the_farthest_one(make) -> None:
    env = make()
    arm = arm_solver(env.scene_entity(ARM["entity_cfg"]))
    assert arm.chain.body == env.robot.body_of("ee_link")
    assert list(arm.moving) == [0, 1, 2, 3, 4, 5]
    wrist = {"uid": "ur10", "joint_names": "Joint[56]", "link_names": "wrist_3_link"}
    assert list(arm_solver(env.scene_entity(wrist)).moving) == [4, 5]


def test_targets_are_matrices_on_the_environment(make) -> None:
    what = event("randomize_target_pose", position_range=BOX, store_key="goal_pose")
    env, drawn = build(make, what)
    assert env.goal_pose.dtype == torch.float32
    expected = np.tile(np.eye(4), (3, 1, 1))
    expected[:, :3, 3] = drawn.last["position"]
    assert np.allclose(env.goal_pose.numpy(), expected, atol=1e-7)
    kept = env.goal_pose
    copy = kept.clone()
    env.reset(options={"reset_ids": [1]})
    assert torch.equal(kept, copy), "a tensor that was handed out changed"
    assert torch.equal(env.goal_pose[[0, 2]], copy[[0, 2]])
    assert not torch.equal(env.goal_pose[1], copy[1])


def test_targets_near_an_entity(make) -> None:
    what = event(
        "randomize_target_pose",
        position_range=[[0, 0, 0.2], [0, 0, 0.2]],
        rotation_range=[[0, 0, 30], [0, 0, 30]],
        relative_position=True,
        relative_rotation=True,
        reference_entity_cfg={"uid": "cube"},
    )
    env, _ = build(make, what)
    pose = env.target_pose[0].numpy()
    assert np.allclose(pose[:3, 3], np.add(CUBE_POS, [0, 0, 0.2]), atol=1e-6)
    angle = np.degrees(np.arctan2(pose[1, 0], pose[0, 0]))
    assert abs(angle - 120) < 1e-4  # the cube starts at 90 degrees


def test_targets_are_uniform_over_the_box(make) -> None:
    what = event("randomize_target_pose", position_range=BOX)
    env, _ = build(make, what, num_envs=256)
    found = env.target_pose[:, :3, 3].numpy()
    size = np.subtract(BOX[1], BOX[0])
    assert (found >= np.float32(BOX[0])).all() and (found <= np.float32(BOX[1])).all()
    assert (np.abs(found.mean(0) - np.mean(BOX, 0)) < 4 * size / np.sqrt(12 * 256)).all()


def test_a_restored_environment_has_its_targets(make) -> None:
    env, _ = build(make, event("randomize_target_pose", position_range=BOX))
    saved, first = env.state_dict(), env.target_pose.clone()
    env.reset()
    assert not torch.equal(env.target_pose, first)
    env.load_state_dict(saved)
    assert torch.equal(env.target_pose, first)


@pytest.mark.parametrize(
    ("what", "part"),
    [
        (
            event("randomize_articulation_root_pose", entity_cfg={"uid": "cube"}),
            "'cube' is not a robot",
        ),
        (
            event("randomize_rigid_object_pose", **ARM, physics_update_step=-2),
            "at least -1",
        ),
        (
            event("randomize_robot_eef_pose", entity_cfg={"uid": "cube"}),
            "'cube' has no joints",
        ),
        (
            event(
                "randomize_robot_eef_pose",
                entity_cfg={"uid": "ur10", "link_names": ["wrist.*"]},
            ),
            "cannot tell which link is the tool",
        ),
        (
            event(
                "randomize_robot_eef_pose",
                entity_cfg={"uid": "ur10", "joint_names": "Joint6", "link_names": "forearm_link"},
            ),
            "none of the picked joints moves 'forearm_link'",
        ),
        (
            event("randomize_target_pose", position_range=BOX, relative_position=True),
            "needs reference_entity_cfg",
        ),
        (
            event("randomize_target_pose", position_range=BOX, store_key="sim"),
            "taken by the environment",
        ),
    ],
)
def test_wrong_parameters(make, what, part) -> None:
    with pytest.raises(ConfigError) as caught:
        make(events={"e": what})
    assert part in str(caught.value)


def reach_event(**params) -> EventCfg:
    return event(
        "sample_rigid_object_pose_from_workspace",
        robot_cfg=TOOL["entity_cfg"],
        entity_cfg={"uid": "goal"},
        **params,
    )


def test_objects_are_placed_where_the_tool_can_reach(make) -> None:
    # The base stands at z = 1; the arm's links are 0.612 + 0.5723 m long, its wrist about 0.2 m.
    what = reach_event(
        position_bounds=[[-2, -2, 0], [2, 2, 3]], rotation_range=[[0, 0, 45], [0, 0, 45]]
    )
    env, _ = build(make, what, num_envs=64)
    pos, quat = poses(env, "goal")
    assert len(np.unique(pos[:, 0])) == 64
    far = np.linalg.norm(pos - [0, 0, 1.1273], axis=1)
    assert far.max() < 1.4 and far.mean() > 0.7
    assert np.allclose(rotation(quat).as_euler("xyz", degrees=True), [0, 0, 45], atol=1e-9)


def test_positions_out_of_reach_are_drawn_again(make) -> None:
    # Only a tenth of this box is within reach; the height is fixed.
    what = reach_event(position_bounds=[[0.8, -0.2, 0], [6.0, 0.2, 0]], reference_height=1.2)
    env, _ = build(make, what, num_envs=32)
    pos = poses(env, "goal")[0]
    assert (pos[:, 2] == 1.2).all() and (pos[:, 0] < 1.4).all()


def test_an_object_stays_if_nothing_is_within_reach(make) -> None:
    what = reach_event(position_bounds=[[5, 5, 5], [6, 6, 6]], max_attempts=3)
    env, _ = build(make, what)
    assert np.array_equal(poses(env, "goal")[0], np.tile(GOAL_POS, (3, 1)))
