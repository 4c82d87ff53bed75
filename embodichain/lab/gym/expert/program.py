"""`Program`: the steps of a task as numbered instructions, for arms that exist."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.cfg import EnvCfg, TermCfg
from embodichain.lab.gym.envs.managers.terms.check import check_params
from embodichain.lab.gym.envs.managers.terms.registry import describe_term, import_object
from embodichain.lab.gym.expert.arms import DeclaredArm, declared_arms, find_arm
from embodichain.lab.gym.expert.instructions import Goal, Grip, Instruction, Move
from embodichain.lab.gym.expert.reading import ReadStep, read_steps
from embodichain.lab.gym.expert.targets import check_target
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.sim.compiler.names import Known

__all__ = ["Program", "check_expert", "check_steps", "step_rows", "steps_of", "targets_in"]


def check_steps(
    values: Sequence[Any], arms: Sequence[DeclaredArm] | None, path: str = "expert"
) -> tuple[list[ReadStep], list[Problem]]:
    """Read steps and check the arms that they name.

    Args:
        values: The steps, as in a task file.
        arms: The arms of the task; None checks none.
        path: Key path of the steps.

    Returns:
        The steps, and every mistake.
    """
    steps, problems = read_steps(values, path)
    if not values:
        problems.append(Problem(path, "needs at least one step"))
    for read in (one for step in steps for one in step.flat()):
        for key, name in read.arms.items() if arms is not None else ():
            try:
                arm = find_arm(name, arms or (), read.path, key)
            except ConfigError as error:
                problems += error.problems if read.lane is None else ()  # once for a lane
                continue
            if read.grips and arm.gripper is None:
                message = f"arm {arm.name!r} has no gripper: no parallel_gripper moves {arm.uid!r}"
                problems.append(Problem(read.path, message))
    return steps, problems


def targets_in(steps: Sequence[ReadStep]) -> list[tuple[str, Any]]:
    """Key path and target of all that the steps refer to."""
    return [pair for step in steps for read in step.flat() for pair in read.targets]


def step_rows(expert: Any) -> list[dict[str, Any]]:
    """A table of the steps in a task: key path, name and what they are made of."""
    steps = read_steps(expert)[0] if isinstance(expert, list) else []
    rows = []
    for read in (one for step in steps for one in step.flat()):
        made = [one for phase in read.phases for lane in phase.values() for one in lane]
        words = ", ".join(_word(one) for one in made)
        rows.append({"path": read.path, "step": read.path.rpartition(".")[2], "made of": words})
    return rows


def _word(instruction: Instruction) -> str:
    if isinstance(instruction, Grip):
        return "open" if instruction.opens else "close"
    return type(instruction).__name__.lower()


def check_expert(cfg: EnvCfg, known: Known | None, allow_import: bool = True) -> list[Problem]:
    """Find every mistake in the section `expert` of a task, without an environment.

    Args:
        cfg: The task.
        known: The declared entities; None checks no targets.
        allow_import: Whether functions may be imported.
    """
    if cfg.expert is None:
        return []
    if isinstance(cfg.expert, TermCfg):
        try:
            if allow_import:
                function_of(cfg.expert)
        except ConfigError as error:
            return list(error.problems)
        return []
    open_scene = cfg.id is not None
    arms = declared_arms(cfg, allow_import)
    # Of two actions of one robot, one may move fingers only: that is seen when it is built.
    known_arms = cfg.actions and not open_scene and len({arm.uid for arm in arms}) == len(arms)
    steps, problems = check_steps(cfg.expert, arms if known_arms else None)
    for path, target in targets_in(steps) if known is not None else ():
        problems += check_target(target, path, known or {}, cfg.commands, open_scene)
    return problems


def steps_of(given: Any, env: BaseEnv) -> Sequence[Any]:
    """The steps, from a list of them or from the function that makes them.

    Raises:
        ConfigError: If there are none, or the function or its parameters are wrong.
    """
    if given is None:
        message = "this task has no section `expert`: its steps are what the policy performs"
        raise ConfigError([Problem("expert", message)])
    if isinstance(given, Mapping):
        given = TermCfg(**given)
    if isinstance(given, TermCfg):
        function, values = function_of(given)
        given = function(env, **values)
    elif callable(given):
        given = given(env)
    return given


def function_of(cfg: TermCfg) -> tuple[Callable[..., Any], dict[str, Any]]:
    """The function that makes the steps, and its checked parameters.

    Raises:
        ConfigError: If there is no such function, or a parameter is wrong.
    """
    try:
        function = import_object(cfg.func) if isinstance(cfg.func, str) else cfg.func
        if not callable(function):
            raise ValueError(f"{cfg.func!r} is not a function")
        spec = describe_term("step", function)
    except (ConfigError, ValueError) as error:
        raise ConfigError([Problem("expert.func", str(error))]) from error
    values, problems = check_params(spec, cfg.params, "expert.params")
    if problems:
        raise ConfigError(problems)
    return function, spec.arguments(values)


class Program:
    """Instructions, and which of them begin when.

    Args:
        steps: The steps, checked.
        arms: The arms.

    Attributes:
        instructions: All of them.
        arm: (I,) number of the arm of each.
        next: (I,) the next one of the same arm in the same phase, or -1.
        first: (P, arms) the first one of each arm in each phase, or -1.
    """

    def __init__(self, steps: Sequence[ReadStep], arms: Sequence[DeclaredArm]) -> None:
        numbers = {arm.name: i for i, arm in enumerate(arms)}
        self.instructions: list[Instruction] = []
        of_arm: list[int] = []
        following: list[int] = []
        first: list[list[int]] = []
        for phase in (phase for step in steps for phase in step.phases):
            row = [-1] * len(arms)
            for name, instructions in phase.items():
                number = numbers[find_arm(name, arms, "").name]
                for instruction in instructions:
                    index = len(self.instructions)
                    if row[number] < 0:
                        row[number] = index
                    else:
                        following[-1] = index
                    self.instructions.append(instruction)
                    of_arm.append(number)
                    following.append(-1)
            first.append(row)
        self.arm: NDArray[np.int64] = np.array(of_arm, np.int64)
        self.next: NDArray[np.int64] = np.array(following, np.int64)
        self.first: NDArray[np.int64] = np.array(first, np.int64).reshape(-1, len(arms))

    def goals(self) -> list[Goal]:
        """The goals of all motions."""
        return [one.goal for one in self.instructions if isinstance(one, Move)]

    def taken(self) -> list[Any]:
        """Everything that is grasped, once each."""
        grips = [one for one in self.instructions if isinstance(one, Grip)]
        return list(dict.fromkeys(grip.takes for grip in grips if grip.takes is not None))
