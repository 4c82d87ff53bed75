"""`World`: an MJCF file with the surroundings of a task, `scene.fpath`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco

from embodichain.lab.sim.cfg import RigidBodyAttributesCfg, RigidObjectCfg
from embodichain.lab.sim.compiler.geoms.shape_geoms import inertia_about_axes
from embodichain.lab.sim.compiler.names import no_such
from embodichain.lab.sim.compiler.robot.files.robot_files import locate, read_model
from embodichain.lab.sim.compiler.robot.floors import floors_of, planes_of
from embodichain.lab.sim.compiler.robot.robot_root import leave_out_sizes, take_sizes
from embodichain.lab.sim.configs.scene_cfg import SceneCfg
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["PREFIX", "WORLD", "World", "add_world", "read_world", "start_world"]

WORLD = "scene"
"""No entity has this uid if there is a file."""
PREFIX = f"{WORLD}/"
"""Names of the file's elements begin with it in the compiled model."""
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)


@dataclass(frozen=True, eq=False)
class World:
    """A file, read and compiled alone.

    Attributes:
        path: The file.
        spec: Its elements, without keyframes. Copied when a scene is compiled.
        model: `spec` compiled.
        start: Its initial state: that of the keyframe, else MuJoCo's reset state.
        objects: The bodies of its world as rigid objects, by name; their poses are those of
            `start`. Joints below them are simulated, but no handle reads them.
        options: The physics options that it gives, see `given_options`.
        notes: Messages for the user, one line each: what of the file is not used.
        floors: Its horizontal planes.
    """

    path: Path
    spec: mujoco.MjSpec
    model: mujoco.MjModel
    start: mujoco.MjData
    objects: Mapping[str, RigidObjectCfg]
    options: frozenset[str]
    notes: tuple[str, ...]
    floors: tuple[str, ...] = ()


def read_world(cfg: SceneCfg) -> World:
    """Read the file of a scene.

    Raises:
        ConfigError: If the file is missing, malformed or not an MJCF, or lacks the keyframe.
    """
    if not cfg.fpath:
        message = "is one of a scene's file: fpath is missing"
        raise ConfigError([Problem("scene.keyframe", message)])
    try:
        file = read_model(locate(cfg.fpath))
    except ConfigError as error:
        raise ConfigError(Problem("scene.fpath", str(p)) for p in error.problems) from error
    spec, model = file.spec, file.model
    if file.is_urdf:
        message = f"{file.path}: a scene is an MJCF file; a URDF is a robot or an articulation"
        raise ConfigError([Problem("scene.fpath", message)])
    if spec.compiler.settotalmass > 0:
        message = f"{file.path}: settotalmass would scale robots and objects too: give masses"
        raise ConfigError([Problem("scene.fpath", message)])
    start, unused = mujoco.MjData(model), [model.key(i).name for i in range(model.nkey)]
    key = cfg.keyframe
    if key is not None and key not in unused:
        raise ConfigError([no_such("keyframe", key, unused or ["none"], "scene.keyframe")])
    if key is None and unused:
        key = "home" if "home" in unused else unused[0]
    if key is not None:
        mujoco.mj_resetDataKeyframe(model, start, unused.index(key))
        unused.remove(key)
    mujoco.mj_kinematics(model, start)
    for keyframe in list(spec.keys):
        spec.delete(keyframe)
    actuators = [model.actuator(i).name for i in range(model.nactuator)]
    sensors = [model.sensor(i).name or "unnamed" for i in range(model.nsensor)]
    said = [
        (unused, f"it starts at {f'its keyframe {key!r}' if key else 'its defaults'}; left out:"),
        (actuators, "no action moves its actuators, their controls stay as at the start:"),
        (sensors, "no term reads its sensors:"),
    ]
    sizes = [f"{file.path}: {line}" for line in leave_out_sizes(spec)]
    notes = sizes + [
        f"{file.path}: {what} {', '.join(map(repr, names))}" for names, what in said if names
    ]
    bodies = [i for i in range(1, model.nbody) if model.body_parentid[i] == 0]
    objects = {model.body(i).name: _object(model, start, i) for i in bodies}
    floors = floors_of(planes_of(spec, model))
    return World(
        file.path, spec, model, start, objects, file.options, (*file.notes, *notes), floors
    )


def _object(model: mujoco.MjModel, start: mujoco.MjData, body: int) -> RigidObjectCfg:
    """A body of the world as a rigid object: its type, its pose, its damping."""
    joint = int(model.body_jntadr[body])
    free = joint >= 0 and int(model.jnt_type[joint]) == _FREE
    mocap = model.body_mocapid[body] >= 0
    linear = angular = 0.0
    if free and model.body_mass[body] > 0:
        # Rates of decay that give the file's damping back, see `damping_of`.
        moments = inertia_about_axes(model.body_iquat[body], model.body_inertia[body])
        damping = model.dof_damping[model.jnt_dofadr[joint] :]
        linear = float(damping[0] / model.body_mass[body])
        angular = float(damping[3] / moments[0]) if moments[0] > 0 else 0.0
    return RigidObjectCfg(
        body_type="dynamic" if free else "kinematic" if mocap else "static",
        attrs=RigidBodyAttributesCfg(
            mass=float(model.body_mass[body]),
            linear_damping=linear,
            angular_damping=angular,
        ),
        init_pos=start.xpos[body].tolist(),
        init_quat=start.xquat[body].tolist(),
    )


def add_world(spec: mujoco.MjSpec, child: mujoco.MjSpec) -> None:
    """Attach a copy of a world's spec to an empty scene, with its visual options."""
    spec.visual = child.visual
    take_sizes(spec, child)
    spec.attach(child, frame=spec.worldbody.add_frame(), prefix=PREFIX)


def start_world(data: mujoco.MjData, world: World) -> None:
    """Copy a world's initial state into that of the scene, in which its elements are first."""
    for name in ("qpos", "qvel", "ctrl", "act", "mocap_pos", "mocap_quat"):
        own = getattr(world.start, name)
        getattr(data, name)[: len(own)] = own
