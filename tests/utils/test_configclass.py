"""`@configclass`: safe defaults, the added methods, and dicts."""

import dataclasses

import pytest

from embodichain.lab.gym.envs.cfg import EnvCfg
from embodichain.lab.sim import cfg as sim_cfg
from embodichain.lab.sim import shapes
from embodichain.lab.sim.cfg import RigidObjectCfg, RobotCfg, SimulationManagerCfg
from embodichain.utils.configclass import MISSING, configclass
from embodichain.utils.errors import ConfigError
from embodichain.utils.fields.defaults import is_given


@configclass
class Inner:
    values: list[int] = [1, 2]
    count = 3


@configclass
class Outer:
    inner: Inner = Inner()
    name: str = MISSING


def test_mutable_defaults_are_not_shared():
    a, b = Outer(name="a"), Outer(name="b")
    a.inner.values.append(9)
    assert b.inner.values == [1, 2] and Outer(name="c").inner.values == [1, 2]
    assert SimulationManagerCfg().render_cfg is not SimulationManagerCfg().render_cfg


def test_unannotated_members_are_fields():
    assert [f.name for f in dataclasses.fields(Inner)] == ["values", "count"]
    assert Inner([5], 6).count == 6


def test_copies_are_deep():
    a = Outer(name="a")
    b = a.replace(name="b")
    b.inner.values.append(3)
    assert (a.inner.values, a.name, b.name, a.copy().name) == ([1, 2], "a", "b", "a")
    assert a.to_dict() == {"inner": {"values": [1, 2], "count": 3}, "name": "a"}


def test_what_must_be_set_is_listed():
    with pytest.raises(TypeError, match=r"Missing values: Outer\.name"):
        Outer().validate()
    Outer(name="a").validate()


def test_a_dict_becomes_a_config():
    cfg = RigidObjectCfg.from_dict(
        {"uid": "cube", "shape": {"shape_type": "Cube", "size": [1, 2, 3]}, "attrs": {"mass": 2}}
    )
    assert cfg.shape.size == [1, 2, 3] and cfg.attrs.mass == 2
    assert RobotCfg.from_dict({"fpath": "a.urdf"}).drive_pros.stiffness == 1e4


def test_every_mistake_in_a_dict_is_reported():
    with pytest.raises(ConfigError) as caught:
        RobotCfg.from_dict({"fpat": "a", "init_pos": [1, 2], "drive_pros": {"stifness": 1}})
    paths = [p.path for p in caught.value.problems]
    assert set(paths) == {"fpat", "init_pos", "drive_pros.stifness"}
    assert "Did you mean 'fpath'?" in str(caught.value)
    with pytest.raises(ConfigError, match="Did you mean 'Cube'"):
        shapes.ShapeCfg.from_dict({"shape_type": "Cub"})


def test_the_published_order_and_defaults():
    """Positional construction as in EmbodiChain 0.2.1."""
    env = EnvCfg(8, SimulationManagerCfg(1280, 720, True), 5, 2, True, 77)
    assert (env.num_envs, env.seed, env.sim_steps_per_control) == (8, 5, 2)
    assert (env.ignore_terminations, env.max_episode_steps) == (True, 77)
    assert (env.sim_cfg.width, env.sim_cfg.height, env.sim_cfg.headless) == (1280, 720, True)
    default = EnvCfg()
    assert (default.num_envs, default.seed, default.max_episode_steps) == (1, None, 300)
    sim = default.sim_cfg
    assert (sim.arena_space, sim.physics_dt, sim.sim_device, sim.headless) == (
        5,
        0.01,
        "cpu",
        False,
    )
    drive = RobotCfg().drive_pros
    assert (drive.drive_type, drive.stiffness, drive.damping) == ("force", 1e4, 1e3)
    # None for the 1e10 there: no limit, as there
    assert (drive.max_effort, drive.max_velocity, drive.friction) == (1e10, None, 0.0)
    assert sim_cfg.ArticulationCfg().drive_pros.drive_type == "none"
    body = RigidObjectCfg().attrs
    assert (body.mass, body.density) == (1, 1000)
    assert (body.linear_damping, body.angular_damping) == (0, 0)  # 0.7 there: free fall is free
    assert (body.dynamic_friction, body.static_friction, body.restitution) == (0.5, 0.5, 0.0)
    assert shapes.CubeCfg().size == [1, 1, 1] and shapes.SphereCfg().radius == 1.0


@pytest.mark.parametrize("name", ["SoftObjectCfg", "GizmoCfg"])
def test_what_is_not_available_exists_and_says_so(name):
    with pytest.raises(NotImplementedError, match=f"{name}.*not available"):
        getattr(sim_cfg, name)()
    with pytest.raises(AttributeError):
        sim_cfg.NothingCfg  # noqa: B018


def test_gains_that_were_not_given_are_still_not_given_after_a_dict():
    """An MJCF robot keeps its actuators when its config was written out and read again."""
    again = RobotCfg.from_dict({"drive_pros": RobotCfg().to_dict()["drive_pros"]}).drive_pros
    assert not is_given(again.stiffness) and not is_given(again.max_effort)
    given = RobotCfg.from_dict({"drive_pros": {"stiffness": 1e4, "damping": "file"}}).drive_pros
    assert is_given(given.stiffness) and given.damping == "file"
    with pytest.raises(ConfigError, match="stiffness"):
        RobotCfg.from_dict({"drive_pros": {"stiffness": "soft"}})
