"""The engines of this package, a module each, called as `sim.engine` names the engine."""
