"""The files of a new task, as text: YAML, a class, a test. Where they go, `new` decides."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from string import Template

from embodichain.cli.new_robot import RobotFacts, robot_words
from embodichain.utils.errors import ConfigError

__all__ = ["Names", "task_files"]


@dataclass(frozen=True, slots=True)
class Names:
    """What the files of a task are called.

    Attributes:
        task: Its name.
        module: The module of its class, as it is imported.
        source: Relative to the working directory: what Python must search for the module.
        package: The package that it goes into; empty for none.
    """

    task: str
    module: str
    source: Path
    package: str

    @property
    def cls(self) -> str:
        """The class: ``push_cube`` gives ``PushCubeEnv``."""
        return "".join(part[:1].upper() + part[1:] for part in self.task.split("_")) + "Env"

    @property
    def env_id(self) -> str:
        """The id that the class registers."""
        return f"{self.cls.removesuffix('Env') or self.task}-v0"

    @property
    def conf(self) -> Path:
        """The folder whose `task` folder gets the YAML."""
        return self._inside("conf") if self.package else Path("conf")

    @property
    def python(self) -> Path:
        """The file of the class."""
        folder = self._inside("tasks") if self.package else self.source
        return folder / f"{self.task}.py"

    @property
    def test(self) -> Path:
        """The test."""
        tests = Path("tests", "tasks")
        return (tests if tests.is_dir() else tests.parent) / f"test_{self.task}.py"

    def _inside(self, name: str) -> Path:
        """A folder of the package; where it is a link, what it points to."""
        folder = self.source / self.package / name
        return Path(os.path.relpath(folder.resolve())) if folder.is_symlink() else folder


def task_files(names: Names, robot: RobotFacts, *, python: bool) -> dict[Path, str]:
    """Return path -> text of the files of a task.

    Args:
        names: What they are called.
        robot: Whose task it is.
        python: Whether the task is a class that a short YAML names.

    Raises:
        ConfigError: If a class is wanted, which sets joint targets, and joints take none.
    """
    if python and robot.passive:
        message = "a Python task sets joint targets, and these joints have no position servo: "
        raise ConfigError(f"--python: {message}{', '.join(robot.passive)}; leave --python out")
    words = {
        "task": names.task,
        "title": names.task.replace("_", " "),
        "cls": names.cls,
        "id": names.env_id,
        "module": names.module,
        "conf": "/".join(f'"{part}"' for part in names.conf.parts).replace("/", " / "),
        "up": str(len(names.test.parts) - 1),
        "source": " / ".join(["ROOT", *(f'"{part}"' for part in names.source.parts)]),
        **robot_words(robot),
    }
    files = {names.conf / "task" / f"{names.task}.yaml": _CLASS_YAML if python else _YAML}
    if python:
        files[names.python] = _CLASS
    files[names.test] = _CLASS_TEST if python else _TEST
    texts = {path: Template(text).substitute(words) for path, text in files.items()}
    if names.package:
        for folder in (names.conf, names.python.parent):
            init = folder / "__init__.py"
            if not init.exists() and (python or folder == names.conf):
                what = "The YAML of this package's tasks." if folder == names.conf else "Tasks."
                texts[init] = f'"""{what}"""\n'
    return texts


_YAML = """\
# What a task may say: docs/task.md. Terms: embodichain list terms; one of them: show term NAME.
description: Bring a link of the robot to a marker that is elsewhere in every episode.
physics: {physics_dt: 0.005}       # seconds a physics step
sim_steps_per_control: 4           # physics steps a control step
max_episode_steps: 100             # control steps
robot:
  uid: $uid
  fpath: $fpath
  init_pos: $position
  init_qpos: $home
  $standing
  $drives
objects:
$pedestal  marker:
    shape: {shape_type: Sphere, radius: 0.02}
    body_type: kinematic
    attrs: {enable_collision: false}
    init_pos: $marker
${actions}events:
  place_marker:
    func: randomize_rigid_object_pose
    mode: reset
    params:
      of: {uid: marker}
      relative_to: {uid: $uid, link_names: [$tool]}
      position_range: [[-$radius, -$radius, -$radius], [$radius, $radius, $radius]]
observations:                      # this order is the order in the learner's vector
  qpos: {func: joint_position_relative, params: {of: {uid: $uid}}}
  qvel: {func: joint_velocity, scale: 0.1, params: {of: {uid: $uid}}}
  to_marker:
    func: relative_position
    params: &pair
      from: {uid: $uid, link_names: [$tool]}
      to: {uid: marker}
rewards:                           # value x weight
  distance: {func: distance_between_objects, params: *pair}
  near: {func: within_distance, weight: 0.5, params: {<<: *pair, threshold: $near}}
metrics:                           # success: what the last step of an episode says
  success: {func: within_distance, reduce: last, params: {<<: *pair, threshold: $near}}
suggested:                         # values of root keys that the command line does not give
  run: {num_envs: 4, episodes: 2}
  train: {num_envs: 64, total_timesteps: 200_000}
"""

_CLASS_YAML = """\
# The scene is built by the class in $module. Terms can be declared beside it.
description: Bring a link of the robot to a marker, as a Python class.
id: $module:$id
physics: {physics_dt: 0.005}       # seconds a physics step
sim_steps_per_control: 4           # physics steps a control step
max_episode_steps: 100             # control steps
$objects${pedestal}observations:                      # what a learner sees, in this order
  qpos: {func: joint_position_relative, params: {of: {uid: $uid}}}
  to_marker:
    func: relative_position
    params: &pair
      from: {uid: $uid, link_names: [$tool]}
      to: {uid: marker}
rewards:                           # added to what `get_reward` returns
  near: {func: within_distance, weight: 0.5, params: {<<: *pair, threshold: $radius}}
metrics:                           # success: what the last step of an episode says
  success: {func: within_distance, reduce: last, params: {<<: *pair, threshold: $near}}
suggested:                         # values of root keys that the command line does not give
  run: {num_envs: 4, episodes: 2, policy: random_around_home}
  train: {num_envs: 64, total_timesteps: 200_000}
"""

_CLASS = '''\
"""A robot that is to bring a link to a marker, written as a Python class.

`embodichain run task=$task` runs it by its YAML. Without that, `gymnasium.make` takes
"$module:$id".
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
import torch

from embodichain.data import get_data_path
from embodichain.lab.gym.envs import BaseEnv
from embodichain.lab.gym.utils.registration import register_env
from embodichain.lab.sim.cfg import $imports
from embodichain.lab.sim.objects import Robot
from embodichain.lab.sim.shapes import SphereCfg
from embodichain.lab.sim.types import EnvAction, EnvObs


@register_env("$id", override=True)
class $cls(BaseEnv):
    """N robots, each with a marker that is elsewhere in every episode.

    Actions are absolute targets of the active joints, rad or m. `BaseEnv.step` says when each
    hook is called, `embodichain.lab.gym.envs.hooks` which others there are.
    """

    home = np.array($array)
    near = $near  # m: closer is a success

    def _setup_robot(self, **kwargs: Any) -> Robot:
        robot = self.sim.add_robot(
            RobotCfg(
                uid="$uid",
                fpath=get_data_path("$fpath"),
                init_pos=$tuple,
                init_qpos=self.home,
                $fixed,$gains
            )
        )
        limits = robot.body_data.qpos_limits[0][robot.active_joint_ids]
        low, high = limits.unbind(dim=1)
        self.single_action_space = gym.spaces.Box(low.numpy(), high.numpy(), dtype=np.float32)
        self.arm = robot
        return robot

    def _prepare_scene(self, **kwargs: Any) -> None:
        self.marker = self.sim.add_rigid_object(
            RigidObjectCfg(
                uid="marker",
                shape=SphereCfg(radius=0.02),
                attrs=RigidBodyAttributesCfg(enable_collision=False),
                body_type="kinematic",
            )
        )

    def _initialize_episode(self, env_ids: torch.Tensor, **kwargs: Any) -> None:
        pose = torch.zeros(len(env_ids), 7)  # x y z, then the quaternion w x y z
        pose[:, 3] = 1.0
        pose[:, :3] = torch.tensor($marker) + self.rand(
            "marker", (3,), -$radius, $radius, env_ids=env_ids
        )
        self.marker.set_local_pose(pose, env_ids=env_ids)

    def _step_action(self, action: EnvAction) -> EnvAction:
        self.arm.set_qpos(action, joint_ids=self.active_joint_ids)
        return action

    def evaluate(self, **kwargs: Any) -> Mapping[str, Any]:
        """How far the tool is from the marker; a success ends the episode."""
        tool = self.arm.get_link_pose("$tool")[:, :3]
        distance = torch.linalg.vector_norm(self.marker.get_local_pose()[:, :3] - tool, dim=1)
        return {"distance": distance, "success": distance < self.near}

    def get_reward(self, obs: EnvObs, action: EnvAction, info: dict[str, Any]) -> torch.Tensor:
        """(N,) the nearer, the better."""
        distance: torch.Tensor = info["distance"]
        return -distance
'''

_HEAD = '''\
"""The task `$task`: how it begins, and that a seed says all of what happens."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch

import embodichain
from embodichain.lab.gym.envs import BaseEnv

ROOT = Path(__file__).parents[$up]
CONF = ROOT / $conf

Make = Callable[[int], BaseEnv]


@pytest.fixture
def make(MONKEY) -> Iterator[Make]:
    """Makes environments of the task, which are closed in the end."""
SEARCH    made: list[BaseEnv] = []

    def build(num_envs: int) -> BaseEnv:
        made.append(embodichain.make("$task", num_envs=num_envs, config_dir=CONF))
        return made[-1]

    yield build
    for env in made:
        env.close()


def rewards(env: BaseEnv, steps: int = 10) -> torch.Tensor:
    """(steps, N) rewards of an episode under actions that seed 1 draws."""
    env.reset(seed=1)
    shape = env.single_action_space.shape
    return torch.stack([env.step(env.rand("test", shape, -0.5, 0.5))[1] for _ in range(steps)])


def test_the_same_seed_gives_the_same_episode(make: Make) -> None:
    assert torch.equal(rewards(make(2)), rewards(make(2)))


def test_an_environment_does_not_depend_on_how_many_there_are(make: Make) -> None:
    assert torch.equal(rewards(make(1))[:, 0], rewards(make(3))[:, 0])


def test_every_episode_has_another_marker(make: Make) -> None:
    env = make(4)
    first = env.reset(seed=1)[0]["to_marker"].clone()
    second = env.reset()[0]["to_marker"]
    places = torch.cat([first, second])
    assert len(torch.unique(places, dim=0)) == 8


def test_at_the_marker_is_the_best_place(make: Make) -> None:
    env = make(2)
    env.reset(seed=1)
    places = env.robot.get_link_pose("$tool")
    places[1, 2] += $far
    env.sim.rigid_objects["marker"].set_local_pose(places)
    stay = torch.from_numpy(HOLD).float()
    reward, info = env.step(stay)[1::3]
    assert reward[0] > reward[1]
    assert SUCCESS == [True, False]
'''

_TEST = (
    _HEAD.replace("MONKEY", "")
    .replace("SEARCH", "")
    .replace("HOLD", "env.action_manager.hold()")
    .replace("SUCCESS", 'info["metrics"]["success"].bool().tolist()')
)
_CLASS_TEST = (
    _HEAD.replace("MONKEY", "monkeypatch: pytest.MonkeyPatch")
    .replace("SEARCH", "    monkeypatch.syspath_prepend($source)\n")
    .replace("torch.from_numpy(HOLD).float()", "env.robot.get_qpos()[:, env.active_joint_ids]")
    .replace("SUCCESS", 'info["success"].tolist()')
)
