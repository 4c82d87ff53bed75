"""`compile_scene`: builds one model from parsed articulations, objects, lights and sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import LightCfg, RigidObjectCfg, SimulationManagerCfg
from embodichain.lab.sim.compiler.articulation import ParsedArticulation
from embodichain.lab.sim.compiler.index import F64, EntityIndex, Ids
from embodichain.lab.sim.compiler.names import GROUND, check_uid
from embodichain.lab.sim.compiler.rigid_objects import (
    add_object,
    check_object,
    check_pose,
    damping_of,
    initial_pose,
)
from embodichain.lab.sim.compiler.robot_files import MUJOCO_ERRORS, as_line, compile_quietly
from embodichain.lab.sim.compiler.robot_links import MAX_MASKED, separate
from embodichain.lab.sim.compiler.scene_sensors import (
    SensorIndex,
    SensorPlan,
    add_sensors,
    index_sensors,
    silent_sensors,
)
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import quat_multiply, quat_rotate

__all__ = ["CompiledScene", "SceneParts", "check_light", "compile_scene"]

_INTEGRATORS = {
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT,
    "Euler": mujoco.mjtIntegrator.mjINT_EULER,
    "RK4": mujoco.mjtIntegrator.mjINT_RK4,
}
_SOLVERS = {
    "Newton": mujoco.mjtSolver.mjSOL_NEWTON,
    "CG": mujoco.mjtSolver.mjSOL_CG,
    "PGS": mujoco.mjtSolver.mjSOL_PGS,
}
_CONES = {
    "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL,
    "elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC,
}
_ENUMS: dict[str, type[Any]] = {
    "integrator": mujoco.mjtIntegrator,
    "solver": mujoco.mjtSolver,
    "cone": mujoco.mjtCone,
    "jacobian": mujoco.mjtJacobian,
}
_FLAGS: dict[str, type[Any]] = {
    "disableflags": mujoco.mjtDisableBit,
    "enableflags": mujoco.mjtEnableBit,
}


def _apply_options(spec: mujoco.MjSpec, cfg: SimulationManagerCfg) -> None:
    """Set a scene's physics options.

    Auto-reset is off: it would reset a diverged simulation to qpos0 within a step.

    Raises:
        ConfigError: If the timestep is not positive.
    """
    if not cfg.physics_dt > 0:
        raise ConfigError([Problem("physics_dt", f"must be positive, got {cfg.physics_dt}")])
    physics, option = cfg.physics_config, spec.option
    option.timestep = float(cfg.physics_dt)
    option.gravity = [float(g) for g in physics.gravity]
    option.integrator = int(_INTEGRATORS[physics.integrator])
    option.solver = int(_SOLVERS[physics.solver])
    option.iterations = int(physics.iterations)
    option.cone = int(_CONES[physics.cone])
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)


def _replace_options(child: mujoco.MjSpec, scene: mujoco.MjSpec) -> list[str]:
    """Replace a child's options by the scene's.

    Returns:
        ``name: value in the file -> value of the scene`` for each option of the file that differs
        from MuJoCo's default and from the scene.
    """
    default = mujoco.MjSpec().option
    replaced: list[str] = []
    for name in (name for name in dir(default) if not name.startswith("_")):
        old, new = getattr(child.option, name), getattr(scene.option, name)
        if name in _FLAGS:
            theirs = int(old) & ~int(new)
            if theirs:
                replaced.append(f"{name} {_flags(name, theirs)} -> off")
        elif not np.array_equal(old, new) and not np.array_equal(old, getattr(default, name)):
            replaced.append(f"{name} {_show(name, old)} -> {_show(name, new)}")
        setattr(child.option, name, new)
    return replaced


def _show(name: str, value: Any) -> str:
    if name in _ENUMS:
        return str(_ENUMS[name](int(value)).name.split("_")[-1].lower())
    array = np.asarray(value, np.float64).reshape(-1)
    return " ".join(f"{x:g}" for x in array)


def _flags(name: str, bits: int) -> str:
    known = [flag for flag in _FLAGS[name].__members__.values() if int(flag) & bits]
    names = [flag.name.split("_")[-1].lower() for flag in known if int(flag).bit_count() == 1]
    return ", ".join(names) or hex(bits)


_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)


@dataclass(frozen=True, eq=False)
class CompiledScene:
    """One model of all declared entities.

    Attributes:
        model: The compiled model. Damping of free objects and the camera's pose are set after
            compiling; MJCF has only one damping for all six axes of a free joint.
        spec: The spec it was compiled from, for export as XML or archive.
        entities: Indices of each entity in the model.
        initial_row: (nstate,) initial `mjSTATE_INTEGRATION`: MuJoCo's reset state with entities at
            their configured poses, drive targets at the configured joint positions, and other
            values of the files' keyframes.
        sensors: Columns of each sensor.
        notes: Messages for the user, one line each: options of the robots' files that the scene
            replaces, sensors that can never report anything.
    """

    model: mujoco.MjModel
    spec: mujoco.MjSpec
    entities: dict[str, EntityIndex]
    initial_row: F64
    sensors: dict[str, SensorIndex] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


SceneParts = tuple[
    SimulationManagerCfg,
    Sequence[ParsedArticulation],
    Mapping[str, RigidObjectCfg],
    Mapping[str, LightCfg],
    Mapping[str, SensorPlan],
]
"""The arguments of `compile_scene`."""


def compile_scene(
    sim_cfg: SimulationManagerCfg,
    articulations: Sequence[ParsedArticulation],
    objects: Mapping[str, RigidObjectCfg],
    lights: Mapping[str, LightCfg],
    sensors: Mapping[str, SensorPlan] | None = None,
) -> CompiledScene:
    """Compile one model, in which elements of an entity are named ``uid/NAME``.

    Args:
        sim_cfg: Timestep, physics options, ground plane.
        articulations: Robots and other articulations.
        objects: Rigid objects by uid.
        lights: Lights by uid.
        sensors: Sensors by uid.

    Raises:
        ConfigError: If names clash, an object is wrong, or MuJoCo refuses the model.
    """
    sensors = sensors or {}
    _check(articulations, objects, (*lights, *sensors))
    spec = mujoco.MjSpec()
    spec.modelname = "embodichain"
    spec.compiler.degree = False
    _apply_options(spec, sim_cfg)
    set_look(spec)
    if sim_cfg.ground_plane:
        add_ground(spec)
    add_lights(spec, lights)
    masked = 0
    notes: list[str] = []
    for parsed in articulations:
        child = parsed.spec.copy()
        if parsed.cfg.disable_self_collision:
            masked += 1
            separate(child, masked)
        notes += _attach(spec, child, parsed)
    for number, (uid, cfg) in enumerate(objects.items()):
        add_object(spec, uid, cfg, number)
    add_sensors(spec, sensors)
    try:
        model = compile_quietly(spec)
    except MUJOCO_ERRORS as error:
        raise ConfigError(f"MuJoCo cannot compile the scene: {as_line(error)[0]}") from error
    notes += silent_sensors(model, sensors)
    entities = {p.uid: _index_articulation(model, p) for p in articulations}
    for uid, cfg in objects.items():
        index = entities[uid] = _index_object(model, uid, cfg)
        if index.free_qvel_adr >= 0:
            dofs = slice(index.free_qvel_adr, index.free_qvel_adr + 6)
            model.dof_damping[dofs] = damping_of(model, index.root_body_id, cfg)
    data = _start(model, articulations, entities)
    row = np.zeros(mujoco.mj_stateSize(model, _STATE))
    mujoco.mj_getState(model, data, row, _STATE)
    mujoco.mj_kinematics(model, data)
    aim_camera(spec, model, data)
    sensor_index = index_sensors(model, sensors, entities)
    return CompiledScene(model, spec, entities, row, sensor_index, tuple(notes))


def _check(
    articulations: Sequence[ParsedArticulation],
    objects: Mapping[str, RigidObjectCfg],
    others: Sequence[str],
) -> None:
    problems: list[Problem] = []
    taken = {GROUND: "the ground plane"}
    for uid in (*(p.uid for p in articulations), *objects, *others):
        problems += check_uid(uid, uid, taken)
        taken[uid] = "another entity"
    for uid, cfg in objects.items():
        problems += [p.below(uid) for p in check_object(cfg)]
    masked = [p.uid for p in articulations if p.cfg.disable_self_collision]
    if len(masked) > MAX_MASKED:
        message = f"at most {MAX_MASKED} articulations of a scene can do without self-collision"
        problems.append(Problem(masked[MAX_MASKED], f"{message}, this is one more"))
    if problems:
        raise ConfigError(problems)


def _attach(spec: mujoco.MjSpec, child: mujoco.MjSpec, parsed: ParsedArticulation) -> list[str]:
    """Attach an articulation at its pose; return messages for the user."""
    what = "; ".join(_replace_options(child, spec))
    options = f"{parsed.uid}: the scene's physics replaces options of {parsed.path}: {what}"
    pos, quat = initial_pose(parsed.cfg)
    frame = spec.worldbody.add_frame(pos=pos, quat=quat)
    spec.attach(child, frame=frame, prefix=f"{parsed.uid}/")
    return [options] if what else []


def _index_articulation(model: mujoco.MjModel, parsed: ParsedArticulation) -> EntityIndex:
    prefix = f"{parsed.uid}/"
    bodies = np.array([model.body(prefix + name).id for name in parsed.link_names], np.int64)
    joints = np.array([model.joint(prefix + name).id for name in parsed.joint_names], np.int64)
    own = [i for i in range(model.nactuator) if model.actuator(i).name.startswith(prefix)]
    actuators = {model.actuator(i).name.removeprefix(prefix): i for i in own}
    targets: Ids = np.array([actuators.get(name, -1) for name in parsed.drives], np.int64)
    alone = parsed.model
    speeds: Ids = np.array(
        [actuators[alone.actuator(int(a)).name] if a >= 0 else -1 for a in parsed.servos.velocity],
        np.int64,
    )
    root = int(model.body(prefix + parsed.root_link_name).id)
    pos, quat = initial_pose(parsed.cfg)
    free = -1 if parsed.fixed_base else int(model.body_jntadr[root])
    return EntityIndex(
        uid=parsed.uid,
        kind="articulation",
        body_ids=bodies,
        root_body_id=root,
        pos0=pos + quat_rotate(quat, parsed.root_pose[:3]),
        quat0=quat_multiply(quat, parsed.root_pose[3:]),
        geom_ids=np.flatnonzero(np.isin(model.geom_bodyid, bodies)).astype(np.int64),
        mocap_id=int(model.body_mocapid[root]),
        free_qpos_adr=int(model.jnt_qposadr[free]) if free >= 0 else -1,
        free_qvel_adr=int(model.jnt_dofadr[free]) if free >= 0 else -1,
        qpos_adr=model.jnt_qposadr[joints].astype(np.int64),
        dof_adr=model.jnt_dofadr[joints].astype(np.int64),
        actuator_ids=targets,
        ctrl_ids=_first_controls(model, targets),
        velocity_ctrl_ids=_first_controls(model, speeds),
        own_actuator_ids=np.array(own, np.int64),
        own_ctrl_ids=_ranges(model.actuator_ctrladr[own], model.actuator_ctrlnum[own]),
        own_act_ids=_ranges(model.actuator_actadr[own], model.actuator_actnum[own]),
    )


def _first_controls(model: mujoco.MjModel, actuators: Ids) -> Ids:
    """Return the first control of each actuator; -1 for -1."""
    columns: Ids = np.full(len(actuators), -1, np.int64)
    known = actuators >= 0
    columns[known] = model.actuator_ctrladr[actuators[known]]
    return columns


def _ranges(starts: Ids, counts: Ids) -> Ids:
    """Return the concatenation of ``start + arange(count)``."""
    parts = [np.arange(a, a + n) for a, n in zip(starts, counts, strict=True)]
    return np.concatenate([np.zeros(0), *parts]).astype(np.int64)


def _index_object(model: mujoco.MjModel, uid: str, cfg: RigidObjectCfg) -> EntityIndex:
    body = int(model.body(uid).id)
    pos, quat = initial_pose(cfg)
    joint = int(model.body_jntadr[body])
    return EntityIndex(
        uid=uid,
        kind="object",
        body_ids=np.array([body], np.int64),
        root_body_id=body,
        pos0=pos,
        quat0=quat,
        geom_ids=np.flatnonzero(model.geom_bodyid == body).astype(np.int64),
        mocap_id=int(model.body_mocapid[body]),
        free_qpos_adr=int(model.jnt_qposadr[joint]) if joint >= 0 else -1,
        free_qvel_adr=int(model.jnt_dofadr[joint]) if joint >= 0 else -1,
    )


def _start(
    model: mujoco.MjModel,
    articulations: Sequence[ParsedArticulation],
    entities: Mapping[str, EntityIndex],
) -> mujoco.MjData:
    """Return the scene's initial state."""
    data = mujoco.MjData(model)
    for index in entities.values():
        pose: F64 = np.concatenate([index.pos0, index.quat0])
        if index.mocap_id >= 0:
            data.mocap_pos[index.mocap_id], data.mocap_quat[index.mocap_id] = pose[:3], pose[3:]
        elif index.free_qpos_adr >= 0:
            data.qpos[index.free_qpos_adr : index.free_qpos_adr + 7] = pose
    for parsed in articulations:
        index = entities[parsed.uid]
        data.qpos[index.qpos_adr], data.qvel[index.dof_adr] = parsed.init_qpos, parsed.init_qvel
        data.ctrl[index.own_ctrl_ids], data.act[index.own_act_ids] = (
            parsed.init_ctrl,
            parsed.init_act,
        )
        if parsed.keyframe is None:
            continue
        start = index.free_qvel_adr
        if start >= 0:
            velocity = parsed.keyframe.root_qvel
            data.qvel[start : start + 3] = quat_rotate(initial_pose(parsed.cfg)[1], velocity[:3])
            data.qvel[start + 3 : start + 6] = velocity[3:]
        for name, (quat, speed) in parsed.keyframe.balls.items():
            joint = model.joint(f"{parsed.uid}/{name}")
            data.qpos[joint.qposadr[0] : joint.qposadr[0] + 4] = quat
            data.qvel[joint.dofadr[0] : joint.dofadr[0] + 3] = speed
    return data


# --------------------------------------------------------------------------------------- appearance

CAMERA = "default"
SUN = "default"

_FULL_INTENSITY = 30.0
_FOVY = 40.0
_VIEW = np.array([1.0, -0.8, 0.32])
"""Direction from the scene to the camera: front, right, above."""
_LIGHTS = {
    "point": mujoco.mjtLightType.mjLIGHT_POINT,
    "sun": mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
    "direction": mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
    "spot": mujoco.mjtLightType.mjLIGHT_SPOT,
}


def set_look(spec: mujoco.MjSpec) -> None:
    """Set sky, haze, ambient light and sizes; add the camera (placed by `aim_camera`)."""
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = 1920, 1440
    visual.global_.fovy = _FOVY
    visual.quality.shadowsize = 4096
    visual.map.znear, visual.map.zfar = 0.01, 60.0
    visual.map.fogstart, visual.map.fogend = 6.0, 20.0
    visual.headlight.ambient = [0.32, 0.33, 0.35]
    visual.headlight.diffuse = [0.38, 0.38, 0.38]
    visual.headlight.specular = [0.05, 0.05, 0.05]
    visual.rgba.haze = [0.80, 0.86, 0.92, 1.0]
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.42, 0.56, 0.72],
        rgb2=[0.86, 0.90, 0.94],
        width=256,
        height=1536,
    )
    spec.worldbody.add_camera(name=CAMERA, fovy=_FOVY)


def add_ground(spec: mujoco.MjSpec) -> None:
    """Add the ground plane at z = 0, with tiles of one metre."""
    spec.add_texture(
        name=GROUND,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=[0.72, 0.74, 0.76],
        rgb2=[0.66, 0.68, 0.71],
        markrgb=[0.55, 0.57, 0.60],
        width=512,
        height=512,
    )
    material = spec.add_material(
        name=GROUND, texuniform=True, texrepeat=[0.5, 0.5], reflectance=0.08
    )
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = GROUND
    spec.worldbody.add_geom(
        name=GROUND,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0.0, 0.0, 1.0],
        material=GROUND,
    )


def check_light(cfg: LightCfg) -> list[Problem]:
    """Return every mistake in a light's config, with paths below it."""
    problems = check_pose(cfg)
    color, direction = np.asarray(cfg.color, np.float64), np.asarray(cfg.direction, np.float64)
    if not ((color >= 0) & (color <= 1)).all():
        problems.append(Problem("color", f"RGB in [0, 1], got {color.tolist()}"))
    if not cfg.intensity >= 0:
        problems.append(Problem("intensity", f"must not be negative, got {cfg.intensity}"))
    if not (np.isfinite(direction).all() and np.linalg.norm(direction) > 1e-9):
        problems.append(Problem("direction", f"must not be zero, got {direction.tolist()}"))
    return problems


def add_lights(spec: mujoco.MjSpec, lights: Mapping[str, LightCfg]) -> None:
    """Add the declared lights, or a sun with soft shadows if there are none."""
    if not lights:
        spec.worldbody.add_light(
            name=SUN,
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            pos=[0.0, 0.0, 6.0],
            dir=[-0.35, 0.45, -1.0],
            diffuse=[0.62, 0.61, 0.58],
            specular=[0.2, 0.2, 0.2],
            castshadow=True,
        )
    for uid, cfg in lights.items():
        strength = np.asarray(cfg.color, np.float64) * (float(cfg.intensity) / _FULL_INTENSITY)
        spec.worldbody.add_light(
            name=uid,
            type=_LIGHTS[cfg.light_type],
            pos=initial_pose(cfg)[0],
            dir=[float(x) for x in cfg.direction],
            diffuse=strength,
            specular=0.3 * strength,
            castshadow=cfg.light_type != "point",
        )


def aim_camera(spec: mujoco.MjSpec, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Place camera ``default`` so that it shows everything but infinite planes.

    Args:
        spec: The scene; its camera is set too, for saved files.
        model: The compiled scene; its camera is changed.
        data: The initial state, with positions computed.
    """
    center, radius = _bounds(model, data)
    back = _VIEW / np.linalg.norm(_VIEW)
    distance = radius / np.sin(np.radians(_FOVY / 2))
    pos = center + distance * back
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    matrix = np.stack([right, np.cross(back, right), back], axis=1)
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, matrix.reshape(9))
    camera = model.camera(CAMERA)
    camera.pos[:], camera.quat[:] = pos, quat
    camera.pos0[:], camera.poscom0[:], camera.mat0[:] = pos, pos, matrix.reshape(9)
    written = spec.camera(CAMERA)
    written.pos, written.quat = pos, quat
    _aim_sun(spec, model, center, radius)
    for stat in (model.stat, spec.stat):
        stat.extent, stat.center = max(2.0 * radius, 1.0), center


def _aim_sun(spec: mujoco.MjSpec, model: mujoco.MjModel, center: F64, radius: float) -> None:
    """Move the default light near the scene: its shadow map covers only its surroundings."""
    sun = spec.light(SUN)
    if sun is not None:
        light = model.light(SUN)
        light.pos[:] = sun.pos = center - 2.0 * radius * light.dir
        light.pos0[:] = light.poscom0[:] = light.pos


def _bounds(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[F64, float]:
    """Return centre and radius of a sphere around all finite geoms."""
    finite = np.flatnonzero(model.geom_rbound > 0)
    if not len(finite):
        return np.array([0.0, 0.0, 0.3]), 1.0
    reach = model.geom_rbound[finite, None]
    low = (data.geom_xpos[finite] - reach).min(axis=0)
    high = (data.geom_xpos[finite] + reach).max(axis=0)
    low[2] = max(low[2], 0.0) if high[2] > 0 else low[2]
    return 0.5 * (low + high), max(0.5 * float(np.linalg.norm(high - low)), 0.15)
