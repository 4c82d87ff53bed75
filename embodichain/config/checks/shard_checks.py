"""What `sim.backend=ray` does not do, refused by name before anything is built."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from embodichain.config.keys.schema import JobVerb, PolicyCfg, RootCfg, SimCfg
from embodichain.lab.gym.envs.managers.terms.registry import Kind, resolve_term
from embodichain.lab.sim.cfg import choose_engine
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["IN_SHARDS", "check_shards"]

IN_SHARDS = ("random", "random_around_home", "zero")
"""Policies without a state that read no observation: they act inside of the shards."""
_READ_SIMULATION = ("expert", "hold", "teleop")
"""Policies that read the simulation, which is not in the process where policies act."""


def check_shards(root: RootCfg, verb: JobVerb, allow_import: bool) -> list[Problem]:
    """Check that a job can run in shards, if it is to.

    Args:
        root: The config.
        verb: The verb of the job.
        allow_import: Whether ``package.module:function`` may be imported.
    """
    sim = root.sim
    if sim.backend == "local":
        problems = []
        for name in ("shards", "ray"):
            if getattr(sim, name) != getattr(SimCfg(), name):
                message = "is for sim.backend=ray; one process has threads: sim.num_threads"
                problems.append(Problem(f"sim.{name}", message))
        return problems
    return [*_check_root(root, verb), *_check_task(root, allow_import)]


def _check_root(root: RootCfg, verb: JobVerb) -> Iterator[Problem]:
    """Check keys besides the task."""
    sim = root.sim
    here = "sim.backend=ray"
    engine, _ = choose_engine(sim.engine, root.device or "cpu")
    if engine != "mujoco" or (root.device or "cpu") != "cpu":
        message = f"ray: shards run on the CPU with engine mujoco, not {engine} on {root.device}"
        yield Problem("sim.backend", message)
    if verb == "collect":
        yield Problem("sim.backend", "ray: a collection is one log; collect runs in one process")
    count = root.num_envs or 1
    if sim.shards > count:
        message = f"{sim.shards} shards need as many environments, num_envs is {count}"
        yield Problem("sim.shards", message)
    if root.viewer.name != "none":
        message = f"{here} has no live viewer, as it sees one process: embodichain replay --view"
        yield Problem("viewer", message)
    if root.record.format != "none" and root.record.every != 1:
        message = f"{here} records every episode, as its logs have no common leading environment"
        yield Problem("record.every", message)
    if root.dataset is not None:
        yield Problem("dataset", f"{here} learns from its own steps alone")
    policy = root.policy.func if isinstance(root.policy, PolicyCfg) else root.policy
    if verb != "train" and policy in _READ_SIMULATION:
        message = f"{policy} reads the simulation, which is in the shards of {here}"
        yield Problem("policy", f"{message}; there are: {', '.join(IN_SHARDS)}, or a policy's file")


def _check_task(root: RootCfg, allow_import: bool) -> Iterator[Problem]:
    """Check that no term needs all environments in one process."""
    for name, event in root.task.events.items():
        path = f"task.events.{name}"
        if event.is_global and event.mode == "interval":
            message = "must be false with sim.backend=ray: the timer would be one for each shard"
            yield Problem(f"{path}.is_global", message)
        reason = _whole_batch("event", event.func, allow_import)
        if reason:
            yield Problem(f"{path}.func", f"not with sim.backend=ray: {reason}")
    for name, curriculum in root.task.curriculum.items():
        reason = _whole_batch("curriculum", curriculum.func, allow_import)
        if reason:
            yield Problem(f"task.curriculum.{name}.func", f"not with sim.backend=ray: {reason}")


def _whole_batch(kind: Kind, func: str | Callable[..., Any], allow_import: bool) -> str:
    """Why a term needs all environments in one process; empty if it does not."""
    try:
        term: Any = resolve_term(kind, func, allow_import=allow_import).func
    except ConfigError:
        return ""  # the check of the terms reports it
    if kind == "curriculum" and "whole_batch" not in vars(term):
        return f"{func} may depend on all environments; a class that does not has whole_batch = ''"
    return getattr(term, "whole_batch", "")
