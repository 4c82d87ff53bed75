"""Action terms own consecutive slices; what they write are drive targets."""

import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import ActionTermCfg
from embodichain.lab.gym.envs.managers import ActionTerm
from embodichain.lab.sim.cfg import JointDrivePropertiesCfg, RobotCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.ur10_task import HOME, UR10


def arm(func: str = "joint_position", **params) -> ActionTermCfg:
    entity = {"uid": "ur10", **params.pop("entity", {})}
    return ActionTermCfg(func=func, params={"entity_cfg": entity, **params})


def targets(env) -> np.ndarray:
    return env.robot.drives.read_target_qpos()


def test_absolute_positions_become_targets(make) -> None:
    env = make(actions={"arm": arm()})
    assert env.single_action_space.shape == (6,)
    assert np.array_equal(
        env.single_action_space.high, env.robot.parsed.qpos_limits[:, 1].astype("f")
    )
    env.reset()
    action = torch.from_numpy(env.action_space.sample()) * 0.3
    env.step(action)
    assert np.array_equal(targets(env), action.numpy().astype(np.float64))


def test_default_offset_clips_then_scales(make) -> None:
    env = make(
        actions={"arm": arm("default_offset_joint_position", scale=0.5, clip=[-2, 1], offset=0.1)}
    )
    assert np.array_equal(env.single_action_space.low, np.full(6, -2, np.float32))
    env.reset()
    env.step(torch.tensor([[0.5, 0.0, -2.0, -9.0, 9.0, 1.0]]).repeat(3, 1))
    expected = np.array(HOME) + 0.1 + 0.5 * np.array([0.5, 0.0, -2.0, -2.0, 1.0, 1.0])
    assert np.allclose(targets(env), expected, atol=1e-12)


def test_relative_adds_to_the_present_position(make) -> None:
    env = make(actions={"arm": arm("relative_joint_position", scale=[0.1] * 6)})
    env.reset()
    env.robot.set_qpos(np.tile(HOME, (3, 1)) + 0.2, target=False)
    before = env.robot.read_qpos().copy()
    env.step(torch.ones(3, 6))
    assert np.allclose(targets(env), before + 0.1, atol=1e-12)


def test_errors_name_the_alias_that_the_config_names(make) -> None:
    """On the way without a shape too: its curricula read the parameters that the alias has."""
    spec = make(actions={"arm": arm()}).action_manager.terms["arm"].spec
    assert spec.label == "action term 'joint_position'"
    assert spec.place.endswith(":JointAction as joint_position")


def test_terms_own_consecutive_slices(make) -> None:
    env = make(
        actions={
            "wrist": arm(entity={"joint_names": "Joint[456]"}),
            "rest": arm("relative_joint_position", entity={"joint_names": "Joint[123]"}, scale=0.1),
        }
    )
    assert env.action_manager.slices == {"wrist": slice(0, 3), "rest": slice(3, 6)}
    assert env.action_manager.names == tuple(
        f"{t}/Joint{i}"
        for t, i in zip(["wrist"] * 3 + ["rest"] * 3, [4, 5, 6, 1, 2, 3], strict=True)
    )
    env.reset()
    env.step(torch.tensor([[0.1, 0.2, 0.3, 1.0, 0.0, -1.0]]).repeat(3, 1))
    expected = [HOME[0] + 0.1, HOME[1], HOME[2] - 0.1, 0.1, 0.2, 0.3]
    assert np.allclose(targets(env), expected, atol=1e-7)


@pytest.mark.parametrize("func", ["joint_position", "default_offset_joint_position"])
def test_home_and_hold(make, func) -> None:
    env = make(actions={"arm": arm(func)})
    env.reset()
    home = torch.from_numpy(np.tile(env.action_manager.home(), (3, 1)).astype(np.float32))
    env.step(home)
    assert np.allclose(targets(env), HOME, atol=1e-6)
    env.step(home + 0.25)
    held = targets(env).copy()
    env.step(torch.from_numpy(env.action_manager.hold().astype(np.float32)))
    assert np.allclose(targets(env), held, atol=1e-6)


def test_relative_holds_at_zero(make) -> None:
    env = make(actions={"arm": arm("relative_joint_position")})
    env.reset()
    assert not env.action_manager.hold().any()


@pytest.mark.parametrize(
    ("term", "path", "part"),
    [
        (arm(scael=1.0), "actions.arm.params.scael", "unknown parameter"),
        (
            arm("default_offset_joint_position", scale=[1.0, 2.0]),
            "actions.arm.params.scale",
            "one value or 6",
        ),
        (arm("default_offset_joint_position", scale=0.0), "actions.arm.params.scale", "not be 0"),
        (
            arm("default_offset_joint_position", clip=[1, -1]),
            "actions.arm.params.clip",
            "low 1.0 exceeds high -1.0",
        ),
        (
            arm("default_offset_joint_position", clip=[1, 1]),
            "actions.arm.params.clip",
            "low 1.0 equals high 1.0",
        ),
        (
            ActionTermCfg(func="joint_position", params={"entity_cfg": {"uid": "cube"}}),
            "actions.arm.params.entity_cfg.uid",
            "has no joints",
        ),
    ],
)
def test_wrong_terms(make, term, path, part) -> None:
    with pytest.raises(ConfigError) as caught:
        make(actions={"arm": term})
    assert caught.value.problems[0].path == path
    assert part in str(caught.value)


def test_joints_without_a_drive_are_refused(make) -> None:
    drives = JointDrivePropertiesCfg(drive_type="none")
    robot = RobotCfg(uid="ur10", fpath=UR10, init_pos=(0, 0, 1), drive_pros=drives)
    with pytest.raises(ConfigError, match="have no drive"):
        make(robot=robot, actions={"arm": arm()})


def test_without_terms_nothing_is_owned(make) -> None:
    manager = make().action_manager
    assert (len(manager), manager.action_dim, manager.names) == (0, 0, ())


def test_a_users_term(make) -> None:
    class Twist(ActionTerm):
        def __init__(self, env, size: float) -> None:
            self.low, self.high = np.full(2, -size), np.full(2, size)
            self.got = []

        def apply(self, action) -> None:
            self.got.append(action.clone())

    env = make(actions={"twist": ActionTermCfg(func=Twist, params={"size": 2.0}), "arm": arm()})
    assert env.single_action_space.shape == (8,)
    assert env.action_manager.names[:3] == ("twist/0", "twist/1", "arm/Joint1")
    env.reset()
    action = torch.rand(3, 8)
    env.step(action)
    assert torch.equal(env.action_manager.terms["twist"].instance.got[0], action[:, :2])
    assert env.action_manager.home()[:2].tolist() == [0.0, 0.0]


def test_a_term_without_bounds(make) -> None:
    class Loose(ActionTerm):
        def __init__(self, env) -> None:
            pass

    with pytest.raises(ConfigError, match="must set low and high"):
        make(actions={"a": ActionTermCfg(func=Loose)})
