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
from embodichain.lab.sim.compiler.names import GROUND, check_uid
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
    sim_cfg, world = parts.sim_cfg, parts.world
    articulations, objects = parts.articulations, parts.objects
    lights, sensors = parts.lights, parts.sensors
    inside = () if world is None else tuple(world.objects)
    _check(articulations, objects, (*lights, *sensors, *inside))
    spec = mujoco.MjSpec()
    spec.modelname = "embodichain"
    spec.compiler.degree = False
    apply_options(spec, sim_cfg)
    notes: list[str] = []
    if world is not None:
        child = world.spec.copy()
        notes += [
            *world.notes,
            *replace_options(child, spec, f"scene.fpath: {world.path}", world.options),
        ]
        add_world(spec, child)
    set_look(spec, sim_cfg.scene)
    add_lights(spec, lights)
    for parsed in articulations:
        notes += _attach(spec, parsed.spec.copy(), parsed)
    terrain = None
    if sim_cfg.scene.terrain is not None:
        from embodichain.lab.sim.compiler.scene.terrain import add_terrain  # few scenes have one

        terrain = add_terrain(spec, sim_cfg.scene.terrain, sim_cfg.scene.ground or GroundCfg())
    elif sim_cfg.has_ground:
        add_ground(spec, sim_cfg.scene.ground or GroundCfg())
    notes += _bind_floors(spec, sim_cfg, articulations, world)
    for number, (uid, cfg) in enumerate(objects.items()):
        add_object(spec, uid, cfg, number)
    table = sim_cfg.scene.table
    if table is not None and "table" in objects:
        from embodichain.lab.sim.compiler.scene.furniture import finish_table  # few scenes have one

        finish_table(spec, table)
    roots = {p.uid: f"{p.uid}/{p.root_link_name}" for p in articulations}
    roots |= {uid: f"{PREFIX}{uid}" for uid in inside}
    jointed = {parsed.uid: parsed for parsed in articulations}
    known = known_entities(jointed, objects, lights, world, table)
    add_views(spec, sim_cfg.views, roots, known)
    for plan in sensors.values():
        add_sensor(spec, plan)
    try:
        with reported(f"compiling the scene of {len(spec.bodies):,} bodies"):
            model = compile_quietly(spec)
    except MUJOCO_ERRORS as error:
        message = f"MuJoCo cannot compile the scene: {as_line(error)[0]}"
        raise ConfigError(_broken_meshes(objects) or message) from error
    for plan in sensors.values():
        notes += notes_on_sensor(model, plan)
    entities = {p.uid: _index_articulation(model, p) for p in articulations}
    for uid, cfg in objects.items():
        index = entities[uid] = _index_object(model, spec, uid, cfg)
        if index.free_qvel_adr >= 0:
            dofs = slice(index.free_qvel_adr, index.free_qvel_adr + 6)
            model.dof_damping[dofs] = damping_of(model, index.root_body_id, cfg)
    if world is not None:
        entities |= _index_world(model, world)
    if sim_cfg.has_ground:
        notes += _strangers_to_ground(model, entities)
    data = _start(model, articulations, entities, world)
    row = np.zeros(mujoco.mj_stateSize(model, _STATE))
    mujoco.mj_getState(model, data, row, _STATE)
    mujoco.mj_kinematics(model, data)
    center, radius = scene_bounds(model, data)
    for stat in (model.stat, spec.stat):
        stat.extent, stat.center = max(2.0 * radius, 1.0), center
    place_lights(spec, model, lights, center, radius)
    place_views(spec, model, data, sim_cfg.views)
    columns = {uid: index_sensor(model, plan, entities) for uid, plan in sensors.items()}
    row.flags.writeable = False  # all simulations of this scene start from it
    return CompiledScene(
        model=model,
        spec=spec,
        parts=parts,
        entities=entities,
        initial_row=row,
        sensors=columns,
        notes=tuple(notes),
        terrain=terrain,
    )


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
    if problems:
        raise ConfigError(problems)


def _broken_meshes(objects: Mapping[str, RigidObjectCfg]) -> list[Problem]:
    """Return a problem for each mesh that MuJoCo cannot compile, with paths below its object."""
    problems: list[Problem] = []
    for uid, cfg in objects.items():
        for name, one in shapes_of(cfg).items():
            if not isinstance(one.shape, MeshCfg):
                continue
            alone = mujoco.MjSpec()
            add_object(alone, uid, one, 0)
            try:
                compile_quietly(alone)
            except MUJOCO_ERRORS as error:
                why = as_line(error)[0].removesuffix(f" (element '{uid}/mesh')")
                message = f"{get_data_path(one.shape.fpath)}: MuJoCo cannot compile it: {why}"
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
    notes: list[str] = []
    declared = sim_cfg.scene.terrain or sim_cfg.scene.ground
    chosen = declared is not None
    given: Collection[str] | None = given_parameters(declared or GroundCfg())
    given = given if sim_cfg.has_ground else None
    for parsed in articulations:
        at_height = not chosen and given is not None and parsed.placement.is_unmoved
        floors, attached = (
            [f"{parsed.uid}/{name}" for name in names]
            for names in (parsed.floors, parsed.attached_floors)
        )
        said = bind_floors(spec, ground, floors, attached, given, at_height=at_height)
        notes += [f"{parsed.uid}: {message}" for message in said]
        if floors:
            given = None  # the ground has the parameters of the first file's floor
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
    free = -1 if parsed.fixed_base else int(model.body_jntadr[root])
    return EntityIndex(
        uid=parsed.uid,
        kind="articulation",
        body_ids=bodies,
        root_body_id=root,
        pos0=parsed.placement.root_pos,
        quat0=parsed.placement.root_quat,
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
        free_qpos_adr=int(model.jnt_qposadr[joint]) if joint >= 0 else -1,
        free_qvel_adr=int(model.jnt_dofadr[joint]) if joint >= 0 else -1,
    )


def _index_world(model: mujoco.MjModel, world: World) -> dict[str, EntityIndex]:
    """Return the indices of a world's objects in the compiled scene.

    Bodies and joints below an object belong to it.
    """
    found = {}
    for uid, cfg in world.objects.items():
        root = int(model.body(PREFIX + uid).id)
        bodies: Ids = np.flatnonzero(model.body_rootid == root).astype(np.int64)
        own = _actuators_on(model, np.flatnonzero(np.isin(model.jnt_bodyid, bodies)))
        joint = int(model.body_jntadr[root]) if cfg.body_type == "dynamic" else -1
        found[uid] = EntityIndex(
            uid=uid,
            kind="object",
            body_ids=bodies,
            root_body_id=root,
            pos0=np.asarray(cfg.init_pos, np.float64),
            quat0=np.asarray(cfg.init_quat, np.float64),
            geom_ids=np.flatnonzero(np.isin(model.geom_bodyid, bodies)).astype(np.int64),
            mocap_id=int(model.body_mocapid[root]),
            free_qpos_adr=int(model.jnt_qposadr[joint]) if joint >= 0 else -1,
            free_qvel_adr=int(model.jnt_dofadr[joint]) if joint >= 0 else -1,
            own_actuator_ids=own,
            own_ctrl_ids=_ranges(model.actuator_ctrladr[own], model.actuator_ctrlnum[own]),
            own_act_ids=_ranges(model.actuator_actadr[own], model.actuator_actnum[own]),
        )
    return found


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
    parts = [np.arange(a, a + n) for a, n in zip(starts, counts, strict=True)]
    return np.concatenate([np.zeros(0), *parts]).astype(np.int64)


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
            data.qvel[start : start + 3] = quat_rotate(parsed.placement.turn, velocity[:3])
            data.qvel[start + 3 : start + 6] = velocity[3:]
        for name, (quat, speed) in parsed.keyframe.balls.items():
            joint = model.joint(f"{parsed.uid}/{name}")
            data.qpos[joint.qposadr[0] : joint.qposadr[0] + 4] = quat
            data.qvel[joint.dofadr[0] : joint.dofadr[0] + 3] = speed
    return data
