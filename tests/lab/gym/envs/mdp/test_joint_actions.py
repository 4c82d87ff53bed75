"""Joint actions on numbers worked by hand: scale, offset, clip, and where they go."""

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import ActionTermCfg
from embodichain.lab.sim.cfg import JointDrivePropertiesCfg, RobotCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.ur10_task import HOME, UR10


def act(func: str, **params) -> ActionTermCfg:
    entity = {"uid": "ur10", **params.pop("entity", {})}
    return ActionTermCfg(func=func, params={"entity_cfg": entity, **params})


def targets(env) -> np.ndarray:
    return env.robot.drives.read_target_qpos()


def step(env, row) -> None:
    env.step(torch.tensor(row, dtype=torch.float32).expand(env.num_envs, -1).contiguous())


def driven(gravcomp: float | None = None, **drives) -> dict:
    """A UR10 with these drives: sections of a task."""
    pros = JointDrivePropertiesCfg(**drives)
    robot = RobotCfg(
        uid="ur10",
        fpath=UR10,
        init_qpos=HOME,
        init_pos=(0, 0, 1),
        drive_pros=pros,
        gravcomp=gravcomp,
    )
    return {"robot": robot}


def test_scale_and_offset_of_absolute_positions(make) -> None:
    env = make(actions={"arm": act("joint_position", scale=0.5, offset={"Joint1": 0.1, ".*": 0})})
    limits = np.asarray(env.robot.parsed.qpos_limits)
    expected = limits / 0.5
    expected[0] -= 0.2  # (limit - 0.1) / 0.5
    assert np.allclose(env.action_manager.low, expected[:, 0], atol=1e-6)
    assert np.allclose(env.action_manager.high, expected[:, 1], atol=1e-6)
    env.reset()
    step(env, [0.4] * 6)
    assert np.allclose(targets(env), [0.3, 0.2, 0.2, 0.2, 0.2, 0.2], atol=1e-7)
    step(env, env.action_manager.home().tolist())
    assert np.allclose(targets(env), HOME, atol=1e-6)
    assert np.allclose(env.action_manager.hold(), env.action_manager.home(), atol=1e-6)


def test_actions_without_bounds_are_not_clamped(make) -> None:
    """2.5 times 0.1 is 0.25 from home, where [-1, 1] would leave 0.1."""
    free = act("joint_action", centre="home", scale=0.1, bounds=None)
    env = make(actions={"arm": free})
    assert (env.single_action_space.low == -np.inf).all()
    assert (env.single_action_space.high == np.inf).all()
    env.reset()
    step(env, [2.5, -2.5, 0, 0, 0, 0])
    assert np.allclose(targets(env) - HOME, [0.25, -0.25, 0, 0, 0, 0], atol=1e-7)
    bounded = make(actions={"arm": act("joint_action", centre="home", scale=0.1)})
    bounded.reset()
    step(bounded, [2.5, -2.5, 0, 0, 0, 0])
    assert np.allclose(targets(bounded) - HOME, [0.1, -0.1, 0, 0, 0, 0], atol=1e-7)
    both = act("joint_action", clip=[-1, 1], bounds=None)
    with pytest.raises(ConfigError, match=r"clip: bounds: null leaves the action without bounds"):
        make(actions={"arm": both})


def test_a_negative_scale_keeps_bounds_in_order(make) -> None:
    env = make(actions={"arm": act("joint_position", scale=-2.0, offset=1.0)})
    limits = np.asarray(env.robot.parsed.qpos_limits)
    assert np.allclose(env.action_manager.low, (limits[:, 1] - 1) / -2, atol=1e-6)


def test_lists_and_maps_give_one_value_a_joint(make) -> None:
    scale = {"Joint[12]": 0.1, "Joint6": 0.5, ".*": 1}
    clip = {"Joint[1-5]": [-1, 1], "Joint6": 0.5}  # one number is both sides
    term = act("default_offset_joint_position", scale=scale, clip=clip, offset=[0, 0, 0, 0, 0, 1])
    env = make(actions={"arm": term})
    assert np.allclose(env.action_manager.high, [1, 1, 1, 1, 1, 0.5])
    env.reset()
    step(env, [1.0, -2.0, 0.5, 0.0, 0.0, 9.0])
    expected = np.add(HOME, [0.1, -0.1, 0.5, 0, 0, 1 + 0.5 * 0.5])
    assert np.allclose(targets(env), expected, atol=1e-7)


def test_clip_as_pairs_of_each_joint(make) -> None:
    pairs = [[-1, 0], [0, 1], [-2, 2], [-3, 3], [-4, 4], [-5, 5]]
    env = make(actions={"arm": act("joint_position", clip=pairs)})
    assert env.action_manager.low.tolist() == [-1, 0, -2, -3, -4, -5]
    assert env.action_manager.high.tolist() == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize(
    ("params", "path", "part"),
    [
        ({"scale": {"Jiont1": 2}}, "scale.Jiont1", "there are: Joint1, Joint2"),
        ({"offset": {"elbow": 1}}, "offset.elbow", "no joint of this term matches 'elbow'"),
        ({"scale": {"Joint.*": 1, "Joint1": 2}}, "scale.Joint1", "matched by 'Joint.*' as well"),
        ({"scale": {"Joint[": 1}}, "scale.Joint[", "malformed regex"),
        ({"scale": "much"}, "scale", "must be a finite number"),
        ({"scale": [1, 2]}, "scale", "one value or 6"),
        ({"clip": {"Joint1": [-1, 1]}}, "clip", "says nothing about joints: Joint2"),
        ({"clip": [1, 2, 3]}, "clip", r"must be \[low, high\]"),
        ({"clip": [[-1, 1]]}, "clip", "one value or 6"),
        ({"offset": float("nan")}, "offset", "finite"),
        ({"scale": {}}, "scale", "must be a finite number"),
    ],
)
def test_wrong_values_are_named(make, params, path, part) -> None:
    with pytest.raises(ConfigError, match=part) as caught:
        make(actions={"arm": act("default_offset_joint_position", **params)})
    assert caught.value.problems[0].path == f"actions.arm.params.{path}"


def test_relative_to_the_target_does_not_sag(make) -> None:
    soft = JointDrivePropertiesCfg(stiffness=300, damping=60)
    robot = RobotCfg(uid="ur10", fpath=UR10, init_qpos=HOME, init_pos=(0, 0, 1), drive_pros=soft)
    found = {}
    for reference in ("qpos", "target"):
        env = make(
            robot=robot,
            actions={"arm": act("relative_joint_position", scale=0.1, reference=reference)},
        )
        env.reset()
        for _ in range(10):
            step(env, [0.0] * 6)
        found[reference] = np.abs(targets(env) - HOME).max()
    assert found["target"] < 1e-12 and found["qpos"] > 0.02
    step(env, [1.0, 0, 0, 0, 0, 0])
    assert np.allclose(targets(env) - HOME, [0.1, 0, 0, 0, 0, 0], atol=1e-9)


def test_relative_offset_drifts_and_home_undoes_it(make) -> None:
    env = make(actions={"arm": act("relative_joint_position", scale=0.5, offset=0.1)})
    env.reset()
    before = env.robot.read_qpos().copy()
    step(env, [0.0] * 6)
    assert np.allclose(targets(env), before + 0.1, atol=1e-9)
    assert np.allclose(env.action_manager.home(), -0.2)


def test_to_limits(make) -> None:
    env = make(
        actions={"arm": act("joint_position_to_limits", entity={"joint_names": "Joint[13]"})}
    )
    low, high = np.asarray(env.robot.parsed.qpos_limits)[[0, 2]].T
    assert env.action_manager.low.tolist() == [-1, -1]
    env.reset()
    for u in (-1.0, 0.5, 1.0, 7.0):
        step(env, [u, u])
        share = (min(u, 1.0) + 1) / 2
        assert np.allclose(targets(env)[:, [0, 2]], low + (high - low) * share, atol=1e-7)
    home = env.action_manager.home()
    step(env, home.tolist())
    assert np.allclose(targets(env)[:, [0, 2]], np.array(HOME)[[0, 2]], atol=1e-6)
    assert np.allclose(env.action_manager.hold(), home, atol=1e-6)


def test_to_limits_with_range_and_scale(make) -> None:
    env = make(actions={"arm": act("joint_position_to_limits", range=[0, 1], scale=2.0)})
    assert env.action_manager.high.tolist() == [0.5] * 6
    low, high = np.asarray(env.robot.parsed.qpos_limits).T
    env.reset()
    step(env, [0.25] * 6)  # half of the range
    assert np.allclose(targets(env), (low + high) / 2, atol=1e-7)


def test_to_limits_needs_a_range(make) -> None:
    with pytest.raises(ConfigError, match="low equals high"):
        make(actions={"arm": act("joint_position_to_limits", range=[1, 1])})


@pytest.mark.parametrize("stiffness", [1e4, 500.0])
def test_velocity_of_stiff_drives(make, stiffness) -> None:
    env = make(
        **driven(stiffness=stiffness, damping=stiffness / 10),
        actions={"arm": act("joint_velocity", scale=0.5)},
    )
    env.reset()
    places = []
    for _ in range(25):  # one second
        step(env, [0.4, 0, 0, 0, 0, -0.4])
        places.append(env.robot.read_qpos()[0] - HOME)
    moved = places[-1]
    assert np.allclose(targets(env)[:, [0, 5]] - np.array(HOME)[[0, 5]], [[0.2, -0.2]], atol=1e-6)
    assert np.allclose(moved[[0, 5]], [0.2, -0.2], atol=0.03)
    speed = (places[-1] - places[-11]) / 0.4  # over ten control steps
    assert np.allclose(speed[[0, 5]], [0.2, -0.2], atol=0.015)
    before = targets(env).copy()
    step(env, env.action_manager.hold()[0].tolist())
    assert np.allclose(targets(env), before, atol=1e-12)
    env.reset()
    assert not env.robot.body_data.target_qvel.any()


def test_a_blocked_velocity_target_does_not_run_away(make) -> None:
    env = make(
        **driven(gravcomp=1, stiffness=1000.0, damping=50.0, max_effort=20.0),
        actions={"arm": act("joint_velocity")},
    )
    env.reset()
    for _ in range(8):
        step(env, [1.0] * 6)
    lead = targets(env) - env.robot.read_qpos()
    assert np.abs(lead).max() < 20 / 1000 + 1.0 * 0.04 + 0.03


def test_velocity_of_a_drive_without_stiffness(make) -> None:
    env = make(
        **driven(stiffness=0.0, damping=200.0, max_effort=50.0, armature=4.0),
        actions={"wrist": act("joint_velocity", entity={"joint_names": "Joint6"}, scale=0.5)},
    )
    env.reset()
    assert np.array_equal(env.robot.read_qvel(), np.zeros((3, 6)))  # a control of 0 is no motion
    env.sim.update(step=1)
    env.robot.set_qvel(torch.full((3, 1), 0.5), joint_ids=[5])
    env.sim.engine.forward()  # 200 x 0.5 = 100 is more than 50
    assert np.allclose(env.robot.read_qf()[:, 5], 50.0, atol=0.5)
    for _ in range(10):
        step(env, [1.0])
    assert np.allclose(env.robot.read_qvel()[:, 5], 0.5, atol=0.01)
    assert np.abs(env.robot.read_qf()[:, 5]).max() < 10.0  # at speed there is nothing to push


def test_a_velocity_drive_becomes_a_position_drive_and_back(make) -> None:
    env = make(
        **driven(stiffness=0.0, damping=200.0),
        actions={"arm": act("default_offset_joint_position")},
    )
    env.reset()
    one = torch.ones((3, 6))
    env.robot.set_joint_drive(stiffness=1e4 * one, damping=1e3 * one)
    env.reset()  # the controls are targets now: the initial positions
    assert np.allclose(targets(env), HOME)
    for _ in range(5):
        step(env, [0.0] * 6)
    assert np.allclose(env.robot.read_qpos(), HOME, atol=0.02)
    env.robot.set_joint_drive(stiffness=0 * one)
    env.reset()
    assert not env.sim.engine.state("ctrl").any()


def test_position_targets_move_no_faster_than_max_velocity(make) -> None:
    limits = {"Joint[12]": 1.0, "Joint3": 2e9}  # rad/s; a control step takes 0.04 s
    for name in ("default_offset_joint_position", None):
        actions = {} if name is None else {"arm": act(name)}
        env = make(**driven(max_velocity=limits), actions=actions)
        env.reset()
        row = [1.0] * 6 if name else (np.array(HOME) + 1.0).tolist()
        step(env, row)
        expected = [0.04, 0.04, 1, 1, 1, 1]
        assert np.allclose(targets(env) - HOME, expected, atol=1e-6), name
        for _ in range(30):
            step(env, row)
        assert np.allclose(targets(env) - HOME, 1.0, atol=1e-5)
        # The joint itself is not clamped: pushed, it is faster.
        env.robot.set_qvel(torch.full((3, 6), 3.0), target=False)
        assert env.robot.get_qvel()[0, 0].item() == pytest.approx(3.0)
        env.close()


def test_a_max_velocity_set_in_one_environment_bounds_its_targets(make) -> None:
    env = make(**driven(), actions={"arm": act("default_offset_joint_position")})
    env.reset()
    before = env.state_dict()
    slow = torch.full((1, 6), 1.0)  # rad/s; a control step takes 0.04 s
    env.robot.set_joint_drive(max_velocity=slow, env_ids=[1])
    step(env, [0.5] * 6)
    moved = targets(env) - HOME
    assert np.allclose(moved[1], 0.04, atol=1e-6)
    assert np.allclose(moved[[0, 2]], 0.5, atol=1e-6)
    bounded = env.state_dict()
    env.load_state_dict(before)
    step(env, [0.5] * 6)
    assert np.allclose(targets(env) - HOME, 0.5, atol=1e-6), "the limit was not restored"
    env.load_state_dict(bounded)
    step(env, [0.5] * 6)
    assert np.allclose((targets(env) - HOME)[1], 0.08, atol=1e-6)


def test_the_files_velocity_limits_bound_targets_and_velocity_actions(make) -> None:
    env = make(**driven(max_velocity="file"), actions={"arm": act("joint_velocity", clip=9)})
    file = env.robot.parsed.qvel_limits
    assert env.robot.drives.max_velocity[0].tolist() == file.tolist()
    env.reset()
    before = targets(env).copy()
    step(env, [9.0] * 6)
    assert np.allclose(targets(env) - before, 0.04 * file, atol=1e-9)
    unlimited = make(**driven(), actions={"arm": act("joint_velocity", clip=9)})
    assert (unlimited.robot.drives.max_velocity == 1e10).all()  # null is the default


def test_velocity_needs_something_to_drive_with(make) -> None:
    with pytest.raises(ConfigError, match="neither stiffness nor damping"):
        make(**driven(stiffness=0.0, damping=0.0), actions={"arm": act("joint_velocity")})


def test_effort_is_applied_and_limited(make) -> None:
    env = make(
        **driven(stiffness=0.0, damping=0.0, max_effort={".*": 30.0, "Joint6": 2.0}),
        actions={"arm": act("joint_effort", scale=10.0, offset={"Joint1": 1.0, ".*": 0.0}, clip=5)},
    )
    assert env.action_manager.high.tolist() == [5.0] * 6
    env.reset()
    step(env, [0.5, -1, -9, 2, 0, 1])
    applied = env.sim.engine.state("qfrc_applied")[:, env.robot.entity.dof_adr]
    assert np.allclose(applied, [6.0, -10, -30, 20, 0, 2])
    assert np.allclose(env.action_manager.hold()[0], [-0.1, 0, 0, 0, 0, 0])
    env.reset()
    assert not env.sim.engine.state("qfrc_applied").any()


def test_effort_without_drives_obeys_the_files_limits(make, caplog) -> None:
    env = make(**driven(drive_type="none"), actions={"arm": act("joint_effort", scale=1000.0)})
    env.reset()
    step(env, [1.0] * 6)
    applied = env.sim.engine.state("qfrc_applied")[0, env.robot.entity.dof_adr]
    assert applied.tolist() == [330, 330, 150, 56, 56, 56]
    assert not caplog.records


def test_effort_beside_stiff_drives_warns(make, caplog) -> None:
    env = make(actions={"arm": act("joint_effort", entity={"joint_names": "Joint1"})})
    assert "joints Joint1 have a drive with stiffness" in caplog.text
    env.reset()
    step(env, [1.0])
