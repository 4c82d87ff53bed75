"""Policies in ONNX and TorchScript files, which contain no Python code and only compute."""

from __future__ import annotations

import importlib
import io
import json
import warnings
import zipfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.learning.checkpoints.checkpoint import DIGEST, SCRIPT, read_digest
from embodichain.learning.checkpoints.script_check import code_at_loading, operations_beyond
from embodichain.learning.checkpoints.trust import NeedsTrust, needs_trust, say_trusted
from embodichain.learning.checkpoints.zip_limits import check_unpacked
from embodichain.learning.cloning.chunks import ChunkMemory, blend
from embodichain.learning.policies.trained_policy import TrainedPolicy, check_columns
from embodichain.learning.spaces import observation_box
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.utils.array_types import EnvIds

__all__ = [
    "INPUT",
    "METADATA",
    "OUTPUT",
    "SUFFIXES",
    "ExportedPolicy",
    "PolicyMetadata",
    "load_exported",
    "need_onnx",
    "script_bytes",
]

METADATA = "embodichain.json"
"""Key of the metadata: an extra file in TorchScript, a custom property in ONNX."""
INPUT = "observation"
"""Name of an ONNX file's input, (N, K)."""
OUTPUT = "action"
"""Name of an ONNX file's output, (N, A)."""
ONNX = (".onnx",)
TORCHSCRIPT = (".pt", ".ts")
SUFFIXES = (*ONNX, *TORCHSCRIPT)
_ONNX_FATAL = 4
"""Log level of onnxruntime: its other messages go to stderr, past the logger."""

F32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class PolicyMetadata:
    """The metadata of an exported file.

    `columns` names the input columns; `action_low` and `action_high` are the bounds of the output
    columns; `embodichain` is the version that wrote it, `trained_in` a `TaskDigest` as JSON. With a
    `chunk_size` H above 1 the output is (N, H, A): actions for this step and the next ones, which
    act as `blend` with `ensemble_decay` averages them.
    """

    task: str
    algo: str
    group: str
    columns: tuple[str, ...]
    action_low: tuple[float, ...]
    action_high: tuple[float, ...]
    embodichain: str
    trained_in: str | None = None
    chunk_size: int = 1
    ensemble_decay: float = 0.0

    def to_json(self) -> str:
        """Return it as one JSON object."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str | bytes, path: Path) -> PolicyMetadata | None:
        """Parse JSON; None for empty text, as in files of other programs.

        Raises:
            ConfigError: If the text is damaged.
        """
        if not text:
            return None
        try:
            values: dict[str, Any] = json.loads(text)
            for name in ("columns", "action_low", "action_high"):
                if name in values:
                    values[name] = tuple(values[name])
            return cls(**values)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise _not_a_policy(path, f"its metadata are damaged: {error}") from error


class ExportedPolicy(TrainedPolicy):
    """A policy from an exported file.

    Args:
        network: Maps (N, K) float32 observations to (N, A) float32 actions in the task's units, or
            to (N, H, A) with a `chunk_size` H in the metadata.
        metadata: The file's metadata; None for files of other programs.
        name: Its name in messages.
        module: The network of a TorchScript file, on tensors.

    Raises:
        ConfigError: The metadata are damaged.
    """

    def __init__(
        self,
        network: Callable[[F32], F32],
        metadata: PolicyMetadata | None,
        name: str,
        module: torch.nn.Module | None = None,
    ) -> None:
        if metadata is None:
            super().__init__(name, "policy", None)
            self.algo: str | None = None
            self.task: str | None = None
        else:
            digest = read_digest({DIGEST: metadata.trained_in}, Path(name))
            super().__init__(name, metadata.group, digest)
            self.algo = metadata.algo
            self.task = metadata.task
        self.metadata = metadata
        self.network = network
        self.module = module
        self._memory: ChunkMemory | None = None
        self._starts: NDArray[np.bool_] | None = None

    def act(self, obs: F32) -> F32:
        """Return (N, A) actions for (N, K) observations, both in the task's units."""
        output = self.network(obs)
        if self.metadata is None or self.metadata.chunk_size == 1:
            return output
        decay = self.metadata.ensemble_decay
        actions, self._memory = blend(output, self._memory, self._starts, decay)
        self._starts = np.zeros(len(actions), np.bool_)
        return actions

    def reset(self, env_ids: EnvIds | None) -> None:
        """Forget the chunks predicted for these environments; None is all."""
        if self._starts is not None:
            self._starts[... if env_ids is None else env_ids] = True

    def _fit(self, env: BaseEnv) -> None:
        """Check the columns, and try the policy once."""
        if self.metadata is not None:
            check_columns(self.name, self.metadata.columns, env, self.group)
        shape = (env.num_envs, *observation_box(env, self.group).shape)
        self._memory = None
        self._starts = None
        try:
            action_shape = np.shape(self.act(np.zeros(shape, np.float32)))
            self.reset(None)
        except Exception as error:  # a network of another program may raise any
            lines = str(error).strip().splitlines()
            why = lines[-1] if lines else type(error).__name__
            message = f"{self.name} does not take this task's observations {shape}: {why}"
            raise ConfigError([Problem("policy", message)]) from error
        needed_shape = (env.num_envs, *(env.single_action_space.shape or ()))
        if action_shape != needed_shape:
            message = f"{self.name} gives actions {action_shape}, this task needs {needed_shape}"
            raise ConfigError([Problem("policy", message)])


def load_exported(path: Path, *, trust: bool = False) -> ExportedPolicy:
    """Read a policy from a file with a suffix in `SUFFIXES`, or a checkpoint of rsl_rl or skrl.

    It runs no Python code of the file. TorchScript can do more than compute: such a file is refused
    unless it is trusted.

    Args:
        path: The file.
        trust: Whether a TorchScript file may do more than compute, such as write files.

    Raises:
        ConfigError: If the file cannot be read, has another format, needs `trust` (`NeedsTrust`),
            or onnxruntime is missing.
    """
    if path.suffix in ONNX:
        return _load_onnx(path)
    try:
        if zipfile.is_zipfile(path):  # TorchScript files are, too
            check_unpacked(path)
            with zipfile.ZipFile(path) as archive:
                if SCRIPT in archive.namelist():
                    return _load_torchscript(archive.read(SCRIPT), path, trust)
        return _load_torchscript(path.read_bytes(), path, trust)
    except OSError as error:
        raise ConfigError([Problem("policy", f"cannot read {path}: {error}")]) from error
    except zipfile.BadZipFile as error:
        raise _not_a_policy(path, f"it is damaged: {error}") from error


def script_bytes(network: torch.nn.Module, example: torch.Tensor, about: PolicyMetadata) -> bytes:
    """Return a network as the content of a TorchScript file.

    Args:
        network: Maps (N, K) to (N, A) or (N, H, A).
        example: (n, K) observations that it is traced with.
        about: The file's metadata.
    """
    stream = io.BytesIO()
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # deprecated, but C++ programs load this format
        script: Any = network
        if not isinstance(network, torch.jit.ScriptModule):
            script = torch.jit.trace(network, example)  # type: ignore[no-untyped-call]
        torch.jit.save(script, stream, _extra_files={METADATA: about.to_json()})
    return stream.getvalue()


def need_onnx(package: str) -> Any:
    """Import a package of the extra `export`.

    Raises:
        ConfigError: If it is not installed; names the extra.
    """
    try:
        return importlib.import_module(package)
    except ImportError as error:
        message = f"ONNX needs the package {package}: pip install 'embodichain[export]'"
        raise ConfigError([Problem("policy", message)]) from error


def _load_onnx(path: Path) -> ExportedPolicy:
    runtime = need_onnx("onnxruntime")
    options = runtime.SessionOptions()
    # Networks are small: more threads would only take cores from the simulation.
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = _ONNX_FATAL
    try:
        session = runtime.InferenceSession(
            path.read_bytes(), options, providers=["CPUExecutionProvider"]
        )
    except OSError as error:
        raise ConfigError([Problem("policy", f"cannot read {path}: {error}")]) from error
    except Exception as error:  # onnxruntime's exceptions have no common base class
        raise _not_a_policy(path, f"it is not an ONNX file: {_first_line(error)}") from error
    inputs = session.get_inputs()
    outputs = session.get_outputs()
    if len(inputs) != 1 or not outputs:
        raise _not_a_policy(path, f"a policy has one input, this has {len(inputs)}")
    input_name = inputs[0].name
    output_name = outputs[0].name

    def act(obs: F32) -> F32:
        (actions,) = session.run([output_name], {input_name: obs})
        return actions

    text = session.get_modelmeta().custom_metadata_map.get(METADATA, "")
    return ExportedPolicy(act, PolicyMetadata.from_json(text, path), str(path))


def _load_torchscript(data: bytes, path: Path, trust: bool) -> ExportedPolicy:
    extra: dict[str, Any] = {METADATA: ""}
    source = io.BytesIO(data)
    try:
        operations = code_at_loading(source)
        if operations and not trust:
            raise needs_trust(path, "TorchScript of it runs while it is loaded", operations)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # the format stays supported
            module = torch.jit.load(source, map_location="cpu", _extra_files=extra)  # type: ignore[no-untyped-call]
        operations += operations_beyond(module)
    except NeedsTrust:  # which is a ValueError, too
        raise
    except (RuntimeError, ValueError, OSError) as error:
        raise _not_a_policy(path, f"it is not a TorchScript file: {_first_line(error)}") from error
    if operations and not trust:
        raise needs_trust(path, "TorchScript of it does more than compute", operations)
    if operations:
        say_trusted(path, operations)

    def act(obs: F32) -> F32:
        with torch.no_grad():
            return module(torch.from_numpy(obs)).numpy()

    return ExportedPolicy(act, PolicyMetadata.from_json(extra[METADATA], path), str(path), module)


def _first_line(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return lines[0] if lines else type(error).__name__


def _not_a_policy(path: Path, why: str) -> ConfigError:
    return ConfigError([Problem("policy", f"{path} is not a policy: {why}")])
