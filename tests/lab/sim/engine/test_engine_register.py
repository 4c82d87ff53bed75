"""Engines of packages: what they say of themselves decides what is checked and what logs say."""

from collections.abc import Iterator
from typing import Any

import pytest

from embodichain.lab.sim.cfg import SimulationManagerCfg, choose_engine
from embodichain.lab.sim.engine.engine_register import (
    ENGINES,
    EngineKind,
    EngineSetup,
    engine,
    find_recorded,
    recorded_name,
    split_recorded,
)
from embodichain.lab.sim.sim_manager import SimulationManager
from embodichain.utils.errors import ConfigError


class Renamed:
    """MuJoCo's engine under another name."""

    def __init__(self, inner: Any, name: str) -> None:
        self._inner = inner
        self.name = name

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)


@pytest.fixture(autouse=True)
def register(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A register that forgets what a test adds: it has no method for that, as nothing else asks."""
    assert "mujoco" in ENGINES
    monkeypatch.setattr(ENGINES, "_members", dict(ENGINES.items()))
    monkeypatch.setattr(ENGINES, "_places", dict(ENGINES._places))
    yield


def add(called: str, **about: Any) -> EngineKind:
    @engine("mine", **about)
    def start_mine(setup: EngineSetup) -> Any:
        return Renamed(ENGINES["mujoco"].start(setup), called)

    return ENGINES["mine"]


@pytest.mark.parametrize("called", ["mujoco", "mujoco_warp 4.0.0", "mine of mine", "", "mine 1 2"])
def test_an_engine_under_the_name_of_another_is_refused(called: str) -> None:
    add(called)
    config = SimulationManagerCfg(headless=True)
    config.engine = "mine"
    simulation = SimulationManager(config, types_checked=True)
    with pytest.raises(ConfigError, match=r"sim\.engine: the engine 'mine' .* `name` must be"):
        simulation.compile()
    simulation.destroy()


@pytest.mark.parametrize("called", ["mine", "mine 1.0.2"])
def test_an_engine_is_found_by_what_a_log_says(called: str) -> None:
    kind = add(called)
    config = SimulationManagerCfg(headless=True, num_envs=2)
    config.engine = "mine"
    simulation = SimulationManager(config, types_checked=True)
    simulation.update(step=2)
    recorded = recorded_name(simulation.engine)
    assert recorded == called  # no package: it was registered by hand
    assert find_recorded(recorded) is kind
    assert find_recorded(f"{recorded} of another-package") is None
    simulation.destroy()


def test_ours_are_in_logs_as_they_were() -> None:
    mujoco = ENGINES["mujoco"]
    warp = ENGINES["warp"]
    assert find_recorded("mujoco") is mujoco and mujoco.is_exact
    assert find_recorded("mujoco_warp 4.0.0") is warp and not warp.is_exact
    for unknown in ("mujoco_warp", "Mujoco", "mujoco 4.0.0", "mujoco of evil", ""):
        assert find_recorded(unknown) is None
    assert split_recorded("counting 1.0 of my-package") == ("counting 1.0", "my-package")


def test_a_device_that_no_engine_of_the_name_runs_on_names_those_that_do() -> None:
    add("mine")
    _, problems = choose_engine("mine", "cuda:1")
    assert [str(p) for p in problems] == [
        "device: sim.engine=mine does not run on 'cuda:1': device=cpu, or sim.engine=warp"
    ]
    assert choose_engine("mine", "cpu") == ("mine", [])
    assert choose_engine(None, "cpu") == ("mujoco", [])
    _, problems = choose_engine("mujco", "cpu")
    assert "Did you mean 'mujoco'?" in str(problems[0])


def test_what_an_engine_lacks_here_is_said() -> None:
    add("mine", devices=("cuda", "cpu"), why_missing=lambda device: f"no {device} today")
    for device, path in (("cpu", "sim.engine"), ("cuda:0", "device")):
        _, problems = choose_engine("mine", device)
        assert [str(p) for p in problems] == [f"{path}: no {device} today"]
