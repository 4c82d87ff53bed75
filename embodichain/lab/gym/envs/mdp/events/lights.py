"""Events that change the lights and the camera that pictures are taken with."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import Box3, NamedEntity, Range
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.term import Term, Uniform
from embodichain.lab.gym.envs.mdp._rows import norm
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import euler_xyz_to_quat, quat_multiply
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.api import F64, EnvIndex

__all__ = ["RandomizeCameraFovy", "RandomizeCameraPose", "RandomizeLight"]


@register_term("event", name="randomize_light")
class RandomizeLight(Term):
    """Moves, tints and dims a declared light in each environment by itself.

    EmbodiChain's event of the same name (where all environments share a light).

    Args:
        entity_cfg: A light of the task's section `lights`.
        position_range: [[x, y, z] low, [x, y, z] high] in metres, added to the declared position.
        color_range: [[r, g, b] low, [r, g, b] high] in [0, 1]: the colour itself.
        intensity_range: [low, high], added to the declared intensity; never below 0. 30 is
            MuJoCo's full diffuse colour.
        direction_range: [[x, y, z] low, [x, y, z] high], added to the declared direction, which is
            then made a unit vector.

    Example:
        ``{func: randomize_light, mode: reset, params: {of: {uid: lamp}, position_range: [[-0.5, -0.5, 0], [0.5, 0.5, 0.5]], intensity_range: [-10, 10]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: NamedEntity,
        position_range: Box3 | None = None,
        color_range: Box3 | None = None,
        intensity_range: Range | None = None,
        direction_range: Box3 | None = None,
    ) -> None:
        lights, uid = env.sim.lights, entity_cfg.uid
        if uid not in lights:
            message = f"no light is called {uid!r}; there are: {', '.join(lights) or 'none'}"
            hint = did_you_mean(uid, lights).strip()
            raise ConfigError([Problem("entity_cfg.uid", message, hint)])
        if color_range is not None and not all(0 <= c <= 1 for row in color_range for c in row):
            raise ConfigError([Problem("color_range", f"RGB in [0, 1], got {color_range}")])
        self._light = lights[uid]
        cfg, model = self._light.cfg, env.sim.engine.model
        self._pos0: F64 = np.array(model.light(uid).pos, np.float64)
        self._dir0: F64 = np.asarray(cfg.direction, np.float64)
        self._color0: F64 = np.asarray(cfg.color, np.float64)
        self._intensity0 = float(cfg.intensity)
        self._move = Uniform.within("position", position_range)
        self._turn = Uniform.within("direction", direction_range)
        self._color = Uniform.within("color", color_range)
        self._intensity = Uniform.within("intensity", intensity_range)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the light of these environments."""
        draws = env.event_manager
        if self._move is not None:
            moved = self._pos0 + self._move(draws, env_ids)
            self._light.write("light_pos", moved, env_ids)
        if self._turn is not None:
            turned = self._dir0 + self._turn(draws, env_ids)
            self._light.write("light_dir", turned / norm(turned)[:, None], env_ids)
        if self._color is None and self._intensity is None:
            return
        color: F64 = self._color0[None, :]
        if self._color is not None:
            color = self._color(draws, env_ids)
        strength: F64 = np.full((1, 1), self._intensity0)
        if self._intensity is not None:
            strength = self._intensity0 + self._intensity(draws, env_ids)
        self._light.write_emission(color, np.maximum(strength, 0.0), env_ids)


def _camera(env: TermContext, name: str) -> int:
    model = env.sim.engine.model
    cameras = [model.camera(i).name for i in range(model.ncam)]
    if name not in cameras:
        message = f"no camera is called {name!r}; there are: {', '.join(cameras)}"
        raise ConfigError([Problem("camera", message, did_you_mean(name, cameras).strip())])
    return cameras.index(name)


@register_term("event", name="randomize_camera_pose")
class RandomizeCameraPose(Term):
    """Moves and turns a camera of the scene in each environment by itself.

    As EmbodiChain's `randomize_camera_extrinsics` for cameras that are mounted somewhere, which
    takes a sensor.

    Args:
        position_range: [[x, y, z] low, [x, y, z] high] in metres, added to the compiled position.
        rotation_range: The same for Euler angles in **degrees**, intrinsic XYZ, about the camera's
            own axes (x right, y up, z towards the viewer).
        camera: Its name; `default` is the one that renders images.

    Example:
        ``{func: randomize_camera_pose, mode: reset, params: {position_range: [[-0.1, -0.1, -0.1], [0.1, 0.1, 0.1]], rotation_range: [[-2, -2, -2], [2, 2, 2]]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        position_range: Box3 | None = None,
        rotation_range: Box3 | None = None,
        camera: str = "default",
    ) -> None:
        self._id, self._engine = _camera(env, camera), env.sim.engine
        model = self._engine.model
        self._pos0: F64 = np.array(model.cam_pos[self._id], np.float64)
        self._quat0: F64 = np.tile(model.cam_quat[self._id], (env.num_envs, 1))
        self._move = Uniform.within("position", position_range)
        self._turn = Uniform.within("rotation", rotation_range, degrees=True)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the camera's pose in these environments."""
        draws, engine = env.event_manager, self._engine
        if self._move is not None:
            moved = self._pos0 + self._move(draws, env_ids)
            engine.write_model("cam_pos", moved, env_ids, slice(3 * self._id, 3 * self._id + 3))
        if self._turn is not None:
            turn = euler_xyz_to_quat(self._turn(draws, env_ids))
            quat = quat_multiply(self._quat0[: len(turn)], turn)
            engine.write_model("cam_quat", quat, env_ids, slice(4 * self._id, 4 * self._id + 4))


@register_term("event", name="randomize_camera_fovy")
class RandomizeCameraFovy(Term):
    """Sets a camera's vertical field of view at random in each environment by itself.

    Args:
        fovy_range: [low, high] in **degrees**, within (0, 180).
        camera: Its name; `default` is the one that renders images.

    Example:
        ``{func: randomize_camera_fovy, mode: reset, params: {fovy_range: [35, 50]}}``
    """

    def __init__(self, env: TermContext, fovy_range: Range, camera: str = "default") -> None:
        low, high = fovy_range
        if not 0 < low <= high < 180:
            raise ConfigError([Problem("fovy_range", f"within (0, 180), got {list(fovy_range)}")])
        self._id, self._engine = _camera(env, camera), env.sim.engine
        self._fovy = Uniform("fovy", [low], [high])

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the field of view of these environments."""
        drawn = self._fovy(env.event_manager, env_ids)
        self._engine.write_model("cam_fovy", drawn, env_ids, slice(self._id, self._id + 1))
