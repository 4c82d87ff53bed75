"""Sweeps: what is checked before one starts, and what is said when one ends.

Points, workers and searches are Hydra's: its basic sweeper and launcher, and the plug-ins of the
extra `sweep`, which bring `hydra/launcher=joblib` and `hydra/sweeper=optuna`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import IntervalSweep, Override
from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf

__all__ = ["BestPoint", "points", "swept", "towards_scores"]

RESULTS_FILE = "optimization_results.yaml"
_DIRECTION = "hydra.sweeper.direction"


def points(overrides: Sequence[str], most: int) -> Iterator[list[str]]:
    """Give the overrides of each job of a sweep, as far as they are known before it starts.

    A search chooses its points as it goes: of one, there is the point with every key's first value.

    Args:
        overrides: As typed, with sweeps.
        most: How many are given at most.

    Raises:
        HydraException: An override is malformed.
    """
    from hydra._internal.core_plugins.basic_sweeper import BasicSweeper

    parsed = OverridesParser.create().parse_overrides(list(overrides))
    if _searches(overrides) or any(o.is_interval_sweep() for o in parsed):
        yield [_first(override) for override in parsed]
        return
    for batch in BasicSweeper.split_arguments(parsed, max_batch_size=most)[:1]:
        yield from (list(job) for job in batch)


def swept(overrides: Sequence[str]) -> list[str]:
    """Return the keys that a sweep gives several values, as they are typed.

    Args:
        overrides: As typed, with sweeps.
    """
    parsed = OverridesParser.create().parse_overrides(list(overrides))
    return [override.key_or_group for override in parsed if override.is_sweep_override()]


def towards_scores(overrides: Sequence[str]) -> list[str]:
    """Let a search look for the highest objective, unless a direction is typed: Optuna minimizes.

    Args:
        overrides: As typed.
    """
    given = any(o.lstrip("+").startswith(f"{_DIRECTION}=") for o in overrides)
    added = [f"{_DIRECTION}=maximize"] if _searches(overrides) and not given else []
    return [*overrides, *added]


def _searches(overrides: Sequence[str]) -> bool:
    return "hydra/sweeper=optuna" in overrides


def _first(override: Override) -> str:
    """The override with one value in place of a sweep."""
    line = override.input_line or ""
    if not override.is_sweep_override():
        return line
    value = override.value()
    if isinstance(value, IntervalSweep):
        return f"{override.get_key_element()}={value.start}"
    return f"{override.get_key_element()}={next(iter(override.sweep_string_iterator()))}"


class BestPoint(Callback):
    """Says which point a search found best; Hydra calls it, see `conf/common.yaml`."""

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Read what the search has left in the sweep's folder; other sweeps leave nothing there."""
        path = Path(config.hydra.sweep.dir) / RESULTS_FILE
        if config.quiet or config.json or not path.is_file():
            return
        found: Any = OmegaConf.to_container(OmegaConf.load(path))
        point = " ".join(f"{k.lstrip('+')}={v}" for k, v in found.get("best_params", {}).items())
        if point:
            sys.stderr.write(f"best objective {found['best_value']:.4g}: {point}\n{path}\n")
