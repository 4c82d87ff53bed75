"""Finds the policy for `eval`, `play` and `export`: of a training, in a file, or by its name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from embodichain.cli.terminal.last import take_last
from embodichain.config.run_folder import CHECKPOINT, named_checkpoint, newest_run
from embodichain.utils.errors import ConfigError
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved

__all__ = ["Target", "find_target", "one_target", "take"]


@dataclass(frozen=True, slots=True)
class Target:
    """A policy.

    Attributes:
        policy: A file's path, or the policy's name.
        file: The file, or None.
        run: The folder of the run that the file belongs to, or None.
    """

    policy: str
    file: Path | None
    run: Path | None

    def resolve(
        self, overrides: Sequence[str], values: Mapping[str, Any], *, only_reads: bool = False
    ) -> Resolved:
        """Return the config for the policy: from ``task=`` in the overrides, else from its run.

        Args:
            overrides: As typed.
            values: Keys of the root to set if the run's config is used.
            only_reads: As in `resolve_run`.

        Raises:
            ConfigError: There is neither, or the config has mistakes.
        """
        if any(line.startswith(("task=", "gym_config=")) for line in overrides):
            from embodichain.config.resolved import resolve

            named = [] if self.file is not None else [f"policy={self.policy}"]
            resolved = resolve([*overrides, *named], "run")
        elif self.run is not None:
            from embodichain.config.rerun import resolve_run

            fresh = {**values, "policy": None}
            resolved = resolve_run(self.run, overrides, fresh, only_reads=only_reads)
        else:
            from embodichain.lab.gym.policies import PRETRAINED, resolve_policy

            if self.file is None and self.policy != PRETRAINED and ":" not in self.policy:
                try:
                    resolve_policy(self.policy)
                except ConfigError as error:
                    hint = did_you_mean(self.policy, ["last"])
                    message = f"there is no run or policy {self.policy!r}."
                    raise ConfigError(f"{message}{hint}") from error
            raise ConfigError(
                f"{self.policy} is not in the folder of a run: give the task, task=NAME"
            )
        return resolved if self.file is None else resolved.changed(policy=self.policy)


def find_target(name: str, output_root: str = "outputs") -> Target:
    """Find a training's policy (``last`` is the newest), a file, or a policy by its name.

    Raises:
        ConfigError: There is no such run or file.
    """
    path = named_checkpoint(name)
    if name == "last":
        newest = newest_run(output_root, CHECKPOINT)
        if newest is None:
            raise ConfigError(f"no training in {output_root} yet: embodichain train task=NAME")
        path = take_last(newest)
    elif not path.exists() and (":" in name or ("/" not in name and not path.suffix)):
        return Target(name, None, None)  # package.module:function; zero, random, ...
    from embodichain.learning.checkpoints.checkpoint import find_checkpoint

    file = find_checkpoint(path).resolve()
    return Target(str(file), file, _run_of(file))


def one_target(action: str, words: Sequence[str]) -> tuple[Target, list[str]]:
    """Return the policy named by a verb's arguments, and the overrides among them.

    Overrides are ``key=value`` and ``~key``; the path of an existing file is a name.

    Args:
        action: What the verb does with it, for messages.
        words: The arguments as typed.

    Raises:
        ConfigError: No policy or several are named, or the policy does not exist.
    """
    marked = [word for word in words if "=" in word or word.startswith("~")]
    lines = [word for word in marked if not Path(word).exists()]
    names = [word for word in words if word not in lines]
    if len(names) != 1:
        raise ConfigError(
            f"{action} what? One of: RUN (a training's folder), last, PATH (a policy)"
        )
    roots = [line.partition("=")[2] for line in lines if line.startswith("output_dir=")]
    return find_target(names[0], roots[-1] if roots else "outputs"), lines


def take(overrides: list[str], key: str, default: str) -> str:
    """Remove ``key=value`` from overrides and return its last value, or the default."""
    values = [line for line in overrides if line.partition("=")[0].lstrip("+") == key]
    overrides[:] = [line for line in overrides if line not in values]
    return values[-1].partition("=")[2] if values else default


def _run_of(file: Path) -> Path | None:
    """The run of a file, if any: an export is in the run folder, a checkpoint one folder below."""
    folders = (file.parent.parent, file.parent)
    return next((folder for folder in folders if (folder / "config.yaml").is_file()), None)
