"""What events declare to draw reaches the compiler, whoever wrote the event."""

import sys

import numpy as np
import pytest

from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.cfg import EnvCfg, EventCfg, PhysicsTaskCfg
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.terms.physics_draws import PhysicsDraw
from embodichain.lab.gym.envs.managers.terms.registry import TERMS, register_term
from embodichain.lab.gym.envs.mdp.events.randomize import Randomize
from embodichain.lab.sim.cfg import JointDrivePropertiesCfg, RobotCfg
from tests.lab.sim.compiler.helpers import HOME, UR10

ARM = {"of": {"uid": "ur10"}}
WRIST = {"of": {"uid": "ur10", "joint_names": "Joint6"}}

MODULE = """
from embodichain.lab.gym.envs.managers.terms.physics_draws import PhysicsDraw
from embodichain.lab.gym.envs.managers.terms.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity


def declared(of, factor):
    return [PhysicsDraw(of, gain, factor, "scale") for gain in ("stiffness", "damping")]


@register_term("event", draws=declared)
def draw_gains_of_a_plugin(env, env_ids, of: ResolvedEntity, factor: list = (1.0, 4.0)):
    pass
"""


@pytest.fixture
def plugin(tmp_path, monkeypatch):
    """A module of a user with an event, importable as `gains_of_a_user`."""
    (tmp_path / "gains_of_a_user.py").write_text(MODULE, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield "gains_of_a_user"
    sys.modules.pop("gains_of_a_user", None)
    TERMS["event"].pop("draw_gains_of_a_plugin", None)


def armature(func=None, params=ARM):
    """(6,) armature of a limited arm in a task with one event."""
    drives = JointDrivePropertiesCfg(stiffness=1e4, damping=1e3, max_effort="file")
    cfg = EnvCfg(
        robot=RobotCfg(uid="ur10", fpath=UR10, init_qpos=HOME, drive_pros=drives),
        physics=PhysicsTaskCfg(physics_dt=0.005),
        events={} if func is None else {"gains": EventCfg(func, params=params, mode="reset")},
    )
    env = BaseEnv(cfg)
    found = np.array(env.robot.parsed.armature)
    env.close()
    return found


def gains(factor, where=ARM):
    return {**where, "stiffness": factor, "damping": factor, "operation": "scale"}


def test_an_event_of_a_user_is_compiled_for_as_randomize_is(plugin):
    none, four = armature(), armature("randomize", gains([1.0, 4.0]))
    assert (four > none).any()
    # by its path, with the default of its parameter
    assert (armature(f"{plugin}:draw_gains_of_a_plugin") == four).all()
    # by its registered name, for some joints
    wrist = armature("draw_gains_of_a_plugin", {**WRIST, "factor": [1.0, 2.0]})
    assert (wrist == armature("randomize", gains([1.0, 2.0], WRIST))).all()
    assert (wrist[:5] < four[:5]).any()


def test_a_class_given_as_func_declares_as_its_name_does():
    assert (
        armature(Randomize, gains([1.0, 4.0])) == armature("randomize", gains([1.0, 4.0]))
    ).all()


def test_an_alias_declares_what_its_target_draws():
    renamed = {"stiffness_range": [1.0, 4.0], "damping_range": [1.0, 4.0], "operation": "scale"}
    found = armature("randomize_actuator_gains", {"entity_cfg": {"uid": "ur10"}, **renamed})
    assert (found == armature("randomize", gains([1.0, 4.0]))).all()


def test_an_event_without_a_declaration_changes_nothing():
    assert (armature(lambda env, env_ids, of: None) == armature()).all()


def test_a_declaration_of_a_parameter_that_the_event_lacks_is_refused():
    def push(env, env_ids, of: ResolvedEntity):
        pass

    with pytest.raises(ValueError, match="draws takes factor, and event term 'push' has no such"):
        register_term("event", draws=lambda of, factor: [PhysicsDraw(of, "mass", factor)])(push)
    assert "push" not in TERMS["event"]
