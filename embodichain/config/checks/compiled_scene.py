"""Checks that need the compiled scene: MuJoCo's own, of the pictures in the log, and Warp's."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from embodichain.config.keys.schema import RootCfg
from embodichain.lab.sim.cfg import choose_engine
from embodichain.lab.sim.engine.engine_register import ENGINES
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.scene_setup.declared_scene import DeclaredScene
    from embodichain.lab.sim.compiler.compile_scene import CompiledScene

__all__ = ["compile_declared"]


def compile_declared(
    root: RootCfg, declared: DeclaredScene, *, images: bool = True
) -> CompiledScene:
    """Compile the scene that a config declares.

    Args:
        root: The config.
        declared: Its scene.
        images: Whether the pictures of `record.images` are checked, too.

    Raises:
        ConfigError: Lists every mistake that only the compiled scene shows, with paths from the
            root: MuJoCo refuses it, the log has pictures of a camera that there is not, or the
            engine that is to step it lacks something.
    """
    try:
        scene = declared.compile()
    except ConfigError as error:
        raise ConfigError(
            replace(problem, path=f"task.{problem.path}".rstrip(".")) for problem in error.problems
        ) from error
    problems = _missing_in_engine(root, scene)
    if images and root.record.images is not None and root.task.id is None:
        from embodichain.config.checks.recorded_images import check_images  # imports MuJoCo

        problems += check_images(root.record.images, scene.model, scene.camera_sensors)
    if problems:
        raise ConfigError(problems)
    return scene


def _missing_in_engine(root: RootCfg, scene: CompiledScene) -> list[Problem]:
    """What the engine that is to step the scene lacks of it."""
    engine, missing = choose_engine(root.sim.engine, root.device or "cpu")
    if missing:
        return []
    return ENGINES[engine].unsupported(scene.model)
