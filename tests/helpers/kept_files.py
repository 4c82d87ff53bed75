"""Compares a robot in a compiled scene, field by field, with its MJCF file loaded alone."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import RobotCfg, SimulationManagerCfg
from embodichain.lab.sim.compiler.compile_scene import CompiledScene
from embodichain.lab.sim.sim_manager import SimulationManager

UID = "r"
_OBJ = mujoco.mjtObj
_KINDS: dict[str, tuple[Any, str, str]] = {
    # kind: its mjtObj, the prefix of its fields, the size of its arrays
    "body": (_OBJ.mjOBJ_BODY, "body_", "nbody"),
    "joint": (_OBJ.mjOBJ_JOINT, "jnt_", "njnt"),
    "geom": (_OBJ.mjOBJ_GEOM, "geom_", "ngeom"),
    "site": (_OBJ.mjOBJ_SITE, "site_", "nsite"),
    "camera": (_OBJ.mjOBJ_CAMERA, "cam_", "ncam"),
    "mesh": (_OBJ.mjOBJ_MESH, "mesh_", "nmesh"),
    "hfield": (_OBJ.mjOBJ_HFIELD, "hfield_", "nhfield"),
    "tendon": (_OBJ.mjOBJ_TENDON, "tendon_", "ntendon"),
    "actuator": (_OBJ.mjOBJ_ACTUATOR, "actuator_", "nactuator"),
    "sensor": (_OBJ.mjOBJ_SENSOR, "sensor_", "nsensor"),
    "equality": (_OBJ.mjOBJ_EQUALITY, "eq_", "neq"),
    "exclude": (_OBJ.mjOBJ_EXCLUDE, "exclude_", "nexclude"),
    "pair": (_OBJ.mjOBJ_PAIR, "pair_", "npair"),
    "numeric": (_OBJ.mjOBJ_NUMERIC, "numeric_", "nnumeric"),
    "tuple": (_OBJ.mjOBJ_TUPLE, "tuple_", "ntuple"),
}
_PLACES = re.compile(r".*(adr|id|num|id1|id2|signature|history|plugin|geom[12])")
"""Fields that say where something is in the model, which is compared by name instead."""
_UNNAMED = ("equality", "pair", "exclude", "sensor")
"""Kinds whose elements often have no name; the scene has only the robot's."""
_NOT_PHYSICS = ("cam_intrinsic", "cam_poscom0", "geom_sameframe", "mesh_extrema")
"""Of pictures (from `<visual>`, which is the scene's), or of how MuJoCo computes frames."""
_PER_DOF = [name for name in dir(mujoco.MjModel) if name.startswith("dof_")]


def in_scene(path: Path, cfg: RobotCfg | None = None) -> CompiledScene:
    """The scene with the robot of a file, under the options of the file."""
    alone = mujoco.MjModel.from_xml_path(str(path))
    sim = SimulationManagerCfg(
        headless=True, physics_dt=alone.opt.timestep, ground_plane=bool(floors_in(alone))
    )
    manager = SimulationManager(sim)
    cfg = cfg or RobotCfg(fix_base=not floats(alone), disable_self_collision=False)
    manager.add_robot(dataclasses.replace(cfg, uid=UID, fpath=str(path)))
    scene = manager.scene
    for name in (name for name in dir(alone.opt) if not name.startswith("_")):
        if name != "disableflags" and not callable(getattr(alone.opt, name)):
            setattr(scene.model.opt, name, getattr(alone.opt, name))
    scene.model.opt.disableflags = alone.opt.disableflags
    return scene


def floats(model: mujoco.MjModel) -> bool:
    """Whether a model has a free joint."""
    return bool((model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any())


def floors_in(model: mujoco.MjModel) -> list[int]:
    """The horizontal planes of a model's world."""
    rotation = np.zeros(9)
    found = []
    for geom in np.flatnonzero(model.geom_bodyid == 0).tolist():
        mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
        plane = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE
        if plane and rotation[8] > 1 - 1e-9:
            found.append(geom)
    return found


def _is_place(field: str) -> bool:
    return _PLACES.fullmatch(field) is not None and not field.endswith("fluid")


class Twin:
    """A file's model, and the elements of a scene that came from it.

    Args:
        path: The file.
        scene: The scene with its robot.
    """

    def __init__(self, path: Path, scene: CompiledScene) -> None:
        self.alone = mujoco.MjModel.from_xml_path(str(path))
        self.model, self.scene = scene.model, scene
        self.ids = {kind: self._pairs(kind) for kind in _KINDS}
        joints = self.ids["joint"]
        self.dofs = self._columns(joints, "jnt_dofadr", self.alone.jnt_type, (6, 3, 1, 1))
        self.qpos = self._columns(joints, "jnt_qposadr", self.alone.jnt_type, (7, 4, 1, 1))

    def _pairs(self, kind: str) -> list[tuple[int, int]]:
        """Ids of an element alone and in the scene, in order; of floors, only alone."""
        _, _, size = _KINDS[kind]
        prefix = f"{UID}/"
        names = self._names(self.model, kind)
        here = [i for i, name in enumerate(names) if name.startswith(prefix)]
        there = list(range(getattr(self.alone, size)))
        if kind in _UNNAMED:
            here = list(range(getattr(self.model, size)))
        if kind in ("pair", "exclude"):  # some are added, and MuJoCo sorts them
            known = {self._ends(self.model, kind, i): i for i in here}
            return [(i, known[self._ends(self.alone, kind, i)]) for i in there]
        if kind == "body":
            there = there[1:]
            here = here[len(here) - len(there) :]  # without an added root
        if kind == "geom":
            there = [i for i in there if i not in floors_in(self.alone)]
        if len(here) < len(there) == len(names):  # without names of their own
            here = list(range(len(names)))
        if len(here) != len(there):
            there_names = [self._names(self.alone, kind)[i] for i in there]
            raise AssertionError(f"{kind}: {there_names} alone, {[names[i] for i in here]} here")
        return list(zip(there, here, strict=True))

    def _ends(self, model: mujoco.MjModel, kind: str, i: int) -> frozenset[str]:
        """The names of the two geoms of a pair, or of the two bodies of an exclude."""
        if kind == "exclude":
            signature = int(model.exclude_signature[i])
            bodies = signature >> 16, signature & 0xFFFF
            named = [model.body(body).name for body in bodies]
        else:
            geoms = int(model.pair_geom1[i]), int(model.pair_geom2[i])
            named = [model.geom(geom).name or f"geom_{geom}" for geom in geoms]
        floors = {self.alone.geom(i).name for i in floors_in(self.alone)}
        own = [name.removeprefix(f"{UID}/") for name in named]
        return frozenset("default_plane" if name in floors else name for name in own)

    def _names(self, model: mujoco.MjModel, kind: str) -> list[str]:
        obj, _, size = _KINDS[kind]
        count = getattr(model, size)
        return [mujoco.mj_id2name(model, int(obj), i) or "" for i in range(count)]

    def _columns(
        self, pairs: Sequence[tuple[int, int]], field: str, types: Any, widths: Sequence[int]
    ) -> tuple[np.ndarray, np.ndarray]:
        alone, here = [], []
        for there, mine in pairs:
            width = widths[int(types[there])]
            alone += [getattr(self.alone, field)[there] + k for k in range(width)]
            here += [getattr(self.model, field)[mine] + k for k in range(width)]
        return np.array(alone, int), np.array(here, int)

    def differences(self) -> Iterator[str]:
        """Fields that differ: name, element, value alone, value in the scene."""
        for kind, (_, prefix, size) in _KINDS.items():
            count = getattr(self.alone, size)
            for name in (name for name in dir(self.alone) if name.startswith(prefix)):
                if name in _NOT_PHYSICS or _is_place(name.removeprefix(prefix)):
                    continue
                values = getattr(self.alone, name)
                if not isinstance(values, np.ndarray) or len(values) != count or not count:
                    continue
                for there, mine in self.ids[kind]:
                    other = getattr(self.model, name)[mine]
                    yield from self._differ(f"{name}[{there}]", values[there], other)
        for name in _PER_DOF:
            if _is_place(name.removeprefix("dof_")):
                continue
            values, others = getattr(self.alone, name), getattr(self.model, name)
            yield from self._differ(name, values[self.dofs[0]], others[self.dofs[1]])
        here = self.qpos[1]
        for name in ("qpos0", "qpos_spring"):
            values, others = getattr(self.alone, name), getattr(self.model, name)
            yield from self._differ(name, values[self.qpos[0]], others[here])

    def _differ(self, name: str, alone: Any, here: Any) -> Iterator[str]:
        alone, here = np.asarray(alone, np.float64), np.asarray(here, np.float64)
        if alone.shape != here.shape or not np.allclose(alone, here, rtol=1e-12, atol=1e-12):
            yield f"{name}: {alone.ravel()[:12]} alone, {here.ravel()[:12]} here"

    def start(self) -> tuple[mujoco.MjData, mujoco.MjData]:
        """The file's start (its keyframe home, else the first, else the reset state), and ours."""
        alone, here = mujoco.MjData(self.alone), mujoco.MjData(self.model)
        names = [self.alone.key(i).name for i in range(self.alone.nkey)]
        if names:
            key = names.index("home") if "home" in names else 0
            mujoco.mj_resetDataKeyframe(self.alone, alone, key)
        state = mujoco.mjtState.mjSTATE_INTEGRATION
        mujoco.mj_setState(self.model, here, self.scene.initial_row, state)
        return alone, here

    def drift(self, steps: int = 200) -> float:
        """The largest difference of a joint position over some steps with the scene's controls."""
        alone, here = self.start()
        for there, mine in self.ids["actuator"]:
            ctrl = slice(*_span(self.alone, there))
            alone.ctrl[ctrl] = here.ctrl[slice(*_span(self.model, mine))]
            act = self.alone.actuator_actadr[there]
            if act >= 0:
                count = self.alone.actuator_actnum[there]
                first = self.model.actuator_actadr[mine]
                alone.act[act : act + count] = here.act[first : first + count]
        worst = float(np.abs(alone.qpos[self.qpos[0]] - here.qpos[self.qpos[1]]).max(initial=0.0))
        for _ in range(steps):
            mujoco.mj_step(self.alone, alone)
            mujoco.mj_step(self.model, here)
            gap = np.abs(alone.qpos[self.qpos[0]] - here.qpos[self.qpos[1]])
            worst = max(worst, float(gap.max(initial=0.0)))
        return worst


def _span(model: mujoco.MjModel, actuator: int) -> tuple[int, int]:
    start = int(model.actuator_ctrladr[actuator])
    return start, start + int(model.actuator_ctrlnum[actuator])
