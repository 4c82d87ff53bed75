"""The stages of a study's job: each has a folder, and a record of the inputs that it was made from.

A stage whose inputs are those of its record is skipped. What counts as an input: the config, the
code of this package and of modules that the config names, versions of the libraries that compute
results, the compiled model, and files such as the checkpoint that an evaluation plays.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from embodichain.cli.jobs.code_digest import code_digest, file_digest, modules_in
from embodichain.cli.jobs.job import Work, execute
from embodichain.cli.sweeps.sweep_jobs import differences, enter
from embodichain.config.keys.schema import JobVerb
from embodichain.config.resolved import Resolved, compile_scene_of, dump_yaml, thaw
from embodichain.config.run_folder import versions
from embodichain.utils.errors import ConfigError
from embodichain.utils.system.atomic import write_text

__all__ = ["Stage", "mark_undone", "read_stage"]

RECORD = "stage.json"
_LIBRARIES = ("python", "mujoco", "numpy", "torch", "stable-baselines3", "gymnasium")
_NO_INPUTS = ("quiet", "json", "traceback", "output_dir", "resume", "viewer", "wandb", "trust")
"""Keys of the root that change no result."""
_MOST_NAMED = 3


@dataclass(frozen=True)
class Stage:
    """A stage of a job, ready to be run or skipped.

    Attributes:
        folder: Its folder.
        resolved: Its config.
        verb: The verb whose kind of run it is: ``train`` or ``run``.
        inputs: Name -> file that it reads, such as ``policy``.
    """

    folder: Path
    resolved: Resolved
    verb: JobVerb
    inputs: Mapping[str, Path]

    def run(self, work: Work, command: list[str], begin: Callable[[str], None]) -> bool:
        """Run the stage unless it is done already.

        Args:
            work: The work of the stage.
            command: The command line, for the record of the run.
            begin: Called with one line before the stage runs: why it does.

        Returns:
            Whether it ran.

        Raises:
            Exception: Any exception of the work; the folder is kept.
        """
        made_from = self._inputs()
        record = read_stage(self.folder)
        reason = self._why(record, made_from)
        if reason is None:
            return False
        begin(reason)
        # An evaluation is not continued, only a training.
        is_outdated = bool(record) and (record.get("inputs") != made_from or self.verb != "train")
        with enter(
            self.folder, self.resolved, self.verb, is_outdated=lambda: is_outdated
        ) as entered:
            facts = {"inputs": made_from, "config": thaw(_relevant(self.resolved)), "done": False}
            _write(self.folder, facts)
            if not entered.finished:
                execute(
                    entered.resolved,
                    work,
                    command,
                    self.folder,
                    verb=self.verb,
                    is_continued=entered.is_continued,
                )
            _write(self.folder, {**facts, "done": True})
        return True

    def why_it_runs(self) -> str | None:
        """Return why the stage has to run; None if it is done."""
        return self._why(read_stage(self.folder), self._inputs())

    def _why(self, record: Mapping[str, Any], made_from: Mapping[str, str]) -> str | None:
        """Why the stage has to run; None if it is done."""
        if not record:
            return "begins"
        earlier = record.get("inputs") or {}
        changed = [name for name in made_from if earlier.get(name) != made_from[name]]
        changed += [name for name in earlier if name not in made_from]
        if changed:
            text = f"again, because of another {', '.join(changed)}"
            if "config" in changed:
                text += f" ({self._config_changes(record)})"
            return text
        if not record.get("done"):
            return "continues"
        return None

    def _config_changes(self, record: Mapping[str, Any]) -> str:
        """Name the first keys of the config that differ from those of a record."""
        now = json.loads(json.dumps(thaw(_relevant(self.resolved)), default=str))
        changes = list(differences(record.get("config") or {}, now))
        text = "; ".join(changes[:_MOST_NAMED])
        if len(changes) > _MOST_NAMED:
            text += f" and {len(changes) - _MOST_NAMED} more"
        return text

    def _inputs(self) -> dict[str, str]:
        """Name -> digest of everything that the result depends on."""
        scene = compile_scene_of(self.resolved)
        inputs = {
            "config": _digest(dump_yaml(_relevant(self.resolved)).encode()),
            "code": code_digest(tuple(sorted(set(modules_in(self.resolved.tree))))),
        }
        if scene is not None:  # else a class adds to the scene; its module is in the code
            from embodichain.recording.format.attachments import model_bytes, model_digest

            inputs["model"] = model_digest(model_bytes(scene.model))
        installed = versions()
        inputs |= {name: str(installed[name]) for name in _LIBRARIES}
        inputs |= {name: file_digest(path) for name, path in self.inputs.items()}
        return inputs


def read_stage(folder: Path) -> dict[str, Any]:
    """Return the record of a stage; empty if there is none.

    Raises:
        ConfigError: It is damaged.
    """
    path = folder / RECORD
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except (OSError, ValueError) as error:
        raise ConfigError(f"cannot read {path}: {error}") from error
    return record if isinstance(record, dict) else {}


def mark_undone(folder: Path) -> None:
    """Let a stage that is done run again: what it was made from has changed, or may have.

    Raises:
        ConfigError: Its record is damaged.
        OSError: It cannot be written.
    """
    record = read_stage(folder)
    if record.get("done"):
        _write(folder, {**record, "done": False})


def _relevant(resolved: Resolved) -> dict[str, Any]:
    """The part of a config on which results depend."""
    tree = {key: value for key, value in resolved.tree.items() if key not in _NO_INPUTS}
    policy = tree.get("policy")
    if isinstance(policy, str) and Path(policy).is_file():
        del tree["policy"]  # its content is an input, wherever the file lies
    # Results do not depend on how many threads step the environments.
    tree["sim"] = {key: value for key, value in tree["sim"].items() if key != "num_threads"}
    return tree


def _write(folder: Path, facts: Mapping[str, Any]) -> None:
    write_text(folder / RECORD, json.dumps(facts, indent=2, default=str) + "\n")


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
