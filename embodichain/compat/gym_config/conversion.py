"""`convert`: converts a gym config to a task, with a list of what is left out."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from embodichain.compat.gym_config import scene
from embodichain.compat.gym_config.draft import Draft, Path
from embodichain.compat.gym_config.terms import convert_actions, convert_terms
from embodichain.compat.gym_config.vocabulary import ENV, PHYSICS, TOP
from embodichain.utils.errors import Problem

__all__ = ["CLASSES", "Conversion", "convert"]

_DEFAULT_DT = 0.01  # seconds per physics step, here and in EmbodiChain
_GENERIC = ("EmbodiedEnv-v1",)
CLASSES = (
    "SimpleTask-v1",
    "PushCubeRL",
    "CartPoleRL",
    "PointMassRL",
    "StackBlocksTwo-v1",
    "StackCups-v1",
    "ScoopIce-v1",
    "PlaceObjectDrawer-v1",
    "BlocksRankingSize-v1",
    "BlocksRankingRGB-v1",
    "MatchObjectContainer-v1",
    "PourWater-v3",
    "PourWaterAgent-v3",
    "Rearrangement-v3",
    "RearrangementAgent-v3",
    "HumanoidRun-v1",
    "UnitreeGo1FlatRL-v1",
    "UnitreeGo2FlatRL-v1",
    "ANYmalCFlatRL-v1",
    "UnitreeG1FlatRL-v1",
    "UnitreeH1_2FlatRL-v1",
    "MicroDuckFlatRL-v1",
    "FrankaReachApg-v0",
)
"""Ids of EmbodiChain's environment classes, which are not in this package."""
_COMPONENTS = ("environment", "embodiment", "scene")
_SIMULATED = ("robot", "objects", "articulations")
_ORDER = (
    "description",
    "id",
    "physics",
    "sim_steps_per_control",
    "max_episode_steps",
    "ignore_terminations",
    "robot",
    "objects",
    "articulations",
    "lights",
    "sensors",
    "actions",
    "events",
    "observations",
    "rewards",
    "extensions",
    "suggested",
)
"""Keys of a task, in the order in which they are written."""


@dataclass(frozen=True)
class Conversion:
    """The result of `convert`.

    Attributes:
        name: The task's name, from `id`; empty for the generic environment.
        task: The task; plain values, not checked.
        origins: Path in the task -> path in the gym config, for whole subtrees.
        notes: What was left out or changed; paths are the gym config's.
        problems: Mistakes: unknown keys, values that cannot be converted.
    """

    name: str
    task: dict[str, Any]
    origins: Mapping[Path, Path]
    notes: tuple[Problem, ...]
    problems: tuple[Problem, ...]

    def origin(self, path: Path) -> Path:
        """Return the path in the gym config of a key of the task, or of its nearest ancestor."""
        for count in range(len(path), 0, -1):
            source = self.origins.get(path[:count])
            if source is not None:
                return (*source, *path[count:])
        return ()


def convert(
    config: Mapping[str, Any], registered: Collection[str] = (), *, ours: bool = False
) -> Conversion:
    """Convert a gym config.

    Args:
        config: Its content, plain values; it is not changed.
        registered: Ids in `CLASSES` for which the user has registered a class.
        ours: Whether it may contain keys of this package, and functions instead of their names,
            as in a task declared in Python.
    """
    draft = Draft(ours)
    draft.apply_rules(config, (), (), TOP)
    _convert_id(draft, config.get("id"), registered)
    _convert_physics(draft, config)
    robot = ""
    if config.get("robot") is not None:
        robot = scene.convert_robot(draft, config["robot"])
    for section in ("background", "rigid_object"):
        scene.convert_objects(draft, section, config.get(section))
    scene.convert_articulations(draft, config.get("articulation"))
    scene.convert_lights(draft, config.get("light"))
    scene.convert_sensors(draft, config.get("sensor"), config.get("enable_sensor") is not False)
    env = config.get("env")
    if env is not None and draft.apply_rules(env, ("env",), (), ENV):
        _convert_control_period(draft, env)
        convert_actions(draft, env, robot)
        for section in ("events", "observations", "rewards"):
            convert_terms(draft, section, env, robot)
        if config.get("id") in CLASSES and "id" not in draft.task:
            _note_lost_success(draft, config["id"])
    _suggest(draft, config)
    _refuse_empty_task(draft, config)
    name = config.get("id")
    if name is None or name in _GENERIC:
        name = ""
    return Conversion(
        name=str(name),
        task={key: draft.task[key] for key in _ORDER if key in draft.task},
        origins=draft.origins,
        notes=tuple(draft.notes),
        problems=tuple(draft.problems),
    )


def _convert_id(draft: Draft, name: Any, registered: Collection[str]) -> None:
    """Convert the id: a class that is registered here, or one that is left out with a note."""
    where = ("id",)
    if name is None:
        return
    if not isinstance(name, str):
        draft.refuse(where, f"expected text, got {name!r}")
        return
    subject = "A task" if name in _GENERIC else f"The task {name}"
    draft.put(("description",), f"{subject}, converted from EmbodiChain's own form.", where)
    if name in CLASSES and name not in registered:
        message = (
            f"{name} is a Python class of EmbodiChain's: what it computes itself (success, "
            "failure, rewards) is not here; declare it as terms, or register a class of that id"
        )
        draft.note(where, message)
    elif name not in _GENERIC:
        draft.put(("id",), name, where)


def _note_lost_success(draft: Draft, name: str) -> None:
    """Add a note if rewards depend on a success that is not computed."""
    for key, term in draft.task.get("rewards", {}).items():
        if term["func"] == "success_reward":
            message = (
                f"it stays 0: success was computed by the Python class of {name}; declare a "
                f"termination of kind success or a metric called success, or register the class"
            )
            draft.note(("env", "rewards", key), message)


def _refuse_empty_task(draft: Draft, config: Mapping[str, Any]) -> None:
    """Refuse a task without robot, object and articulation: it would simulate nothing."""
    for key in _COMPONENTS:
        if config.get(key) is not None:
            message = "components of release 0.3 are not read: write their sections into this file"
            draft.refuse((key,), message)
    if draft.problems or "id" in draft.task:  # a registered class may add entities
        return
    if not any(draft.task.get(section) for section in _SIMULATED):
        message = "nothing is left to simulate: the file has no robot, object or articulation"
        draft.refuse((), message)


def _convert_physics(draft: Draft, config: Mapping[str, Any]) -> None:
    """Convert `physics_config` and `physics_dt`."""
    if config.get("physics_config") is not None:
        draft.apply_rules(config["physics_config"], ("physics_config",), ("physics",), PHYSICS)
    if config.get("physics_dt") is not None:
        draft.put(("physics", "physics_dt"), config["physics_dt"], ("physics_dt",))


def _convert_control_period(draft: Draft, env: Mapping[str, Any]) -> None:
    """Convert the frequency of control; a control step is a whole number of physics steps."""
    where = ("env", "target_control_frequency")
    frequency = env.get("target_control_frequency")
    if frequency is None:
        return
    dt = draft.task.get("physics", {}).get("physics_dt", _DEFAULT_DT)
    if not (_is_positive(frequency) and _is_positive(dt)):
        draft.refuse(where, f"expected a positive number, got {frequency!r}")
        return
    steps = 1.0 / (dt * frequency)
    if round(steps) < 1 or abs(steps - round(steps)) > 1e-9 * steps:
        draft.refuse(where, f"{frequency} Hz is not a whole number of physics steps of {dt} s")
        return
    draft.put(("sim_steps_per_control",), round(steps), where)


def _is_positive(value: Any) -> bool:
    return isinstance(value, (int, float)) and value > 0


def _suggest(draft: Draft, config: Mapping[str, Any]) -> None:
    """Write root keys of a run as suggestions, so that the command line overrides them."""
    for key, name, verbs in (
        ("num_envs", "num_envs", ("run", "train")),
        ("seed", "seed", ("run", "train")),
        ("max_episodes", "episodes", ("run",)),
    ):
        value = config.get(key)
        if value is None or (key == "seed" and value == -1):  # -1 draws one, as null does
            continue
        for verb in verbs:
            draft.put(("suggested", verb, name), value, (key,))
    device = config.get("device")
    card = config.get("gpu_id")
    if device == "cuda" and isinstance(card, int):
        draft.note(("device",), f"give it on the command line: device=cuda:{card}")
        draft.note(("gpu_id",), "it is the number in device=cuda:N")
    elif device not in (None, "cpu"):
        draft.note(("device",), f"give it on the command line: device={device}")
    elif card is not None:
        draft.note(("gpu_id",), f"physics runs on a card with device=cuda:{card}, else on the CPU")
