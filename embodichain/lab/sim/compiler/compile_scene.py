"""`compile_scene`: builds one model from parsed articulations, objects, lights and sensors."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from embodichain.data import get_data_path
from embodichain.lab.sim.cfg import RigidObjectCfg, SimulationManagerCfg
from embodichain.lab.sim.compiler.geoms.contact_parameters import given_parameters
from embodichain.lab.sim.compiler.geoms.poses import initial_pose
from embodichain.lab.sim.compiler.index import F64, EntityIndex, Ids
from embodichain.lab.sim.compiler.model_size import reported
from embodichain.lab.sim.compiler.names import GROUND, Known, check_uid
from embodichain.lab.sim.compiler.robot.files.initial_state import Keyframe
from embodichain.lab.sim.compiler.robot.files.robot_files import (
    MUJOCO_ERRORS,
    as_line,
    compile_quietly,
)
from embodichain.lab.sim.compiler.robot.floors import bind_floors, strangers_to
from embodichain.lab.sim.compiler.robot.parsed_articulation import ParsedArticulation
from embodichain.lab.sim.compiler.robot.robot_root import take_sizes
from embodichain.lab.sim.compiler.scene.appearance import (
    add_ground,
    add_lights,
    place_lights,
    set_look,
)
from embodichain.lab.sim.compiler.scene.known import known_entities
from embodichain.lab.sim.compiler.scene.physics_options import apply_options, replace_options
from embodichain.lab.sim.compiler.scene.rigid_objects import (
    add_object,
    check_object,
    damping_of,
    shapes_of,
)
from embodichain.lab.sim.compiler.scene.world import PREFIX, World, add_world, start_world
from embodichain.lab.sim.compiler.scene_parts import SceneParts
from embodichain.lab.sim.compiler.sensing.scene_sensors import (
    add_sensor,
    index_sensor,
    notes_on_sensor,
)
from embodichain.lab.sim.compiler.sensing.sensor_index import SensorIndex
from embodichain.lab.sim.compiler.sensing.views import add_views, place_views, scene_bounds
from embodichain.lab.sim.configs.scene_cfg import GroundCfg
from embodichain.lab.sim.shapes import MeshCfg
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import quat_rotate
from embodichain.utils.short_repr import short_repr

if TYPE_CHECKING:
    from embodichain.lab.sim.compiler.scene.terrain import Terrain

__all__ = ["CompiledScene", "compile_scene"]

_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)


@dataclass(frozen=True, eq=False)
class CompiledScene:
    """One model of all declared entities.

    Any number of simulations may be built from it, at once or one after the other: engines copy the
    model, and nothing writes to a compiled scene.

    Attributes:
        model: The compiled model. Damping of free objects and poses of views are set after
            compiling; MJCF has only one damping for all six axes of a free joint.
        spec: The spec it was compiled from, for export as XML or archive.
        parts: The entities and sensors it was compiled from.
        entities: Indices of each entity in the model.
        initial_row: (nstate,) initial `mjSTATE_INTEGRATION`: MuJoCo's reset state with entities at
            their configured poses, drive targets at the configured joint positions, and other
            values of the files' keyframes.
        sensors: Columns of each sensor.
        notes: Messages for the user, one line each: options of the robots' files that the scene
            replaces, sensors that can never report anything.
        terrain: The patches of the ground, if it has any.
    """

    model: mujoco.MjModel
    spec: mujoco.MjSpec
    parts: SceneParts
    entities: dict[str, EntityIndex]
    initial_row: F64
    sensors: dict[str, SensorIndex] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    terrain: Terrain | None = None

    def __repr__(self) -> str:
        """Return the sizes of the model and the names of what is in it."""
        return short_repr(
            self,
            nq=self.model.nq,
            nv=self.model.nv,
            nu=self.model.nu,
            entities=list(self.entities),
            sensors=list(self.sensors),
        )

    @property
    def camera_sensors(self) -> dict[str, tuple[int, tuple[int, int]]]:
        """Name of each picture of camera sensors to the id of the camera, and width and height."""
        return {
            name: camera
            for index in self.sensors.values()
            for name, camera in index.picture_cameras().items()
        }


def compile_scene(parts: SceneParts) -> CompiledScene:
    """Compile one model, in which elements of an entity are named ``uid/NAME``.

    Args:
        parts: What the scene is made of; not changed.

    Raises:
        ConfigError: If names clash, an object is wrong, or MuJoCo refuses the model.
    """
    _check_parts(parts)
    sim_cfg = parts.sim_cfg
    spec = mujoco.MjSpec()
    spec.modelname = "embodichain"
    spec.compiler.degree = False
    apply_options(spec, sim_cfg)
    notes = _add_world(spec, parts.world)
    set_look(spec, sim_cfg.scene)
    add_lights(spec, parts.lights, sim_cfg.scene.sun)
    for parsed in parts.articulations:
        notes += _attach(spec, parsed.spec.copy(), parsed)
    terrain = _add_ground(spec, sim_cfg)
    notes += _bind_floors(spec, sim_cfg, parts.articulations, parts.world)
    _add_objects(spec, parts)
    known = _known(parts)
    _add_views(spec, parts, known)
    _add_marks(spec, parts, known)
    for plan in parts.sensors.values():
        add_sensor(spec, plan)

    model = _compile(spec, parts.objects)
    for plan in parts.sensors.values():
        notes += notes_on_sensor(model, plan)
    entities = _index_entities(model, spec, parts)
    _set_damping(model, entities, parts.objects)
    if sim_cfg.has_ground:
        notes += _strangers_to_ground(model, entities)

    data = _start(model, parts.articulations, entities, parts.world)
    row = np.zeros(mujoco.mj_stateSize(model, _STATE))
    mujoco.mj_getState(model, data, row, _STATE)
    row.flags.writeable = False  # all simulations of this scene start from it

    mujoco.mj_kinematics(model, data)
    center, radius = scene_bounds(model, data)
    for stat in (model.stat, spec.stat):
        stat.extent = max(2.0 * radius, 1.0)
        stat.center = center
    place_lights(spec, model, parts.lights, center, radius)
    place_views(spec, model, data, sim_cfg.views)
    return CompiledScene(
        model=model,
        spec=spec,
        parts=parts,
        entities=entities,
        initial_row=row,
        sensors={uid: index_sensor(model, plan, entities) for uid, plan in parts.sensors.items()},
        notes=tuple(notes),
        terrain=terrain,
    )


def _check_parts(parts: SceneParts) -> None:
    """Refuse names that clash, and objects that are wrong."""
    problems: list[Problem] = []
    used_names = {GROUND: "the ground plane"}
    uids = [parsed.uid for parsed in parts.articulations]
    uids += [*parts.objects, *parts.lights, *parts.sensors]
    if parts.world is not None:
        uids += parts.world.objects
    for uid in uids:
        problems += check_uid(uid, uid, used_names)
        used_names[uid] = "another entity"
    for uid, cfg in parts.objects.items():
        problems += [p.below(uid) for p in check_object(cfg)]
    if problems:
        raise ConfigError(problems)


# ------------------------------------------------------------------------------- parts to a spec


def _add_world(spec: mujoco.MjSpec, world: World | None) -> list[str]:
    """Add the elements of the scene's file; return messages for the user."""
    if world is None:
        return []
    child = world.spec.copy()
    replaced = replace_options(child, spec, f"scene.fpath: {world.path}", world.options)
    add_world(spec, child)
    return [*world.notes, *replaced]


def _add_ground(spec: mujoco.MjSpec, sim_cfg: SimulationManagerCfg) -> Terrain | None:
    """Add the terrain or the ground plane, if the scene has one of them."""
    ground = sim_cfg.scene.ground or GroundCfg()
    if sim_cfg.scene.terrain is not None:
        from embodichain.lab.sim.compiler.scene.terrain import add_terrain  # few scenes have one

        return add_terrain(spec, sim_cfg.scene.terrain, ground)
    if sim_cfg.has_ground:
        add_ground(spec, ground)
    return None


def _add_objects(spec: mujoco.MjSpec, parts: SceneParts) -> None:
    """Add the rigid objects, and the legs of the table."""
    for number, (uid, cfg) in enumerate(parts.objects.items()):
        add_object(spec, uid, cfg, number)
    table = parts.sim_cfg.scene.table
    if table is not None and "table" in parts.objects:
        from embodichain.lab.sim.compiler.scene.furniture import finish_table  # few scenes have one

        finish_table(spec, table)


def _known(parts: SceneParts) -> Known:
    """Return what views and marks may refer to."""
    return known_entities(
        {parsed.uid: parsed for parsed in parts.articulations},
        parts.objects,
        parts.lights,
        parts.world,
        parts.sim_cfg.scene.table,
    )


def _add_views(spec: mujoco.MjSpec, parts: SceneParts, known: Known) -> None:
    """Add the cameras of views, once all that they may follow is there."""
    roots = {parsed.uid: f"{parsed.uid}/{parsed.root_link_name}" for parsed in parts.articulations}
    if parts.world is not None:
        roots |= {uid: f"{PREFIX}{uid}" for uid in parts.world.objects}
    add_views(spec, parts.sim_cfg.views, roots, known)


def _add_marks(spec: mujoco.MjSpec, parts: SceneParts, known: Known) -> None:
    """Add the marks of objects and of parts of articulations, if there are any."""
    has_marks = any(cfg.halo or cfg.reached for cfg in parts.objects.values())
    if has_marks or any(parsed.cfg.marks for parsed in parts.articulations):
        from embodichain.lab.sim.compiler.scene.object_marks import add_marks  # few scenes have any

        articulations = {parsed.uid: parsed.cfg for parsed in parts.articulations}
        add_marks(spec, {**parts.objects, **articulations}, known)


def _compile(spec: mujoco.MjSpec, objects: Mapping[str, RigidObjectCfg]) -> mujoco.MjModel:
    """Compile a scene.

    Raises:
        ConfigError: If MuJoCo refuses it; names the objects whose meshes are the reason.
    """
    try:
        with reported(f"compiling the scene of {len(spec.bodies):,} bodies"):
            return compile_quietly(spec)
    except MUJOCO_ERRORS as error:
        message = f"MuJoCo cannot compile the scene: {as_line(error)[0]}"
        raise ConfigError(_broken_meshes(objects) or message) from error


def _broken_meshes(objects: Mapping[str, RigidObjectCfg]) -> list[Problem]:
    """Return a problem for each mesh that MuJoCo cannot compile, with paths below its object."""
    problems: list[Problem] = []
    for uid, cfg in objects.items():
        for name, variant in shapes_of(cfg).items():
            if not isinstance(variant.shape, MeshCfg):
                continue
            alone = mujoco.MjSpec()
            add_object(alone, uid, variant, 0)
            try:
                compile_quietly(alone)
            except MUJOCO_ERRORS as error:
                reason = as_line(error)[0].removesuffix(f" (element '{uid}/mesh')")
                file = get_data_path(variant.shape.fpath)
                message = f"{file}: MuJoCo cannot compile it: {reason}"
                path = f"{uid}.any_of.{name}" if name else uid
                problems.append(Problem(f"{path}.shape.fpath", message))
    return problems


def _attach(spec: mujoco.MjSpec, child: mujoco.MjSpec, parsed: ParsedArticulation) -> list[str]:
    """Attach an articulation at its pose; return messages for the user."""
    notes = replace_options(child, spec, f"{parsed.uid}: {parsed.path}", parsed.options)
    for path, options, given in parsed.attached_options:
        notes += replace_options(options.copy(), spec, f"{parsed.uid}: {path}", given)
    place = parsed.placement
    frame = spec.worldbody.add_frame(pos=place.world_pos, quat=place.world_quat)
    take_sizes(spec, child)
    spec.attach(child, frame=frame, prefix=f"{parsed.uid}/")
    return notes


def _bind_floors(
    spec: mujoco.MjSpec,
    sim_cfg: SimulationManagerCfg,
    articulations: Sequence[ParsedArticulation],
    world: World | None,
) -> list[str]:
    """Put the scene's ground in the place of the floors of robots' files; return messages."""
    ground = GROUND if sim_cfg.has_ground else None
    if ground is None and world is not None and world.floors:
        ground = f"{PREFIX}{world.floors[0]}"
    is_declared = sim_cfg.scene.terrain is not None or sim_cfg.scene.ground is not None
    ground_cfg = sim_cfg.scene.terrain or sim_cfg.scene.ground or GroundCfg()
    decided: Collection[str] | None = given_parameters(ground_cfg)
    if not sim_cfg.has_ground:
        decided = None  # a floor of the scene's file keeps all its parameters
    notes: list[str] = []
    for parsed in articulations:
        floors = [f"{parsed.uid}/{name}" for name in parsed.floors]
        messages = bind_floors(
            spec,
            ground,
            floors,
            [f"{parsed.uid}/{name}" for name in parsed.attached_floors],
            decided,
            at_height=not is_declared and decided is not None and parsed.placement.is_unmoved,
        )
        notes += [f"{parsed.uid}: {message}" for message in messages]
        if floors:
            decided = None  # the ground has the parameters of the first file's floor
    return notes


def _strangers_to_ground(
    model: mujoco.MjModel, entities: Mapping[str, EntityIndex]
) -> Iterator[str]:
    """Yield a message about each robot and object that falls through the ground."""
    geoms = {uid: index.geom_ids.tolist() for uid, index in entities.items()}
    ground = model.geom(GROUND)
    for uid in strangers_to(model, ground.id, geoms):
        bits = f"contype {ground.contype[0]}, conaffinity {ground.conaffinity[0]}"
        yield f"{uid}: no shape of it can touch the ground, whose bits are {bits}"


# ------------------------------------------------------------------------------ parts in a model


def _index_entities(
    model: mujoco.MjModel, spec: mujoco.MjSpec, parts: SceneParts
) -> dict[str, EntityIndex]:
    """Return where each robot and object is in the model, by uid."""
    entities = {parsed.uid: _index_articulation(model, parsed) for parsed in parts.articulations}
    for uid, cfg in parts.objects.items():
        entities[uid] = _index_object(model, spec, uid, cfg)
    if parts.world is not None:
        entities |= _index_world(model, parts.world)
    return entities


def _set_damping(
    model: mujoco.MjModel,
    entities: Mapping[str, EntityIndex],
    objects: Mapping[str, RigidObjectCfg],
) -> None:
    """Set the damping of free objects, which MJCF cannot give for each axis."""
    for uid, cfg in objects.items():
        start = entities[uid].free_qvel_adr
        if start >= 0:
            damping = damping_of(model, entities[uid].root_body_id, cfg)
            model.dof_damping[start : start + 6] = damping


def _index_articulation(model: mujoco.MjModel, parsed: ParsedArticulation) -> EntityIndex:
    prefix = f"{parsed.uid}/"
    bodies = np.array([model.body(prefix + name).id for name in parsed.link_names], np.int64)
    joints = np.array([model.joint(prefix + name).id for name in parsed.joint_names], np.int64)
    actuators: dict[str, int] = {}
    for i in range(model.nactuator):
        name = model.actuator(i).name
        if name.startswith(prefix):
            actuators[name.removeprefix(prefix)] = i
    own_actuators = list(actuators.values())
    drives: Ids = np.array([actuators.get(name, -1) for name in parsed.drives], np.int64)
    velocity_servos: Ids = np.full(len(parsed.servos.velocity), -1, np.int64)
    for row, servo in enumerate(parsed.servos.velocity.tolist()):
        if servo >= 0:
            velocity_servos[row] = actuators[parsed.model.actuator(servo).name]
    root = int(model.body(prefix + parsed.root_link_name).id)
    free_joint = -1 if parsed.fixed_base else int(model.body_jntadr[root])
    return EntityIndex(
        uid=parsed.uid,
        kind="articulation",
        body_ids=bodies,
        root_body_id=root,
        pos0=parsed.placement.root_pos,
        quat0=parsed.placement.root_quat,
        geom_ids=np.flatnonzero(np.isin(model.geom_bodyid, bodies)).astype(np.int64),
        mocap_id=int(model.body_mocapid[root]),
        free_qpos_adr=_qpos_start(model, free_joint),
        free_qvel_adr=_qvel_start(model, free_joint),
        qpos_adr=model.jnt_qposadr[joints].astype(np.int64),
        dof_adr=model.jnt_dofadr[joints].astype(np.int64),
        actuator_ids=drives,
        ctrl_ids=_first_controls(model, drives),
        velocity_ctrl_ids=_first_controls(model, velocity_servos),
        own_actuator_ids=np.array(own_actuators, np.int64),
        own_ctrl_ids=_controls_of(model, own_actuators),
        own_act_ids=_activations_of(model, own_actuators),
    )


def _qpos_start(model: mujoco.MjModel, joint: int) -> int:
    """Return the first column of a joint in qpos; -1 for -1."""
    return int(model.jnt_qposadr[joint]) if joint >= 0 else -1


def _qvel_start(model: mujoco.MjModel, joint: int) -> int:
    """Return the first column of a joint in qvel; -1 for -1."""
    return int(model.jnt_dofadr[joint]) if joint >= 0 else -1


def _first_controls(model: mujoco.MjModel, actuators: Ids) -> Ids:
    """Return the first control of each actuator; -1 for -1."""
    columns: Ids = np.full(len(actuators), -1, np.int64)
    exists = actuators >= 0
    columns[exists] = model.actuator_ctrladr[actuators[exists]]
    return columns


def _controls_of(model: mujoco.MjModel, actuators: Sequence[int] | Ids) -> Ids:
    """Return all controls of actuators, in their order."""
    return _ranges(model.actuator_ctrladr[actuators], model.actuator_ctrlnum[actuators])


def _activations_of(model: mujoco.MjModel, actuators: Sequence[int] | Ids) -> Ids:
    """Return all activations of actuators, in their order."""
    return _ranges(model.actuator_actadr[actuators], model.actuator_actnum[actuators])


def _index_object(
    model: mujoco.MjModel, spec: mujoco.MjSpec, uid: str, cfg: RigidObjectCfg
) -> EntityIndex:
    body = int(model.body(uid).id)
    pos, quat = initial_pose(cfg)
    joint = int(model.body_jntadr[body])
    geoms: Ids = np.flatnonzero(model.geom_bodyid == body).astype(np.int64)
    variants = None
    if cfg.any_of:
        from embodichain.lab.sim.compiler.scene.variants import (
            index_variants,  # few scenes have any
        )

        variants = index_variants(model, spec, uid, cfg, geoms)
    return EntityIndex(
        uid=uid,
        kind="object",
        body_ids=np.array([body], np.int64),
        root_body_id=body,
        pos0=pos,
        quat0=quat,
        geom_ids=geoms,
        variants=variants,
        mocap_id=int(model.body_mocapid[body]),
        free_qpos_adr=_qpos_start(model, joint),
        free_qvel_adr=_qvel_start(model, joint),
    )


def _index_world(model: mujoco.MjModel, world: World) -> dict[str, EntityIndex]:
    """Return the indices of a world's objects in the compiled scene.

    Bodies and joints below an object belong to it.
    """
    entities: dict[str, EntityIndex] = {}
    for uid, cfg in world.objects.items():
        root = int(model.body(PREFIX + uid).id)
        bodies: Ids = np.flatnonzero(model.body_rootid == root).astype(np.int64)
        actuators = _actuators_on(model, np.flatnonzero(np.isin(model.jnt_bodyid, bodies)))
        joint = int(model.body_jntadr[root]) if cfg.body_type == "dynamic" else -1
        entities[uid] = EntityIndex(
            uid=uid,
            kind="object",
            body_ids=bodies,
            root_body_id=root,
            pos0=np.asarray(cfg.init_pos, np.float64),
            quat0=np.asarray(cfg.init_quat, np.float64),
            geom_ids=np.flatnonzero(np.isin(model.geom_bodyid, bodies)).astype(np.int64),
            mocap_id=int(model.body_mocapid[root]),
            free_qpos_adr=_qpos_start(model, joint),
            free_qvel_adr=_qvel_start(model, joint),
            own_actuator_ids=actuators,
            own_ctrl_ids=_controls_of(model, actuators),
            own_act_ids=_activations_of(model, actuators),
        )
    return entities


def _actuators_on(model: mujoco.MjModel, joints: Ids) -> Ids:
    """The actuators on some joints."""
    on_joint = np.isin(
        model.actuator_trntype,
        [int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)],
    )
    on_these = np.isin(model.actuator_trnid[:, 0], joints)
    return np.flatnonzero(on_joint & on_these).astype(np.int64)


def _ranges(starts: Ids, counts: Ids) -> Ids:
    """Return the concatenation of ``start + arange(count)``."""
    ids: list[int] = []
    for start, count in zip(starts.tolist(), counts.tolist(), strict=True):
        ids += range(start, start + count)
    return np.array(ids, np.int64)


# --------------------------------------------------------------------------------- initial state


def _start(
    model: mujoco.MjModel,
    articulations: Sequence[ParsedArticulation],
    entities: Mapping[str, EntityIndex],
    world: World | None,
) -> mujoco.MjData:
    """Return the scene's initial state."""
    data = mujoco.MjData(model)
    if world is not None:
        start_world(data, world)
    for index in entities.values():
        start = index.free_qpos_adr
        if index.mocap_id >= 0:
            data.mocap_pos[index.mocap_id] = index.pos0
            data.mocap_quat[index.mocap_id] = index.quat0
        elif start >= 0:
            data.qpos[start : start + 3] = index.pos0
            data.qpos[start + 3 : start + 7] = index.quat0
    for parsed in articulations:
        index = entities[parsed.uid]
        data.qpos[index.qpos_adr] = parsed.init_qpos
        data.qvel[index.dof_adr] = parsed.init_qvel
        data.ctrl[index.own_ctrl_ids] = parsed.init_ctrl
        data.act[index.own_act_ids] = parsed.init_act
        if parsed.keyframe is not None:
            _start_at_keyframe(model, data, parsed, parsed.keyframe, index.free_qvel_adr)
    return data


def _start_at_keyframe(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    parsed: ParsedArticulation,
    keyframe: Keyframe,
    root_dof: int,
) -> None:
    """Set the root's velocity and the ball joints, which joint arrays leave out.

    Args:
        model: The scene.
        data: The initial state; changed.
        parsed: The articulation.
        keyframe: The keyframe of its file.
        root_dof: First column of its root in qvel; -1 if it is fixed.
    """
    if root_dof >= 0:
        velocity = keyframe.root_qvel
        data.qvel[root_dof : root_dof + 3] = quat_rotate(parsed.placement.turn, velocity[:3])
        data.qvel[root_dof + 3 : root_dof + 6] = velocity[3:]
    for name, (quat, speed) in keyframe.balls.items():
        joint = model.joint(f"{parsed.uid}/{name}")
        qpos_start = joint.qposadr[0]
        qvel_start = joint.dofadr[0]
        data.qpos[qpos_start : qpos_start + 4] = quat
        data.qvel[qvel_start : qvel_start + 3] = speed
