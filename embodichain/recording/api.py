"""`open` a log: `Log` is all that can be asked of one."""

from __future__ import annotations

from pathlib import Path

from embodichain.lab.gym.envs.snapshot import Snapshot
from embodichain.recording.recorded_log import RecordedLog
from embodichain.recording.snapshots import snapshot

__all__ = ["Log", "open"]


def open(path: str | Path, simulate: bool = False) -> Log:
    """Open a log; its messages are read when they are asked for. Close it, or use `with`.

    A broken file is read up to where it is good: `complete` is False, and `warnings` says why.

    Args:
        path: A log, the manifest of one in several files, or the folder of a run. The first file
            of several stands for all of them; any other is opened alone.
        simulate: Whether states between the keyframes of a log with `record.state=keyframes` are
            simulated again, from the file alone. Without it only keyframes are read.

    Raises:
        ConfigError: If the file is missing, empty or not MCAP.
        LogError: If it is not a log of embodichain's.
    """
    return Log(path, simulate)


class Log(RecordedLog):
    """An open log.

    Attributes:
        path: The file.
        reader: The file's chunks, channels and messages.
        header: What was recorded and how: task, seed, num_envs, time steps, layout of states.
    """

    def snapshot(self, env: int, episode: int | None = None, step: int | None = None) -> Snapshot:
        """One environment before a control step: `env.restore(log, ...)` goes on from there.

        Args:
            env: The environment.
            episode: One of its episodes; None counts steps from the start of the recording.
            step: Finished control steps, from the start of the episode or of the recording; None
                is 0.

        Raises:
            ConfigError: If there is no such moment in the log.
            LogError: If the log has no states, or is damaged there.
        """
        return snapshot(self, env, episode, step)
