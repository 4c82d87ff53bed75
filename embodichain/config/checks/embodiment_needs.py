"""`check_embodiment`: what a task needs of its robots and the chosen embodiment does not have.

A task names its robots' parts by the names that embodiments share, and joints by names or patterns.
All that an embodiment lacks is one mistake, which names the embodiments that have it; what follows
from it is not reported.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from embodichain.config.composition.composed import Composed, compose, list_options
from embodichain.config.composition.defaults_lists import place_of_choice
from embodichain.config.composition.embodiments import EMBODIMENT
from embodichain.config.composition.locate import COMMAND_LINE, display_path
from embodichain.config.keys.check_types import check_types
from embodichain.data import get_data_path
from embodichain.data.faults import fault_of
from embodichain.lab.gym.envs.cfg import EnvCfg
from embodichain.lab.gym.envs.managers.scene_entity import references_in
from embodichain.lab.gym.envs.managers.terms.registry import SECTIONS
from embodichain.lab.sim.cfg import ReachedCfg
from embodichain.lab.sim.compiler.names import Known, pick
from embodichain.lab.sim.configs.references import FRAME_KEYS, LinksCfg
from embodichain.utils.errors import DataNotFoundError, OutsideError, Problem

if TYPE_CHECKING:
    from embodichain.config.checks.check_result import Check

__all__ = ["check_embodiment", "follows_from_name"]

_NAMES = re.compile(
    r"task\.(?:robot|robots\.[^.]+|articulations\.[^.]+)\.(?P<key>names|control_parts)"
    r"(?:\.(?P<name>.+?)(?:\.\d+)*)?"
)
"""Key path of names that a robot's config gives, or of one of them."""
_UNKNOWN_PART = re.compile(r"no (?:link|site|geom|link, site or geom|control part)\b.* matches ")
"""A message that a robot has no part of a name."""

_CHOICE = f"{EMBODIMENT}@task"
"""The choice of an embodiment, as Hydra calls it."""
_UID = "robot"
"""What tasks call their only robot."""
_GRIPPER_ACTION = "parallel_gripper"
_COMMANDS = ("open_command", "close_command")


@dataclass(frozen=True)
class _Need:
    """Something of a robot that a task names.

    Attributes:
        path: Key path in the task of what names it.
        uid: The robot.
        kind: ``robot``, ``name`` (of a link), ``part``, ``joint`` or ``gripper``.
        name: The name.
    """

    path: str
    uid: str
    kind: str
    name: str


def check_embodiment(
    composed: Composed,
    task: EnvCfg,
    known: Known,
    problems: Sequence[Problem],
    check: Callable[[Composed], Check],
) -> list[Problem]:
    """Return mistakes in which all that the embodiment lacks is one of them.

    Args:
        composed: The composed config.
        task: The task, of it.
        known: The entities of its scene.
        problems: The mistakes that were found, with paths from the root.
        check: Checks a config with another embodiment.
    """
    problems = [problem for problem in problems if not follows_from_name(problem, problems)]
    if not problems:
        return []
    if _is_taken_out(composed):
        return _without_embodiment(composed, problems, check)
    name = composed.choices.get(_CHOICE)
    if name is None:
        return list(problems)
    robots_here = _robots(composed.tree)
    needs = dict.fromkeys(_missing_needs(task, known))
    # A name that stands for nothing in the robot's file is a mistake of its own.
    absent = [need for need in needs if not _has(robots_here, need)]
    if not absent:  # else the task is composed with each embodiment, which takes seconds
        return list(problems)
    choices = _Choices(composed)
    options = {option: _robots(choices.of(option).tree) for option in list_options(EMBODIMENT)}
    # What no embodiment has is a mistake of its own too, such as a misspelt name.
    having_joints = _HavingJoints(choices, options, check)
    missing = [
        need
        for need in absent
        if having_joints.of(need) or any(_has(robots, need) for robots in options.values())
    ]
    place = _place(composed, name)
    if place != COMMAND_LINE:
        # Who writes joints and the robot into one file has most likely misspelt the joints.
        joints = [need for need in missing if need.kind == "joint"]
        problems = [_with_embodiments(problem, joints, having_joints) for problem in problems]
        missing = [need for need in missing if need.kind != "joint"]
    if not missing:
        return list(problems)
    # What no embodiment has stays a mistake at its own key.
    misspelt = [need for need in absent if need not in missing]
    of_file = [problem for problem in composed.problems if problem.path == EMBODIMENT]
    if of_file and not _robots(composed.tree):  # an empty file
        return of_file
    paths = [f"task.{need.path}" for need in missing]
    paths += ["task.robot", "task.robots", "task.expert"]
    mistake = _misnamed_robot(composed, task, missing)
    if mistake is not None:
        return [mistake, *(problem for problem in problems if not _follows(problem, paths))]
    names_misspelt = [problem for problem in problems if _names_one_of(problem, misspelt)]
    having = [
        option
        for option, robots in options.items()
        if all(_has(robots, need) or option in having_joints.of(need) for need in missing)
        and _can_load(choices, option, robots)
    ]
    hint = "No embodiment has all of it: embodichain list embodiments."
    if having:
        hint = f"Embodiments that have it: {', '.join(having)}."
    message = f"{name} lacks what the task needs: {_listed(missing)}."
    mistake = Problem(EMBODIMENT, message, hint, place)
    others = [problem for problem in problems if not _follows(problem, paths)]
    if others and having:
        others = _shared(composed, others, check(choices.of(having[0])).problems)
    others += [problem for problem in names_misspelt if problem not in others]
    return [mistake, *others]


def _names_one_of(problem: Problem, needs: Iterable[_Need]) -> bool:
    """Whether a mistake is that one of some joints does not exist."""
    return any(
        need.kind == "joint"
        and _follows(problem, [f"task.{need.path}"])
        and f"matches {need.name!r}" in problem.message
        for need in needs
    )


def _with_embodiments(
    problem: Problem, joints: Iterable[_Need], having_joints: _HavingJoints
) -> Problem:
    """Return the mistake that a joint does not exist with the embodiments that have it."""
    for need in joints:
        if _names_one_of(problem, [need]):
            having = ", ".join(having_joints.of(need))
            hint = f"{problem.hint} Embodiments that have it: {having}.".strip()
            return replace(problem, hint=hint).at(problem.source)
    return problem


def _shared(
    composed: Composed, problems: Iterable[Problem], others: Iterable[Problem]
) -> list[Problem]:
    """Return the mistakes in composing, and those that are there with another embodiment too."""
    paths = {problem.path for problem in (*composed.problems, *others)}
    return [problem for problem in problems if problem.path in paths]


def _is_taken_out(composed: Composed) -> bool:
    """Whether an override takes the embodiment out, and nothing else gives the task a robot."""
    return any(_is_deletion(line) for line in composed.overrides) and not _robots(composed.tree)


def _is_deletion(line: str) -> bool:
    return line.startswith(f"~{EMBODIMENT}")


def _without_embodiment(
    composed: Composed, problems: Sequence[Problem], check: Callable[[Composed], Check]
) -> list[Problem]:
    """Return that a task has no robot without its embodiment, and what is wrong with it too."""
    lines = [line for line in composed.overrides if not _is_deletion(line)]
    typed = next(line for line in composed.overrides if _is_deletion(line))
    message = "the task has no robot without it."
    hint = f"Write {EMBODIMENT}=NAME in place of {typed}."
    mistake = Problem(EMBODIMENT, message, hint, COMMAND_LINE)
    with_embodiment = check(compose(lines, composed.config_name))
    return [mistake, *_shared(composed, problems, with_embodiment.problems)]


class _Choices:
    """The present config with other embodiments, each composed once.

    Args:
        composed: The present config.
    """

    def __init__(self, composed: Composed) -> None:
        self.present = composed
        self._lines = [
            line for line in composed.overrides if not line.lstrip("+~").startswith(EMBODIMENT)
        ]
        self._composed: dict[str, Composed] = {}

    def of(self, option: str) -> Composed:
        """Return the config with an embodiment."""
        if option not in self._composed:
            lines = [*self._lines, f"{EMBODIMENT}={option}"]
            self._composed[option] = compose(lines, self.present.config_name)
        return self._composed[option]


class _HavingJoints:
    """The embodiments that have joints which a task names; their files are read when asked.

    Args:
        choices: The config with other embodiments.
        options: Embodiment -> uid -> its robot.
        check: Checks a config with another embodiment.
    """

    def __init__(
        self,
        choices: _Choices,
        options: Mapping[str, Mapping[str, Mapping[str, Any]]],
        check: Callable[[Composed], Check],
    ) -> None:
        self._choices = choices
        self._options = options
        self._check = check
        self._scenes: dict[str, Known] = {}

    def of(self, need: _Need) -> list[str]:
        """Return the embodiments that have a joint; none for another kind of need."""
        if need.kind != "joint":
            return []
        reference = {"uid": need.uid, _JOINTS: need.name}
        having = []
        for option, robots in self._options.items():
            if need.uid not in robots:
                continue
            _, mistakes = pick("", reference, self._scene(option))
            if not mistakes:
                having.append(option)
        return having

    def _scene(self, option: str) -> Known:
        """The entities of the task's scene with another embodiment; none if it cannot be read."""
        if option not in self._scenes:
            scene = self._check(self._choices.of(option)).scene
            self._scenes[option] = {} if scene is None else scene.known
        return self._scenes[option]


def _misnamed_robot(composed: Composed, task: EnvCfg, missing: Iterable[_Need]) -> Problem | None:
    """Return that the embodiment's only robot has another name than the task calls it, or None."""
    robot = composed.tree["task"].get("robot")
    absent = {need.uid for need in missing if need.kind == "robot"}
    if absent != {_UID} or not isinstance(robot, Mapping) or not _has_file(robot):
        return None
    uid = robot.get("uid")
    if any(reference.get("uid") == uid for _, reference in _references(task) if uid):
        return None  # the task has a use for it: another robot is missing
    source = composed.source("task.robot.uid")
    if not uid:
        for file in composed.locator.files:
            if any(f"task.robot.{key}" in file.keys for key in _FILE_KEYS):
                source = f"{display_path(file.path)}:{file.keys['task.robot'].line}"
    message = f"tasks call it {_UID}; write uid: {_UID}"
    return Problem("task.robot.uid", message, source=source)


_FILE_KEYS = ("fpath", "urdf_cfg")
"""Keys of a robot that say what it is."""


def _has_file(robot: Mapping[str, Any]) -> bool:
    return any(robot.get(key) for key in _FILE_KEYS)


def _can_load(choices: _Choices, option: str, robots: Mapping[str, Mapping[str, Any]]) -> bool:
    """Whether an embodiment has no mistake as far as its files show, nothing compiled."""
    other = choices.of(option)
    paths_here = {problem.path for problem in choices.present.problems}
    if any(problem.path not in paths_here for problem in other.problems):
        return False
    mistakes = [*other.problems, *check_types(other.tree).problems]
    if any(_follows(problem, ["task.robot", "task.robots"]) for problem in mistakes):
        return False
    for robot in robots.values():
        if not robot.get("fpath"):
            continue
        try:
            path = Path(get_data_path(str(robot["fpath"])))
        except (DataNotFoundError, OutsideError):
            return False
        if fault_of(path):
            return False
    return True


_JOINTS = "joint_names"
_WORDS = {
    "robot": "robots",
    "name": "names",
    "part": "control parts",
    "joint": "joints",
    "gripper": "grippers",
}
"""Kind of a need -> what it is called in messages."""


def _listed(needs: Iterable[_Need]) -> str:
    """Return needs for people, by kind: ``names left_finger, right_finger``."""
    names_of: dict[str, list[str]] = {kind: [] for kind in _WORDS}
    for need in needs:
        name = need.name
        if need.kind != "robot" and need.uid != _UID:
            name = f"{need.uid}/{name}"
        if name not in names_of[need.kind]:
            names_of[need.kind].append(name)
    listed = [f"{_WORDS[kind]} {', '.join(names)}" for kind, names in names_of.items() if names]
    return "; ".join(listed)


def follows_from_name(problem: Problem, problems: Iterable[Problem]) -> bool:
    """Return whether a mistake is that a name is unknown which is wrong in the robot's config.

    Args:
        problem: The mistake.
        problems: All mistakes.
    """
    if _NAMES.fullmatch(problem.path):
        return False
    for other in problems:
        wrong = _NAMES.fullmatch(other.path)
        if wrong is None:
            continue
        name = wrong["name"]
        if name is None:  # none of its names is known
            if _UNKNOWN_PART.match(problem.message):
                return True
        elif f"matches {name!r}" in problem.message or f"is called {name!r}" in problem.message:
            return True
    return False


def _follows(problem: Problem, paths: Iterable[str]) -> bool:
    """Whether a mistake is at one of some key paths, or below it."""
    return any(problem.path == path or problem.path.startswith(f"{path}.") for path in paths)


def _place(composed: Composed, name: str) -> str:
    """Where the embodiment was chosen: an override, else the line of a file."""
    if any(line.lstrip("+").startswith(EMBODIMENT) for line in composed.overrides):
        return COMMAND_LINE
    files = composed.locator.files
    return place_of_choice(files, EMBODIMENT, name) or composed.source("task.robot")


def _robots(tree: Any) -> dict[str, Mapping[str, Any]]:
    """Uid -> robot of a composed task; a map without a file is what the task adds to no robot."""
    task = tree.get("task") if isinstance(tree, Mapping) else None
    if not isinstance(task, Mapping):
        return {}
    robots: dict[str, Any] = {}
    for uid, robot in (task.get("robots") or {}).items():
        robots[str(uid)] = robot
    robot = task.get("robot")
    if isinstance(robot, Mapping) and robot.get("uid"):
        robots[str(robot["uid"])] = robot
    return {
        uid: robot
        for uid, robot in robots.items()
        if isinstance(robot, Mapping) and _has_file(robot)
    }


def _missing_needs(task: EnvCfg, known: Known) -> Iterator[_Need]:
    """Yield what the task names of robots and other entities, and what these do not have."""
    for path, reference in _references(task):
        uid = str(reference.get("uid") or "")
        if not uid:
            continue
        if uid not in known:
            yield _Need(path, uid, "robot", uid)
        yield from _missing_parts(path, uid, reference, known)
    for uid, cfg in _declared_robots(task):
        if cfg.home is not None and uid in known:
            reference = {"uid": uid, "link": cfg.home.link}
            path = "robot.home" if uid == "robot" else f"robots.{uid}.home"
            yield from _missing_parts(path, uid, reference, known)
    robots = dict(_declared_robots(task))
    for name, action in task.actions.items():
        of = action.params.get("of", action.params.get("entity_cfg"))
        uid = str(of.get("uid") if isinstance(of, Mapping) else getattr(of, "uid", ""))
        robot = robots.get(uid)
        if action.func != _GRIPPER_ACTION or robot is None or robot.grippers:
            continue
        is_binary = action.params.get("command_mode") == "binary"
        if is_binary and not any(action.params.get(key) is not None for key in _COMMANDS):
            yield _Need(f"actions.{name}", uid, "gripper", "gripper")


def _missing_parts(
    path: str, uid: str, reference: Mapping[str, Any], known: Known
) -> Iterator[_Need]:
    """Yield the names of a reference that pick nothing of its robot."""
    keys = [(key, "name") for key in (*FRAME_KEYS, "body_names")]
    keys += [("control_parts", "part"), (_JOINTS, "joint")]
    for key, kind in keys:
        value = reference.get(key)
        names = [value] if isinstance(value, str) else list(value or [])
        for name in names:
            _, mistakes = pick("", {"uid": uid, key: name}, known)
            if mistakes:
                yield _Need(path, uid, kind, str(name))


def _declared_robots(task: EnvCfg) -> Iterator[tuple[str, Any]]:
    """Yield uid and config of the task's robots."""
    if task.robot is not None and task.robot.uid:
        yield task.robot.uid, task.robot
    yield from task.robots.items()


def _references(task: EnvCfg) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield key path and keys of every reference of a task: of terms, sensors, views, objects."""
    for section in SECTIONS:
        for name, term in getattr(task, section).items():
            yield from references_in(f"{section}.{name}.params", term.params)
    for name, sensor in task.sensors.items():
        for key, value in vars(sensor).items():
            if isinstance(value, LinksCfg) and value.uid:
                yield f"sensors.{name}.{key}", vars(value)
    for name, view in task.views.items():
        if view.body:
            yield f"views.{name}", _reference_to(view.body)
        for uid in view.show or ():
            yield f"views.{name}", {"uid": uid}
    for path, reached in _conditions_of_marks(task):
        if reached.by is not None:
            yield path, _reference_to(reached.by)
        elif reached.joint is not None:
            uid, _, joint = reached.joint.partition("/")
            yield path, {"uid": uid, _JOINTS: joint}


def _conditions_of_marks(task: EnvCfg) -> Iterator[tuple[str, ReachedCfg]]:
    """Yield key path and condition of the marks of objects and articulations."""
    for uid, cfg in task.objects.items():
        if cfg.reached is not None:
            yield f"objects.{uid}.reached", cfg.reached
    for uid, articulation in task.articulations.items():
        for name, mark in articulation.marks.items():
            if mark.reached is not None:
                yield f"articulations.{uid}.marks.{name}.reached", mark.reached


def _reference_to(frame: str) -> dict[str, str]:
    """The keys of a reference to ``UID`` or ``UID/NAME``."""
    uid, slash, name = frame.partition("/")
    return {"uid": uid, "link": name} if slash else {"uid": uid}


def _has(robots: Mapping[str, Mapping[str, Any]], need: _Need) -> bool:
    """Whether an embodiment has what a task needs, by what its file says."""
    robot = robots.get(need.uid)
    if robot is None:
        return False
    if need.kind == "robot":
        return True
    if need.kind == "gripper":
        return bool(robot.get("grippers"))
    if need.kind == "joint":  # its config does not say
        return False
    names = robot.get("control_parts" if need.kind == "part" else "names")
    return isinstance(names, Mapping) and need.name in names
