"""Checkpoints: zip files with metadata (a note), written atomically.

They are models of Stable-Baselines3, or policies of other learners as TorchScript.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from embodichain.config.run_folder import checkpoint_of
from embodichain.learning.checkpoints.task_digest import TaskDigest
from embodichain.learning.checkpoints.zip_limits import check_unpacked
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.system.atomic import atomic_file

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

__all__ = [
    "CHECKPOINTS",
    "DIGEST",
    "FINAL",
    "SCRIPT",
    "find_checkpoint",
    "has_script",
    "made_by",
    "read_digest",
    "read_note",
    "save_checkpoint",
    "save_script",
]

CHECKPOINTS = "checkpoints"
"""The folder of checkpoints in a run folder."""
FINAL = "final.zip"
DIGEST = "trained_in"
"""Key of the note with the JSON of a `TaskDigest`."""
NOTE = "embodichain"
"""Key of the note in the zip's ``data``: an attribute, which Stable-Baselines3 saves as JSON."""
SCRIPT = "policy.pt"
"""The TorchScript file in a zip of a learner on tensors, such as rsl_rl's."""
_MODEL = "policy.pth"


def save_checkpoint(model: BaseAlgorithm, path: Path, note: Mapping[str, Any]) -> None:
    """Write a model atomically.

    Args:
        model: The model; gets the note as an attribute.
        path: The file; its folder is created.
        note: Plain JSON with ``algo``, ``group``, and the task's digest (`DIGEST`).

    Raises:
        OSError: The file cannot be written (the disk is full); no partial file remains.
    """
    setattr(model, NOTE, dict(note))
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(path) as temporary, temporary.open("wb") as stream:
        model.save(stream)


def save_script(script: bytes, path: Path, note: Mapping[str, Any]) -> None:
    """Write a policy of rsl_rl or skrl atomically; arguments and errors as of `save_checkpoint`.

    Args:
        script: The content of a TorchScript file.
        path: The file; its folder is created.
        note: Plain JSON.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        archive.writestr("data", json.dumps({NOTE: dict(note)}))
        archive.writestr(SCRIPT, script)


def find_checkpoint(path: str | Path) -> Path:
    """Return the checkpoint of a path: a file, ``RUN/best``, or a run folder's final checkpoint.

    Raises:
        ConfigError: If there is none; lists the checkpoints of the folder.
    """
    return checkpoint_of(path)


def has_script(path: Path) -> bool:
    """Whether a checkpoint contains a policy as TorchScript, which needs no learner to act.

    Raises:
        ConfigError: If the file cannot be read or is not a checkpoint, see `read_note`.
    """
    read_note(path)
    with zipfile.ZipFile(path) as archive:
        return SCRIPT in archive.namelist()


def read_note(path: Path) -> dict[str, Any]:
    """Read a checkpoint's note without running code of the file.

    Returns:
        The note; for a file that Stable-Baselines3 itself wrote, ``algo`` is found from the
        attributes in it and ``group`` is ``policy``.

    Raises:
        ConfigError: If the file cannot be read or is not a checkpoint of a known algorithm.
    """
    data = _read_data(path)
    if isinstance(data, dict):
        note = data.get(NOTE)
        if isinstance(note, dict):
            return note
        algo = made_by(data)
        if algo is not None:
            return {"algo": algo, "group": "policy"}
    raise _not_a_policy(path, "it does not say which algorithm made it")


def _read_data(path: Path) -> Any:
    """Read the JSON in a checkpoint; errors as of `read_note`."""
    try:
        check_unpacked(path)
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
            policy = SCRIPT if SCRIPT in names else _MODEL
            missing = [name for name in ("data", policy) if name not in names]
            if missing:
                raise _not_a_policy(path, f"it has no {' and no '.join(missing)}")
            return json.loads(archive.read("data"))
    except (zipfile.BadZipFile, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise _not_a_policy(path, str(error)) from error
    except OSError as error:
        raise ConfigError([Problem("policy", f"cannot read {path}: {error}")]) from error


def read_digest(note: Mapping[str, Any], path: Path) -> TaskDigest | None:
    """Return the digest of a checkpoint's task in training; None if its note has none.

    Raises:
        ConfigError: If the digest is damaged.
    """
    text = note.get(DIGEST)
    if text is None:
        return None
    try:
        return TaskDigest.from_json(str(text))
    except ValueError as error:
        raise _not_a_policy(path, f"its digest of the task is damaged: {error}") from error


def _not_a_policy(path: Path, why: str) -> ConfigError:
    message = f"{path} is not a policy of Stable-Baselines3: {why}"
    return ConfigError([Problem("policy", message)])


# Names of attributes that only this algorithm's models have, among those further down. DDPG is
# TD3 with other values: as policies they are the same.
_ATTRIBUTES: tuple[tuple[str, frozenset[str]], ...] = (
    ("tqc", frozenset({"top_quantiles_to_drop_per_net"})),
    ("crossq", frozenset({"target_entropy", "policy_delay"})),
    ("sac", frozenset({"target_entropy"})),
    ("td3", frozenset({"target_policy_noise"})),
    ("dqn", frozenset({"exploration_fraction"})),
    ("trpo", frozenset({"cg_max_steps"})),
    ("ppo", frozenset({"clip_range", "n_epochs"})),
    ("a2c", frozenset({"gae_lambda"})),
    ("bc", frozenset({"ensemble_decay"})),
)


def made_by(data: Mapping[str, Any]) -> str | None:
    """Return the algorithm's name, as in ``algo.name``; None for an unknown algorithm.

    Args:
        data: The JSON in a zip of Stable-Baselines3: attributes of the model.
    """
    policy = data.get("policy_class")
    if isinstance(policy, Mapping) and "recurrent" in str(policy.get("__module__")):
        return "recurrent_ppo"
    for name, attributes in _ATTRIBUTES:
        if attributes <= data.keys():
            return name
    return None
