"""What types cannot express: devices, policies, suggestions, and what is not available yet.

No torch: what a device or a policy can do is known by name here.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from embodichain.config.check_types import check_types, show_value
from embodichain.config.newest import CHECKPOINT, named_checkpoint, newest_run
from embodichain.config.schema import SUGGESTED_KEYS, RootCfg
from embodichain.lab.gym.envs.cfg import EnvCfg
from embodichain.lab.gym.envs.managers.registry import SECTIONS
from embodichain.lab.gym.policies import resolve_policy
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

__all__ = ["check_root", "check_suggested", "check_task"]


def check_root(root: RootCfg, *, allow_import: bool = True) -> list[Problem]:
    """Check the everyday keys.

    Args:
        root: What passed the check of types.
        allow_import: Whether a policy may be imported to read its signature.
    """
    problems = _check_device(root.device) + _check_policy(root, allow_import)
    count = root.num_envs or 1
    beyond = [i for i in root.record.view_envs if i >= count]
    if beyond and root.record.format != "none":
        message = f"no such environments: {beyond}; num_envs is {count}"
        problems.append(Problem("record.view_envs", message))
    if root.viewer.name != "none" and root.viewer.env >= count:
        message = f"no such environment: {root.viewer.env}; num_envs is {count}"
        problems.append(Problem("viewer.env", message))
    if root.video and (root.record.format == "none" or root.record.state == "none"):
        message = "films are made from the log: they need record=mcap with record.state=all"
        problems.append(Problem("video", message))
    return problems


def check_task(task: EnvCfg, *, allow_import: bool = True) -> list[Problem]:
    """Check values of a task that belong to no term and no entity.

    Args:
        task: What passed the check of types.
        allow_import: Whether the module of an id ``package.module:id`` may be imported.
    """
    problems = []
    steps = task.max_episode_steps
    if steps < 1 and steps != -1:
        message = f"must be at least 1, or -1 for no limit, got {steps}"
        problems.append(Problem("task.max_episode_steps", message))
    if task.id is not None:
        from embodichain.config.plugins import require_registered  # Gymnasium: only when needed

        reason = require_registered(task.id, allow_import=allow_import)
        problems += [Problem("task.id", reason)] if reason else []
    for section in SECTIONS:
        for name, term in getattr(task, section).items():
            if term.func == "":
                path = f"task.{section}.{name}.func"
                problems.append(Problem(path, "missing value: the name of a function"))
    return problems


def check_suggested(tree: Mapping[str, Any]) -> list[Problem]:
    """Check `task.suggested.run` and `.train` as what they become: values of root keys."""
    task = tree.get("task")
    suggested = task.get("suggested") if isinstance(task, Mapping) else None
    problems: list[Problem] = []
    for verb in ("run", "train"):
        values = suggested.get(verb) if isinstance(suggested, Mapping) else None
        if not isinstance(values, Mapping):
            continue
        allowed = [*SUGGESTED_KEYS, *(["algo"] if verb == "train" else [])]
        path = f"task.suggested.{verb}"
        for name in values:
            if name not in allowed:
                hint = did_you_mean(name, allowed).strip()
                message = f"unknown key; allowed: {', '.join(allowed)}."
                problems.append(Problem(f"{path}.{name}", message, hint))
        known = {k: v for k, v in values.items() if k in allowed}
        found = check_types({"task": {}, **known})
        problems += [Problem(f"{path}.{p.path}", p.message, p.hint) for p in found.problems]
    return problems


def _check_device(device: str | None) -> list[Problem]:
    if device is None or device == "cpu":
        return []
    if re.fullmatch(r"cuda(:\d+)?", device):
        message = f"{device!r} is not available: the CUDA engine comes later; allowed: cpu"
        return [Problem("device", message)]
    hint = did_you_mean(device, ["cpu", "cuda"]).strip()
    return [Problem("device", f"unknown device {show_value(device)}; allowed: cpu.", hint)]


def _check_policy(root: RootCfg, allow_import: bool) -> list[Problem]:
    """Check that a policy exists and takes its parameters; a trained one, that its path exists."""
    policy = root.policy
    if policy is None:
        return []
    name = policy if isinstance(policy, str) else policy.func
    if ":" in name and not allow_import:
        return [Problem("policy", f"{name!r} would be imported, which this config may not ask for")]
    try:
        params = {} if isinstance(policy, str) else {"params": policy.params}
        resolve_policy({"func": name, **params}, load_file=lambda path: _existing(root, path))
    except ConfigError as error:
        return list(error.problems)
    return []


def _existing(root: RootCfg, path: Path) -> Any:
    if str(path) == "last":
        if newest_run(root.output_dir, CHECKPOINT) is None:
            message = f"there is no finished training in {root.output_dir} (train first)"
            raise ConfigError([Problem("policy", message)])
    elif not named_checkpoint(path).exists():
        raise ConfigError([Problem("policy", f"no such file or folder: {path}")])
    return lambda obs, env: None
