"""Cameras: `Camera` and `StereoCamera`, in N environments.

Pictures are drawn when they are read. Poses and lenses are model fields, which may differ between
environments.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.views import Optics, Output, View, lens_of, view_of
from embodichain.lab.sim.sensors.base_sensor import BaseSensor, register_sensor
from embodichain.lab.sim.sensors.camera_cfg import CameraCfg, StereoCameraCfg
from embodichain.lab.sim.sensors.camera_model import (
    CameraIndex,
    add_camera,
    entity_of_geom,
    mount,
    pair_offset,
    picture_names,
)
from embodichain.lab.sim.sensors.depth_images import (
    disparities,
    distances,
    normals,
    positions,
    slopes,
)
from embodichain.utils.arrays import (
    as_env_ids,
    as_rows,
    is_host,
    rows_at,
    tensor_of,
    to_tensor,
    zeros,
)
from embodichain.utils.errors import RenderError
from embodichain.utils.math import (
    look_at,
    matrix_to_pose,
    matrix_to_quat,
    normalize_quat,
    pose_to_matrix,
    quat_multiply,
    quat_rotate,
)

if TYPE_CHECKING:
    import mujoco
    import torch

    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.compiler.sensing.sensor_plans import SceneNames, SensorPlan
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.lab.sim.engine.warp.device_engine import DeviceEngine
    from embodichain.lab.sim.objects.sim_context import SimContext
    from embodichain.lab.sim.sensors.sampling import Readings
    from embodichain.utils.array_types import Floats
    from embodichain.utils.errors import Problem

__all__ = ["Camera", "StereoCamera"]

PixelOrigin = Literal["corner", "centre"]
_FIRST_PIXEL = {"corner": 0.0, "centre": 0.5}
"""Where pixels are counted from, to where the middle of the first pixel is in a config's."""
_BY_DEPTH = frozenset({"depth", "distance", "normal", "position", "disparity"})


class _Shot(NamedTuple):
    """What one camera draws in n environments.

    Attributes:
        eye: (n or 1, 3) its position, m.
        axes: (n or 1, 3, 3) its axes.
        lens: (n or 1, 4) fx, fy, cx, cy in pixels.
        pictures: Output -> (n, H, W, ...).
    """

    eye: Floats
    axes: Floats
    lens: Floats
    pictures: dict[str, NDArray[Any]]


@register_sensor(CameraCfg)
class Camera(BaseSensor):
    """A pinhole camera. Images are arrays (N, H, W, ...), the first row at the top.

    ``color`` is uint8 RGBA; ``depth`` float32 metres along the camera's axis, ``distance`` along
    the ray; ``mask`` int32, the number of each pixel's entity (`get_object_uid`: MuJoCo's id of its
    root body; 0 for the ground, -1 where nothing is drawn); ``normal`` and ``position`` float32
    (N, H, W, 3) in the environment's frame, computed from depth, 0 where nothing is drawn.

    Poses have OpenGL's axes: x right, y up, view along -z.

    Attributes:
        was_drawn: Whether its images were read since it was built.
    """

    of_positions = True
    SUPPORTED_DATA_TYPES: ClassVar[tuple[str, ...]] = (
        "color",
        "depth",
        "distance",
        "mask",
        "normal",
        "position",
    )
    index: CameraIndex

    def __init__(self, plan: SensorPlan, host: SimContext) -> None:
        super().__init__(plan, host)
        if not isinstance(plan.cfg, CameraCfg):
            raise TypeError(f"{plan.uid}: expected the config of a camera, got {plan.cfg!r}")
        self.cfg: CameraCfg = plan.cfg
        self.was_drawn = False

    # -- in the scene --------------------------------------------------------------------------

    @classmethod
    def make_plan(
        cls, uid: str, cfg: CameraCfg, scene: SceneNames
    ) -> tuple[SensorPlan | None, list[Problem]]:
        """Look up the link, site or geom that it is fixed on, if any."""
        carrier, problems = mount(cfg, scene.known)
        if carrier is None:
            return scene.plan_without_carrier(uid, cfg), problems
        frames, mistakes = scene.one("of", carrier)
        problems += mistakes
        if problems or frames is None:
            return None, problems
        return frames.plan(uid, cfg), []

    @classmethod
    def edit_spec(cls, spec: mujoco.MjSpec, plan: SensorPlan) -> None:
        """Add its cameras, or find that of a file."""
        cfg: CameraCfg = plan.cfg  # type: ignore[assignment]
        add_camera(spec, plan.uid, cfg, next(iter(plan.places), None))

    @classmethod
    def find_index(
        cls, model: mujoco.MjModel, plan: SensorPlan, entities: Mapping[str, EntityIndex]
    ) -> CameraIndex:
        """Return its cameras in the model, and the numbers of entities in its masks."""
        cfg: CameraCfg = plan.cfg  # type: ignore[assignment]
        cameras = picture_names(plan.uid, cfg)
        return CameraIndex(
            ids=tuple(int(model.camera(name).id) for name in cameras.values()),
            entity_of_geom=entity_of_geom(model, entities),
            pictures=tuple(cameras),
            size=(cfg.width, cfg.height),
        )

    @property
    def eyes(self) -> tuple[int, ...]:
        """MuJoCo's ids of its cameras: one, or left and right."""
        return self.index.ids

    # -- images --------------------------------------------------------------------------------

    @property
    def outputs(self) -> tuple[Output, ...]:
        """What is drawn for its images: of ``color``, ``depth``, ``mask``."""
        names = {name.removesuffix("_right") for name in self.reads}
        needed = {"depth" if name in _BY_DEPTH else name for name in names}
        kinds: tuple[Output, ...] = ("color", "depth", "mask")
        return tuple(kind for kind in kinds if kind in needed)

    def read(self, name: str) -> NDArray[Any]:
        """Return an image of `reads`, (N, H, W, ...): do not write or store it.

        Raises:
            KeyError: If the config does not ask for it; lists those there are.
        """
        if name not in self.reads:
            raise KeyError(f"{self.uid}: no image {name!r}; data_types: {', '.join(self.reads)}")
        return self.latest()[self.reads.index(name)]

    def get_data(self) -> dict[str, torch.Tensor]:
        """Return all `reads` as tensors (N, H, W, ...), as in ``obs["sensor"][uid]`` (copies)."""
        return {
            name: tensor_of(image.copy())
            for name, image in zip(self.reads, self.latest(), strict=True)
        }

    def update(self, **kwargs: Any) -> None:
        """No effect: images are drawn when they are read. EmbodiChain's name."""

    def measure(self, env_ids: EnvIndex | None) -> Readings:
        """Draw its images, (n, H, W, ...) each."""
        self.was_drawn = True
        shots = self._draw_on_device() if self.sim.arrays.on_device else self._draw(env_ids)
        return tuple(self._image(name, shots) for name in self.reads)

    def _draw(self, env_ids: EnvIndex | None) -> list[_Shot]:
        views = [self._view(camera) for camera in self.index.ids]
        try:
            pictures = self.sim.draw(views, env_ids)
        except RenderError as error:
            raise RenderError(f"camera {self.uid!r}: {error}") from error

        def rows(values: Any) -> Any:
            if len(values) == 1 or env_ids is None:
                return values
            return values[env_ids]

        return [
            _Shot(
                eye=rows(view.position),
                axes=rows(view.axes),
                lens=rows(view.lens),
                pictures=pictures_of_view,
            )
            for view, pictures_of_view in zip(views, pictures, strict=True)
        ]

    def _draw_on_device(self) -> list[_Shot]:
        """Draw all environments by MuJoCo Warp's renderer."""
        engine = cast("DeviceEngine", self.engine)
        shots = []
        for side, camera in enumerate(self.index.ids):
            pictures = engine.pictures(camera, self._optics(camera), self.outputs, self.cfg.look)
            shot = _Shot(
                eye=engine.derived("cam_xpos")[:, camera],
                axes=engine.derived("cam_xmat")[:, camera].reshape(-1, 3, 3),
                lens=self.read_intrinsics(side),
                pictures=pictures,
            )
            shots.append(shot)
        return shots

    def _optics(self, camera: int) -> Optics:
        """The lens as compiled."""
        cfg = self.cfg
        fx, fy, cx, cy = lens_of(self.engine.model, camera, cfg.width, cfg.height)[0].tolist()
        return Optics(
            width=cfg.width,
            height=cfg.height,
            focal=(fx, fy),
            centre=(cx, cy),
            near=cfg.near,
            far=cfg.far,
        )

    def _view(self, camera: int) -> View:
        cfg = self.cfg
        return view_of(
            self.engine,
            camera,
            cfg.width,
            cfg.height,
            near=cfg.near,
            far=cfg.far,
            outputs=self.outputs,
            look=cfg.look,
        )

    def _image(self, name: str, shots: list[_Shot]) -> NDArray[Any]:
        """(n, H, W, ...) an image of `reads`, from what was drawn."""
        shot = shots[1 if name.endswith("_right") else 0]
        kind = name.removesuffix("_right")
        if kind == "color":
            return shot.pictures["color"]
        if kind == "mask":
            return rows_at(self.index.entity_of_geom, shot.pictures["mask"])
        depth: NDArray[np.float32] = shot.pictures["depth"]
        if kind == "depth":
            return self._with_no_hit(depth, depth)
        right, up = slopes(shot.lens, self.cfg.width, self.cfg.height)
        if kind == "distance":
            return self._with_no_hit(distances(depth, right, up), depth)
        points = positions(depth, right, up, shot.eye, shot.axes)
        if kind == "position":
            return points
        return normals(depth, points, shot.eye)

    def _with_no_hit(
        self, values: NDArray[np.float32], depth: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        if self.cfg.no_hit == "zero":
            return values
        other = np.float32(np.inf if self.cfg.no_hit == "inf" else self.cfg.far)
        return np.where(depth > 0, values, other)

    # -- pose ----------------------------------------------------------------------------------

    @property
    def is_attached(self) -> bool:
        """Whether it is fixed on a link."""
        return bool(self.plan.bodies) or self.cfg.camera is not None

    def read_pose(self) -> tuple[Floats, Floats]:
        """Position (N, 3) and wxyz orientation (N, 4) in the environment's frame."""
        camera = self.index.ids[0]
        axes = self.engine.derived("cam_xmat")[:, camera].reshape(-1, 3, 3)
        return self.engine.derived("cam_xpos")[:, camera].copy(), matrix_to_quat(axes)

    def read_local_pose(self) -> tuple[Floats, Floats]:
        """Position (N, 3) and wxyz orientation (N, 4) in the frame of its link, if it has one."""
        pos = self._model_values("cam_pos")
        quat = self._model_values("cam_quat")
        count = self.num_instances
        return np.broadcast_to(pos, (count, 3)).copy(), np.broadcast_to(quat, (count, 4)).copy()

    def _model_values(self, field: str) -> Floats:
        """(N or 1, k) values of a field of its first camera."""
        values = self.engine.model_values(field)[:, self.index.ids[0]]
        return self._to_arrays(values.astype(np.float64))

    def write_local_pose(self, pos: Floats, quat: Floats, env_ids: EnvIndex | None) -> None:
        """Set position (n, 3) and unit wxyz orientation (n, 4) from checked arrays."""
        self._write_pose(self.index.ids[0], pos, quat, env_ids)

    def _write_pose(self, camera: int, pos: Floats, quat: Floats, env_ids: EnvIndex | None) -> None:
        write = self.engine.write_model
        write("cam_pos", pos, env_ids, slice(3 * camera, 3 * camera + 3))
        write("cam_quat", quat, env_ids, slice(4 * camera, 4 * camera + 4))

    def get_local_pose(self, to_matrix: bool = False) -> torch.Tensor:
        """Pose in the frame of its link: (N, 7) x, y, z, qw, qx, qy, qz, or (N, 4, 4)."""
        return _pose_tensor(self.read_local_pose(), to_matrix)

    def get_arena_pose(self, to_matrix: bool = False) -> torch.Tensor:
        """Pose in the environment's frame: (N, 7) x, y, z, qw, qx, qy, qz, or (N, 4, 4)."""
        return _pose_tensor(self.read_pose(), to_matrix)

    def set_local_pose(self, pose: Any, env_ids: Any = None) -> None:
        """Set the pose in the frame of its link, or of the environment if it has none.

        Args:
            pose: (n, 7) x, y, z, qw, qx, qy, qz, or (n, 4, 4), with OpenGL's axes.
            env_ids: The n environments (sorted unique, or a mask); None is all N.

        Raises:
            ValueError: If the shape does not match ``env_ids`` or a value is not finite.
        """
        ids = as_env_ids(env_ids, self.num_instances)
        count = self.num_instances if ids is None else len(ids)
        what = f"{self.uid}: pose"
        shape = tuple(np.shape(pose))
        if len(shape) == 3 and shape[1:] == (4, 4):
            flat = as_rows(np.asarray(pose).reshape(shape[0], 16), count, 16, what)
            array = matrix_to_pose(flat.reshape(-1, 4, 4))
        else:
            array = as_rows(pose, count, 7, what)
        self.write_local_pose(array[:, :3], normalize_quat(array[:, 3:]), ids)

    def look_at(self, eye: Any, target: Any, up: Any = None, env_ids: Any = None) -> None:
        """Set the pose such that it looks from one point to another, in the frame of its link.

        Args:
            eye: (n, 3) metres.
            target: (n, 3) metres.
            up: (n, 3) the direction that is up in the picture; None is z.
            env_ids: The n environments (sorted unique, or a mask); None is all N.

        Raises:
            ValueError: If a shape does not match ``env_ids``, or an eye is at its target.
        """
        ids = as_env_ids(env_ids, self.num_instances)
        count = self.num_instances if ids is None else len(ids)
        if up is None:
            up = (0.0, 0.0, 1.0)
        eye = as_rows(eye, count, 3, f"{self.uid}: eye", shared=True)
        target = as_rows(target, count, 3, f"{self.uid}: target", shared=True)
        up = as_rows(up, count, 3, f"{self.uid}: up", shared=True)
        self.write_local_pose(eye, matrix_to_quat(look_at(eye, target, up)), ids)

    # -- lens ----------------------------------------------------------------------------------

    def read_intrinsics(self, side: int = 0) -> Floats:
        """(N, 4) fx, fy, cx, cy in pixels."""
        lens = lens_of(
            self.engine.model,
            self.index.ids[side],
            self.cfg.width,
            self.cfg.height,
            values=self.engine.model_values,
        )
        return np.broadcast_to(self._to_arrays(lens), (self.num_instances, 4)).copy()

    def _to_arrays(self, values: Floats) -> Floats:
        """Put values of the model where arrays are; those that all share are on the host."""
        return self.sim.arrays.constant(values) if is_host(values) else values

    def write_intrinsics(self, lens: Floats, env_ids: EnvIndex | None, side: int = 0) -> None:
        """Set fx, fy, cx, cy (n, 4) in pixels from a checked array.

        Raises:
            ValueError: If the camera is declared with a field of view.
        """
        camera = self.index.ids[side]
        if not self.engine.model.cam_sensorsize[camera].any():
            raise ValueError(
                f"{self.uid}: it has a field of view and no intrinsics: declare intrinsics, or "
                "write cam_fovy"
            )
        sensor = np.asarray(self.engine.model.cam_sensorsize[camera], np.float64)
        size = np.array([self.cfg.width, self.cfg.height], np.float64)
        lengths = np.concatenate([lens[:, :2], size / 2.0 - lens[:, 2:]], axis=1)
        lengths *= np.tile(sensor / size, 2)
        columns = slice(4 * camera, 4 * camera + 4)
        self.engine.write_model("cam_intrinsic", lengths, env_ids, columns)

    def set_intrinsics(self, intrinsics: Any, env_ids: Any = None) -> None:
        """Set fx, fy, cx, cy in pixels.

        Args:
            intrinsics: (4,) or (n, 4), or matrices (3, 3) or (n, 3, 3).
            env_ids: The n environments (sorted unique, or a mask); None is all N.

        Raises:
            ValueError: If the shape is wrong, a focal length is not positive, or the camera is
                declared with a field of view.
        """
        self._set_intrinsics(intrinsics, env_ids, 0)

    def _set_intrinsics(self, intrinsics: Any, env_ids: Any, side: int) -> None:
        ids = as_env_ids(env_ids, self.num_instances)
        count = self.num_instances if ids is None else len(ids)
        array = np.asarray(intrinsics, np.float64)
        if array.shape[-2:] == (3, 3):
            array = array[..., (0, 1, 0, 1), (0, 1, 2, 2)]
        lens = as_rows(array, count, 4, f"{self.uid}: intrinsics", shared=True)
        if (lens[:, :2] <= 0).any():
            raise ValueError(f"{self.uid}: fx and fy must be positive, got {lens[:, :2].tolist()}")
        self.write_intrinsics(lens, ids, side)

    def get_intrinsics(self, pixel_origin: PixelOrigin = "corner") -> Any:
        """(N, 3, 3) matrices ((fx, 0, cx), (0, fy, cy), (0, 0, 1)), pixels.

        Args:
            pixel_origin: Where the pixel in the top left corner is at (0, 0): at its ``corner``, as
                in configs, so that the middle of a picture is at (width / 2, height / 2); or at its
                ``centre``, as in OpenCV, ROS and Open3D, half a pixel less.
        """
        return _matrices(self.read_intrinsics(), pixel_origin)


@register_sensor(StereoCameraCfg)
class StereoCamera(Camera):
    """Two cameras side by side. Images are the left camera's; those of the right end in ``_right``.

    ``disparity`` is float32 pixels, fx b / depth of the left camera with the distance b between the
    cameras, 0 where nothing is drawn. Poses are those of the point halfway between the cameras.
    """

    SUPPORTED_DATA_TYPES: ClassVar[tuple[str, ...]] = (
        *Camera.SUPPORTED_DATA_TYPES,
        *(f"{name}_right" for name in Camera.SUPPORTED_DATA_TYPES),
        "disparity",
    )

    def __init__(self, plan: SensorPlan, host: SimContext) -> None:
        super().__init__(plan, host)
        if not isinstance(plan.cfg, StereoCameraCfg):
            raise TypeError(f"{plan.uid}: expected the config of a stereo camera")
        self.cfg: StereoCameraCfg = plan.cfg

    def _image(self, name: str, shots: list[_Shot]) -> NDArray[Any]:
        if name != "disparity":
            return super()._image(name, shots)
        offset = np.asarray(self.cfg.left_to_right_pos, np.float64)
        baseline = float(np.sqrt((offset * offset).sum()))
        left = shots[0]
        return disparities(left.pictures["depth"], left.lens[:, 0], baseline)

    def _centre(self, pos: Floats, quat: Floats) -> tuple[Floats, Floats]:
        """The pose halfway between the cameras, of the left one's."""
        offset, _ = pair_offset(self.cfg, 0)
        return pos - quat_rotate(quat, np.broadcast_to(offset, pos.shape)), quat

    def read_pose(self) -> tuple[Floats, Floats]:
        """Position (N, 3) and wxyz orientation (N, 4) halfway, in the environment's frame."""
        return self._centre(*super().read_pose())

    def read_local_pose(self) -> tuple[Floats, Floats]:
        """Position (N, 3) and wxyz orientation (N, 4) halfway, in the frame of its link."""
        return self._centre(*super().read_local_pose())

    def write_local_pose(self, pos: Floats, quat: Floats, env_ids: EnvIndex | None) -> None:
        """Set the pose halfway: position (n, 3), unit wxyz orientation (n, 4)."""
        for side, camera in enumerate(self.index.ids):
            offset, turn = pair_offset(self.cfg, side)
            at = pos + quat_rotate(quat, np.broadcast_to(offset, pos.shape))
            self._write_pose(camera, at, quat_multiply(quat, turn), env_ids)

    def get_left_right_arena_pose(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Poses (N, 4, 4) of the left and of the right camera in the environment's frame."""
        left, right = (self._camera_pose(camera) for camera in self.index.ids)
        return to_tensor(pose_to_matrix(left)), to_tensor(pose_to_matrix(right))

    def _camera_pose(self, camera: int) -> Floats:
        """(N, 7) x, y, z, qw, qx, qy, qz of a camera, by MuJoCo's id."""
        pos = self.engine.derived("cam_xpos")[:, camera]
        axes = self.engine.derived("cam_xmat")[:, camera].reshape(-1, 3, 3)
        return np.concatenate([pos, matrix_to_quat(axes)], axis=1)

    def set_intrinsics(  # type: ignore[override]  # EmbodiChain's signature
        self, intrinsics: Any, right_intrinsics: Any = None, env_ids: Any = None
    ) -> None:
        """Set fx, fy, cx, cy of the left and the right camera; without the latter, the same."""
        self._set_intrinsics(intrinsics, env_ids, 0)
        right = intrinsics if right_intrinsics is None else right_intrinsics
        self._set_intrinsics(right, env_ids, 1)

    def get_intrinsics(
        self, pixel_origin: PixelOrigin = "corner"
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Matrices (N, 3, 3) of the left and of the right camera, pixels; see `Camera`."""
        left, right = (_matrices(self.read_intrinsics(i), pixel_origin) for i in (0, 1))
        return left, right


def _pose_tensor(pose: tuple[Floats, Floats], to_matrix: bool) -> torch.Tensor:
    poses = np.concatenate(pose, axis=1)
    return to_tensor(pose_to_matrix(poses) if to_matrix else poses)


def _matrices(lens: Floats, pixel_origin: PixelOrigin) -> torch.Tensor:
    if pixel_origin not in _FIRST_PIXEL:
        choices = " or ".join(map(repr, _FIRST_PIXEL))
        raise ValueError(f"pixel_origin is {choices}, got {pixel_origin!r}")
    shift = _FIRST_PIXEL[pixel_origin]
    matrices = zeros((len(lens), 3, 3), lens)
    matrices[:, 0, 0] = lens[:, 0]
    matrices[:, 1, 1] = lens[:, 1]
    matrices[:, 0, 2] = lens[:, 2] - shift
    matrices[:, 1, 2] = lens[:, 3] - shift
    matrices[:, 2, 2] = 1.0
    return to_tensor(matrices)
