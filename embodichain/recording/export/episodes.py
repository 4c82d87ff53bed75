"""`export_episodes`: episodes of logs, with the task's observations, as one data set."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from embodichain.recording.demos.demonstrations import Episode, read_episodes, sources_of
from embodichain.recording.export.data_set import DataSet
from embodichain.recording.export.format_register import EPISODE_FORMATS, FORMATS
from embodichain.recording.export.log_export import new_file
from embodichain.utils.errors import ConfigError

__all__ = ["export_episodes"]


def export_episodes(
    paths: str | Path | Sequence[str | Path],
    format: str,
    output: str | Path | None = None,
    *,
    group: str = "policy",
    failures: bool = False,
    progress: Callable[[int], None] | None = None,
) -> Path:
    """Write the episodes of logs with the task's observations, see `read_episodes`.

    Args:
        paths: One or several logs, or folders of runs or collections.
        format: Key of `EPISODE_FORMATS`.
        output: A new file, or folder if the format is one; None: next to the first log.
        group: The observation group that is written.
        failures: Also write episodes that did not succeed.
        progress: Called with the number of episodes written.

    Returns:
        The file or folder.

    Raises:
        ConfigError: See `read_episodes`; or the format or the group does not exist, a package is
            missing, or the file exists.
        LogError: If a log has no states, or is damaged.
        OSError: If the file cannot be written.
    """
    if format not in EPISODE_FORMATS and format in FORMATS.names():
        names = ", ".join(EPISODE_FORMATS)
        raise ConfigError(f"{format} has no observations. Formats that have: {names}")
    file_format = EPISODE_FORMATS[format]
    if isinstance(paths, (str, Path)):
        logs: list[str | Path] = [paths]
    else:
        logs = list(paths)
    first_log = sources_of(logs[0])[0].path
    if output:
        path = Path(output)
    else:
        path = first_log.with_name(f"{first_log.stem}_{format}{file_format.suffix}")

    def read_counted() -> Iterator[Episode]:
        for number, episode in enumerate(read_episodes(logs, failures=failures), start=1):
            yield episode
            # The writer asks for the next episode when it has written this one.
            if progress is not None:
                progress(number)

    with new_file(path, file_format.suffix) as partial:
        file_format.write(DataSet(read_counted(), group), partial)
    return path
