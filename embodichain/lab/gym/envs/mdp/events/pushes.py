"""Events that push: velocity changes, forces until the next firing, forces of random duration."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.param_types import Axes6, Frames, Range, Whole
from embodichain.lab.gym.envs.managers.random_managers import Timer
from embodichain.lab.gym.envs.managers.term import Term, Uniform
from embodichain.lab.gym.envs.managers.terms.registry import register_term
from embodichain.lab.gym.envs.mdp.events.placing import (
    need_free_root,
    read_root_velocity,
    six_axes,
    write_root_velocity,
)
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import cross

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.utils.array_types import Floats

__all__ = ["ApplyBodyImpulse", "ApplyExternalForceTorque", "EpisodeTimer", "PushBySettingVelocity"]


class EpisodeTimer:
    """A timer of a term that is called in control steps, restarted in every episode.

    Args:
        env: The environment.
    """

    def __init__(self, env: TermContext) -> None:
        self._env = env
        self._arrays = env.arrays
        self._timer = Timer(env.num_envs, env.step_dt, env.arrays)
        # Control steps of the episode that have been counted.
        self._seen: NDArray[np.int64] = env.arrays.full(env.num_envs, 0, np.int64)

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Stop the timer of these environments."""
        where: Any = slice(None) if env_ids is None else env_ids
        self._timer.left[where] = 0
        self._seen[where] = 0

    def stopped(self, env_ids: EnvIndex | None) -> EnvIndex:
        """Return those environments whose timer has not been started in this episode."""
        ids: EnvIndex = self._arrays.every(len(self._seen)) if env_ids is None else env_ids
        return ids[self._timer.left[ids] == 0]

    def advance(self, env_ids: EnvIndex | None) -> EnvIndex:
        """Count the control steps since the last call; return environments that are due."""
        ids = self._arrays.every(len(self._seen)) if env_ids is None else env_ids
        elapsed = self._arrays.of(self._env.elapsed_steps)[ids].astype(np.int64)
        passed = elapsed - self._seen[ids]
        self._seen[ids] = elapsed
        return self._timer.advance(ids, passed)

    def start(self, seconds: Uniform, env_ids: EnvIndex) -> None:
        """Start stopped or due timers for a drawn time."""
        if len(env_ids):
            self._timer.start(env_ids, seconds(self._env.event_manager, env_ids)[:, 0])

    def state_dict(self) -> dict[str, Any]:
        """Control steps left and counted (copies)."""
        return {"left": self._timer.left.copy(), "seen": self._seen.copy()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self._timer.left[:] = state["left"]
        self._seen[:] = state["seen"]

    @staticmethod
    def seconds(name: str, param: str, bounds: Range) -> Uniform:
        """The times of a parameter [low, high].

        Raises:
            ConfigError: If they are not positive.
        """
        if not bounds[0] > 0:
            raise ConfigError([Problem(param, f"needs 0 < low, got {list(bounds)}")])
        return Uniform(name, [bounds[0]], [bounds[1]])


@register_term("event", name="push_by_setting_velocity", takes_strength=True)
class PushBySettingVelocity(Term):
    """Adds a random velocity to that of an entity's root: an instantaneous push.

    v += U(velocity_range), environment's axes. Isaac Lab's and mjlab's event of the same name.

    Args:
        entity_cfg: A dynamic object, or a robot with a floating base.
        velocity_range: {x, y, z: [low, high] in m/s; roll, pitch, yaw: [low, high] in rad/s}. An
            axis that is absent is not pushed.

    Example:
        ``{func: push_by_setting_velocity, mode: interval, interval_range_s: [1, 3], params: {of: {uid: cube}, velocity_range: {x: [-0.5, 0.5], y: [-0.5, 0.5]}}}``
    """  # noqa: E501  (an example is one line)

    def __init__(self, env: TermContext, entity_cfg: Whole, velocity_range: Axes6) -> None:
        need_free_root(entity_cfg)
        self._asset = entity_cfg.asset
        push = six_axes("velocity", velocity_range, default=0.0)
        if push is None:
            raise ConfigError([Problem("velocity_range", "names no axis: nothing is pushed")])
        self._push = push

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Push these environments' entities."""
        push = self._push(env.event_manager, env_ids)
        velocity = read_root_velocity(self._asset)
        if env_ids is not None:
            velocity = velocity[env_ids]
        write_root_velocity(self._asset, velocity + push, env_ids)


@register_term("event", name="apply_external_force_torque", takes_strength=True)
class ApplyExternalForceTorque(Term):
    """Applies a random force and torque to bodies, until its next call or a reset.

    Each component is uniform in its range, one draw per body, in the environment's axes; the force
    acts at the body's centre of mass (MuJoCo's `xfrc_applied`). Of a site or geom it acts at its
    origin: its moment about the centre of mass is added, as it is when the force is drawn. Isaac
    Lab's event of the same name (there in the body's axes).

    Args:
        entity_cfg: A dynamic object, or a robot; links, sites or geoms of it, by default the root.
        force_range: [low, high] in N.
        torque_range: [low, high] in N m.

    Example:
        ``{func: apply_external_force_torque, mode: interval, interval_range_s: [1, 2], params: {of: {uid: ur10, link_names: [wrist_3_link]}, force_range: [-5, 5], torque_range: [-0.5, 0.5]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: Frames,
        force_range: Range = (0.0, 0.0),
        torque_range: Range = (0.0, 0.0),
    ) -> None:
        asset = entity_cfg.asset
        index = asset.index
        if not entity_cfg.frame_ids and index.free_qvel_adr < 0:
            message = (
                f"the root of {entity_cfg.uid!r} does not move, forces have no effect on it: "
                "pick links by link_names, sites or geoms, or a dynamic object"
            )
            raise ConfigError([Problem("entity_cfg", message)])
        self._engine = asset.engine
        self._frames = entity_cfg.frames
        bodies = np.atleast_1d(np.arange(asset.engine.model.nbody)[self._frames.bodies])
        if len(np.unique(bodies)) < len(bodies):
            message = f"several {entity_cfg.kind}s of one link: its forces would be the last one's"
            raise ConfigError([Problem(f"entity_cfg.{entity_cfg.frame_key}", message)])
        self._columns: NDArray[np.int64] = np.concatenate(
            [6 * int(body) + np.arange(6, dtype=np.int64) for body in bodies]
        )
        low, high = ([force_range[i]] * 3 + [torque_range[i]] * 3 for i in (0, 1))
        count = len(bodies)
        self._wrench = Uniform("wrench", np.tile(low, count), np.tile(high, count), default=0.0)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the forces of these environments."""
        wrenches = self._wrench(env.event_manager, env_ids)
        if self._frames.kind != "link":
            wrenches = wrenches + self._moments(wrenches, env_ids)
        self._engine.write("xfrc_applied", wrenches, env_ids, self._columns)

    def _moments(self, wrenches: Floats, env_ids: EnvIndex | None) -> Floats:
        """(n, 6 k) no forces, and the moments of the drawn forces about the centres of mass."""
        engine = self._engine
        frames = self._frames
        where: Any = slice(None) if env_ids is None else env_ids
        lever = frames.positions(engine)[where] - engine.derived("xipos")[where][:, frames.bodies]
        forces = wrenches.reshape(len(wrenches), -1, 6)[..., :3]
        moments = cross(lever, forces)
        no_forces = np.zeros_like(moments)
        return np.concatenate([no_forces, moments], axis=2).reshape(len(wrenches), -1)


@register_term("event", name="apply_body_impulse", takes_strength=True)
class ApplyBodyImpulse(ApplyExternalForceTorque):
    """Applies a random force and torque to bodies for a random time, then none, repeatedly.

    Needs `mode: interval` and `interval_step: 1`: it counts control steps. An episode begins
    without a force; times are rounded to control steps, at least one. mjlab's event of the same
    name. Of two terms that push the same body only one has effect.

    Args:
        entity_cfg: A dynamic object, or a robot; links, sites or geoms of it, by default the root.
        force_range: [low, high] in N for each component, environment's axes, at the centre of mass,
            or at the site or geom, as of `apply_external_force_torque`.
        torque_range: [low, high] in N m, likewise.
        duration_s: [low, high] seconds of a push.
        cooldown_s: [low, high] seconds without a force.

    Example:
        ``{func: apply_body_impulse, mode: interval, interval_step: 1, params: {of: {uid: go}, force_range: [-30, 30], torque_range: [0, 0], duration_s: [0.1, 0.2], cooldown_s: [1, 3]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: Frames,
        force_range: Range,
        torque_range: Range,
        duration_s: Range,
        cooldown_s: Range,
    ) -> None:
        super().__init__(env, entity_cfg, force_range, torque_range)
        self._duration = EpisodeTimer.seconds("duration", "duration_s", duration_s)
        self._cooldown = EpisodeTimer.seconds("cooldown", "cooldown_s", cooldown_s)
        self._timer = EpisodeTimer(env)
        self._pushes: NDArray[np.bool_] = env.arrays.full(env.num_envs, False, np.bool_)

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Begin without a force: the reset of the scene has removed it."""
        self._timer.reset(env_ids)
        self._pushes[slice(None) if env_ids is None else env_ids] = False

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Begin and end the pushes that are due in these environments."""
        timer = self._timer
        timer.start(self._cooldown, timer.stopped(env_ids))
        due = timer.advance(env_ids)
        ends = due[self._pushes[due]]
        begins = due[~self._pushes[due]]
        if len(ends):
            self._engine.write("xfrc_applied", 0.0, ends, self._columns)
            timer.start(self._cooldown, ends)
        if len(begins):
            super().__call__(env, begins)
            timer.start(self._duration, begins)
        self._pushes[due] = ~self._pushes[due]

    def state_dict(self) -> dict[str, Any]:
        """The pushed environments, and their timers (copies)."""
        return {**self._timer.state_dict(), "pushes": self._pushes.copy()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self._timer.load_state_dict(state)
        self._pushes[:] = state["pushes"]
