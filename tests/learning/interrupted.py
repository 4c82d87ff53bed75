"""A training that is interrupted and resumed, beside one that is not."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import torch

from embodichain.config.resolved import Resolved
from embodichain.learning.training.train import TrainSummary, train


@dataclass(frozen=True)
class Resumed:
    """Folders of trainings to the same number of steps.

    Attributes:
        whole: Of the training without a break.
        first: Of the one that was interrupted.
        second: Of the one that was resumed from it.
        summary: What `train` returned for that.
    """

    whole: Path
    first: Path
    second: Path
    summary: TrainSummary


def interrupt_and_resume(
    config: Callable[..., Resolved], tmp_path: Path, at: int, **options: Any
) -> Resumed:
    """Train to the end; and once more, interrupted at a step and resumed.

    Args:
        config: Resolves further overrides.
        tmp_path: A folder for theirs.
        at: The first number of environment steps at which it is interrupted.
        options: Of `train`.
    """
    whole, first, second = (tmp_path / name for name in ("whole", "first", "second"))
    for folder in (whole, first, second):
        folder.mkdir()
    train(config(), whole, **options)

    def interrupt(statistics: Any) -> None:
        if statistics.env_steps >= at:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(config(), first, interrupt, **options)
    torch.rand(5)  # what else this process draws does not matter
    summary = train(config(f"resume={first}"), second, **options)
    assert summary.resumed_from is not None
    assert summary.resumed_from.startswith(str(first))
    return Resumed(whole, first, second, summary)
