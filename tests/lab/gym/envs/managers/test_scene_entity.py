"""What a SceneEntityCfg means in a scene; what matches nothing lists the candidates."""

import pytest

from embodichain.lab.gym.envs.cfg import SceneEntityCfg
from embodichain.lab.sim.cfg import RobotCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.ur10_task import UR10


@pytest.fixture
def env(make):
    return make()


def test_without_a_choice_all_active_joints_and_the_root(env) -> None:
    found = env.scene_entity({"uid": "ur10"})
    assert found.asset is env.robot
    assert found.joint_names == tuple(env.robot.joint_names)
    assert found.all_joints and found.joints is None
    assert found.link_names == () and found.link_name is None


def test_joints_by_regex_keep_the_robots_order(env) -> None:
    cfg = SceneEntityCfg(uid="ur10", joint_names=["Joint3", "Joint[12]"])
    assert env.scene_entity(cfg).joint_ids == (0, 1, 2)
    cfg.preserve_order = True
    found = env.scene_entity(cfg)
    assert found.joint_ids == (2, 0, 1)
    assert found.joints == [2, 0, 1]
    assert not found.all_joints


def test_control_parts(make) -> None:
    parts = {"wrist": ["Joint[56]"], "arm": ["Joint[1-3]"]}
    robot = RobotCfg(uid="ur10", fpath=UR10, control_parts=parts)
    env = make(robot=robot)

    def names(**cfg) -> tuple[str, ...]:
        return env.scene_entity({"uid": "ur10", **cfg}).joint_names

    assert names(control_parts="arm") == ("Joint1", "Joint2", "Joint3")
    both = ["wrist", "arm"]
    assert names(control_parts=both) == ("Joint1", "Joint2", "Joint3", "Joint5", "Joint6")
    kept = names(control_parts=both, joint_names=["Joint4", "Joint1"], preserve_order=True)
    assert kept == ("Joint5", "Joint6", "Joint1", "Joint2", "Joint3", "Joint4")
    with pytest.raises(ConfigError, match="there are: wrist, arm"):
        names(control_parts="leg")


def test_one_name_and_one_link(env) -> None:
    found = env.scene_entity({"uid": "ur10", "joint_names": "Joint6", "link_names": "ee_link"})
    assert found.joint_ids == (5,)
    assert found.link_name == "ee_link"
    assert env.robot.link_names[found.link_ids[0]] == "ee_link"


def test_a_resolved_entity_stays(env) -> None:
    found = env.scene_entity({"uid": "cube"})
    assert env.scene_entity(found) is found
    assert found.joint_ids == ()


@pytest.mark.parametrize(
    ("cfg", "path", "parts"),
    [
        ({"uid": "cub"}, "uid", ["ur10, cube, goal", "Did you mean 'cube'?"]),
        ({"uid": "ur10", "joint_names": "Joint9"}, "joint_names", ["Joint1", "'Joint9'"]),
        ({"uid": "ur10", "link_names": ["ee_lnk"]}, "link_names", ["Did you mean 'ee_link'?"]),
        ({"uid": "ur10", "body_names": "x("}, "body_names", ["malformed regex"]),
        ({"uid": "ur10", "control_parts": "arm"}, "control_parts", ["no control part"]),
        ({"uid": "ur10", "joint_ids": [6]}, "joint_ids", ["has 6 joints", "[6]"]),
        ({"uid": "ur10", "body_ids": [-1]}, "body_ids", ["links", "[-1]"]),
        ({"uid": "cube", "joint_names": "a"}, "joint_names", ["without joints"]),
        ({"uid": "cube", "link_names": "lid"}, "link_names", ["no link of 'cube'"]),
        ({"uid": "cube", "joint": "a"}, "joint", ["unknown key", "Did you mean 'joint_ids'?"]),
    ],
)
def test_what_matches_nothing(env, cfg, path, parts) -> None:
    with pytest.raises(ConfigError) as caught:
        env.scene_entity(cfg)
    (problem,) = caught.value.problems
    assert problem.path == path
    for part in parts:
        assert part in str(problem)


def test_several_links_where_one_is_wanted(env) -> None:
    found = env.scene_entity({"uid": "ur10", "link_names": [".*link"]})
    assert len(found.link_names) > 1
    with pytest.raises(ConfigError, match="one link of 'ur10' is wanted"):
        _ = found.link_name
