"""Events that change the laws of a scene: gravity."""

from __future__ import annotations

from typing import TYPE_CHECKING

from embodichain.lab.gym.envs.managers.param_types import Box3
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp._model_fields import Distribution, Draw, Operation, Quantity

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import EnvIndex

__all__ = ["RandomizePhysicsSceneGravity"]


@register_term("event", name="randomize_physics_scene_gravity")
class RandomizePhysicsSceneGravity(Term):
    """Gives each environment a random gravity.

    Isaac Lab's event of the same name (there one draw serves all environments).

    Args:
        gravity_range: [[x, y, z] low, [x, y, z] high] in m/s^2 (or factors, with
            ``operation: scale``).
        operation: ``add`` to the declared gravity, ``scale`` it axis by axis, or ``abs``: replace
            it.
        distribution: ``uniform``, ``log_uniform`` or ``gaussian`` within the box.

    Example:
        ``{func: randomize_physics_scene_gravity, mode: reset, params: {gravity_range: [[-0.2, -0.2, -0.5], [0.2, 0.2, 0.5]]}}``
    """  # noqa: E501

    def __init__(
        self,
        env: TermContext,
        gravity_range: Box3,
        operation: Operation = "add",
        distribution: Distribution = "uniform",
    ) -> None:
        self._engine = env.sim.engine
        default = self._engine.model.opt.gravity
        quantity = Quantity("gravity_range", gravity_range, list("xyz"), default, operation)
        self._draw = Draw([quantity], distribution)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the gravity of these environments."""
        self._engine.write_model("opt.gravity", self._draw(env, env_ids)[0], env_ids)
