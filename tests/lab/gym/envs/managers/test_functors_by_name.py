"""Functors written as EmbodiChain's are: parameters that name entities, without our annotations."""

from typing import TYPE_CHECKING

import pytest
import torch

from embodichain.lab.gym.envs.cfg import EventCfg, ObservationCfg, RewardCfg, SceneEntityCfg
from embodichain.utils.errors import ConfigError
from tests.lab.gym.conftest import home, make_env

if TYPE_CHECKING:
    from nowhere import Elsewhere

__all__ = ["make_env"]
SEEN = {}


def nudge(env, env_ids, entity_cfg, others=None, entity_cfgs=()):
    SEEN["event"] = entity_cfg
    SEEN["list"] = entity_cfgs
    SEEN["others"] = others
    env.sim.get_rigid_object(entity_cfg.uid).set_local_pose(torch.eye(4).repeat(3, 1, 1))


def apart(env, obs, action, info, source_entity_cfg, target_entity_cfg: "Elsewhere"):
    robot = env.sim.get_robot(source_entity_cfg.uid)
    link = robot.get_link_pose(source_entity_cfg.link_names[0])[:, :3]
    cube = env.sim.get_rigid_object(target_entity_cfg.uid).get_local_pose()[:, :3]
    return (link - cube).norm(dim=1)


def picked(env, obs, entity_cfg: SceneEntityCfg):
    return env.robot.get_qpos()[:, list(entity_cfg.joint_ids)]


def test_references_are_resolved_by_the_names_of_parameters(make_env):
    tool = {"uid": "ur10", "link_names": ["ee_link"]}
    cube = {"uid": "cube"}
    env = make_env(
        events={
            "e": EventCfg(
                nudge, {"entity_cfg": cube, "others": {"uid": "x"}, "entity_cfgs": [cube, tool]}
            )
        },
        observations={
            "q": ObservationCfg(
                picked, {"entity_cfg": {"uid": "ur10", "joint_names": ["Joint[23]"]}}
            )
        },
        rewards={"d": RewardCfg(apart, {"source_entity_cfg": tool, "target_entity_cfg": cube})},
    )
    obs, _ = env.reset()
    assert obs["q"].shape == (3, 2)
    found = SEEN["event"]
    assert found.uid == "cube" and found.asset is env.sim.get_rigid_object("cube")
    assert [e.uid for e in SEEN["list"]] == ["cube", "ur10"]
    assert SEEN["others"] == {"uid": "x"}  # a name that means nothing there stays as it is
    link = SEEN["list"][1]
    assert (
        (link.body_names, link.body_ids) == (link.link_names, link.link_ids) == (("ee_link",), (7,))
    )
    info = env.step(home(env))[4]
    expected = env.robot.get_link_pose("ee_link")[:, :3].norm(dim=1)
    assert torch.allclose(info["rewards"]["d"], expected, atol=1e-3)


def test_what_does_not_exist_is_named_with_its_path(make_env):
    params = {"source_entity_cfg": {"uid": "ur1"}, "target_entity_cfg": {"uid": "cube", "jont": 1}}
    with pytest.raises(ConfigError) as caught:
        make_env(rewards={"d": RewardCfg(apart, params)})
    text = str(caught.value)
    assert "rewards.d.params.target_entity_cfg.jont: unknown key" in text
    params["target_entity_cfg"] = {"uid": "cube"}
    with pytest.raises(ConfigError, match="rewards.d.params.source_entity_cfg.*'ur10'"):
        make_env(rewards={"d": RewardCfg(apart, params)})
