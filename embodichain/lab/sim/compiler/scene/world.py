"""`World`: an MJCF file with the surroundings of a task, `scene.fpath`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

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
        notes: Messages for the user, one line each: parts of the file that are not used.
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
    start = mujoco.MjData(model)
    unused = _start_at_keyframe(cfg, model, start)
    for keyframe in list(spec.keys):
        spec.delete(keyframe)
    lines = [*leave_out_sizes(spec), *unused, *_unused_elements(model)]
    bodies = [i for i in range(1, model.nbody) if model.body_parentid[i] == 0]
    return World(
        path=file.path,
        spec=spec,
        model=model,
        start=start,
        objects={model.body(i).name: _object(model, start, i) for i in bodies},
        options=file.options,
        notes=(*file.notes, *(f"{file.path}: {line}" for line in lines)),
        floors=floors_of(planes_of(spec, model)),
    )


def _start_at_keyframe(cfg: SceneCfg, model: mujoco.MjModel, start: mujoco.MjData) -> list[str]:
    """Set the initial state of a file; return a message about keyframes that are not used.

    It is the keyframe of the config, else ``home``, else the first, else MuJoCo's reset state.

    Raises:
        ConfigError: If the file lacks the keyframe.
    """
    names = [model.key(i).name for i in range(model.nkey)]
    name = cfg.keyframe
    if name is not None and name not in names:
        raise ConfigError([no_such("keyframe", name, names or ["none"], "scene.keyframe")])
    if name is None and names:
        name = "home" if "home" in names else names[0]
    chosen = "its defaults"
    if name is not None:
        mujoco.mj_resetDataKeyframe(model, start, names.index(name))
        names.remove(name)
        if name:
            chosen = f"its keyframe {name!r}"
    mujoco.mj_kinematics(model, start)
    if not names:
        return []
    return [f"it starts at {chosen}; left out: {', '.join(map(repr, names))}"]


def _unused_elements(model: mujoco.MjModel) -> list[str]:
    """Return messages about actuators and sensors, which nothing of a task reaches."""
    messages: list[str] = []
    actuators = [model.actuator(i).name for i in range(model.nactuator)]
    if actuators:
        names = ", ".join(map(repr, actuators))
        message = "no action moves its actuators, their controls stay as at the start"
        messages.append(f"{message}: {names}")
    sensors = [model.sensor(i).name or "unnamed" for i in range(model.nsensor)]
    if sensors:
        messages.append(f"no term reads its sensors: {', '.join(map(repr, sensors))}")
    return messages


def _object(model: mujoco.MjModel, start: mujoco.MjData, body: int) -> RigidObjectCfg:
    """A body of the world as a rigid object: its type, its pose, its damping."""
    joint = int(model.body_jntadr[body])
    is_free = joint >= 0 and int(model.jnt_type[joint]) == _FREE
    body_type: Literal["dynamic", "kinematic", "static"] = "static"
    if is_free:
        body_type = "dynamic"
    elif model.body_mocapid[body] >= 0:
        body_type = "kinematic"
    linear = 0.0
    angular = 0.0
    if is_free and model.body_mass[body] > 0:
        # Rates of decay that give the file's damping back, see `damping_of`.
        moments = inertia_about_axes(model.body_iquat[body], model.body_inertia[body])
        damping = model.dof_damping[model.jnt_dofadr[joint] :]
        linear = float(damping[0] / model.body_mass[body])
        angular = float(damping[3] / moments[0]) if moments[0] > 0 else 0.0
    return RigidObjectCfg(
        body_type=body_type,
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
        values = getattr(world.start, name)
        getattr(data, name)[: len(values)] = values
