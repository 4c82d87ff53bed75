"""The log of a run, attached to its environment."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from embodichain.cli.jobs import Job
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.recording import McapRecorder

__all__ = ["attach_log"]


def attach_log(run: Job, env: BaseEnv) -> McapRecorder | None:
    """Attach the log, unless the config wants none; closing the environment finishes it."""
    if run.root.record.format == "none":
        return None
    from embodichain.config.frozen import dump_yaml
    from embodichain.config.newest import LOG
    from embodichain.recording import McapRecorder

    recorder = McapRecorder(
        run.folder / LOG,
        env,
        config=dump_yaml(run.resolved.tree),
        overrides=dump_yaml(list(run.resolved.overrides)),
        options=run.root.record,
        task=run.resolved.task_name,
    )
    env.add_observer(recorder)
    return recorder
