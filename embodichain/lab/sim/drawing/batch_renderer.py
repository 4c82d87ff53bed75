"""`BatchRenderer`: draws N environments x M cameras in one call, from the arrays of a batch.

Sizes, colours, textures, lights and cameras are those of each environment. Pictures do not depend
on N or on the other environments.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.geometry import SceneGeometry, geom_scales
from embodichain.lab.sim.drawing.gl import (
    Context,
    LayeredTarget,
    NumberTexture,
    Program,
    ShadowMap,
    VertexBuffers,
)
from embodichain.lab.sim.drawing.shaders import (
    BACKGROUND,
    SCENE_FRAGMENT,
    SCENE_VERTEX,
    SHADOW_VERTEX,
)
from embodichain.lab.sim.drawing.textures import SceneTextures
from embodichain.lab.sim.drawing.views import DrawnState, Optics, Pictures, View

__all__ = ["BatchRenderer"]

F32 = NDArray[np.float32]
_CHUNK_BYTES = 256 * 2**20
_UNITS = {"poses": 0, "looks": 1, "views": 2, "lights": 3, "shadowViews": 4, "textures": 5}
_SHADOW_UNIT = 6
_GREY = np.array([0.5, 0.5, 0.5, 1.0], np.float32)
_SHADOW_PIXELS = 1024
_TRIANGLES = 300
"""Triangles of a mesh after simplification."""


class BatchRenderer:
    """Draws a scene. Call it from the render thread only.

    Args:
        model: The compiled scene.

    Raises:
        RenderError: If OpenGL does not work here.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.context = Context()
        self._model = model
        self._geometry = SceneGeometry.of_model(model, 24, _TRIANGLES)
        self._types = model.geom_type[self._geometry.geoms]
        self._textures = SceneTextures(model, _UNITS["textures"])
        self._buffers = VertexBuffers(self._geometry.vertices, self._geometry.triangles)
        self._scene = Program(SCENE_VERTEX, SCENE_FRAGMENT)
        self._sky = Program(*BACKGROUND)
        self._shadow = Program(SHADOW_VERTEX)
        self._numbers = {name: NumberTexture(_UNITS[name]) for name in list(_UNITS)[:5]}
        self._targets: dict[Any, LayeredTarget] = {}
        self._shadow_map: Any = None
        self._names = np.append(self._geometry.geoms, -1).astype(np.int32)

    def draw(
        self, state: DrawnState, views: Sequence[View], envs: NDArray[np.int64] | None = None
    ) -> list[Pictures]:
        """Draw every view of n environments.

        Args:
            state: The environments.
            views: The cameras.
            envs: (n,) which environments; None is all N.

        Returns:
            The pictures of each view, n rows each.
        """
        self.context.make_current()
        rows = np.arange(state.num_envs) if envs is None else envs
        most = self._most(views)
        starts = range(0, max(len(rows), 1), most)
        chunks = [self._draw_chunk(state, views, rows[start : start + most]) for start in starts]
        if len(chunks) == 1:
            return chunks[0]
        return [
            {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
            for parts in zip(*chunks, strict=True)
        ]

    def _most(self, views: Sequence[View]) -> int:
        """How many environments are drawn at once: bounded by layers, and by memory."""
        pixels = sum(
            v.optics.width * v.optics.height * (16 if v.look == "full" else 4) for v in views
        )
        by_memory = _CHUNK_BYTES // max(1, 4 * pixels)
        return max(1, min(by_memory, self.context.max_layers // max(1, len(views))))

    def _draw_chunk(
        self, state: DrawnState, views: Sequence[View], rows: NDArray[np.int64]
    ) -> list[Pictures]:
        far = max(view.optics.far for view in views)
        self._upload_scene(state, rows, far)
        full = any(view.look == "full" for view in views)
        shadow_light = self._draw_shadows(state, rows) if full else -1
        found: list[Pictures] = [{} for _ in views]
        # Views of one size and look are layers of one target.
        groups: dict[Any, list[int]] = {}
        for index, view in enumerate(views):
            size = view.optics.width, view.optics.height
            if "color" in view.outputs and view.look == "full":
                groups.setdefault((*size, ("color",), True), []).append(index)
            rest = tuple(o for o in view.outputs if o != "color" or view.look == "fast")
            if rest:
                groups.setdefault((*size, rest, False), []).append(index)
        for (width, height, outputs, is_full), members in groups.items():
            layers = len(rows) * len(members)
            key = width, height, layers, outputs, is_full
            target = self._targets.get(key)
            if target is None:
                self._forget_targets()
                target = LayeredTarget(width, height, layers, outputs, halved=is_full)
                self._targets[key] = target
            self._upload_views([views[i] for i in members], rows)
            self._draw_into(target, layers, is_full, shadow_light, state)
            for name in outputs:
                values = target.empty(name)
                target.read(name, values)
                if name == "mask":
                    values = self._names[values]
                for place, index in enumerate(members):
                    part = values[place * len(rows) : (place + 1) * len(rows)]
                    found[index][name] = part
        return found

    def _forget_targets(self) -> None:
        """Free the oldest targets: sizes change when films of other sizes are made."""
        while len(self._targets) >= 8:
            self._targets.pop(next(iter(self._targets))).close()

    # -- numbers -------------------------------------------------------------------------------

    def _upload_scene(self, state: DrawnState, rows: NDArray[np.int64], far: float) -> None:
        geoms, count = self._geometry.geoms, len(rows)
        poses = np.empty((count, len(geoms), 3, 4), np.float32)
        matrix = state.derived("geom_xmat").reshape(state.num_envs, -1, 3, 3)
        poses[..., :3] = matrix[rows][:, geoms]
        poses[..., 3] = state.derived("geom_xpos")[rows][:, geoms]
        self._numbers["poses"].upload(poses)
        field = _Rows(state, rows)
        looks = np.zeros((count, len(geoms), 3, 4), np.float32)
        looks[..., 0, :] = geom_scales(self._types, field("geom_size", 3)[:, geoms], far)
        self._put_materials(field, looks)
        self._numbers["looks"].upload(looks)
        self._numbers["lights"].upload(self._lights(state, rows, field))

    def _put_materials(self, field: _Rows, looks: F32) -> None:
        """Colours, reflections and textures; a material's win over the geom's own colour."""
        geoms = self._geometry.geoms
        own = np.broadcast_to(field("geom_rgba", 4)[:, geoms], looks[..., 1, :].shape)
        looks[..., 1, :] = own
        looks[..., 2, :] = 0.5, 0.5, 0.0, -1.0  # MuJoCo's for a geom without a material
        if not self._model.nmat:
            return
        material = np.broadcast_to(field("geom_matid", 0)[:, geoms], looks.shape[:2])
        env, geom = np.nonzero(material >= 0)
        picked = material[env, geom].astype(np.int64)

        def of(name: str, width: int) -> NDArray[Any]:
            values = field(name, width)
            found: NDArray[Any] = values[np.minimum(env, len(values) - 1), picked]
            return found

        # A geom's own colour counts where it is another than MuJoCo's default grey.
        default = (own[env, geom] == _GREY).all(axis=1)
        looks[env, geom, 1] = np.where(default[:, None], of("mat_rgba", 4), own[env, geom])
        kinds = [of(name, 0) for name in ("mat_specular", "mat_shininess", "mat_emission")]
        looks[env, geom, 2] = np.stack([*kinds, picked], axis=1)

    def _lights(self, state: DrawnState, rows: NDArray[np.int64], field: _Rows) -> F32:
        count = self._model.nlight
        lights = np.zeros((len(rows), max(count, 1), 6, 4), np.float32)
        if not count:
            return lights
        directional = int(mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
        spot = int(mujoco.mjtLightType.mjLIGHT_SPOT)
        lights[..., 0, :3] = state.derived("light_xpos")[rows]
        lights[..., 1, :3] = state.derived("light_xdir")[rows]
        kind = field("light_type", 0)
        lights[..., 0, 3] = kind == directional
        cutoff = np.cos(np.radians(field("light_cutoff", 0)))
        lights[..., 1, 3] = np.where(kind == spot, cutoff, -1.0)
        lights[..., 2, :3] = field("light_diffuse", 3)
        lights[..., 2, 3] = field("light_active", 0) != 0
        lights[..., 3, :3] = field("light_ambient", 3)
        lights[..., 4, :3] = field("light_specular", 3)
        lights[..., 5, :3] = field("light_attenuation", 3)
        lights[..., 5, 3] = field("light_exponent", 0)
        return lights

    def _upload_views(self, views: Sequence[View], rows: NDArray[np.int64]) -> None:
        found = np.zeros((len(views), len(rows), 8, 4), np.float32)
        for out, view in zip(found, views, strict=True):
            position = np.asarray(view.position, np.float64)
            axes = np.asarray(view.axes, np.float64).reshape(-1, 3, 3)
            position, axes = (a if len(a) == 1 else a[rows] for a in (position, axes))
            focal = np.asarray(view.optics.focal)[None] if view.focal is None else view.focal[rows]
            middle = np.asarray(view.optics.centre)[None]
            centre = middle if view.centre is None else view.centre[rows]
            projection = _projection(view.optics, focal, centre)
            turned = np.swapaxes(axes, 1, 2)  # world to camera
            world = np.zeros((len(axes), 4, 4))
            world[:, :3, :3] = turned
            world[:, :3, 3] = -(turned * position[:, None]).sum(axis=2)
            world[:, 3, 3] = 1.0
            out[:, :4] = projection @ world
            out[:, 4, :3], out[:, 4, 3] = position, np.arange(len(rows))
            corner, right, down = _rays(view.optics, focal, centre, axes)
            out[:, 5, :3], out[:, 6, :3], out[:, 7, :3] = corner, right, down
        self._numbers["views"].upload(found)

    # -- passes --------------------------------------------------------------------------------

    def _draw_into(
        self, target: LayeredTarget, layers: int, full: bool, shadow_light: int, state: DrawnState
    ) -> None:
        target.begin()
        headlight = self._model.vis.headlight
        shared = {**_UNITS, **self._textures.uniforms()}
        on = 1.0 if headlight.active else 0.0
        values: dict[str, Any] = {
            **shared,
            "geomCount": len(self._geometry.geoms),
            "lightCount": int(self._model.nlight),
            "full": int(full),
            "shadows": _SHADOW_UNIT,
            "shadowLight": shadow_light,
            "headAmbient": on * np.asarray(headlight.ambient),
            "headDiffuse": on * np.asarray(headlight.diffuse),
            "headSpecular": on * np.asarray(headlight.specular),
            "transparentPass": 0,
        }
        self._scene.use(values)
        triangles = len(self._geometry.triangles)
        self._buffers.draw(0, triangles, layers)
        if "color" in target.outputs:
            clear = np.array([0.7, 0.78, 0.86])
            self._sky.use({**shared, "sky": self._textures.sky, "clear": clear})
            with target.color_alone():
                self._buffers.draw_background(layers)
        if self._any_transparent(state):
            self._scene.use({"transparentPass": 1})
            with target.color_alone(blended=True):
                self._buffers.draw(0, triangles, layers)

    def _any_transparent(self, state: DrawnState) -> bool:
        colours = [state.model_values("geom_rgba").reshape(-1, 4)]
        if self._model.nmat:
            colours.append(state.model_values("mat_rgba").reshape(-1, 4))
        return any(bool((c[:, 3] < 1.0).any()) for c in colours)

    def _draw_shadows(self, state: DrawnState, rows: NDArray[np.int64]) -> int:
        """Draw what the first directional light that casts shadows sees; returns which it is."""
        model = self._model
        directional = int(mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
        casts = np.flatnonzero(
            (model.light_type == directional)
            & (np.asarray(model.light_castshadow) != 0)
            & (np.asarray(model.light_active) != 0)
        )
        if not len(casts):
            return -1
        light = int(casts[0])
        direction = state.derived("light_xdir")[rows][:, light]
        finite = ~self._geometry.infinite & (self._types != int(mujoco.mjtGeom.mjGEOM_PLANE))
        geoms = self._geometry.geoms[finite]
        places = state.derived("geom_xpos")[rows][:, geoms]
        reach = model.geom_rbound[geoms]
        low = (places - reach[:, None]).min(axis=1, initial=1e9)
        high = (places + reach[:, None]).max(axis=1, initial=-1e9)
        centre, radius = (low + high) / 2, np.linalg.norm(high - low, axis=1) / 2 + 1e-3
        self._numbers["shadowViews"].upload(_sun_views(direction, centre, radius))
        if self._shadow_map is None or self._shadow_map.layers != len(rows):
            if self._shadow_map is not None:
                self._shadow_map.close()
            self._shadow_map = ShadowMap(_SHADOW_PIXELS, len(rows), _SHADOW_UNIT)
        self._shadow_map.begin()
        values = {**_UNITS, "geomCount": len(self._geometry.geoms)}
        self._shadow.use(values)
        for (first, count), drawn in zip(self._geometry.ranges, finite, strict=True):
            if drawn:
                self._buffers.draw(int(first), int(count), len(rows))
        self._shadow_map.end()
        return light

    def close(self) -> None:
        """Free the context and everything in it."""
        self.context.close()


class _Rows:
    """Model fields of some environments, (n or 1, count, width)."""

    def __init__(self, state: DrawnState, rows: NDArray[np.int64]) -> None:
        self._state, self._rows = state, rows

    def __call__(self, name: str, width: int) -> NDArray[Any]:
        values = self._state.model_values(name)
        found = values if len(values) == 1 else values[self._rows]
        return found.reshape(len(found), -1, width) if width else found.reshape(len(found), -1)


def _projection(optics: Optics, focal: NDArray[Any], centre: NDArray[Any]) -> NDArray[np.float64]:
    """(n, 4, 4) OpenGL projections, upside down, so that the first row read is the top."""
    near, far = optics.near, optics.far
    width, height = optics.width, optics.height
    found = np.zeros((max(len(focal), len(centre)), 4, 4))
    found[:, 0, 0] = 2.0 * focal[:, 0] / width
    found[:, 0, 2] = 1.0 - 2.0 * centre[:, 0] / width
    found[:, 1, 1] = -2.0 * focal[:, 1] / height
    found[:, 1, 2] = 1.0 - 2.0 * centre[:, 1] / height
    found[:, 2, 2], found[:, 2, 3] = -(far + near) / (far - near), -2.0 * far * near / (far - near)
    found[:, 3, 2] = -1.0
    return found


def _rays(
    optics: Optics, focal: NDArray[Any], centre: NDArray[Any], axes: NDArray[Any]
) -> tuple[Any, Any, Any]:
    """(n, 3) each: the ray through the top left corner, and what one width and one height add."""
    x, y = -centre[:, :1] / focal[:, :1], centre[:, 1:] / focal[:, 1:]
    right, up, back = axes[..., 0], axes[..., 1], axes[..., 2]
    corner = x * right + y * up - back
    return corner, right * optics.width / focal[:, :1], -up * optics.height / focal[:, 1:]


def _sun_views(direction: NDArray[Any], centre: NDArray[Any], radius: NDArray[Any]) -> F32:
    """(n, 4, 4) orthographic projections along light onto spheres."""
    back = -direction / np.linalg.norm(direction, axis=1, keepdims=True)
    upwards = np.where(np.abs(back[:, 2:]) > 0.9, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    right = np.cross(upwards, back)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    up = np.cross(back, right)
    found = np.zeros((len(back), 4, 4), np.float32)
    for row, (axis, sign) in enumerate(((right, 1.0), (up, 1.0), (back, -1.0))):
        found[:, row, :3] = sign * axis / radius[:, None]
        found[:, row, 3] = -sign * (axis * centre).sum(axis=1) / radius
    found[:, 3, 3] = 1.0
    return found
