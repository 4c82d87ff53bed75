"""EmbodiChain's public names: importable from where they are there, or refused with what to use."""

import importlib
import subprocess
import sys
import textwrap

import pytest

from embodichain.compat.names import OURS, REASONS, reason, upstream_modules, upstream_names

MODULES = sorted(upstream_modules())


def _python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_the_list_is_the_releases() -> None:
    assert len(MODULES) > 280
    assert sum(len(upstream_names(module)) for module in MODULES) > 1250
    assert {"BaseEnv", "EmbodiedEnvCfg"} <= upstream_names("embodichain.lab.gym.envs")


@pytest.mark.parametrize("module", MODULES)
def test_every_name_is_an_object_or_says_what_to_use(module: str) -> None:
    found = importlib.import_module(module)
    for name in sorted(upstream_names(module)):
        try:
            value = getattr(found, name)
        except NotImplementedError as error:
            assert str(error) == f"{module}.{name} is not available: {reason(module, name)}"
            assert len(reason(module, name)) > 10, name
        else:
            assert value is not None, name


@pytest.mark.parametrize("module", MODULES)
def test_a_name_that_nobody_has_is_an_import_error(module: str) -> None:
    found = importlib.import_module(module)
    with pytest.raises(AttributeError, match="NotAName"):
        found.NotAName  # noqa: B018


def test_every_alias_and_every_reason_is_of_a_name_that_exists() -> None:
    names = {name for module in MODULES for name in upstream_names(module)}
    assert set(OURS) <= names
    assert [path for path in REASONS if not _exists(path)] == []


def _exists(path: str) -> bool:
    module, _, name = path.rpartition(".")
    return path in MODULES or name in upstream_names(module)


def test_imports_of_the_tutorial_after_the_first() -> None:
    done = _python(
        """
        import embodichain.lab.gym.envs.managers.events as events
        import embodichain.lab.gym.envs.managers.observations as obs
        import embodichain.lab.gym.envs.managers.randomization as rand
        from embodichain.lab.gym.envs import EmbodiedEnv, EmbodiedEnvCfg
        from embodichain.lab.gym.envs.managers import EventCfg, ObservationCfg, SceneEntityCfg
        from embodichain.lab.sim.objects import RigidObjectCfg
        from embodichain.lab.sim.sensors import SensorCfg, StereoCameraCfg
        from embodichain.utils import configclass, logger
        print(rand.randomize_rigid_object_mass, ObservationCfg().mode, EventCfg().mode)
        print(configclass.__name__, "replace_assets_from_group" in dir(events))
        from embodichain.lab.gym.envs.managers.randomization import *
        print(randomize_light.__name__)
        from embodichain.lab.sim.robots import DexforceW1Cfg
        """
    )
    assert done.stdout.splitlines() == [
        "randomize_rigid_object_mass modify reset",
        "configclass False",
        "RandomizeLight",
    ]
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("NotImplementedError: embodichain.lab.sim.robots.DexforceW1Cfg is not")
    assert "RobotCfg(fpath=...)" in last


def test_a_functor_is_the_term_of_that_name_or_the_name_of_an_alias() -> None:
    from embodichain.lab.gym.envs.managers import actions, rewards  # type: ignore[attr-defined]
    from embodichain.lab.gym.envs.managers.terms.registry import TERMS

    assert actions.DeltaQposTerm == "relative_joint_position"
    assert actions.DeltaQposTerm in TERMS["action"]
    assert rewards.action_smoothness_penalty == "action_smoothness_penalty"
    assert rewards.success_reward is TERMS["reward"]["success_reward"].func
    with pytest.raises(NotImplementedError, match="a mesh is compiled once"):
        importlib.import_module("embodichain.lab.gym.envs.managers.events").__getattr__(
            "replace_assets_from_group"
        )


def test_the_hook_imports_nothing_heavy_and_leaves_other_modules_alone() -> None:
    done = _python(
        """
        import sys
        import embodichain
        import embodichain.lab.sim.solvers
        import embodichain.lab.sim.cfg
        heavy = {"torch", "mujoco", "pydantic"} & set(sys.modules)
        print(sorted(heavy - {"pydantic"}))
        try:
            import embodichain.lab.no_such_module
        except ModuleNotFoundError as error:
            print(error.name)
        """
    )
    assert done.stdout.splitlines() == ["[]", "embodichain.lab.no_such_module"], done.stderr


def test_messages_go_to_logging_and_errors_raise(caplog: pytest.LogCaptureFixture) -> None:
    from embodichain.utils import logger

    logger.set_log_level("warning")
    logger.log_info("left out")
    logger.log_warning("seen")
    assert [r.message for r in caplog.records] == ["\033[95m[EmbodiChain WARNING]: seen\033[0m"]
    with pytest.raises(KeyError, match="lost"):
        logger.log_error("lost", KeyError)
    with pytest.raises(ValueError, match="one of: DEBUG"):
        logger.set_log_level("loud")
