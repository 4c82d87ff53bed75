"""`embodichain.make("reach", num_envs=64)`: builds the environment of `run task=reach`.

Torch is imported when an environment is built, not before.
"""

from __future__ import annotations

import dataclasses
import logging
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

from embodichain.config.composition.locate import COMMAND_LINE
from embodichain.config.environments.host_arrays import why_host, why_not_device, with_arrays
from embodichain.config.environments.unread_overrides import refuse_unread_overrides
from embodichain.config.gymnasium_ids import task_of_id
from embodichain.config.resolved import (
    Resolved,
    build_env,
    compile_scene_of,
    resolve,
    thaw,
)
from embodichain.lab.gym.envs.managers.terms.term_errors import TermError
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    import torch
    from gymnasium.vector import AutoresetMode

    from embodichain.config.keys.schema import JobVerb
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.sim.compiler.compile_scene import CompiledScene

__all__ = ["make", "make_batch", "make_env", "with_warp_sizes", "with_warp_values"]

_log = logging.getLogger(__name__)


def make(
    task: str,
    num_envs: int | None = None,
    overrides: Sequence[str] = (),
    *,
    device: str | torch.device | None = None,
    seed: int | None = None,
    render_mode: Literal["rgb_array"] | None = None,
    autoreset_mode: AutoresetMode | str | None = None,
    run_dir: str | Path | None = None,
    config_dir: str | Path | None = None,
    **kwargs: Any,
) -> BaseEnv:
    """Make the environment of a YAML task: N environments, stepped together, with torch tensors.

    A loop, where environments that end begin again by themselves::

        import torch

        import embodichain

        env = embodichain.make("reach", num_envs=4, seed=1)
        obs, info = env.reset()
        for _ in range(100):
            action = 2 * torch.rand(env.action_space.shape) - 1  # (4, 6), from -1 to 1
            obs, reward, terminated, truncated, info = env.step(action)
        print(obs["robot"]["qpos"].shape, reward.mean(), info["success"])
        env.close()

    ``embodichain list tasks`` has the names; ``embodichain show task=reach`` what is in the
    observation, what an action does, and every key.

    Args:
        task: An option of the group `task`: ``reach``.
        num_envs: N; None is the task's suggestion, else 1.
        overrides: As on the command line: ``["task.rewards.near.weight=2", "sim.num_threads=2"]``.
        device: ``cpu``, or ``cuda`` for MuJoCo Warp on a GPU; None is that of the config.
        seed: The seed of every random stream; None draws one.
        render_mode: ``rgb_array`` for `render`; None draws nothing.
        autoreset_mode: ``SameStep`` (None), ``NextStep`` or ``Disabled``, as in Gymnasium.
        run_dir: Folder for the states of environments that diverge; None writes none.
        config_dir: A folder with the user's groups, searched first.
        **kwargs: Arguments of the class that the task names, if it names one.

    Returns:
        The batched torch environment (in shards: see `make_batch`). `gymnasium.make` makes one
        environment with numpy observations of the same task, `gymnasium.make_vec` a batch of them.

    Raises:
        ConfigError: Lists every mistake in the config, and the overrides that only verbs read.
        DeviceError: There is no such device here; says why.
        TypeError: If `overrides` is one string instead of several, or an argument is unknown.
    """
    if isinstance(overrides, str):
        raise TypeError(f"overrides: a list of strings, such as [{overrides!r}], not a string")
    lines = [f"task={task}", *overrides]
    if not any(line.lstrip("+~").startswith(("policy=", "policy.")) for line in overrides):
        lines.append("policy=random")  # the environment has none: not the task's suggestion
    keys = {"num_envs": num_envs, "seed": seed, "device": device}
    for key, value in keys.items():
        if value is not None:
            _check_once(key, value, overrides)
            lines.append(f"{key}={value}")
    arguments = {
        "render_mode": render_mode,
        "autoreset_mode": autoreset_mode,
        "run_dir": None if run_dir is None else Path(run_dir),
    }
    # A class of the user need not have them.
    kwargs |= {name: value for name, value in arguments.items() if value is not None}
    try:
        resolved = resolve(lines, "run", config_dir)
    except ConfigError as error:
        _check_name(task, config_dir)
        raise type(error)([_in_python(problem) for problem in error.problems]) from error
    refuse_unread_overrides(overrides, resolved.root.viewer.name)
    find = resolved.source
    resolved = dataclasses.replace(
        resolved,
        notes=tuple(_in_python(note) for note in resolved.notes),
        source=lambda path: find(path).replace(COMMAND_LINE, _CALL),
    )
    for note in resolved.notes:
        _log.warning("%s", note)
    compiled_scene = compile_scene_of(resolved)
    resolved = with_warp_values(resolved, None, kwargs, compiled_scene=compiled_scene)
    return make_batch(resolved, compiled_scene=compiled_scene, **kwargs)


def make_env(
    resolved: Resolved, *, compiled_scene: CompiledScene | None = None, **kwargs: Any
) -> BaseEnv:
    """Build the environment of a config in this process, whatever ``sim.backend`` says.

    It is an instance of the class that the config names.

    Args:
        resolved: A checked config. ``auto`` arrays are on the host; see `with_warp_values`.
        compiled_scene: The scene of this config (`compile_scene_of`), which environments may share;
            None compiles it.
        **kwargs: For `BaseEnv`, or for the class.

    Raises:
        ConfigError: A mistake that is only found by building, with its place.
        TypeError: If an argument is unknown.
    """
    if compiled_scene is None:
        compiled_scene = compile_scene_of(resolved)
    if resolved.tree["sim"]["engine"] == "warp":
        resolved = with_warp_sizes(resolved, compiled_scene)
    return build_env(resolved, compiled_scene, **kwargs)


def make_batch(
    resolved: Resolved, *, compiled_scene: CompiledScene | None = None, **kwargs: Any
) -> BaseEnv:
    """Build the environments of a job where ``sim.backend`` says.

    Args:
        resolved: A checked config.
        compiled_scene: As of `make_env`; shards elsewhere compile their own.
        **kwargs: As of `make_env`.

    Returns:
        The result of `make_env`; with ``sim.backend=ray`` a `ShardedEnv`, which has the interface
        of a batch that learners, evaluations and policies use, and no simulation in this process.

    Raises:
        ConfigError: As `make_env` does, or there is no cluster with room for the shards.
        TypeError: If an argument is unknown, or has no form with shards.
    """
    if resolved.tree["sim"]["backend"] == "local":
        return make_env(resolved, compiled_scene=compiled_scene, **kwargs)
    from embodichain.config.environments.ray_shards import make_sharded

    return cast("BaseEnv", make_sharded(resolved, kwargs, compiled_scene))


_PROBE_ENVS = 8
"""Environments that `with_warp_sizes` steps."""
_PROBE_STEPS = 64
"""Control steps that it takes."""
_PROBE_EVERY = 4
"""Control steps between two states that it measures."""
_PROBE_DIVERGED = (
    "sim.warp: %d of %d environments diverged in %d control steps with random actions, which "
    "measure the memory of MuJoCo Warp on the CPU. A run with such actions diverges too "
    "(policy=random device=cpu sim.engine=mujoco writes the states to its folder): use shorter "
    "physics steps (task.physics.physics_dt), smaller actions or gains; or give sim.warp.nconmax "
    "and sim.warp.njmax, and nothing is measured"
)


def with_warp_sizes(resolved: Resolved, compiled_scene: CompiledScene | None = None) -> Resolved:
    """Return the config with the memory that MuJoCo Warp needs, where it is not given.

    A few environments of the task run on the CPU with random actions; MuJoCo Warp counts contacts
    and constraints in their states. Twice the largest numbers are filled in. One warning reports
    how many of these environments diverged.

    Args:
        resolved: A checked config; it is returned as it is unless it runs on Warp.
        compiled_scene: As of `make_env`.

    Raises:
        ConfigError: As `make_env` does.
    """
    sim = thaw(resolved.tree["sim"])
    sizes = vars(resolved.root.sim.warp)
    if sim["engine"] != "warp" or None not in sizes.values():
        return resolved
    import numpy as np

    from embodichain.lab.gym.policies import resolve_policy
    from embodichain.lab.sim.engine.warp.warp_worlds import measured_sizes

    on_cpu = resolved.changed(
        num_envs=_PROBE_ENVS,
        device="cpu",
        sim={**sim, "engine": "mujoco", "warp": {"nconmax": None, "njmax": None}},
        viewer={**resolved.tree["viewer"], "name": "none"},
    )
    env = make_env(on_cpu, compiled_scene=compiled_scene)
    try:
        policy = resolve_policy("random")
        obs, _ = env.reset()
        states = [env.sim.engine.rows.copy()]
        diverged = np.zeros(_PROBE_ENVS, np.bool_)
        with _without_step_warnings():
            for step in range(1, _PROBE_STEPS + 1):
                obs, *_, info = env.step(policy(obs, env))
                diverged |= np.asarray(info["diverged"])
                if step % _PROBE_EVERY == 0:
                    states.append(env.sim.engine.rows.copy())
        measured = measured_sizes(env.sim.engine.model, np.concatenate(states))
    finally:
        env.close()
    if diverged.any():
        count = int(diverged.sum())
        _log.warning(_PROBE_DIVERGED, count, _PROBE_ENVS, _PROBE_STEPS)
    filled = {}
    for key, size in sizes.items():
        filled[key] = measured[key] if size is None else size
    return resolved.changed(sim={**sim, "warp": filled})


@contextmanager
def _without_step_warnings() -> Iterator[None]:
    """Suppress the warnings of single control steps of an environment that no user has."""
    logger = logging.getLogger("embodichain.lab.gym.envs.step.judging")
    before = logger.disabled
    logger.disabled = True
    try:
        yield
    finally:
        logger.disabled = before


_TRIED_ENVS = 2
"""Environments of a trial with arrays on the device."""
_TRIED_STEPS = 3
"""Control steps of the trial."""


def with_warp_values(
    resolved: Resolved,
    verb: JobVerb | None,
    kwargs: Mapping[str, Any] | None = None,
    *,
    compiled_scene: CompiledScene | None = None,
) -> Resolved:
    """Return the config with the values of `sim.warp` that are chosen for each job.

    Memory that is not given is measured (`with_warp_sizes`). ``arrays: auto`` becomes ``device`` if
    nothing in the job needs the host and a few environments take some steps with arrays on the
    device; else it becomes ``host``, and a note says why.

    Args:
        resolved: A checked config; it is returned as it is unless it runs on Warp.
        verb: The verb of the job; None is an environment without a log, a viewer or a policy.
        kwargs: Arguments of the environment.
        compiled_scene: As of `make_env`.

    Raises:
        ConfigError: As `make_env` does; or ``arrays`` is ``device``, and a job needs the host.
    """
    if resolved.tree["sim"]["engine"] != "warp":
        return resolved
    resolved = with_warp_sizes(resolved, compiled_scene)
    arrays = resolved.root.sim.warp.arrays
    if arrays == "host" or (arrays == "device" and verb is None):  # `BaseEnv` reports it itself
        return resolved
    if arrays == "auto":
        reasons = why_host(resolved.root, verb)
    else:
        reasons = why_not_device(resolved.root, verb)
    if not reasons:
        has_log = verb not in (None, "train") and resolved.root.record.format != "none"
        try:
            _try_device(resolved, kwargs or {}, compiled_scene, has_log=has_log)
        except (ConfigError, IndexError, RuntimeError, TypeError, ValueError) as error:
            cause = _raised_by_term(error)
            if arrays == "device" and not isinstance(cause, TypeError):
                raise
            # A mistake that is one on the host too is raised again by the environment of the job.
            reasons = [f"{_term_of(cause)}{cause}"]
    if arrays == "device":
        if reasons:
            raise ConfigError([Problem("sim.warp.arrays", f"device: {why}") for why in reasons])
        return resolved
    if not reasons:
        return with_arrays(resolved, "device")
    note = Problem("sim.warp.arrays", f"host, because {'; '.join(reasons)}")
    if verb is None:
        _log.info("%s", note)
    return dataclasses.replace(with_arrays(resolved, "host"), notes=(*resolved.notes, note))


def _try_device(
    resolved: Resolved,
    kwargs: Mapping[str, Any],
    compiled_scene: CompiledScene | None,
    *,
    has_log: bool,
) -> None:
    """Step a few environments with arrays on the device; with copies for a log if there is one."""
    from embodichain.lab.gym.envs.observers import StepObserver
    from embodichain.lab.gym.policies import resolve_policy

    trial = with_arrays(resolved, "device").changed(
        num_envs=_TRIED_ENVS,
        viewer={**resolved.tree["viewer"], "name": "none"},
    )
    arguments = {key: value for key, value in kwargs.items() if key != "run_dir"}
    with closing(make_env(trial, compiled_scene=compiled_scene, **arguments)) as env:
        if has_log:
            observer = StepObserver()
            observer.may_lag = True
            env.add_observer(observer)
        policy = resolve_policy("zero")
        obs, _ = env.reset()
        for _ in range(_TRIED_STEPS):
            obs, *_ = env.step(policy(obs, env))


def _raised_by_term(error: BaseException) -> BaseException:
    """The exception of a term, of the error that names the term."""
    while isinstance(error, TermError) and error.__cause__ is not None:
        error = error.__cause__
    return error


def _term_of(error: BaseException) -> str:
    """The function or class of a term in which an error was raised, for messages."""
    for frame, _ in traceback.walk_tb(error.__traceback__):
        code = frame.f_code
        if any(part in code.co_filename for part in ("/envs/mdp/", "/compat/terms/")):
            return f"{code.co_qualname} in {Path(code.co_filename).name}: "
    return ""


def _check_once(key: str, value: object, overrides: Sequence[str]) -> None:
    """Refuse a value given both as an argument and in an override, since one would be ignored."""
    for line in overrides:
        if line.partition("=")[0].lstrip("+") == key:
            raise ConfigError(f"{key} is given twice: {value} as argument, and {line} in overrides")


_CALL = "embodichain.make"
"""Where the arguments of `make` were written; they are read as words of a command line."""


def _in_python(problem: Problem) -> Problem:
    """The problem of an argument or an override; in Python it has no command line."""
    return problem.at(problem.source.replace(COMMAND_LINE, _CALL))


def _check_name(task: str, config_dir: str | Path | None) -> None:
    """For a name that is a Gymnasium id and not a task, report the function to call instead."""
    name = task_of_id(task)
    if name is not None:
        raise ConfigError(
            f"{task!r} is an id for gymnasium.make and gymnasium.make_vec; "
            f"here it is the task's name: embodichain.make({name!r})"
        )
    from embodichain.config.composition.composed import list_options
    from embodichain.lab.gym.utils.registration import REGISTERED_ENVS

    if task in REGISTERED_ENVS and task not in list_options("task", config_dir):
        raise ConfigError(
            f"{task!r} is a registered class, not a YAML task: gymnasium.make({task!r}, num_envs=N)"
        )
