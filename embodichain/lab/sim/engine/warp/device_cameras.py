"""`DeviceCameras`: pictures of cameras in N worlds by MuJoCo Warp's renderer, on its device.

Importing this module imports Warp (extra ``gpu``).
"""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from typing import Any, NamedTuple

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.geometry import VISIBLE_GROUPS
from embodichain.lab.sim.drawing.views import Look, Optics, Output
from embodichain.lab.sim.engine.device.device_array import DeviceArray
from embodichain.lab.sim.engine.warp.warp_worlds import WarpWorlds
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import listing

__all__ = ["DeviceCameras", "DevicePictures"]

_log = logging.getLogger(__name__)

DevicePictures = dict[str, Any]
"""Output -> `DeviceArray`, as `drawing.views.Pictures`: ``color`` (N, H, W, 4) uint8, ``depth``
(N, H, W) float32, ``mask`` (N, H, W) int32. New arrays in each call."""

_SAMPLES = 2
"""Along each side of a pixel in full look, as `BatchRenderer`."""
_LEAST_NEAR = 0.005
"""Metres: the default of `CameraCfg.near`. Nearer things are drawn if lenses differ."""
_NO_SKY = (0.70, 0.77, 0.86, 1.0)
"""The middle of the gradient that `BatchRenderer` draws without a skybox."""
_RGB = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)
_CUBE = int(mujoco.mjtTexture.mjTEXTURE_CUBE)
_SKYBOX = int(mujoco.mjtTexture.mjTEXTURE_SKYBOX)


class _Part(NamedTuple):
    """What one launch draws of a camera.

    Attributes:
        context: Warp's settings and arrays.
        outputs: Which of its arrays are drawn.
        packed: (N, 4 H W) bytes of colours.
        depth: (N, H W) metres.
        surface: (N, H W, 2) geoms, and what they are.
    """

    context: mjw.RenderContext
    outputs: tuple[Output, ...]
    packed: torch.Tensor
    depth: torch.Tensor
    surface: torch.Tensor


class _Drawn(NamedTuple):
    """What a picture is drawn of, and how: parts with the same are made once.

    Attributes:
        camera: Its id.
        optics: Its lens as compiled.
        outputs: Of ``color``, ``depth``, ``mask``.
        look: ``fast`` or ``full``.
        lenses_differ: Whether lenses may differ between worlds.
        attenuates: Whether the attenuation of lights was written.
    """

    camera: int
    optics: Optics
    outputs: tuple[Output, ...]
    look: Look
    lenses_differ: bool
    attenuates: bool


class DeviceCameras:
    """Draws cameras of a scene in all worlds.

    Materials, sizes, colours, lights, poses and lenses are those of each world. Geoms in one tree
    of bounding boxes for each world are hit by a ray through the middle of each pixel. Meshes are
    exact. Transparent geoms are drawn opaque, and textures that are cubes as their mean colour; the
    first camera logs their names.

    Args:
        worlds: The worlds.
        model: The compiled scene.
        count: N.
        device: Warp's name of the device.
        written: Returns values of a model field that may differ between worlds; None of another.
    """

    def __init__(
        self,
        worlds: WarpWorlds,
        model: mujoco.MjModel,
        count: int,
        device: str,
        written: Callable[[str], DeviceArray | None],
    ) -> None:
        self._worlds = worlds
        self._model = model
        self._count = count
        self._written = written
        self._device = wp.get_device(device)
        self._scene: mjw.RenderContext | None = None
        self._parts: dict[_Drawn, list[_Part]] = {}
        self._kernels: dict[Any, Any] = {}
        self._version = -1

    def draw(
        self, camera: int, optics: Optics, outputs: Sequence[Output], look: Look, version: int
    ) -> DevicePictures:
        """Draw a camera in all worlds, from poses that were computed before.

        Args:
            camera: Its id.
            optics: Its lens as compiled; in worlds that may differ, model fields count.
            outputs: Of ``color``, ``depth``, ``mask``.
            look: ``fast``, or ``full`` with shadows, highlights and smooth edges.
            version: Number of the state: the tree is computed again when it increases.

        Raises:
            ConfigError: If lenses may differ between worlds, and something of this one is not
                supported then; names the camera.
        """
        scene = self._scene
        if scene is None:
            with wp.ScopedDevice(self._device):
                scene = self._make_scene()
            self._scene = scene
        if self._version != version:
            self._version = version
            self._worlds.refit(scene)
        drawn = _Drawn(
            camera=camera,
            optics=optics,
            outputs=tuple(outputs),
            look=look,
            lenses_differ=self._written(self._lens_field(camera)) is not None,
            attenuates=self._written("light_attenuation") is not None,
        )
        if drawn not in self._parts:
            if drawn.lenses_differ:
                self._check_lens(camera, optics)
            with wp.ScopedDevice(self._device):
                self._parts[drawn] = list(self._make_parts(scene, drawn))
        pictures: DevicePictures = {}
        for part in self._parts[drawn]:
            self._render(part.context)
            for output in part.outputs:
                pictures[output] = DeviceArray(self._read(part, output, drawn))
        return {output: pictures[output] for output in outputs}

    def _render(self, context: mjw.RenderContext) -> None:
        """Draw a context; those of one kind share a kernel, which takes a second to build."""
        kind = _kernel_kind(context)
        context._megakernel = self._kernels.get(kind)
        self._worlds.render(context)
        self._kernels[kind] = context._megakernel

    def _read(self, part: _Part, output: Output, drawn: _Drawn) -> torch.Tensor:
        """A new array of a picture that was drawn."""
        size = (self._count, drawn.optics.height, drawn.optics.width)
        if output == "color":
            blue, green, red, alpha = part.packed.view(*size, 4).unbind(-1)
            return torch.stack([red, green, blue, alpha], dim=-1)
        if output == "mask":
            geom = part.surface.view(*size, 2)[..., 0]
            return geom.clone(memory_format=torch.contiguous_format)
        depth = part.depth.view(size)
        near = 0.0 if drawn.lenses_differ else drawn.optics.near  # where rays begin
        return torch.where(depth > 0, depth + near, depth)

    # -- contexts ----------------------------------------------------------------------------------

    def _make_scene(self) -> mjw.RenderContext:
        """What all cameras share: trees, meshes, textures."""
        model = self._model
        _say_what_differs(model)
        sky = np.flatnonzero(model.tex_type == _SKYBOX)
        scene = self._worlds.render_context(
            cam_active=[],
            cam_res=[],
            background_color=_NO_SKY,
            shadow_light_fraction=0.0,
            use_textures=bool((model.mat_texid[:, _RGB] >= 0).any()),
            render_skybox=bool(len(sky)),
        )
        pictures = {int(i): _mean(model, int(i)) for i in np.flatnonzero(model.tex_type == _CUBE)}
        if len(sky) and model.tex_height[sky[0]] != 6 * model.tex_width[sky[0]]:
            face = _pixels(model, int(sky[0]))  # one for all sides
            pictures[int(sky[0])] = np.tile(face, (6, 1, 1))
        if pictures:
            scene = _with_textures(scene, pictures)
        return scene

    def _make_parts(self, scene: mjw.RenderContext, drawn: _Drawn) -> Iterator[_Part]:
        """Yield what is drawn together: only colours in full look have several samples."""
        if drawn.look == "fast":
            yield self._make_part(scene, drawn, drawn.outputs, full=False)
            return
        others = tuple(output for output in drawn.outputs if output != "color")
        if others:
            yield self._make_part(scene, drawn, others, full=False)
        yield self._make_part(scene, drawn, ("color",), full=True)

    def _make_part(
        self,
        scene: mjw.RenderContext,
        drawn: _Drawn,
        outputs: tuple[Output, ...],
        *,
        full: bool,
    ) -> _Part:
        context = self._make_context(scene, drawn, outputs, full=full)
        context.light_attenuation_is_default &= not drawn.attenuates
        return _Part(
            context=context,
            outputs=outputs,
            packed=wp.to_torch(context.rgb_data).view(torch.uint8),
            depth=wp.to_torch(context.depth_data),
            surface=wp.to_torch(context.seg_data),
        )

    def _make_context(
        self,
        scene: mjw.RenderContext,
        drawn: _Drawn,
        outputs: Sequence[Output],
        *,
        full: bool,
    ) -> mjw.RenderContext:
        count = self._count
        optics = drawn.optics
        pixels = optics.width * optics.height
        has_colour = "color" in outputs
        has_depth = "depth" in outputs
        has_mask = "mask" in outputs
        same_lens = not drawn.lenses_differ
        samples = _SAMPLES if full and same_lens else 1
        rays = _rays(optics, samples)
        lengths = np.linalg.norm(rays, axis=-1, keepdims=True)
        start = wp.array([0], dtype=int)
        return dataclasses.replace(
            scene,
            nrender=1,
            cam_res=wp.array([(optics.width, optics.height)], dtype=wp.vec2i),
            cam_id_map=wp.array([drawn.camera], dtype=int),
            total_rays=pixels,
            ray=wp.array(rays / lengths, dtype=wp.vec3),
            # Warp adds these to the origin of rays where there is an orthographic camera. Here they
            # make rays begin at `near`.
            ray_offset=wp.array(optics.near * rays, dtype=wp.vec3),
            has_orthographic_camera=same_lens,
            use_precomputed_rays=same_lens,
            zfar=optics.far - (optics.near if same_lens else 0.0),
            use_shadows=full,
            enable_specular=full,
            samples_per_pixel=samples,
            aa_accum=wp.zeros((count, pixels if samples > 1 else 1), dtype=wp.vec3),
            rgb_data=wp.zeros((count, pixels if has_colour else 0), dtype=wp.uint32),
            depth_data=wp.zeros((count, pixels if has_depth else 0), dtype=wp.float32),
            seg_data=wp.zeros((count, pixels if has_mask else 1), dtype=wp.vec2i),
            rgb_adr=start,
            depth_adr=start,
            seg_adr=start,
            render_rgb=wp.array([has_colour], dtype=bool),
            render_depth=wp.array([has_depth], dtype=bool),
            render_seg=wp.array([has_mask], dtype=bool),
        )

    # -- lenses that differ ------------------------------------------------------------------------

    def _lens_field(self, camera: int) -> str:
        return "cam_intrinsic" if self._model.cam_sensorsize[camera].all() else "cam_fovy"

    def _check_lens(self, camera: int, optics: Optics) -> None:
        """Check what is not supported if rays are computed for each world."""
        name = self._model.camera(camera).name
        sensor = self._model.cam_sensorsize[camera]
        mistakes = []
        if optics.near > _LEAST_NEAR:
            mistakes.append(f"near must be at most {_LEAST_NEAR} m, got {optics.near},")
        if sensor.all() and abs(sensor[0] * optics.height / sensor[1] / optics.width - 1) > 1e-5:
            mistakes.append("pixels must be as wide as its file's sensor has them")
        if mistakes:
            message = (
                f"camera {name!r}: {' and '.join(mistakes)} where lenses differ between "
                "environments and arrays are on a device"
            )
            raise ConfigError([Problem("sensor", message)])


def _kernel_kind(context: mjw.RenderContext) -> tuple[Any, ...]:
    """The numbers of a context that its kernel is compiled for, and that differ in one scene."""
    return (
        context.enable_specular,
        context.samples_per_pixel,
        context.use_precomputed_rays,
        context.zfar,
        context.light_attenuation_is_default,
    )


def _rays(optics: Optics, samples: int) -> NDArray[np.float64]:
    """(S S H W, 3) rays through parts of pixels, 1 m along the axis, in the camera's frame."""
    fx, fy = optics.focal
    cx, cy = optics.centre
    rays = []
    for down in range(samples):
        for across in range(samples):
            columns = np.arange(optics.width) + (across + 0.5) / samples
            rows = np.arange(optics.height) + (down + 0.5) / samples
            right, up = np.meshgrid((columns - cx) / fx, (cy - rows) / fy)
            rays.append(np.stack([right, up, -np.ones_like(right)], axis=-1).reshape(-1, 3))
    return np.concatenate(rays)


def _pixels(model: mujoco.MjModel, texture: int) -> NDArray[np.uint8]:
    """(H, W, C) of a texture."""
    shape = model.tex_height[texture], model.tex_width[texture], model.tex_nchannel[texture]
    start = int(model.tex_adr[texture])
    return model.tex_data[start : start + int(np.prod(shape))].reshape(shape)


def _with_textures(
    scene: mjw.RenderContext, pictures: dict[int, NDArray[np.uint8]]
) -> mjw.RenderContext:
    """A scene with other pictures (H, W, C) as textures, by their ids."""
    registry = list(scene.textures_registry)
    for texture, picture in pictures.items():
        is_grey = picture.shape[2] < 3
        rgb = picture[..., :1] if is_grey else picture[..., :3]
        rgba = np.ones((*picture.shape[:2], 4), np.float32)
        rgba[..., :3] = rgb / np.float32(255.0)
        registry[texture] = wp.Texture2D(wp.array(rgba), filter_mode=wp.TextureFilterMode.LINEAR)
    textures = wp.array(registry, dtype=wp.Texture2D)
    return dataclasses.replace(scene, textures=textures, textures_registry=registry)


def _mean(model: mujoco.MjModel, texture: int) -> NDArray[np.uint8]:
    """(1, 1, C) mean colour of a texture."""
    mean = _pixels(model, texture).mean(axis=(0, 1), keepdims=True)
    return np.rint(mean).astype(np.uint8)


def _say_what_differs(model: mujoco.MjModel) -> None:
    """Log once what is drawn otherwise than on the host."""
    alpha = np.array(model.geom_rgba[:, 3])
    for geom in np.flatnonzero(model.geom_matid >= 0):
        if np.allclose(model.geom_rgba[geom], (0.5, 0.5, 0.5, 1.0), atol=1e-6):
            alpha[geom] = model.mat_rgba[model.geom_matid[geom], 3]
    seen = model.geom_group < VISIBLE_GROUPS
    clear = np.flatnonzero((alpha > 0) & (alpha < 1) & seen)
    bodies = dict.fromkeys(model.body(int(model.geom_bodyid[g])).name or "world" for g in clear)
    if bodies:
        _say_once(f"transparent shapes are drawn opaque on a device: {listing(list(bodies), '')}")
    textures = model.mat_texid[:, _RGB]
    cubes = [
        model.material(int(i)).name or str(i)
        for i in np.flatnonzero(textures >= 0)
        if model.tex_type[textures[i]] == _CUBE
    ]
    if cubes:
        message = "textures that are cubes are drawn as their mean colour on a device, of materials"
        _say_once(f"{message} {listing(cubes, '')}")
    if model.nskin:
        names = [model.skin(i).name or str(i) for i in range(model.nskin)]
        _say_once(f"skins are not drawn: {listing(names, '')}")


@cache
def _say_once(message: str) -> None:
    _log.warning(message)
