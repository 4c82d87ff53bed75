"""The stage of a curriculum at a checkpoint, in a file beside it, for evaluations of its policy."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from embodichain.learning.checkpoints.plain_state import read_tree, write_tree

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv

__all__ = ["at_stage", "hold_at_stage", "read_stage", "save_stage", "stage_path"]

_SUFFIX = ".curriculum.npz"
_log = logging.getLogger(__name__)


def stage_path(checkpoint: str | Path) -> Path:
    """Return the file with the stage of ``NAME.zip``: ``NAME.curriculum.npz`` beside it."""
    path = Path(checkpoint)
    return path.with_name(path.stem + _SUFFIX)


def save_stage(checkpoint: Path, env: BaseEnv) -> None:
    """Write the stage that an environment has reached; nothing for a task without a curriculum."""
    if env.cfg.curriculum:
        path = stage_path(checkpoint)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_tree(path, env.curriculum_stage())


def read_stage(policy: str | Path) -> dict[str, Any] | None:
    """Read the stage beside a checkpoint or an exported policy; None if there is none.

    Raises:
        ConfigError: If the file is damaged.
    """
    path = stage_path(policy)
    if not path.is_file():
        return None
    return read_tree(path, key="policy", what="stage of a curriculum")


def hold_at_stage(env: BaseEnv, policy: Any) -> None:
    """Hold the curriculum at the stage of a policy's training, if it has one, and log it."""
    stage = getattr(policy, "stage", None)
    if stage is not None and env.cfg.curriculum:
        env.hold_curriculum(stage)
        step = stage["control_step"]
        _log.info("the curriculum stays where it was in training at control step %d", step)


@contextmanager
def at_stage(env: BaseEnv, policy: Any) -> Iterator[dict[str, Any] | None]:
    """Hold the curriculum of an environment at the stage of a policy's training.

    Without one it is held where it is, in a new environment at its first stage, and a warning is
    logged.

    Args:
        env: The environment; its curriculum goes on afterwards, unless it was held before.
        policy: The policy; one from a file has the `stage` of its training.

    Yields:
        The ``control_step`` of the stage, whether it is the ``training``'s, and the ``values`` in
        force; None in a task without a curriculum.
    """
    if not env.cfg.curriculum:
        yield None
        return
    was_held = env.curriculum_manager.held
    stage = getattr(policy, "stage", None)
    step = env.control_step if stage is None else stage["control_step"]
    if not was_held:
        env.hold_curriculum(stage)
        if stage is None:
            _log.warning(
                "%s has no stage of the curriculum: it stays at control step %d",
                getattr(policy, "name", "the policy"),
                step,
            )
    try:
        yield {
            "control_step": step,
            "training": stage is not None and not was_held,
            "values": dict(env.curriculum_manager.values),
        }
    finally:
        if not was_held:
            env.release_curriculum()
