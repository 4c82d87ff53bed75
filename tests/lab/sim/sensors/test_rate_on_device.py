"""`Sampler` with arrays on a device: readings by masks, without a decision on the host."""

from typing import Any

import numpy as np
import pytest
import torch

from embodichain.lab.sim.engine.device.device_array import DeviceArray
from embodichain.lab.sim.engine.warp.device_arrays import DeviceArrays
from embodichain.lab.sim.sensors.sampling import Sampler

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

N = 3
ARRAYS = DeviceArrays("cpu")


class Clock:
    """An engine of which only the time is read."""

    num_envs = N

    def __init__(self) -> None:
        self.version = 0
        self.time = torch.zeros((N, 1), dtype=torch.float64)

    def state(self, name: str) -> DeviceArray:
        return DeviceArray(self.time)

    def step(self, seconds: float) -> None:
        self.time += seconds
        self.version += 1


class Counting:
    """Counts how often it was asked, and returns 10 x the count + the environment."""

    def __init__(self) -> None:
        self.asked = 0

    def __call__(self, env_ids: Any) -> tuple[Any, ...]:
        self.asked += 1
        return (ARRAYS.put(10.0 * self.asked + np.arange(N)[:, None]),)


def sampler(clock: Clock, rate: float | None, measure: Any, of_positions: bool = False) -> Sampler:
    engine: Any = clock
    return Sampler(engine, ARRAYS, measure, rate, of_positions)


def reading(of: Sampler) -> list[float]:
    array: Any = of.read()[0]
    return array.host()[:, 0].tolist()


def test_without_a_rate_every_change_of_the_state_is_measured() -> None:
    for of_positions in (False, True):
        clock, measure = Clock(), Counting()
        sensor = sampler(clock, None, measure, of_positions)
        assert reading(sensor) == reading(sensor) == [10, 11, 12]
        clock.step(0.01)
        assert reading(sensor) == [20, 21, 22]


def test_readings_are_kept_until_the_next_period() -> None:
    clock, measure = Clock(), Counting()
    sensor = sampler(clock, 25.0, measure)
    assert reading(sensor) == [10, 11, 12]
    for _ in range(3):
        clock.step(0.01)
        assert reading(sensor) == [10, 11, 12]
    clock.step(0.01)  # 0.04 s: a whole period
    assert reading(sensor)[0] == 10 * measure.asked > 10


def test_times_of_long_runs_are_exact() -> None:
    clock = Clock()
    clock.time += 1e5  # s: float32 has steps of 0.008 s there
    sensor = sampler(clock, 100.0, Counting())
    first = reading(sensor)
    clock.step(0.006)
    assert reading(sensor) == first
    clock.step(0.006)
    assert reading(sensor) != first


def test_environments_that_were_reset_measure_alone() -> None:
    clock, measure = Clock(), Counting()
    sensor = sampler(clock, 25.0, measure)
    before = reading(sensor)
    clock.step(0.01)
    clock.time[1] = 0.0
    sensor.reset(ARRAYS.environments(np.array([1]), N))
    assert reading(sensor) == [before[0], 10 * measure.asked + 1, before[2]]
    clock.step(0.03)  # 0.04 s in the others, 0.03 s in the one that was reset
    one = 10 * (measure.asked) + 1
    assert reading(sensor) == [10 * measure.asked, one, 10 * measure.asked + 2]


def test_readings_that_were_returned_stay_as_they_are() -> None:
    clock, values = Clock(), ARRAYS.full((N, 1), 1.0)
    sensor = sampler(clock, 25.0, lambda env_ids: (values,))
    first: Any = sensor.read()[0]
    values[:] = 2.0  # a live view of the engine
    clock.step(0.05)
    assert first.host().tolist() == [[1.0]] * N
    assert reading(sensor) == [2.0] * N


def test_a_saved_state_continues() -> None:
    clock, measure = Clock(), Counting()
    sensor = sampler(clock, 25.0, measure)
    first = reading(sensor)
    clock.step(0.01)
    saved = sensor.state_dict()
    clock.step(0.05)
    assert reading(sensor) != first
    clock.time -= 0.05
    sensor.load_state_dict(saved)
    assert reading(sensor) == first
    assert sampler(clock, None, measure).state_dict() == {}
