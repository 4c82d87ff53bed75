"""Events that push: sudden velocities, and forces that stay until the next firing or a reset."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.param_types import Axes6, Range
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp._ranges import constant
from embodichain.lab.gym.envs.mdp._root_state import (
    need_free_root,
    read_root_velocity,
    six_axes,
    write_root_velocity,
)
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = ["ApplyExternalForceTorque", "PushArticulation", "PushBySettingVelocity"]


@register_term("event", name="push_by_setting_velocity")
class PushBySettingVelocity(Term):
    """Adds a random velocity to that of an entity's root: a push that takes no time.

    v += U(velocity_range), environment's axes. Isaac Lab's and mjlab's event of the same name.

    Args:
        entity_cfg: A dynamic object, or a robot with a floating base.
        velocity_range: {x, y, z: [low, high] in m/s; roll, pitch, yaw: [low, high] in rad/s}. An
            axis that is absent is not pushed.

    Example:
        ``{func: push_by_setting_velocity, mode: interval, interval_range_s: [1, 3], params: {entity_cfg: {uid: cube}, velocity_range: {x: [-0.5, 0.5], y: [-0.5, 0.5]}}}``
    """  # noqa: E501  (an example is one line)

    def __init__(self, env: TermContext, entity_cfg: ResolvedEntity, velocity_range: Axes6) -> None:
        need_free_root(entity_cfg)
        self._asset = entity_cfg.asset
        bounds = six_axes(velocity_range)
        if bounds is None:
            raise ConfigError([Problem("velocity_range", "names no axis: nothing is pushed")])
        self._bounds = bounds

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Push these environments' entities."""
        drawn = env.event_manager.draw("velocity", (6,), *self._bounds, env_ids)
        now = read_root_velocity(self._asset)
        now = now if env_ids is None else now[env_ids]
        write_root_velocity(self._asset, now + drawn, env_ids)


@register_term("event", name="push_articulation_by_setting_velocity")
class PushArticulation(PushBySettingVelocity):
    """`push_by_setting_velocity` with a schedule of its own: EmbodiChain's event of this name.

    Give it `mode: interval` and `interval_step: 1`: it then looks at its clock in every control
    step. Each environment is pushed after a time drawn from `interval_range_s`, counted from its
    last push or from the beginning of its episode.

    Args:
        entity_cfg: A robot with a floating base, or a dynamic object.
        interval_range_s: [low, high] seconds between pushes, positive.
        velocity_range: See `push_by_setting_velocity`.

    Example:
        ``{func: push_articulation_by_setting_velocity, mode: interval, interval_step: 1, params: {entity_cfg: {uid: go}, interval_range_s: [5, 10], velocity_range: {x: [-0.5, 0.5], y: [-0.5, 0.5]}}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        interval_range_s: Range,
        velocity_range: Axes6,
    ) -> None:
        super().__init__(env, entity_cfg, velocity_range)
        if not interval_range_s[0] > 0:
            message = f"needs 0 < low, got {list(interval_range_s)}"
            raise ConfigError([Problem("interval_range_s", message)])
        self._interval = constant([interval_range_s[0]]), constant([interval_range_s[1]])
        self._due: NDArray[np.int64] = np.zeros(env.num_envs, np.int64)
        """Control step of the episode in which the next push comes; 0 is not drawn yet."""

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Draw a new time where an episode begins."""
        self._due[slice(None) if env_ids is None else env_ids] = 0

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Push the environments whose time has come."""
        ids = np.arange(env.num_envs) if env_ids is None else env_ids
        step = env.elapsed_steps.numpy().astype(np.int64) + 1  # this one is not counted yet
        new = ids[self._due[ids] == 0]
        if len(new):
            self._draw_due(env, new, step * 0)
        pushed = ids[step[ids] >= self._due[ids]]
        if len(pushed):
            super().__call__(env, pushed)
            self._draw_due(env, pushed, step)

    def _draw_due(self, env: TermContext, ids: EnvIndex, since: NDArray[np.int64]) -> None:
        seconds = env.event_manager.draw("interval", (1,), *self._interval, ids)[:, 0]
        steps = np.maximum(1, np.rint(seconds / env.step_dt)).astype(np.int64)
        self._due[ids] = since[ids] + steps

    def state_dict(self) -> dict[str, Any]:
        """When the next pushes come."""
        return {"due": self._due.copy()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self._due[:] = state["due"]


@register_term("event", name="apply_external_force_torque")
class ApplyExternalForceTorque(Term):
    """Applies a random force and torque to bodies, until the next firing or a reset.

    Each component is uniform in its range, one draw a body; the force acts at the body's centre of
    mass (MuJoCo's `xfrc_applied`), environment's axes. Isaac Lab's event of the same name (there in
    the body's axes).

    Args:
        entity_cfg: A dynamic object, or a robot; its link names pick links, else it is the root.
        force_range: [low, high] in N.
        torque_range: [low, high] in N m.

    Example:
        ``{func: apply_external_force_torque, mode: interval, interval_range_s: [1, 2], params: {entity_cfg: {uid: ur10, link_names: [wrist_3_link]}, force_range: [-5, 5], torque_range: [-0.5, 0.5]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        force_range: Range = (0.0, 0.0),
        torque_range: Range = (0.0, 0.0),
    ) -> None:
        asset = entity_cfg.asset
        index = asset.entity
        if not entity_cfg.link_ids and index.free_qvel_adr < 0:
            message = (
                f"the root of {entity_cfg.uid!r} does not move, forces have no effect on it: "
                "pick links by link_names, or a dynamic object"
            )
            raise ConfigError([Problem("entity_cfg", message)])
        links = list(entity_cfg.link_ids)
        bodies = np.asarray(index.body_ids)[links] if links else [index.root_body_id]
        self._columns: NDArray[np.int64] = np.concatenate(
            [6 * int(body) + np.arange(6, dtype=np.int64) for body in bodies]
        )
        both = [(force_range[i], torque_range[i]) for i in (0, 1)]
        low, high = (np.tile(np.repeat(pair, 3), len(bodies)) for pair in both)
        self._low, self._high = constant(low), constant(high)
        self._engine = asset.engine

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the forces of these environments."""
        shape = (len(self._columns),)
        drawn: F64 = env.event_manager.draw("wrench", shape, self._low, self._high, env_ids)
        self._engine.write("xfrc_applied", drawn, env_ids, self._columns)
