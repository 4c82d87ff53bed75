"""Events that change cameras: their poses, fields of view and intrinsics."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import Box3, CameraOf, Range
from embodichain.lab.gym.envs.managers.term import Term, Uniform
from embodichain.lab.gym.envs.managers.terms.registry import register_term
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.math import euler_xyz_to_quat, quat_multiply
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.context import EventDraws, TermContext
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.lab.sim.sensors.camera import StereoCamera
    from embodichain.utils.array_types import Floats

__all__ = ["RandomizeCameraFovy", "RandomizeCameraIntrinsics", "RandomizeCameraPose"]

_FX = 0
"""Column of the focal length along x in intrinsics."""
_FY = 1


def _camera_id(env: TermContext, name: str) -> int:
    """MuJoCo's id of a camera.

    Raises:
        ConfigError: If there is none with this name.
    """
    sensor = env.sensors.get(name)
    if getattr(sensor, "eyes", None):
        return int(
            env.sensors[name].eyes[0]
        )  # it may be a camera of a file, which has another name
    model = env.sim.engine.model
    cameras = [model.camera(i).name for i in range(model.ncam)]
    if name not in cameras:
        message = f"no camera is called {name!r}; there are: {', '.join(cameras)}"
        raise ConfigError([Problem("camera", message, did_you_mean(name, cameras).strip())])
    return cameras.index(name)


@register_term("event", name="randomize_camera_pose", takes_strength=True)
class RandomizeCameraPose(Term):
    """Moves and rotates a camera of the scene, separately in each environment.

    A stereo camera moves as a whole. Like EmbodiChain's `randomize_camera_extrinsics` for mounted
    cameras, which takes a sensor.

    Args:
        position_range: [[x, y, z] low, [x, y, z] high] in metres, added to the compiled position.
        rotation_range: The same for Euler angles in **degrees**, intrinsic XYZ, about the camera's
            own axes (x right, y up, z towards the viewer).
        camera: The name of a camera sensor, of a view, or ``UID/NAME`` of an entity's file;
            `default` is the one that renders images.

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
        self._id = _camera_id(env, camera)
        self._engine = env.sim.engine
        self._stereo: StereoCamera | None = None
        sensor = env.sensors.get(camera)
        if len(getattr(sensor, "eyes", ())) > 1:
            self._stereo = sensor
        self._pos0: Floats
        self._quat0: Floats
        if self._stereo is not None:
            pos, self._quat0 = self._stereo.read_local_pose()
            self._pos0 = pos[0]
        else:
            model = self._engine.model
            self._pos0 = np.array(model.cam_pos[self._id], np.float64)
            self._quat0 = np.tile(model.cam_quat[self._id], (env.num_envs, 1))
        self._move = Uniform.within("position", position_range, default=0.0)
        self._turn = Uniform.within("rotation", rotation_range, degrees=True, default=0.0)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the camera's pose in these environments."""
        draws = env.event_manager
        if self._stereo is not None:
            self._move_stereo(self._stereo, draws, env_ids)
            return
        if self._move is not None:
            pos = self._pos0 + self._move(draws, env_ids)
            columns = slice(3 * self._id, 3 * self._id + 3)
            self._engine.write_model("cam_pos", pos, env_ids, columns)
        if self._turn is not None:
            turn = euler_xyz_to_quat(self._turn(draws, env_ids))
            quat = quat_multiply(self._quat0[: len(turn)], turn)
            columns = slice(4 * self._id, 4 * self._id + 4)
            self._engine.write_model("cam_quat", quat, env_ids, columns)

    def _move_stereo(
        self, stereo: StereoCamera, draws: EventDraws, env_ids: EnvIndex | None
    ) -> None:
        """Draw and write the pose of a stereo camera, both eyes together."""
        count = len(self._quat0) if env_ids is None else len(env_ids)
        pos = np.tile(self._pos0, (count, 1))
        quat = self._quat0[:count]
        if self._move is not None:
            pos = pos + self._move(draws, env_ids)
        if self._turn is not None:
            quat = quat_multiply(quat, euler_xyz_to_quat(self._turn(draws, env_ids)))
        stereo.write_local_pose(pos, quat, env_ids)


@register_term("event", name="randomize_camera_fovy", takes_strength=True)
class RandomizeCameraFovy(Term):
    """Sets a random vertical field of view of a camera, separately in each environment.

    Args:
        fovy_range: [low, high] in **degrees**, within (0, 180).
        camera: Its name, as in `randomize_camera_pose`; it must have a field of view instead of
            intrinsics.

    Example:
        ``{func: randomize_camera_fovy, mode: reset, params: {fovy_range: [35, 50]}}``
    """

    def __init__(self, env: TermContext, fovy_range: Range, camera: str = "default") -> None:
        low, high = fovy_range
        if not 0 < low <= high < 180:
            raise ConfigError([Problem("fovy_range", f"within (0, 180), got {list(fovy_range)}")])
        self._id = _camera_id(env, camera)
        self._engine = env.sim.engine
        if self._engine.model.cam_sensorsize[self._id].any():
            message = f"{camera!r} has intrinsics, which MuJoCo takes instead of a field of view"
            raise ConfigError([Problem("camera", message, "Use randomize_camera_intrinsics.")])
        declared = float(self._engine.model.cam_fovy[self._id])
        self._fovy = Uniform("fovy", [low], [high], default=declared)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the field of view of these environments."""
        drawn = self._fovy(env.event_manager, env_ids)
        self._engine.write_model("cam_fovy", drawn, env_ids, slice(self._id, self._id + 1))


@register_term("event", name="randomize_camera_intrinsics", takes_strength=True)
class RandomizeCameraIntrinsics(Term):
    """Adds random numbers to the intrinsics of a camera sensor, separately in each environment.

    EmbodiChain's event of the same name, which calls the sensor `entity_cfg`. A stereo camera's
    eyes get the same numbers.

    Args:
        sensor: A camera that is declared with intrinsics, or with neither them nor `fovy`.
        focal_x_range: [low, high] pixels, added to the declared fx; fx stays positive.
        focal_y_range: Likewise fy; None is the share by which fx changes.
        cx_range: [low, high] pixels, added to the declared cx.
        cy_range: Likewise cy.

    Example:
        ``{func: randomize_camera_intrinsics, mode: reset, params: {sensor: wrist, focal_x_range: [-2, 2], cx_range: [-1, 1]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        sensor: CameraOf,
        focal_x_range: Range | None = None,
        focal_y_range: Range | None = None,
        cx_range: Range | None = None,
        cy_range: Range | None = None,
    ) -> None:
        model = env.sim.engine.model
        self._sensor = sensor
        if not all(model.cam_sensorsize[camera].any() for camera in sensor.eyes):
            message = f"{sensor.uid!r} has a field of view: use randomize_camera_fovy"
            raise ConfigError([Problem("sensor", message)])
        # In the order of the columns of intrinsics.
        ranges = {
            "focal_x": focal_x_range,
            "focal_y": focal_y_range,
            "cx": cx_range,
            "cy": cy_range,
        }
        if all(bounds is None for bounds in ranges.values()):
            message = "missing: give at least one range, else nothing changes"
            raise ConfigError([Problem("focal_x_range", message)])
        self._declared = [sensor.read_intrinsics(side) for side in range(len(sensor.eyes))]
        for column, name in ((_FX, "focal_x"), (_FY, "focal_y")):
            bounds = ranges[name]
            shortest = min(float(env.arrays.host(eye)[0, column]) for eye in self._declared)
            if bounds is not None and shortest + bounds[0] <= 0:
                message = f"the declared one is {shortest:g} pixels: it would not stay positive"
                raise ConfigError([Problem(f"{name}_range", message)])
        self._change_of_column = {
            column: Uniform(name, [bounds[0]], [bounds[1]], default=0.0)
            for column, (name, bounds) in enumerate(ranges.items())
            if bounds is not None
        }

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the intrinsics in these environments."""
        changes = {
            column: change(env.event_manager, env_ids)[:, 0]
            for column, change in self._change_of_column.items()
        }
        count = env.num_envs if env_ids is None else len(env_ids)
        for side, declared in enumerate(self._declared):
            intrinsics = declared[:count].copy()
            for column, change in changes.items():
                intrinsics[:, column] += change
            if _FX in changes and _FY not in changes:
                intrinsics[:, _FY] *= intrinsics[:, _FX] / declared[:count, _FX]
            self._sensor.write_intrinsics(intrinsics, env_ids, side)
