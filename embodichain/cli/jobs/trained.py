"""The policy that `eval`, `play` and `export` act on: of a training, in a file, or by its name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from embodichain.cli.terminal.last import announce_last
from embodichain.config.run_folder import CHECKPOINT, CONFIG, named_checkpoint, newest_run
from embodichain.utils.errors import ConfigError
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.config.resolved import Resolved

__all__ = ["Target", "find_target", "parse_target", "pop_override"]


@dataclass(frozen=True, slots=True)
class Target:
    """The policy that a verb acts on.

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
        names_task = any(line.startswith(("task=", "gym_config=")) for line in overrides)
        if names_task:
            resolved = self._resolve_task(overrides)
        elif self.run is not None:
            from embodichain.config.rerun import resolve_run

            root_values = {**values, "policy": None}
            resolved = resolve_run(self.run, overrides, root_values, only_reads=only_reads)
        else:
            self._check_name()
            raise ConfigError(
                f"{self.policy} is not in the folder of a run: give the task, task=NAME"
            )
        if self.file is None:
            return resolved
        # A path is not an override: it may have signs of Hydra's grammar.
        return resolved.changed(policy=self.policy)

    def _resolve_task(self, overrides: Sequence[str]) -> Resolved:
        """Return the config of the task that the overrides name, with a policy that has a name."""
        from embodichain.config.resolved import resolve

        if self.file is None:
            overrides = [*overrides, f"policy={self.policy}"]
        return resolve(overrides, "run")

    def _check_name(self) -> None:
        """Check that there is a policy of this name.

        Raises:
            ConfigError: There is none.
        """
        from embodichain.lab.gym.policies import PRETRAINED, resolve_policy

        is_import_path = ":" in self.policy
        if self.file is not None or self.policy == PRETRAINED or is_import_path:
            return
        try:
            resolve_policy(self.policy)
        except ConfigError as error:
            hint = did_you_mean(self.policy, ["last"])
            if not hint:
                hint = f" Looked for {Path(self.policy).absolute()}; 'last' is the newest run."
            raise ConfigError(f"there is no run or policy {self.policy!r}.{hint}") from error


def find_target(name: str, output_root: str = "outputs") -> Target:
    """Find a training's policy (``last`` is the newest), a file, or a policy by its name.

    Raises:
        ConfigError: There is no such run or file.
    """
    path = named_checkpoint(name)
    is_import_path = ":" in name  # package.module:function
    is_word = "/" not in name and not path.suffix  # zero, random, ...
    if name == "last":
        newest = newest_run(output_root, CHECKPOINT)
        if newest is None:
            raise ConfigError(f"no training in {output_root} yet: embodichain train task=NAME")
        path = announce_last(newest)
    elif not path.exists() and (is_import_path or is_word):
        return Target(policy=name, file=None, run=None)
    from embodichain.learning.checkpoints.checkpoint import find_checkpoint

    file = find_checkpoint(path).resolve()
    return Target(policy=str(file), file=file, run=_run_of(file))


def parse_target(action: str, words: Sequence[str]) -> tuple[Target, list[str]]:
    """Return the policy that a verb's arguments name, and the overrides among them.

    Overrides are ``key=value`` and ``~key``; the path of an existing file is a name.

    Args:
        action: What the verb does with it, for messages.
        words: The arguments as typed.

    Raises:
        ConfigError: No policy or several are named, or the policy does not exist.
    """
    lines: list[str] = []
    names: list[str] = []
    output_root = "outputs"
    for word in words:
        has_form_of_override = "=" in word or word.startswith("~")
        if not has_form_of_override or Path(word).exists():
            names.append(word)
            continue
        lines.append(word)
        if word.startswith("output_dir="):
            output_root = word.partition("=")[2]
    if len(names) != 1:
        raise ConfigError(
            f"{action} what? One of: RUN (a training's folder), last, PATH (a policy)"
        )
    return find_target(names[0], output_root), lines


def pop_override(overrides: list[str], key: str, default: str) -> str:
    """Remove ``key=value`` from overrides and return its last value, or the default."""
    last_value = default
    others: list[str] = []
    for line in overrides:
        name, _, value = line.partition("=")
        if name.lstrip("+") == key:
            last_value = value
        else:
            others.append(line)
    overrides[:] = others
    return last_value


def _run_of(file: Path) -> Path | None:
    """The run of a file, if any: an export is in the run folder, a checkpoint one folder below."""
    for folder in (file.parent.parent, file.parent):
        if (folder / CONFIG).is_file():
            return folder
    return None
