"""Policies from ONNX and TorchScript files: what `export` writes, and files of users' own.

They take flat observations as the task gives them and return actions within the task's bounds;
neither format holds Python code. Writing such files is in `exporting.py`.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.learning.columns import check_columns
from embodichain.learning.spaces import flat_observation, observation_box
from embodichain.learning.task_digest import Change, TaskDigest, check_unchanged
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.lab.sim.types import EnvObs

__all__ = [
    "INPUT",
    "METADATA",
    "OUTPUT",
    "SUFFIXES",
    "ExportedPolicy",
    "PolicyMetadata",
    "load_exported",
    "need_onnx",
]

METADATA = "embodichain.json"
"""Key of the metadata: an extra file of TorchScript, a custom property of ONNX."""
INPUT, OUTPUT = "observation", "action"
"""Names of an ONNX file's input (N, K) and output (N, A)."""
ONNX = (".onnx",)
TORCHSCRIPT = (".pt", ".ts")
SUFFIXES = (*ONNX, *TORCHSCRIPT)

F32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class PolicyMetadata:
    """What an exported file says of itself.

    Attributes:
        task: The task it was trained in.
        algo: The algorithm.
        group: The observation group it sees.
        columns: Name of each column of its input.
        action_low: Smallest action of each column of its output.
        action_high: Largest action.
        embodichain: The version that wrote the file.
        trained_in: The JSON of a `TaskDigest`: what the task was in training, where it is known.
    """

    task: str
    algo: str
    group: str
    columns: tuple[str, ...]
    action_low: tuple[float, ...]
    action_high: tuple[float, ...]
    embodichain: str
    trained_in: str | None = None

    def to_json(self) -> str:
        """Return it as one JSON object."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str | bytes, path: Path) -> PolicyMetadata | None:
        """Read it back; None for nothing, as in files that others wrote.

        Raises:
            ConfigError: If it is damaged.
        """
        if not text:
            return None
        try:
            found: dict[str, Any] = json.loads(text)
            lists = ("columns", "action_low", "action_high")
            values: Any = {k: tuple(v) if k in lists else v for k, v in found.items()}
            return cls(**values)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise _wrong(path, f"its metadata are damaged: {error}") from error


class ExportedPolicy:
    """A function of flat observations that acts in batched environments.

    Args:
        act: (N, K) float32 observations to (N, A) float32 actions in the task's units.
        metadata: What the file says of itself, if anything.
        name: What messages call it.
    """

    def __init__(
        self, act: Callable[[F32], F32], metadata: PolicyMetadata | None, name: str
    ) -> None:
        self.act = act
        self.metadata = metadata
        self.name = name
        self.group = metadata.group if metadata is not None else "policy"
        self.trained_in = _digest(metadata, name)
        self.allow_changed = False
        """Whether it acts in a task that has changed since training."""
        self.changed: tuple[Change, ...] = ()
        """What of the task that it was last checked against is another than in training."""
        self._env: BaseEnv | None = None

    def check(self, env: BaseEnv) -> None:
        """Check that the policy fits an environment, by its columns and by trying it once.

        Raises:
            ConfigError: If it does not take the task's observations or give its actions, or the
                task changed since training and `allow_changed` is not set.
        """
        if self.metadata is not None:
            check_columns(self.name, self.metadata.columns, env, self.group)
        width = observation_box(env, self.group).shape[0]
        shape = (env.num_envs, width)
        try:
            found = np.shape(self.act(np.zeros(shape, np.float32)))
        except Exception as error:
            why = str(error).strip().splitlines()
            last = why[-1] if why else type(error).__name__
            message = f"{self.name} does not take this task's observations {shape}: {last}"
            raise ConfigError([Problem("policy", message)]) from error
        wanted = (env.num_envs, *(env.single_action_space.shape or ()))
        if found != wanted:
            message = f"{self.name} gives actions {found}, this task needs {wanted}"
            raise ConfigError([Problem("policy", message)])
        self.changed = check_unchanged(
            self.name, self.trained_in, env, self.group, allow=self.allow_changed
        )
        self._env = env

    def __call__(self, obs: EnvObs, env: BaseEnv) -> torch.Tensor:
        """Return (N, A) float32 actions for an observation.

        Raises:
            ConfigError: At the first call in an environment, if the policy does not fit it.
        """
        if env is not self._env:
            self.check(env)
        actions = self.act(flat_observation(env, obs, self.group))
        return torch.from_numpy(np.array(actions, np.float32)).to(env.device)

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Nothing is kept from step to step."""


def _digest(metadata: PolicyMetadata | None, name: str) -> TaskDigest | None:
    if metadata is None or metadata.trained_in is None:
        return None
    try:
        return TaskDigest.from_json(metadata.trained_in)
    except ValueError as error:
        raise _wrong(Path(name), f"its digest of the task is damaged: {error}") from error


def load_exported(path: Path) -> ExportedPolicy:
    """Read a policy from a file whose suffix is one of `SUFFIXES`; runs no Python of it.

    Raises:
        ConfigError: If it cannot be read, is no such file, or onnxruntime is missing.
    """
    if path.suffix in ONNX:
        return _load_onnx(path)
    return _load_torchscript(path)


def need_onnx(package: str) -> Any:
    """Import a package of the extra `export`.

    Raises:
        ConfigError: If it is not installed; names the extra.
    """
    import importlib

    try:
        return importlib.import_module(package)
    except ImportError as error:
        message = f"ONNX needs the package {package}: pip install 'embodichain[export]'"
        raise ConfigError([Problem("policy", message)]) from error


def _load_onnx(path: Path) -> ExportedPolicy:
    runtime = need_onnx("onnxruntime")
    options = runtime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1  # networks are small
    options.log_severity_level = 4
    try:
        session = runtime.InferenceSession(
            path.read_bytes(), options, providers=["CPUExecutionProvider"]
        )
    except OSError as error:
        raise ConfigError([Problem("policy", f"cannot read {path}: {error}")]) from error
    except Exception as error:  # its exceptions share no base class
        raise _wrong(path, f"it is no ONNX file: {_first_line(error)}") from error
    names = [entry.name for entry in session.get_inputs()]
    if len(names) != 1 or not session.get_outputs():
        raise _wrong(path, f"a policy has one input, this has {len(names)}")
    output = session.get_outputs()[0].name

    def act(obs: F32) -> F32:
        actions: F32 = session.run([output], {names[0]: obs})[0]
        return actions

    text = session.get_modelmeta().custom_metadata_map.get(METADATA, "")
    return ExportedPolicy(act, PolicyMetadata.from_json(text, path), str(path))


def _load_torchscript(path: Path) -> ExportedPolicy:
    extra: dict[str, Any] = {METADATA: ""}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # the format stays supported
            module = torch.jit.load(str(path), map_location="cpu", _extra_files=extra)  # type: ignore[no-untyped-call]
    except (RuntimeError, ValueError, OSError) as error:
        raise _wrong(path, f"it is no TorchScript file: {_first_line(error)}") from error

    def act(obs: F32) -> F32:
        with torch.no_grad():
            actions: F32 = module(torch.from_numpy(obs)).numpy()
        return actions

    return ExportedPolicy(act, PolicyMetadata.from_json(extra[METADATA], path), str(path))


def _first_line(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return lines[0] if lines else type(error).__name__


def _wrong(path: Path, why: str) -> ConfigError:
    return ConfigError([Problem("policy", f"{path} is no policy: {why}")])
