"""Randomizers by hand: ranges of one number, and what must come of them; mistakes that are said."""

import mujoco
import numpy as np
import pytest
import torch

from embodichain.lab.gym.envs.cfg import EventCfg
from embodichain.lab.sim.cfg import (
    JointDrivePropertiesCfg,
    RigidBodyAttributesCfg,
    RigidObjectCfg,
    RobotCfg,
)
from embodichain.lab.sim.shapes import CapsuleCfg, CubeCfg, CylinderCfg, PlaneCfg, SphereCfg
from embodichain.utils.errors import ConfigError
from tests.helpers.ur10_task import HOME, UR10, task

ARM = {"entity_cfg": {"uid": "ur10"}}
CUBE = {"entity_cfg": {"uid": "cube"}}
ELBOW = {"entity_cfg": {"uid": "ur10", "joint_names": "Joint3"}}


def fired(make, func: str, params: dict, **sections):
    env = make(events={"e": EventCfg(func=func, mode="reset", params=params)}, **sections)
    env.reset()
    return env


def field(env, name: str) -> np.ndarray:
    """Of environment 0, with whatever MuJoCo derives."""
    env.sim.engine.derived("xpos")
    return np.asarray(getattr(env.sim.engine.model_of(0), name))


# -- masses and inertias: the cube is 10 cm wide and weighs 1 kg: I = m a^2 / 6 = 1/600 -----------


def test_mass_of_an_object_and_what_follows_from_it(make) -> None:
    objects = task().objects
    objects["cube"].attrs = RigidBodyAttributesCfg(linear_damping=0.7, angular_damping=0.7)
    params = {**CUBE, "mass_range": [3, 3]}
    env = fired(make, "randomize_rigid_object_mass", params, objects=objects)
    cube = env.sim.get_rigid_object("cube")
    body = cube.entity.root_body_id
    assert cube.get_mass().tolist() == [3.0] * 3
    assert cube.get_inertia()[0].tolist() == pytest.approx([3 / 600] * 3)
    assert field(env, "body_subtreemass")[body] == 3.0
    assert field(env, "body_invweight0")[body, 0] == pytest.approx(1 / 3)
    damping = field(env, "dof_damping")[cube.entity.free_qvel_adr :][:6]
    assert damping == pytest.approx([0.7 * 3] * 3 + [0.7 * 3 / 600] * 3)


@pytest.mark.parametrize(
    ("params", "mass"),
    [
        ({"mass_range": [0.25, 0.25], "relative": True}, 1.25),
        ({"mass_range": [0.25, 0.25], "operation": "scale"}, 0.25),
        ({"mass_range": [-5, -5], "relative": True}, 1e-6),
        ({"mass_range": [0.1, 0.1], "min_mass": 0.2}, 0.2),
        ({"mass_range": [2, 2], "distribution": "log_uniform"}, 2.0),
        ({"mass_range": [2, 2], "distribution": "gaussian"}, 2.0),
    ],
)
def test_ways_to_say_a_mass(make, params, mass) -> None:
    env = fired(make, "randomize_rigid_object_mass", {**CUBE, **params})
    cube = env.sim.get_rigid_object("cube")
    assert cube.get_mass()[1].item() == pytest.approx(mass)
    assert cube.get_inertia()[1, 0].item() == pytest.approx(mass / 600)


def test_another_distribution_of_the_mass(make) -> None:
    params = {**CUBE, "mass_range": [3, 3], "recompute_inertia": False}
    cube = fired(make, "randomize_rigid_object_mass", params).sim.get_rigid_object("cube")
    assert cube.get_mass()[0].item() == 3.0
    assert cube.get_inertia()[0, 0].item() == pytest.approx(1 / 600)


def test_masses_of_links_by_name(make) -> None:
    params = {**ARM, "mass_range": {"shoulder_.*": [2, 2], "wrist_3.*": [0.5, 0.5]}}
    env = fired(make, "randomize_articulation_mass", {**params, "operation": "scale"})
    robot, model = env.robot, env.sim.engine.model
    names = ["shoulder_link", "upper_arm_link", "wrist_3_link"]
    factors = [2.0, 1.0, 0.5]
    bodies = [robot.body_of(n) for n in names]
    expected = model.body_mass[bodies] * factors
    assert robot.get_mass(names)[2].tolist() == pytest.approx(expected.tolist())
    inertia = field(env, "body_inertia")[bodies] / model.body_inertia[bodies]
    assert inertia == pytest.approx(np.repeat(factors, 3).reshape(3, 3))
    only = {**ARM, "mass_range": [1, 1], "link_names": "wrist_.*"}
    masses = fired(make, "randomize_articulation_mass", only).robot.get_mass()[0]
    wrists = [i for i, n in enumerate(robot.link_names) if n.startswith("wrist")]
    assert masses[wrists].tolist() == [1.0] * 3
    assert masses[robot.link_names.index("forearm_link")] != 1.0


def test_a_moved_centre_of_mass_is_a_model_compiled_so(make) -> None:
    offset = [0.02, -0.01, 0.03]
    params = {**CUBE, "com_pos_offset_range": [offset, offset]}
    env = fired(make, "randomize_rigid_object_center_of_mass", params)
    cube, engine = env.sim.get_rigid_object("cube"), env.sim.engine
    assert cube.body_data.com_pose[0, :3].tolist() == pytest.approx(offset)
    spec = env.sim.scene.spec.copy()
    body = spec.body("cube")
    body.explicitinertial, body.mass, body.ipos = True, 1.0, offset
    body.inertia = engine.model.body_inertia[cube.entity.root_body_id]
    model = spec.compile()
    model.dof_damping[:] = engine.model.dof_damping
    cube.set_local_pose([[0.5, 0.5, 1.0, 1, 0, 0, 0]] * 3)
    cube.set_velocity(ang_vel=[[1.0, 2.0, 3.0]] * 3)
    data = mujoco.MjData(model)
    state = mujoco.mjtState.mjSTATE_INTEGRATION
    mujoco.mj_setState(model, data, engine.rows[0], state)
    for _ in range(50):
        mujoco.mj_step(model, data)
    engine.step(50)
    assert engine.take_diverged() is None
    assert np.allclose(engine.state("qpos")[0], data.qpos, atol=1e-9)
    turned = data.qpos[cube.entity.free_qpos_adr + 3 :][:4]
    assert abs(turned[0]) < 0.9  # it tumbles, about its centre of mass


def test_centres_of_mass_of_links(make) -> None:
    step = [0.01, 0.02, -0.03]
    entity = {"uid": "ur10", "link_names": ["forearm_link"]}
    env = fired(make, "randomize_link_com", {"entity_cfg": entity, "com_range": [step, step]})
    moved = field(env, "body_ipos") - env.sim.engine.model.body_ipos
    body = env.robot.body_of("forearm_link")
    assert moved[body] == pytest.approx(step)
    assert not np.delete(moved, body, axis=0).any()


def test_inertia_scales_and_mass_stays(make) -> None:
    heavy = EventCfg(func="randomize_rigid_object_mass", params={**CUBE, "mass_range": [3, 3]})
    round_ = EventCfg(func="randomize_link_inertia", params={**CUBE, "inertia_range": [2, 2]})
    arm = {"entity_cfg": {"uid": "ur10", "link_names": "forearm_link"}, "inertia_range": [0.5, 0.5]}
    env = make(events={"a": heavy, "b": round_, "c": EventCfg("randomize_link_inertia", arm)})
    env.reset()
    env.reset()
    cube = env.sim.get_rigid_object("cube")
    assert cube.get_mass()[0].item() == 3.0
    assert cube.get_inertia()[0].tolist() == pytest.approx([2 * 3 / 600] * 3)
    body = env.robot.body_of("forearm_link")
    ratio = field(env, "body_inertia")[body] / env.sim.engine.model.body_inertia[body]
    assert ratio == pytest.approx([0.5] * 3)
    assert field(env, "body_mass")[body] == env.sim.engine.model.body_mass[body]


# -- friction --------------------------------------------------------------------------------------


def test_friction_of_an_object_a_link_and_the_ground(make) -> None:
    params = {**CUBE, "friction_range": [0.3, 0.3], "rolling_range": [0.02, 0.02]}
    env = fired(make, "randomize_rigid_body_material", params)
    cube = env.sim.get_rigid_object("cube")
    geom, compiled = int(cube.entity.geom_ids[0]), env.sim.engine.model.geom_friction
    assert cube.get_friction().tolist() == pytest.approx([0.3] * 3)
    assert field(env, "geom_friction")[geom].tolist() == [0.3, compiled[geom, 1], 0.02]
    ground = fired(make, "randomize_ground_material", {"torsional_range": [0.1, 0.1]})
    plane = ground.sim.engine.model.geom("default_plane").id
    assert field(ground, "geom_friction")[plane].tolist() == [0.3, 0.1, compiled[plane, 2]]
    link = {"entity_cfg": {"uid": "ur10", "link_names": "wrist_1_link"}}
    arm = fired(make, "randomize_rigid_body_material", {**link, "friction_range": [0.7, 0.7]})
    model = arm.sim.engine.model
    changed = np.flatnonzero((field(arm, "geom_friction") != model.geom_friction).any(axis=1))
    assert len(changed)
    assert set(model.geom_bodyid[changed]) == {arm.robot.body_of("wrist_1_link")}
    assert set(field(arm, "geom_friction")[changed, 0]) == {0.7}


def test_the_larger_friction_of_cube_and_ground_acts(make) -> None:
    slick = {"friction_range": [0.05, 0.05]}
    both = {
        "cube": EventCfg(func="randomize_rigid_body_material", params={**CUBE, **slick}),
        "ground": EventCfg(func="randomize_ground_material", params=slick),
    }

    def slides(events: dict) -> float:
        env = make(num_envs=1, events=events)
        env.reset()
        env.sim.update(step=20)  # it comes to rest
        cube = env.sim.get_rigid_object("cube")
        cube.set_velocity(lin_vel=[[1.0, 0.0, 0.0]])
        before = cube.read_pose()[0][0, 0]
        env.sim.update(step=40)
        return float(cube.read_pose()[0][0, 0] - before)

    # In 0.4 s at 1 m/s: v t - mu g t^2 / 2, or to the end, v^2 / (2 mu g).
    assert slides(both) == pytest.approx(0.4 - 0.05 * 9.81 * 0.4**2 / 2, rel=0.05)
    assert slides({}) == pytest.approx(1 / (2 * 0.5 * 9.81), rel=0.1)
    with pytest.raises(ConfigError, match="cannot act: cube: .* at least 0.1, and the larger"):
        slides({"cube": both["cube"]})


# -- joints ----------------------------------------------------------------------------------------


def test_gains_are_what_the_handle_says(make) -> None:
    given = {"stiffness_range": {"Joint3": [77, 77]}, "damping_range": [8, 8]}
    env = fired(make, "randomize_actuator_gains", {**ARM, **given})
    stiffness, damping, *_ = env.robot.get_joint_drive()
    assert stiffness[1].tolist() == [1e4, 1e4, 77, 1e4, 1e4, 1e4]
    assert damping[1].tolist() == [8] * 6
    actuator = env.robot.entity.actuator_ids[2]
    assert field(env, "actuator_gainprm")[actuator, 0] == 77
    assert field(env, "actuator_biasprm")[actuator, :3].tolist() == [0, -77, -8]
    # The force: 77 x (target - position) - 8 x velocity, at rest 0.5 rad off the target.
    env.robot.set_qpos(torch.tensor([HOME] * 3) + torch.tensor([0.0, 0, 0.5, 0, 0, 0]))
    env.sim.engine.forward()
    assert env.robot.get_qf()[0, 2].item() == pytest.approx(77 * 0.5, rel=1e-5)


def test_effort_limits_clamp_and_are_said(make) -> None:
    env = fired(make, "randomize_effort_limits", {**ELBOW, "effort_limit_range": [20, 20]})
    assert (
        env.robot.get_joint_drive()[2][0].tolist() == [torch.inf, torch.inf, 20] + [torch.inf] * 3
    )
    env.robot.set_qpos(torch.tensor([HOME] * 3) + 0.5)
    env.sim.engine.forward()
    assert env.robot.get_qf()[0].abs().tolist() == pytest.approx([5e3, 5e3, 20, 5e3, 5e3, 5e3])


def test_declared_effort_limits_scale(make) -> None:
    drives = JointDrivePropertiesCfg(max_effort="file")
    robot = RobotCfg(uid="ur10", fpath=UR10, init_qpos=HOME, drive_pros=drives)
    params = {**ARM, "effort_limit_range": [0.5, 0.5], "operation": "scale"}
    env = fired(make, "randomize_effort_limits", params, robot=robot)
    declared = env.robot.parsed.max_effort
    assert env.robot.get_joint_drive()[2][0].tolist() == pytest.approx((declared / 2).tolist())
    strong = EventCfg(
        func="randomize_actuator_strength", params={**ARM, "strength_range": [0.5, 0.5]}
    )
    both = make(robot=robot, events={"a": EventCfg("randomize_effort_limits", params), "b": strong})
    both.reset()
    both.reset()  # the order does not matter, and nothing is multiplied twice
    limits = field(both, "actuator_forcerange")[both.robot.entity.actuator_ids, 1]
    assert limits.tolist() == pytest.approx((declared / 4).tolist())
    gains = field(both, "actuator_gainprm")[both.robot.entity.actuator_ids, 0]
    assert gains.tolist() == [5e3] * 6
    assert both.robot.get_joint_drive()[0][0].tolist() == [1e4] * 6  # nominal


def test_joint_parameters_are_what_the_handle_says(make) -> None:
    given = {
        "friction_range": [2, 2],
        "armature_range": [0.3, 0.3],
        "damping_range": [7, 7],
        "lower_limit_range": {"Joint3": [-1, -1]},
        "upper_limit_range": {"Joint3": [2, 2]},
    }
    env = fired(make, "randomize_joint_parameters", {**ARM, **given})
    _, damping, _, _, friction = env.robot.get_joint_drive()
    armature = env.robot.body_data.joint_armature
    for found, wanted in ((friction, 2), (armature, 0.3)):
        assert found[2].tolist() == pytest.approx([wanted] * 6)
    dofs = env.robot.entity.dof_adr
    assert field(env, "dof_damping")[dofs].tolist() == [7.0] * 6  # the joints' own ...
    assert damping[2].tolist() == [1e3] * 6  # ... not that of the drives
    assert field(env, "dof_frictionloss")[dofs].tolist() == [2.0] * 6
    plain = make()
    plain.reset()
    plain.sim.engine.derived("xpos")
    inertia = field(env, "dof_M0")[dofs] - plain.sim.engine.model_of(0).dof_M0[dofs]
    assert inertia == pytest.approx([0.3] * 6)
    limits = env.robot.get_qpos_limits()[:, 2]
    assert limits.tolist() == [[-1.0, 2.0]] * 3
    env.robot.set_qpos(torch.full((3, 6), 3.0))
    assert env.robot.get_qpos(target=True)[:, 2].tolist() == [2.0] * 3
    env.robot.set_qpos(torch.full((3, 6), -3.0), target=False)
    assert env.robot.get_qpos()[:, 2].tolist() == [-1.0] * 3
    assert env.robot.get_qpos()[:, 1].tolist() == [-3.0] * 3


OWN = """
<mujoco>
  <worldbody>
    <body name="base">
      <geom size=".1" mass="1"/>
      <body name="arm" pos="0 0 .2">
        <joint name="swing" axis="0 1 0"/><geom size=".05" pos=".3 0 0" mass="1"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="motor" joint="swing" gear="3" forcerange="-4 4" ctrlrange="-9 9"/>
  </actuator>
</mujoco>
"""


def test_a_files_own_motor_is_made_weaker(make, tmp_path) -> None:
    (tmp_path / "own.xml").write_text(OWN)
    robot = RobotCfg(
        uid="own",
        fpath=str(tmp_path / "own.xml"),
        drive_pros=JointDrivePropertiesCfg(drive_type="none"),
        init_pos=(0, 0, 1),
    )
    own = {"entity_cfg": {"uid": "own"}}
    env = fired(
        make, "randomize_actuator_strength", {**own, "strength_range": [0.5, 0.5]}, robot=robot
    )
    motor = int(env.robot.entity.own_actuator_ids[0])
    for ctrl, force in ((1.0, 0.5), (9.0, 2.0)):  # half of each; limited to half of 4
        env.sim.engine.write("ctrl", ctrl, None, slice(motor, motor + 1))
        env.sim.engine.forward()
        assert env.sim.engine.acceleration("actuator_force")[0, motor] == force
    with pytest.raises(ConfigError, match="use randomize_actuator_strength"):
        fired(make, "randomize_actuator_gains", {**own, "stiffness_range": [1, 2]}, robot=robot)


def test_gravity_is_each_environments_own(make) -> None:
    params = {"gravity_range": [[0, 0, 0], [0, 0, 9.81]]}
    env = fired(make, "randomize_physics_scene_gravity", params, num_envs=8)
    gravity = env.sim.engine.model_field("opt.gravity")
    cube = env.sim.get_rigid_object("cube")
    cube.set_local_pose([[0.5, 0.5, 3.0, 1, 0, 0, 0]] * 8)
    cube.set_damping([[0.0, 0.0]] * 8)
    env.sim.update(step=10)
    time = 10 * env.physics_dt
    fell = cube.read_velocity()[0][:, 2]
    assert fell == pytest.approx(gravity[:, 2] * time)
    assert len(set(fell.tolist())) == 8


# -- sizes -----------------------------------------------------------------------------------------


def scaled(make, shape, factors, fixed_density=True):
    low = factors if isinstance(factors, list) else None
    params = {
        "entity_cfg": {"uid": "thing"},
        "scale_factor_range": [low, low] if low else [factors, factors],
        "same_scale_all_axes": low is None,
        "fixed_density": fixed_density,
    }
    objects = {"thing": RigidObjectCfg(shape=shape, init_pos=(0, 0, 1))}
    return fired(make, "randomize_rigid_object_scale", params, objects=objects)


@pytest.mark.parametrize(
    ("shape", "bigger", "factors"),
    [
        (CubeCfg(size=[0.1, 0.2, 0.3]), CubeCfg(size=[0.2, 0.1, 0.9]), [2.0, 0.5, 3.0]),
        (SphereCfg(radius=0.1), SphereCfg(radius=0.15), 1.5),
        (CylinderCfg(radius=0.1, height=0.3), CylinderCfg(radius=0.05, height=0.6), [0.5, 9, 2.0]),
        (CapsuleCfg(radius=0.1, height=0.3), CapsuleCfg(radius=0.2, height=0.15), [2.0, 9, 0.5]),
    ],
)
@pytest.mark.parametrize("fixed_density", [True, False])
def test_a_scaled_shape_is_the_shape_compiled_at_that_size(
    make, shape, bigger, factors, fixed_density
) -> None:
    env = scaled(make, shape, factors, fixed_density)
    env.reset()
    wanted = make(objects={"thing": RigidObjectCfg(shape=bigger, init_pos=(0, 0, 1))})
    model = wanted.sim.engine.model
    thing = env.sim.get_rigid_object("thing")
    body, geom = thing.entity.root_body_id, int(thing.entity.geom_ids[0])
    for name in ("geom_size", "geom_rbound", "geom_aabb"):
        assert field(env, name)[geom] == pytest.approx(getattr(model, name)[geom]), name
    compiled = env.sim.engine.model
    volume = _volume(bigger) / _volume(shape)
    mass = compiled.body_mass[body] * (volume if fixed_density else 1)
    assert thing.get_mass()[0].item() == pytest.approx(mass)
    # Declared masses are 1 kg whatever the size: inertia per mass is what is compared.
    inertia = field(env, "body_inertia")[body] / mass
    assert inertia == pytest.approx(model.body_inertia[body] / model.body_mass[body])
    scale = factors if isinstance(factors, list) else [factors] * 3
    if len(thing.solid.equal_axes) == 2:
        scale = [scale[0], scale[0], scale[2]]
    assert thing.get_body_scale()[0].tolist() == pytest.approx(scale)


def _volume(shape) -> float:
    if isinstance(shape, CubeCfg):
        return float(np.prod(shape.size))
    r = shape.radius
    if isinstance(shape, SphereCfg):
        return 4 / 3 * np.pi * r**3
    ends = 4 / 3 * np.pi * r**3 if isinstance(shape, CapsuleCfg) else 0.0
    return np.pi * r**2 * shape.height + ends


def test_mass_after_size_keeps_the_inertia_of_the_size(make) -> None:
    size = {**CUBE, "scale_factor_range": [2, 2]}
    events = {
        "size": EventCfg("randomize_rigid_object_scale", size),
        "mass": EventCfg("randomize_rigid_object_mass", {**CUBE, "mass_range": [5, 5]}),
    }
    env = make(events=events)
    env.reset()
    env.reset()
    cube = env.sim.get_rigid_object("cube")
    assert cube.get_mass()[0].item() == 5.0
    assert cube.get_inertia()[0].tolist() == pytest.approx([5 * 0.2**2 / 6] * 3)


def test_a_bigger_cube_rests_higher(make) -> None:
    env = fired(make, "randomize_rigid_object_scale", {**CUBE, "scale_factor_range": [2, 2]})
    env.sim.get_rigid_object("cube").set_local_pose([[0.5, 0.5, 0.12, 1, 0, 0, 0]] * 3)
    env.sim.update(step=150)
    height = env.sim.get_rigid_object("cube").read_pose()[0][:, 2]
    assert height == pytest.approx([0.1] * 3, abs=2e-3)


def test_one_factor_may_be_written_as_a_range_of_one_axis(make) -> None:
    size = {**CUBE, "scale_factor_range": [[2], [2.0]]}
    env = fired(make, "randomize_rigid_object_scale", size)
    assert env.sim.get_rigid_object("cube").get_body_scale().tolist() == [[2.0] * 3] * 3


def test_objects_share_a_draw_or_not(make) -> None:
    both = [{"uid": "cube"}, {"uid": "goal"}]
    for shared in (True, False):
        params = {
            "entity_cfgs": both,
            "scale_factor_range": [0.5, 1.5],
            "shared_sample": shared,
        }
        env = fired(make, "randomize_rigid_objects_scale", params)
        cube, goal = (env.sim.get_rigid_object(uid).get_body_scale() for uid in ("cube", "goal"))
        assert torch.equal(cube, goal) is shared


def test_fields_of_one_term_are_drawn_together(make) -> None:
    params = {**CUBE, "scale": [2, 2], "mass": [5, 5], "friction": [0.3, 0.3]}
    env = fired(make, "randomize", params)
    cube = env.sim.get_rigid_object("cube")
    assert cube.get_body_scale()[0].tolist() == [2.0] * 3
    assert cube.get_mass()[0].item() == 5.0
    assert cube.get_inertia()[0].tolist() == pytest.approx([5 * 0.2**2 / 6] * 3)
    assert cube.get_friction().tolist() == pytest.approx([0.3] * 3)
    scene = fired(make, "randomize", {"gravity": [[0, 0, 9], [0, 0, 9]], "friction": [0.5, 0.5]})
    plane = scene.sim.engine.model.geom("default_plane").id
    assert field(scene, "geom_friction")[plane, 0] == 0.5
    assert scene.sim.engine.model_field("opt.gravity")[0].tolist() == pytest.approx([0, 0, -0.81])


def test_several_entities_have_draws_of_their_own(make) -> None:
    both = {"entity_cfgs": [{"uid": "cube"}, {"uid": "ur10"}], "mass": [0.5, 2]}
    env = fired(make, "randomize", both)
    masses = [env.sim.get_rigid_object("cube").get_mass()[0].item(), *env.robot.get_mass()[0]]
    assert len({round(float(m), 9) for m in masses if m > 0}) > 5


# -- mistakes --------------------------------------------------------------------------------------

WRONG = [
    ("randomize_rigid_object_mass", {"entity_cfg": {"uid": "ur10"}, "mass_range": [1, 2]},
     "entity_cfg.uid", "not a rigid object"),
    ("randomize_rigid_object_mass", {"entity_cfg": {"uid": "goal"}, "mass_range": [1, 2]},
     "entity_cfg.uid", "kinematic"),
    ("randomize_rigid_object_mass", {**CUBE, "mass_range": [2, 1]}, "mass_range", "exceeds"),
    ("randomize_rigid_object_mass", {**CUBE, "mass_range": [1, 2], "min_mass": 0}, "min_mass", ""),
    ("randomize_rigid_object_mass",
     {**CUBE, "mass_range": [1, 2], "relative": True, "operation": "scale"}, "operation", "adds"),
    ("randomize_rigid_object_mass",
     {**CUBE, "mass_range": [0, 2], "distribution": "log_uniform"}, "mass_range", "positive"),
    ("randomize_rigid_object_mass",
     {**CUBE, "mass_range": [1, 2], "distribution": "normal"}, "distribution", "gaussian"),
    ("randomize_articulation_mass", {**CUBE, "mass_range": [1, 2]}, "entity_cfg.uid", "no joints"),
    ("randomize_articulation_mass", {**ARM, "mass_range": {"wrist": [1, 2]}},
     "mass_range.wrist", "wrist_1_link"),
    ("randomize_articulation_mass", {**ARM, "mass_range": [1, 2], "link_names": ["nose"]},
     "link_names", "no link"),
    ("randomize_rigid_body_material", {**CUBE}, "", "at least one range"),
    ("randomize_rigid_body_material", {"entity_cfg": {"uid": "goal"}, "friction_range": [1, 2]},
     "entity_cfg", "collides"),
    ("randomize_rigid_body_material", {**CUBE, "friction_range": [-0.1, 1]},
     "friction_range", "below 0"),
    ("randomize_actuator_gains", {**ARM, "stiffness_range": [-2e4, 0], "operation": "add"},
     "stiffness_range", "below 0"),
    ("randomize_effort_limits", {**ARM, "effort_limit_range": [0.5, 1], "operation": "scale"},
     "effort_limit_range", "no limit"),
    ("randomize_joint_parameters", {**ELBOW, "lower_limit_range": [8, 9]},
     "lower_limit_range", "exceed the upper"),
    ("randomize_link_inertia", {**ARM, "inertia_range": [0, 1]}, "inertia_range", "below"),
    ("randomize_rigid_object_scale", {**CUBE, "scale_factor_range": [0, 1]},
     "scale_factor_range", "below"),
    ("randomize_rigid_object_scale",
     {**CUBE, "scale_factor_range": [[1, 1, 1], [2, 2, 2]]}, "scale_factor_range", "false"),
    ("randomize_rigid_object_scale",
     {"entity_cfg": {"uid": "goal"}, "scale_factor_range": [1, 2], "same_scale_all_axes": False},
     "same_scale_all_axes", "sphere"),
    ("randomize_rigid_objects_scale", {"entity_cfgs": [], "scale_factor_range": [1, 2]},
     "entity_cfgs", "no object"),
    ("randomize_rigid_object_mass", {"of": {"uid": "ur10"}, "mass_range": [1, 2]},
     "of.uid", "not a rigid object"),
    ("randomize", {**CUBE}, "", "at least one range"),
    ("randomize", {"mass": [1, 2]}, "of", "of which entity"),
    ("randomize", {**CUBE, "gravity": [[0, 0, -9], [0, 0, -8]]}, "gravity", "leave `of` out"),
    ("randomize", {**CUBE, "inertia": [1, 2], "operation": "add"}, "operation", "always"),
    ("randomize", {**CUBE, "stiffness": [1, 2]}, "entity_cfg.uid", "no joints"),
    ("randomize", {**CUBE, "mass": [1, 2], "shared_sample": True}, "shared_sample", "scales"),
    ("randomize", {**CUBE, "mas": [1, 2]}, "mas", "Did you mean 'mass'?"),
]  # fmt: skip


@pytest.mark.parametrize(("func", "params", "path", "message"), WRONG)
def test_mistakes_are_said_at_build(make, func, params, path, message) -> None:
    with pytest.raises(ConfigError) as caught:
        make(events={"e": EventCfg(func=func, params=params)})
    (problem,) = caught.value.problems[:1]
    assert problem.path.rstrip(".").endswith(f"events.e.params.{path}".rstrip("."))
    assert message in str(caught.value)


def test_what_has_no_size_is_refused(make) -> None:
    floor = {"thing": RigidObjectCfg(shape=PlaneCfg(size=[1, 1]), body_type="static")}
    params = {"entity_cfg": {"uid": "thing"}, "scale_factor_range": [1, 2]}
    with pytest.raises(ConfigError, match="thing is a plane.*only box, sphere") as caught:
        fired(make, "randomize_rigid_object_scale", params, objects=floor)
    assert caught.value.problems[0].path == "events.e.params.entity_cfg.uid"
