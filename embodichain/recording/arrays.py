"""`LogArrays`: what was read from a log, as numpy, torch or a pandas frame. Reads no file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.recording.columns import Column
from embodichain.utils.errors import ConfigError
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    import pandas as pd
    import torch

__all__ = ["LogArrays"]


@dataclass(frozen=True)
class LogArrays:
    """T control steps of N environments.

    ``data["qpos"]`` is (T, N, nq), ``data["rewards"]`` (T, N); `columns` names the last axis.

    Attributes:
        steps: (T,) control steps, counted from the start of the recording.
        env_ids: (N,) environments.
        control_dt: Seconds a control step.
        columns: Field to name and unit of its columns; one of them for fields that are (T, N).
        values: Field to array, time first, environments second.
    """

    steps: NDArray[np.int64]
    env_ids: NDArray[np.int64]
    control_dt: float
    columns: Mapping[str, list[Column]]
    values: Mapping[str, NDArray[Any]]

    def __getitem__(self, field: str) -> NDArray[Any]:
        """The array of a field.

        Raises:
            ConfigError: If it was not read.
        """
        if field not in self.values:
            hint = did_you_mean(field, self.values)
            raise ConfigError(f"no field {field!r} was read.{hint} Fields: {', '.join(self)}")
        return self.values[field]

    def __iter__(self) -> Iterator[str]:
        """Names of the fields."""
        return iter(self.values)

    def __len__(self) -> int:
        """T."""
        return len(self.steps)

    def names(self, field: str) -> list[str]:
        """Names of a field's columns, in order."""
        return [column.name for column in self.columns[field]]

    @property
    def time(self) -> NDArray[np.float64]:
        """(T,) seconds of simulated time since the start of the recording."""
        return self.steps.astype(np.float64) * np.float64(self.control_dt)

    def torch(self) -> dict[str, torch.Tensor]:
        """The same arrays as tensors, which share their memory."""
        import torch

        return {field: torch.from_numpy(values) for field, values in self.values.items()}

    def flat(self) -> Iterator[tuple[Column, NDArray[Any]]]:
        """A table with a row for each step and environment: its columns, each (T * N,)."""
        n = len(self.env_ids)
        yield Column("step", ""), np.repeat(self.steps, n)
        yield Column("time", "s"), np.repeat(self.time, n)
        yield Column("env", ""), np.tile(self.env_ids, len(self.steps))
        for field, values in self.values.items():
            wide = values.reshape(len(self.steps) * n, len(self.columns[field]))
            for index, (name, unit) in enumerate(self.columns[field]):
                yield Column(name if name == field else f"{field}/{name}", unit), wide[:, index]

    def frame(self) -> pd.DataFrame:
        """A pandas frame with a row for each step and environment.

        Raises:
            ConfigError: If pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError as error:
            raise ConfigError("a frame needs pandas: pip install 'embodichain[pandas]'") from error
        return pd.DataFrame({column.name: values for column, values in self.flat()})
