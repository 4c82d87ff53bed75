"""`Program`: the steps of a task as numbered instructions, for arms that exist."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.cfg import EnvCfg, TermCfg
from embodichain.lab.gym.envs.managers.terms.check import check_params
from embodichain.lab.gym.envs.managers.terms.registry import describe_term, import_object
from embodichain.lab.gym.expert.arms import DeclaredArm, declared_arms, find_arm
from embodichain.lab.gym.expert.instructions import Grip, Instruction
from embodichain.lab.gym.expert.reading import ParsedStep, flat_steps, read_steps
from embodichain.lab.gym.expert.targets import check_target
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.sim.compiler.names import Known

__all__ = ["Program", "check_expert", "check_steps", "step_rows", "steps_of", "targets_in"]

_NONE = -1
"""In place of the index of an instruction that does not exist."""


def check_steps(
    values: Sequence[Any], arms: Sequence[DeclaredArm] | None, path: str = "expert"
) -> tuple[list[ParsedStep], list[Problem]]:
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
    if arms is not None:
        for step in flat_steps(steps):
            problems += _check_arms(step, arms)
    return steps, problems


def _check_arms(step: ParsedStep, arms: Sequence[DeclaredArm]) -> list[Problem]:
    """Return the arms of a step that do not exist, or lack the gripper that it needs."""
    problems: list[Problem] = []
    for key, name in step.arms.items():
        try:
            arm = find_arm(name, arms, step.path, key)
        except ConfigError as error:
            # The arm of a lane is an arm of each step in it: its `together` reports it, once.
            if step.lane is None:
                problems += error.problems
            continue
        if step.grips and arm.gripper is None:
            message = f"arm {arm.name!r} has no gripper: no parallel_gripper moves {arm.uid!r}"
            problems.append(Problem(step.path, message))
    return problems


def targets_in(steps: Sequence[ParsedStep]) -> list[tuple[str, Any]]:
    """Key path and target of all that the steps refer to."""
    pairs: list[tuple[str, Any]] = []
    for step in flat_steps(steps):
        pairs += step.targets
    return pairs


def step_rows(expert: Any) -> list[dict[str, Any]]:
    """A table of the steps in a task: key path, name and what they are made of."""
    if not isinstance(expert, list):
        return []
    steps, _ = read_steps(expert)
    rows: list[dict[str, Any]] = []
    for step in flat_steps(steps):
        words = ", ".join(_word(instruction) for instruction in step.instructions())
        rows.append({"path": step.path, "step": step.path.rpartition(".")[2], "made of": words})
    return rows


def _word(instruction: Instruction) -> str:
    """The name of a kind of instruction in tables."""
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
    # Of two actions of one robot, one may move fingers only: only the built environment can tell.
    one_arm_a_robot = len({arm.uid for arm in arms}) == len(arms)
    are_arms_clear = cfg.actions and not open_scene and one_arm_a_robot
    steps, problems = check_steps(cfg.expert, arms if are_arms_clear else None)
    if known is not None:
        for path, target in targets_in(steps):
            problems += check_target(target, path, known, cfg.commands, open_scene)
    return problems


def steps_of(expert: Any, env: BaseEnv) -> Sequence[Any]:
    """The steps, from a list of them or from the function that makes them.

    Raises:
        ConfigError: If there are none, or the function or its parameters are wrong.
    """
    if expert is None:
        message = "this task has no section `expert`: its steps are what the policy performs"
        raise ConfigError([Problem("expert", message)])
    if isinstance(expert, Mapping):
        expert = TermCfg(**expert)
    if isinstance(expert, TermCfg):
        function, arguments = function_of(expert)
        return function(env, **arguments)
    if callable(expert):
        return expert(env)
    return expert


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
        next: (I,) the next one of the same arm in the same phase, or -1.
        first: (P, arms) the first one of each arm in each phase, or -1.
    """

    def __init__(self, steps: Sequence[ParsedStep], arms: Sequence[DeclaredArm]) -> None:
        self.instructions: list[Instruction] = []
        arm_numbers = {arm.name: number for number, arm in enumerate(arms)}
        next_of: list[int] = []
        first_of_phases: list[list[int]] = []
        for step in steps:
            for phase in step.phases:
                first_of_arms = [_NONE] * len(arms)
                for name, instructions in phase.items():
                    number = arm_numbers[find_arm(name, arms, "").name]
                    for instruction in instructions:
                        index = len(self.instructions)
                        if first_of_arms[number] == _NONE:
                            first_of_arms[number] = index
                        else:
                            # Instructions of one arm in one phase have consecutive indices.
                            next_of[-1] = index
                        self.instructions.append(instruction)
                        next_of.append(_NONE)
                first_of_phases.append(first_of_arms)
        self.next: NDArray[np.int64] = np.array(next_of, np.int64)
        self.first: NDArray[np.int64] = np.array(first_of_phases, np.int64).reshape(-1, len(arms))

    def taken(self) -> list[Any]:
        """Everything that is grasped, once each."""
        grips = [item for item in self.instructions if isinstance(item, Grip)]
        return list(dict.fromkeys(grip.takes for grip in grips if grip.takes is not None))
