"""`receipt.json`: what a result was made from and what it says, so that others can check it.

A receipt names files beside it with their digests, and the numbers that follow from them.
`embodichain verify` compares both, simulates the logs again and plays the policy once more. It
proves that the files agree, not who made them.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from embodichain.cli.jobs.code_digest import code_digest, file_digest
from embodichain.config.run_folder import CONFIG, versions
from embodichain.utils.errors import ConfigError
from embodichain.utils.system.atomic import write_text

__all__ = ["FORMAT", "RECEIPT", "Receipt", "read_receipt", "write_receipt"]

RECEIPT = "receipt.json"
"""Name of a receipt in the folder of its run."""
FORMAT = 1
"""Version of the form of receipts."""
_SEAL = "seal"
_KEYS = {
    "eval": ("results", "policy", "seed", "deterministic", "num_envs", "episodes"),
    "collect": ("results",),
    "study": ("results",),
}
"""Kind -> what a receipt of it says, beside what all say."""


@dataclass(frozen=True)
class Receipt:
    """A receipt that was read.

    Attributes:
        path: Its file.
        content: What it says.
        is_sealed: Whether its seal is the digest of its content: if not, it was changed.
    """

    path: Path
    content: Mapping[str, Any]
    is_sealed: bool

    @property
    def kind(self) -> str:
        """``eval``, ``collect`` or ``study``."""
        return str(self.content["kind"])

    @property
    def files(self) -> dict[str, str]:
        """Path of each file, relative to the receipt's folder -> its SHA-256."""
        return dict(self.content["files"])

    @property
    def logs(self) -> list[Path]:
        """The logs."""
        return [self.path.parent / name for name in self.content["logs"]]

    def file(self, name: str) -> Path:
        """Path of one of the files."""
        return self.path.parent / name


def write_receipt(
    folder: Path,
    kind: str,
    facts: Mapping[str, Any],
    *,
    files: Sequence[Path],
    logs: Sequence[Path] = (),
    policy: Path | None = None,
) -> Path:
    """Write the receipt of a result into its folder.

    Args:
        folder: The folder of the run or the study.
        kind: ``eval``, ``collect`` or ``study``.
        facts: Task, seeds, results, ...: plain data.
        files: Files that the result consists of, or was made from, below the folder. The run's
            `config.yaml` and the logs are added.
        logs: Its logs.
        policy: The file of the policy; it may be elsewhere.

    Returns:
        The receipt.
    """
    paths = dict.fromkeys([*files, *logs])
    if (folder / CONFIG).is_file():
        paths = dict.fromkeys([folder / CONFIG, *paths])
    content: dict[str, Any] = {
        "format": FORMAT,
        "kind": kind,
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
        **facts,
        "code": code_digest(),
        "versions": versions(),
        "cpu": _cpu_name(),
        "files": {_relative(path, folder): file_digest(path) for path in paths},
        "logs": [_relative(path, folder) for path in logs],
    }
    if policy is not None:
        content["policy_file"] = {"path": _relative(policy, folder), "sha256": file_digest(policy)}
    content[_SEAL] = _seal_of(content)
    path = folder / RECEIPT
    write_text(path, json.dumps(content, indent=2) + "\n")
    return path


def read_receipt(path: Path) -> Receipt:
    """Read a receipt.

    Args:
        path: The file, or the folder that it is in.

    Raises:
        ConfigError: There is none, it is damaged, or another version wrote it.
    """
    if path.is_dir():
        path = path / RECEIPT
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ConfigError(f"there is no receipt {path}") from error
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path} is not a receipt: {error}") from error
    if not isinstance(content, dict) or "format" not in content:
        raise ConfigError(f"{path} is not a receipt")
    if content["format"] != FORMAT:
        message = f"{path} is a receipt of format {content['format']!r}, this is for {FORMAT}"
        raise ConfigError(f"{message}: use the version that wrote it")
    kind = content.get("kind")
    if not isinstance(kind, str) or kind not in _KEYS:
        raise ConfigError(f"{path} is damaged: its kind is {kind!r}, not {', '.join(_KEYS)}")
    missing = [key for key in ("files", "logs", "versions", *_KEYS[kind]) if key not in content]
    if missing:
        raise ConfigError(f"{path} is damaged: {', '.join(missing)} missing")
    return Receipt(path, content, content.get(_SEAL) == _seal_of(content))


def _seal_of(content: Mapping[str, Any]) -> str:
    """Digest of a receipt's content without the seal."""
    facts = {key: value for key, value in content.items() if key != _SEAL}
    text = json.dumps(facts, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _relative(path: Path, folder: Path) -> str:
    return os.path.relpath(path.resolve(), folder.resolve())


def _cpu_name() -> str:
    from embodichain.recording.format.attachments import cpu_name

    return cpu_name()
