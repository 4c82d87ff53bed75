import random
from collections.abc import Callable

import numpy as np
import pytest
import torch

from embodichain.cli.results.global_random import global_draws


class Global:
    def step(self) -> object:
        return torch.rand(3) + np.random.uniform() + random.random()  # noqa: NPY002

    def noise(self, x: torch.Tensor) -> None:
        x.uniform_(0, 1)


class Own:
    def __init__(self, env: object) -> None:
        self.generator = torch.Generator()
        self.rng = np.random.default_rng(0)

    def step(self, env: object) -> object:
        drawn = env.rand("noise", (3,))  # type: ignore[attr-defined]
        return drawn + torch.rand(3, generator=self.generator) + self.rng.uniform()


def test_draws_from_global_generators_are_found_with_their_lines() -> None:
    found = global_draws(Global)
    assert [f.split(" ")[0] for f in found] == [
        "torch.rand",
        "np.random.uniform",
        "random.random",
        "x.uniform_",
    ]
    assert all(
        f"(line {line} of {__file__})" in f for f, line in zip(found, (13, 13, 13, 16), strict=True)
    )


@pytest.mark.parametrize("thing", [Own, len, lambda: torch.zeros(3)])
def test_own_generators_and_no_source_are_fine(thing: type | Callable[..., object]) -> None:
    assert global_draws(thing) == []
