"""`read_embodiment`: the robot of an embodiment as a new task will have it."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from embodichain.cli.new_task.new_reach import ToolFrame
from embodichain.utils.errors import ConfigError

if TYPE_CHECKING:
    import mujoco
    from numpy.typing import NDArray

    from embodichain.lab.sim.compiler.robot.parsed_articulation import ParsedArticulation

    F64 = NDArray[np.float64]

__all__ = ["TRIAL", "EmbodiedRobot", "NewEmbodiment", "read_embodiment", "write_trial_files"]

TRIAL = "trial_of_a_new_task"
"""The name of tasks that are built before a file is written."""
_BARE_TASK = """\
defaults: [/embodiment@_here_: {name}, _self_]
description: The robot alone.
physics: {{physics_dt: 0.005}}
max_episode_steps: 10
"""


@dataclass(frozen=True)
class NewEmbodiment:
    """The embodiment of a new task.

    Attributes:
        name: Its name.
        text: Its file, where Hydra may not find it; empty for one that it finds.
        is_new: Whether the file is to be written.
    """

    name: str
    text: str = ""
    is_new: bool = False


@dataclass(frozen=True, eq=False)
class EmbodiedRobot:
    """A robot with the names, parts and first pose of its embodiment.

    Attributes:
        embodiment: The embodiment.
        parsed: Its file, with the embodiment's config applied.
        data: Its model in the first pose.
        file_dt: The time step that its own MJCF gives, s; None for a URDF.
        cameras: The cameras of its file on the links that the arm moves.
    """

    embodiment: NewEmbodiment
    parsed: ParsedArticulation
    data: mujoco.MjData
    file_dt: float | None
    cameras: tuple[str, ...]

    @property
    def model(self) -> mujoco.MjModel:
        """Its model alone."""
        return self.parsed.model

    @property
    def is_floating(self) -> bool:
        """Whether its base is not fixed to the world."""
        return not self.parsed.fixed_base

    @property
    def names(self) -> set[str]:
        """The names of links that the embodiment gives."""
        return {name for name, alias in self.parsed.aliases.items() if alias.frames}

    @property
    def base_height(self) -> float:
        """Height of its root above the ground, m."""
        return float(self.parsed.placement.root_pos[2])

    @property
    def shift(self) -> F64:
        """(3,) from a place in its model alone to the same place in a scene, m."""
        return self.parsed.placement.root_pos - self.data.body(self.parsed.root_link_name).xpos

    def joints_of(self, part: str) -> list[str]:
        """The joints of a control part that do not follow others; none without the part."""
        joints = self.parsed.control_parts.get(part, ())
        return [self.parsed.joint_names[i] for i in joints if i not in self.parsed.mimic_ids]

    def frames_of(self, name: str) -> list[str]:
        """The frames of its file that a name of the embodiment stands for."""
        alias = self.parsed.aliases.get(name)
        return list(alias.frames) if alias else []

    def tool(self) -> ToolFrame:
        """The tool.

        Raises:
            ConfigError: If there is none.
        """
        alias = self.parsed.aliases.get("tool")
        if alias is None or len(alias.frames) != 1 or alias.kind == "geom":
            raise ConfigError(
                f"embodiment {self.embodiment.name}: names.tool names no link or site"
            )
        return ToolFrame(alias.kind, alias.frames[0])

    def without_servo(self, joints: list[str]) -> list[str]:
        """Those of some joints that no position target moves."""
        columns = {name: i for i, name in enumerate(self.parsed.joint_names)}
        return [name for name in joints if not self.parsed.drives[columns[name]]]

    def qpos_of(self, joints: list[str]) -> F64:
        """(k,) first positions of joints, rad or m."""
        return np.array([float(self.data.joint(name).qpos[0]) for name in joints])


def read_embodiment(embodiment: NewEmbodiment) -> EmbodiedRobot:
    """Read the robot of an embodiment.

    Raises:
        ConfigError: If the embodiment does not exist, has mistakes, or has several robots.
    """
    import mujoco

    from embodichain.config.composition.composed import compose
    from embodichain.config.keys.check_types import check_types
    from embodichain.lab.sim.compiler.robot.articulation import parse_with_problems
    from embodichain.lab.sim.compiler.robot.files.robot_files import locate, read_model

    with tempfile.TemporaryDirectory() as folder:
        write_trial_files(Path(folder), _BARE_TASK.format(name=embodiment.name), embodiment)
        composed = compose([f"task={TRIAL}"], "run", folder)
        checked = check_types(composed.tree)
    problems = [*composed.problems, *checked.problems]
    if problems or checked.root is None:
        raise ConfigError(problems)
    cfg = checked.root.task.robot
    if cfg is None or not cfg.fpath:
        message = f"embodiment {embodiment.name} has several robots, or none with a file"
        raise ConfigError(f"{message}: `new task --kind` writes tasks of one robot")
    parsed, problems = parse_with_problems("robot", cfg)
    if parsed is None or problems:
        raise ConfigError(problems)
    data = mujoco.MjData(parsed.model)
    for name, value in zip(parsed.joint_names, parsed.init_qpos, strict=True):
        data.joint(name).qpos = value
    root = parsed.model.body(parsed.root_link_name)
    if not parsed.fixed_base:
        start = int(parsed.model.jnt_qposadr[root.jntadr[0]])
        data.qpos[start : start + 3] = parsed.placement.root_pos
        data.qpos[start + 3 : start + 7] = parsed.placement.root_quat
    mujoco.mj_kinematics(parsed.model, data)
    mujoco.mj_comPos(parsed.model, data)
    file = read_model(locate(str(cfg.fpath)))
    return EmbodiedRobot(
        embodiment=embodiment,
        parsed=parsed,
        data=data,
        file_dt=None if file.is_urdf else float(file.spec.option.timestep),
        cameras=_moved_cameras(parsed.model),
    )


def write_trial_files(folder: Path, task: str, embodiment: NewEmbodiment | None) -> None:
    """Write a task that is only built, and its embodiment, into a folder of configs.

    Args:
        folder: The folder, which exists.
        task: The task's YAML.
        embodiment: Its file is written if it has a text.
    """
    (folder / "task").mkdir()
    (folder / "task" / f"{TRIAL}.yaml").write_text(task, encoding="utf-8")
    if embodiment is not None and embodiment.text:
        (folder / "embodiment").mkdir()
        path = folder / "embodiment" / f"{embodiment.name}.yaml"
        path.write_text(embodiment.text, encoding="utf-8")


def _moved_cameras(model: mujoco.MjModel) -> tuple[str, ...]:
    """Cameras on links that at least two joints move: those on a wrist or a hand."""
    cameras = []
    for i in range(model.ncam):
        name = model.camera(i).name
        body = int(model.cam_bodyid[i])
        joints = 0
        while body:
            joints += int(model.body_jntnum[body])
            body = int(model.body_parentid[body])
        if name and joints >= 2:
            cameras.append(name)
    return tuple(cameras)
