"""Friction, contact parameters and physics options of a task file, by hand and by MuJoCo's rule."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml

import embodichain
from embodichain.config import compose, resolve, validate

GRAVITY = 9.81
SPEED = 1.5
ARM = """<mujoco model="arm"><worldbody><body name="base">
  <geom name="foot" type="box" size=".1 .1 .1" friction="0.7" condim="4"/>
  <body name="tip" pos="0 0 .3"><joint name="j" type="slide"/>
    <geom name="pad" size=".05" friction="0.6 0.02 0.003"/>
    <geom name="shell" size=".04" contype="0" conaffinity="0"/></body>
</body></worldbody></mujoco>"""

Sections = dict[str, Any]


def block(friction: float | None, y: float = 0.0, **more: Any) -> Sections:
    attrs = {"mass": 1} if friction is None else {"mass": 1, "dynamic_friction": friction}
    size = {"shape_type": "Cube", "size": [0.2, 0.2, 0.04]}
    return {"shape": size, "attrs": attrs, "init_pos": [0, y, 0.02], **more}


def write(**sections: Any) -> None:
    task = {
        "description": "Blocks on the ground.",
        "physics": {"physics_dt": 0.002},
        "max_episode_steps": 100,
        **sections,
    }
    Path("conf/task").mkdir(parents=True, exist_ok=True)
    Path("conf/task/mine.yaml").write_text(yaml.safe_dump(task))


@contextmanager
def made(**sections: Any) -> Iterator[Any]:
    write(**sections)
    env = embodichain.make("mine", seed=0)
    env.reset()
    try:
        yield env
    finally:
        env.close()


def mistakes(**sections: Any) -> list[str]:
    write(**sections)
    return [str(p).partition(" task.")[2] for p in validate(compose(["task=mine"]))]


def slides(**sections: Any) -> list[float]:
    """How far each object slides that is thrown at `SPEED` along x."""
    with made(**sections) as env:
        env.sim.update(step=100)
        moving = [env.sim.get_rigid_object(uid) for uid in sections["objects"]]
        moving = [one for one in moving if not one.is_non_dynamic]
        for one in moving:
            one.set_velocity(lin_vel=[[SPEED, 0, 0]])
        start = [float(one.get_local_pose()[0, 0]) for one in moving]
        env.sim.update(step=1500)
        ends = [float(one.get_local_pose()[0, 0]) for one in moving]
        return [end - begin for end, begin in zip(ends, start, strict=True)]


def coulomb(*frictions: float) -> Any:
    return pytest.approx([SPEED**2 / (2 * mu * GRAVITY) for mu in frictions], rel=0.05)


TWO = {"ice": block(0.05), "rubber": block(0.9, 1.0), "usual": block(None, 2.0)}


def test_what_stands_on_the_ground_decides() -> None:
    assert slides(objects=TWO) == coulomb(0.05, 0.9, 0.5)


def test_a_ground_with_a_friction_takes_part_and_one_with_a_priority_decides() -> None:
    ground = {"ground": {"friction": 0.3}}
    assert slides(objects=TWO, scene=ground) == coulomb(0.3, 0.9, 0.5)
    ground = {"ground": {"friction": 0.2, "priority": 1}}
    assert slides(objects=TWO, scene=ground) == coulomb(0.2, 0.2, 0.2)


@pytest.mark.parametrize("given", [None, 0.4])
def test_table_terrain_and_static_objects_are_like_the_ground(given: float | None) -> None:
    own = {} if given is None else {"friction": given}
    at = {"init_pos": [0, 0, 0.12]}
    size = {"shape_type": "Cube", "size": [9, 1, 0.1]}
    attrs = {} if given is None else {"dynamic_friction": given}
    slab = {"shape": size, "body_type": "static", "attrs": attrs, "init_pos": [0, 0, 0.05]}
    wanted = coulomb(0.1 if given is None else 0.4)
    assert slides(objects={"ice": block(0.1, **at), "slab": slab}) == wanted
    table = {"table": {"size": [9, 1, 0.1], "thickness": 0.1, **own}}
    assert slides(objects={"ice": block(0.1, **at)}, scene=table) == wanted
    patches = {"patches": {"flat": {"type": "flat"}}, "levels": 1, **own}
    # Blocks stumble over the edges of a height field's cells.
    with made(objects={"ice": block(0.1)}, scene={"terrain": patches}) as env:
        ground = env.sim.engine.model.geom("default_plane")
        assert ground.priority == (-1 if given is None else 0)
        assert ground.friction[0] == (1.0 if given is None else given)


def test_a_kinematic_object_moves_and_takes_part() -> None:
    size = {"shape_type": "Cube", "size": [9, 1, 0.1]}
    slab = {"shape": size, "body_type": "kinematic", "init_pos": [0, 0, 0.05]}
    ice = block(0.1, init_pos=[0, 0, 0.12])
    assert slides(objects={"ice": ice, "slab": slab}) == coulomb(0.5)


def test_an_object_falls_freely() -> None:
    with made(objects={"stone": block(None, init_pos=[0, 0, 20])}) as env:
        stone = env.sim.get_rigid_object("stone")
        env.sim.update(step=500)
        fallen = 20 - float(stone.get_local_pose()[0, 2])
        # g t^2 / 2, and half a step more of the semi-implicit integrator: g t h / 2
        assert fallen == pytest.approx(GRAVITY / 2 + GRAVITY * 0.002 / 2, abs=1e-4)


# -- given, or the default ------------------------------------------------------------------------


@pytest.mark.parametrize("friction", [0.49, 0.5, 0.51])
def test_a_friction_of_a_robot_file_gives_way_to_any_that_is_given(friction: float) -> None:
    Path("arm.xml").write_text(ARM)
    robot = {"uid": "arm", "fpath": "arm.xml"}
    with made(robot={**robot, "attrs": {"dynamic_friction": friction}}) as env:
        model = env.sim.engine.model
        assert model.geom("arm/pad").friction.tolist() == [friction, 0.02, 0.003]
    with made(robot=robot) as env:
        assert env.sim.engine.model.geom("arm/pad").friction.tolist() == [0.6, 0.02, 0.003]


def test_a_shape_beside_any_of_is_refused_even_if_it_is_the_default() -> None:
    any_of = {"ball": {"shape": {"shape_type": "Sphere"}}}
    default = {"shape_type": "Cube", "size": [1, 1, 1]}
    thing = {"shape": default, "body_scale": [1, 1, 1], "collision": "hull", "any_of": any_of}
    assert mistakes(objects={"thing": thing}) == [
        f"objects.thing.{key}: the object has any_of: give each of its shapes there"
        for key in ("shape", "body_scale", "collision")
    ]


def test_one_convex_part_is_not_a_decomposition() -> None:
    thing = {"shape": {"shape_type": "Cube"}, "collision": "decompose", "max_convex_hull_num": 1}
    assert "1 part is the hull, but collision is decompose" in mistakes(objects={"a": thing})[0]


# -- contact parameters ---------------------------------------------------------------------------


def test_contact_parameters_of_robots_by_link_and_geom() -> None:
    Path("arm.xml").write_text(ARM)
    tool = {"link": "tip", "contact": {"friction": [2.0, 0.1], "priority": 3}}
    contact = {
        "base|tip": {"solref": [0.03, 1], "condim": 6},
        "pad": {"friction": [0.9, 0.04], "solref": [-500, -3], "margin": 0.01, "gap": 0.02},
        "tool": {"solimp": [0.8, 0.9]},
    }
    robot = {"uid": "arm", "fpath": "arm.xml", "attachments": {"tool": tool}, "contact": contact}
    with made(robot=robot) as env:
        model = env.sim.engine.model
        foot, pad, tip = (model.geom(f"arm/{name}") for name in ("foot", "pad", "tool/geom"))
        assert foot.solref.tolist() == [0.03, 1] and foot.condim == 6
        assert pad.solref.tolist() == [-500, -3] and pad.condim == 6
        assert pad.friction.tolist() == [0.9, 0.04, 0.003], "what is not given stays"
        assert pad.margin == 0.01 and pad.gap == 0.02
        assert tip.friction.tolist() == [2.0, 0.1, 0.0001] and tip.priority == 3
        assert tip.solimp.tolist() == [0.8, 0.9, 0.001, 0.5, 2]
        assert model.geom("arm/shell").condim == 3, "a geom that does not collide stays"


def test_an_attached_file_and_an_object_and_the_ground_have_them_too() -> None:
    Path("arm.xml").write_text(ARM)
    given = {"friction": [0.8, 0.02, 0.001], "condim": 6, "solref": [0.05, 0.5], "priority": 2}
    robot = {
        "uid": "ur10",
        "fpath": "UniversalRobots/UR10/UR10.urdf",
        "init_pos": [0, 2, 0.5],
        "attach": {"hand": {"fpath": "arm.xml", "to": "ee_link", "contact": {"pad": given}}},
    }
    scene = {"ground": given, "pedestal": given}
    with made(robot=robot, scene=scene, objects={"a": block(None, contact=given)}) as env:
        model = env.sim.engine.model
        for name in ("ur10/hand/pad", "default_plane", "a/geom", "pedestal/geom"):
            geom = model.geom(name)
            found = geom.friction.tolist(), int(geom.condim[0]), geom.solref.tolist()
            assert found == ([0.8, 0.02, 0.001], 6, [0.05, 0.5]), name
            assert geom.priority == 2


WRONG: list[tuple[Sections, str]] = [
    ({"contact": {"tipp": {"condim": 4}}}, "contact.tipp: no link or geom matches 'tipp'; there "),
    ({"contact": {"shell": {"condim": 4}}}, "contact.shell: no part of 'shell' collides"),
    ({"contact": {"pad": {"condim": 2}}}, "contact.pad.condim: expected one of 1, 3, 4 or 6, got"),
    ({"contact": {"pad": {"solref": [0.1, -1]}}}, "contact.pad.solref: must be [time constant, "),
    ({"contact": {"pad": {"solimp": [0.9, 1.5]}}}, "contact.pad.solimp: dmax must be 0.0001 to"),
    ({"contact": {"pad": {"frictio": 1}}}, "contact.pad.frictio: unknown key; allowed: friction,"),
    ({"contact": {"pad": {"friction": -1}}}, "contact.pad.friction: must be at least 0.0, got -1"),
    ({"attachments": {"t": {"link": "tip", "dynamic_friction": 0.5, "contact": {"friction": 1}}}},
     "attachments.t.contact.friction: dynamic_friction is given as well"),
]  # fmt: skip


@pytest.mark.parametrize(("robot", "message"), WRONG)
def test_mistakes_in_contact_parameters(robot: Sections, message: str) -> None:
    Path("arm.xml").write_text(ARM)
    found = mistakes(robot={"uid": "arm", "fpath": "arm.xml", **robot})
    assert len(found) == 1 and found[0].startswith(f"robot.{message}"), found


def test_what_cannot_act_on_the_ground_is_refused() -> None:
    advice = "give friction, or priority: 1"
    (found,) = mistakes(objects=TWO, scene={"ground": {"solref": [0.1, 1]}})
    assert found.startswith("scene.ground.solref: has no effect") and found.endswith(advice)
    (found,) = mistakes(objects=TWO, scene={"table": {"condim": 6}})
    assert found.startswith("scene.table.condim: has no effect")
    static = block(None, body_type="static", contact={"condim": 6})
    (found,) = mistakes(objects={"a": static})
    assert found.startswith("objects.a.contact.condim: has no effect")
    patches = {"patches": {"flat": {"type": "flat"}}}
    (found,) = mistakes(objects=TWO, scene={"terrain": patches, "ground": {"friction": 1}})
    assert found.startswith("scene.ground.friction: the terrain is the ground")


# -- what MuJoCo does not have --------------------------------------------------------------------


@pytest.mark.parametrize("wanted", [0.2, 0.4, 0.7, 0.9])
def test_restitution_is_an_error_that_says_the_solref_to_write(wanted: float) -> None:
    ball = {"shape": {"shape_type": "Sphere", "radius": 0.05}, "init_pos": [0, 0, 1]}
    (found,) = mistakes(objects={"ball": {**ball, "attrs": {"restitution": wanted}}})
    assert found.startswith("objects.ball.attrs.restitution: MuJoCo has no restitution")
    solref = yaml.safe_load(found.partition("solref: ")[2].partition("}")[0])
    with made(objects={"ball": {**ball, "contact": {"solref": solref}}}) as env:
        handle = env.sim.get_rigid_object("ball")
        speeds = []
        for _ in range(600):
            env.sim.update(step=1)
            speeds.append(float(handle.body_data.vel[0, 2]))
        assert max(speeds) / -min(speeds) == pytest.approx(wanted, abs=0.02)


def test_static_friction_is_an_error_and_zero_is_not() -> None:
    (found,) = mistakes(objects={"a": {"attrs": {"static_friction": 0.5}}})  # the default
    assert found.startswith("objects.a.attrs.static_friction: MuJoCo has one sliding coefficient")
    assert not mistakes(objects={"a": {"attrs": {"static_friction": 0, "restitution": 0}}})
    Path("arm.xml").write_text(ARM)
    robot = {"uid": "arm", "fpath": "arm.xml", "attrs": {"restitution": 0.5}}
    assert mistakes(robot=robot)[0].startswith("robot.attrs.restitution")


def test_keys_without_effect_are_said_even_with_their_default() -> None:
    Path("arm.xml").write_text(ARM)
    attrs = {"max_linear_velocity": 100.0, "density": 500, "enable_ccd": False}
    write(
        objects={"a": {"attrs": attrs, "sdf_resolution": 0}},
        robot={"uid": "arm", "fpath": "arm.xml", "attrs": {"mass": 1}, "build_pk_chain": True},
    )
    found = {note.path: note.message for note in resolve(["task=mine"]).notes}
    assert set(found) == {
        "task.objects.a.attrs.max_linear_velocity",
        "task.objects.a.attrs.density",
        "task.objects.a.attrs.enable_ccd",
        "task.objects.a.sdf_resolution",
        "task.robot.attrs.mass",
        "task.robot.build_pk_chain",
    }
    assert all(message.startswith("has no effect") for message in found.values())


# -- physics options ------------------------------------------------------------------------------


def test_options_of_physics_are_those_of_mujoco() -> None:
    given: Sections = {
        "density": 1.2,
        "viscosity": 2e-5,
        "wind": [1, 2, 3],
        "magnetic": [0, 1, 0],
        "tolerance": 1e-6,
        "ls_iterations": 20,
        "ls_tolerance": 0.02,
        "noslip_iterations": 3,
        "noslip_tolerance": 1e-5,
        "ccd_iterations": 40,
        "ccd_tolerance": 1e-5,
        "sdf_iterations": 11,
        "sdf_initpoints": 41,
        "o_margin": 0.01,
    }
    lists: Sections = {"o_solref": [0.03, 1], "o_solimp": [0.8, 0.9], "o_friction": [0.7, 0.6]}
    flags = {"gravity": "disable", "energy": "enable", "override": "enable"}
    physics = {**given, **lists, "jacobian": "sparse", "flags": flags}
    with made(objects=TWO, physics=physics) as env:
        option = env.sim.engine.model.opt
        for name, value in given.items():
            assert np.array_equal(getattr(option, name), value), name
        assert option.o_solref.tolist() == [0.03, 1]
        assert option.o_solimp.tolist() == [0.8, 0.9, 0.001, 0.5, 2]
        assert option.o_friction.tolist() == [0.7, 0.6, 0.005, 0.0001, 0.0001]
        assert option.jacobian == mujoco.mjtJacobian.mjJAC_SPARSE
        disable, enable = mujoco.mjtDisableBit, mujoco.mjtEnableBit
        assert option.disableflags == disable.mjDSBL_GRAVITY | disable.mjDSBL_AUTORESET
        assert option.enableflags == enable.mjENBL_ENERGY | enable.mjENBL_OVERRIDE


def test_drag_of_the_medium_acts() -> None:
    """A sphere in MuJoCo's inertia model loses speed by Stokes' law: F = 6 pi r mu v."""
    ball = {"shape": {"shape_type": "Sphere", "radius": 0.1}, "init_pos": [0, 0, 5]}
    physics = {"physics_dt": 0.001, "gravity": [0, 0, 0], "viscosity": 0.2}
    with made(objects={"ball": ball}, physics=physics) as env:
        handle = env.sim.get_rigid_object("ball")
        handle.set_velocity(lin_vel=[[1.0, 0, 0]])
        env.sim.update(step=1000)
        # The box with the inertia of a sphere of 1 kg and radius r has edges of 2 r sqrt(3 / 5);
        # MuJoCo takes the mean edge as the diameter.
        radius = 0.1 * np.sqrt(3 / 5)
        wanted = np.exp(-6 * np.pi * radius * 0.2)
        assert float(handle.body_data.vel[0, 0]) == pytest.approx(wanted, rel=1e-3)


OPTIONS: list[tuple[Sections, str]] = [
    ({"o_margin": 0.1}, "o_margin: has no effect without flags: {override: enable}"),
    ({"sleep_tolerance": 0.1}, "sleep_tolerance: has no effect without flags: {sleep: enable}"),
    ({"noslip_tolerance": 0.1}, "noslip_tolerance: has no effect without noslip_iterations"),
    ({"viscosity": -1}, "viscosity: must be at least 0.0, got -1"),
    ({"wind": [1, 2]}, "wind: expected 3 values, got 2: [1, 2]"),
    ({"flags": {"gravty": "disable"}}, "flags.gravty: unknown key; allowed: constraint, equality"),
    ({"flags": {"gravity": False}}, "flags.gravity: expected one of 'enable', 'disable'"),
    ({"flags": {"autoreset": "enable"}}, "flags.autoreset: unknown key"),
    ({"ls_iteration": 3}, "ls_iteration: unknown key; allowed: "),
]


@pytest.mark.parametrize(("physics", "message"), OPTIONS)
def test_mistakes_in_options(physics: Sections, message: str) -> None:
    found = mistakes(objects=TWO, physics=physics)
    assert len(found) == 1 and found[0].startswith(f"physics.{message}"), found


def test_options_that_a_file_gives_are_named_even_if_they_are_mujocos_defaults() -> None:
    Path("part.xml").write_text('<mujoco><option ls_iterations="50"/></mujoco>')
    inside = '<include file="part.xml"/><option timestep="0.002"><flag gravity="enable"/></option>'
    Path("arm.xml").write_text(ARM.replace("<worldbody>", f"{inside}<worldbody>"))
    physics = {"physics_dt": 0.004, "ls_iterations": 30, "flags": {"gravity": "disable"}}
    with made(robot={"uid": "arm", "fpath": "arm.xml"}, physics=physics) as env:
        (note,) = [n for n in env.sim.scene.notes if "replaces its options" in n]
        what = note.partition("options: ")[2].split("; ")
        assert what == [
            "disableflags gravity -> on",
            "ls_iterations 50 -> 30",
            "timestep 0.002 -> 0.004",
        ]


# -- events ---------------------------------------------------------------------------------------


def drawn(of: str | None, **ranges: Any) -> Sections:
    params = dict(ranges) if of is None else {"of": {"uid": of}, **ranges}
    return {"func": "randomize", "mode": "reset", "params": params}


def refusal(objects: Sections, events: Sections, scene: Sections | None = None) -> str:
    write(objects=objects, events=events, **({} if scene is None else {"scene": scene}))
    with pytest.raises(embodichain.utils.errors.ConfigError) as error:
        embodichain.make("mine", seed=0)
    return str(error.value)


Build = Callable[..., str]


def test_draws_of_an_objects_friction_act_on_the_ground() -> None:
    events = {"slick": drawn("ice", friction=[0.2, 0.2])}
    assert slides(objects={"ice": block(0.9)}, events=events) == coulomb(0.2)


def test_draws_that_cannot_act_are_refused() -> None:
    ice = {"ice": block(0.3)}
    ground = drawn(None, friction=[0.1, 2.0])
    found = refusal(ice, {"e": ground})
    assert (
        "task.events.e.params.friction: this friction cannot act: ground: it has priority -1"
        in found
    )
    cube = {"e": drawn("ice", friction=[0.1, 0.8])}
    found = refusal(ice, cube, {"ground": {"priority": 1}})
    assert (
        "ice: it has priority 0, and what touches it a higher one and decides (default_plane"
        in found
    )
    found = refusal(ice, cube, {"ground": {"friction": 0.8}})
    assert "ice: what touches it has at least 0.8, and the larger value acts" in found
    found = refusal(ice, {"e": drawn("ice", torsional_friction=[0.1, 0.2])})
    assert "torsional friction needs a contact with condim 4" in found
    off = {"shape": {"shape_type": "Cube"}, "body_type": "static"}
    found = refusal({**ice, "wall": off}, {"e": drawn("wall", friction=[0.1, 0.2])})
    assert "wall: it has priority -1" in found


def test_draws_that_can_act_are_not_refused() -> None:
    ice = {"ice": block(0.3)}
    both = {"a": drawn("ice", friction=[0.1, 0.8]), "b": drawn(None, friction=[0.05, 0.9])}
    scene = {"ground": {"friction": 1.0}}
    with made(objects=ice, events=both, scene=scene):
        pass  # the ground may be drawn smaller than the block
    turn = {"e": drawn("ice", torsional_friction=[0.1, 0.2])}
    with made(objects={"ice": block(0.3, contact={"condim": 4})}, events=turn):
        pass
    other = {"ice": block(0.3, contact={"priority": 2})}
    with made(objects=other, events={"e": drawn("ice", friction=[0.1, 0.2])}, scene=scene):
        pass


# -- given in Python ------------------------------------------------------------------------------


def test_python_classes_say_once_what_has_no_effect(caplog: pytest.LogCaptureFixture) -> None:
    from embodichain.lab.sim.cfg import (
        RigidBodyAttributesCfg,
        RigidObjectCfg,
        SimulationManagerCfg,
    )
    from embodichain.lab.sim.sim_manager import SimulationManager

    sim = SimulationManager(SimulationManagerCfg(headless=True))
    attrs = RigidBodyAttributesCfg(restitution=0.9, static_friction=0.5)
    sim.add_rigid_object(RigidObjectCfg(uid="a", attrs=attrs))
    sim.add_rigid_object(RigidObjectCfg(uid="b", init_pos=(3, 0, 0)))
    sim.update(step=1)
    sim.update(step=1)
    sim.destroy()
    assert [r.getMessage() for r in caplog.records if "has no effect" in r.getMessage()] == [
        "a: attrs.restitution has no effect: MuJoCo has no restitution coefficient",
        "a: attrs.static_friction has no effect: MuJoCo has one sliding coefficient, "
        "dynamic_friction",
    ]


def test_a_config_says_after_a_copy_whether_a_value_was_given() -> None:
    from embodichain.lab.sim.cfg import RigidBodyAttributesCfg
    from embodichain.utils.fields.defaults import is_given

    usual, given = RigidBodyAttributesCfg(), RigidBodyAttributesCfg(dynamic_friction=0.5)
    assert usual == given and usual.dynamic_friction == 0.5
    for cfg, wanted in ((usual, False), (given, True)):
        again = RigidBodyAttributesCfg.from_dict(cfg.replace(mass=2.0).to_dict())
        assert is_given(again.dynamic_friction) is wanted


def test_a_registered_class_keeps_a_limit_that_equals_the_default() -> None:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.envs.cfg import EnvCfg
    from embodichain.lab.gym.utils import registration
    from embodichain.lab.sim.cfg import SimulationManagerCfg

    registration.register_env("Limited-v0", max_episode_steps=20)(BaseEnv)
    sim = SimulationManagerCfg(headless=True)
    try:
        for cfg, wanted in (
            (EnvCfg(sim_cfg=sim), 20),
            (EnvCfg(sim_cfg=sim, max_episode_steps=300), 300),
            (EnvCfg(sim_cfg=sim, episode_length_s=0.4), 10),
        ):
            env = registration.make("Limited-v0", cfg=cfg)
            assert env.max_episode_steps == wanted
            env.close()
    finally:
        registration.REGISTERED_ENVS.pop("Limited-v0")


def test_a_joint_friction_of_zero_is_given() -> None:
    Path("arm.xml").write_text(ARM.replace('type="slide"', 'type="slide" frictionloss="3"'))
    robot = {"uid": "arm", "fpath": "arm.xml"}
    for drives, wanted in (({}, 3.0), ({"friction": 0}, 0.0)):
        with made(robot={**robot, "drive_pros": drives}) as env:
            assert env.sim.engine.model.dof_frictionloss.tolist() == [wanted]
