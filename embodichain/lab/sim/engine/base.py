"""Older name of `engine.api`."""

from embodichain.lab.sim.engine.api import (
    F64,
    Engine,
    EngineListener,
    EnvIndex,
    PhysicsEvent,
    Write,
)

__all__ = ["F64", "Engine", "EngineListener", "EnvIndex", "PhysicsEvent", "Write"]
