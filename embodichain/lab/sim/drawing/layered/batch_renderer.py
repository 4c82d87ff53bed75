"""`BatchRenderer`: draws N environments x M cameras in one call, from the arrays of a batch.

Sizes, colours, textures, lights and cameras are those of each environment. Pictures do not depend
on N or on the other environments.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.geometry import SceneGeometry, overlay_geometry
from embodichain.lab.sim.drawing.gl import Context, NumberTexture, Program, VertexBuffers
from embodichain.lab.sim.drawing.layered import shaders
from embodichain.lab.sim.drawing.layered.lighting import (
    casters,
    light_table,
    positional,
    shadow_views,
)
from embodichain.lab.sim.drawing.layered.projections import EYE_ROW, VIEW_ROWS, view_table
from embodichain.lab.sim.drawing.layered.targets import (
    OUTPUT_BYTES,
    PictureTarget,
    ShadowMaps,
    picture_bytes,
)
from embodichain.lab.sim.drawing.layered.textures import SceneTextures
from embodichain.lab.sim.drawing.looks import SurfaceTable, Unchanged
from embodichain.lab.sim.drawing.marks import MarkedState
from embodichain.lab.sim.drawing.overlays import Overlay, Part, PartKind
from embodichain.lab.sim.drawing.views import DrawnState, Output, Pictures, View
from embodichain.utils.errors import RenderError
from embodichain.utils.system import platforms

__all__ = ["BatchRenderer"]

_log = logging.getLogger(__name__)

Index = NDArray[np.int64]
_CHUNK_BYTES = 256 * 2**20
"""Memory of what is drawn at once; and of all targets that are kept."""


@dataclass(frozen=True)
class _Detail:
    """How finely shapes are drawn.

    Attributes:
        longest_side: Pixels of the largest picture that is drawn so, in fast look.
        slices: Around round geoms.
        triangles: Most triangles of a mesh; None draws all.
    """

    longest_side: float
    slices: int
    triangles: int | None


_DETAILS = (
    _Detail(longest_side=128, slices=24, triangles=150),
    _Detail(longest_side=256, slices=24, triangles=400),
    _Detail(longest_side=400, slices=24, triangles=1500),
    _Detail(longest_side=np.inf, slices=32, triangles=None),
)
_FULL_DETAIL = len(_DETAILS) - 1
_SHADOW_DETAIL = 1
_OVERLAY_FINISH = 0.1, 0.3, 0.15, -1.0
"""Specular, shininess, emission and no texture, of what pictures show beside the scene."""


@dataclass(frozen=True)
class _TargetKind:
    """Pictures that can be layers of one target.

    Depth and mask have one sample a pixel, colour in full look has four.

    Attributes:
        width, height: Pixels.
        outputs: What is drawn of each.
        is_full: Whether they are drawn in full look.
    """

    width: int
    height: int
    outputs: tuple[Output, ...]
    is_full: bool

    @property
    def samples(self) -> int:
        """Samples of a pixel, along each side."""
        return 2 if self.is_full else 1


class BatchRenderer:
    """Draws a scene. Call it from one thread only.

    Args:
        model: The compiled scene.
        mark: Called with the name of each part when it is done: ``upload``, ``draw``, ``read``.

    Attributes:
        about: OpenGL's renderer and version.

    Raises:
        RenderError: If OpenGL does not work here.
    """

    def __init__(
        self, model: mujoco.MjModel, mark: Callable[[str], object] = lambda name: None
    ) -> None:
        self.context = Context()
        self.about = f"{self.context.renderer}, OpenGL {self.context.version}"
        self._model = model
        self._mark = mark
        _warn_of_what_is_not_drawn(model)

        # The scene: the same for all pictures.
        self._textures = SceneTextures(model)
        self._surfaces = SurfaceTable(model, self._textures.layers)
        self._meshes: dict[int, _Meshes] = {}  # level of detail -> its triangles
        self._overlay_meshes: _OverlayMeshes | None = None

        # What the programs read.
        self._programs: dict[Any, Program] = {}
        names = ("poses", "looks", "views", "lights", "shadowViews", "order")
        self._numbers = {name: NumberTexture(shaders.UNITS[name]) for name in names}
        self._uniforms: dict[str, Any] = {}

        # What they draw into.
        self._targets: dict[tuple[_TargetKind, int], PictureTarget] = {}
        self._shadow_maps: ShadowMaps | None = None
        self._shadows_same = Unchanged()

    def draw(
        self, state: DrawnState, views: Sequence[View], envs: Index | None = None
    ) -> list[Pictures]:
        """Draw every view of n environments.

        Args:
            state: The environments.
            views: The cameras.
            envs: (n,) which environments; None is all N.

        Returns:
            The pictures of each view, n rows each.

        Raises:
            RenderError: If the pictures are larger than OpenGL's, or than this machine's memory.
        """
        rows = np.arange(state.num_envs) if envs is None else envs
        self._refuse_too_large(views, len(rows))
        self.context.make_current()
        self._surfaces.update(state)
        size = self._chunk_size(views)
        starts = range(0, max(len(rows), 1), size)
        chunks = [self._draw_chunk(state, views, rows[start : start + size]) for start in starts]
        if len(chunks) == 1:
            return chunks[0]
        return [_joined(pictures_of_view) for pictures_of_view in zip(*chunks, strict=True)]

    def _refuse_too_large(self, views: Sequence[View], count: int) -> None:
        total = 0
        for view in views:
            width = view.optics.width
            height = view.optics.height
            samples = _samples(view)
            if max(width, height) * samples > self.context.max_pixels:
                most = self.context.max_pixels // samples
                message = f"a picture of {width} x {height} is too large"
                raise RenderError(f"{message}: the most in {view.look} look is {most} a side")
            total += count * width * height * len(view.outputs) * OUTPUT_BYTES
            total += picture_bytes(width, height, samples)
        memory = platforms.memory_bytes()
        if total > memory:
            sizes = ", ".join(f"{v.optics.width} x {v.optics.height}" for v in views)
            message = f"pictures of {count} environments ({sizes}) take {total / 2**30:.1f} GiB"
            raise RenderError(
                f"{message}; this machine has {memory / 2**30:.1f}: draw fewer, or smaller ones"
            )

    def _chunk_size(self, views: Sequence[View]) -> int:
        """How many environments are drawn at once: bounded by layers, and by memory."""
        env_bytes = sum(
            picture_bytes(view.optics.width, view.optics.height, _samples(view)) for view in views
        )
        by_memory = _CHUNK_BYTES // max(1, env_bytes)
        by_layers = self.context.max_layers // max(1, len(views))
        return max(1, min(by_memory, by_layers))

    def _draw_chunk(self, state: DrawnState, views: Sequence[View], rows: Index) -> list[Pictures]:
        frame = _Frame(state, rows, self._surfaces)
        self._upload(frame)
        pictures: list[Pictures] = [{} for _ in views]
        for kind, members in _by_target(views).items():
            members_views = [views[index] for index in members]
            table = view_table(members_views, rows)
            self._numbers["views"].upload(table)
            self._mark("upload")
            target = self._target(kind, layers=len(members) * len(rows))
            far = max(view.optics.far for view in members_views)
            drawn = self._draw_into(target, frame, table, far=float(far), full=kind.is_full)
            for name, values in drawn.items():
                parts = values.reshape(len(members), len(rows), *values.shape[1:])
                for part, index in zip(parts, members, strict=True):
                    pictures[index][name] = part
        return pictures

    def _target(self, kind: _TargetKind, layers: int) -> PictureTarget:
        key = (kind, layers)
        if key not in self._targets:
            target = PictureTarget(
                width=kind.width,
                height=kind.height,
                layers=layers,
                outputs=kind.outputs,
                samples=kind.samples,
            )
            # Sizes change when films of other sizes are made: free the oldest.
            while self._targets and target.bytes + self._target_bytes() > _CHUNK_BYTES:
                self._targets.pop(next(iter(self._targets))).close()
            self._targets[key] = target
        return self._targets[key]

    def _target_bytes(self) -> int:
        return sum(target.bytes for target in self._targets.values())

    def _upload(self, frame: _Frame) -> None:
        self._numbers["poses"].upload(frame.poses)
        self._numbers["looks"].upload(frame.looks)
        self._numbers["lights"].upload(frame.lights)

    # -- passes --------------------------------------------------------------------------------

    def _draw_into(
        self,
        target: PictureTarget,
        frame: _Frame,
        table: NDArray[np.float32],
        *,
        far: float,
        full: bool,
    ) -> dict[str, NDArray[Any]]:
        """Draw the pictures of one target, and read them.

        Args:
            target: Where to.
            frame: The environments.
            table: The views, see `view_table`.
            far: Largest distance that any of them shows, in metres.
            full: Whether in full look.

        Returns:
            (layers, H, W, ...) of each output.
        """
        has_colour = "color" in target.outputs
        has_sky = self._textures.sky >= 0
        layers = target.layers
        self._set_uniforms(far, geom_count=frame.poses.shape[1])

        lights = casters(frame.state) if full else ()
        defines: dict[str, object] = {"LIGHTS": self._model.nlight, "SHADOW_MAPS": len(lights)}
        if lights:
            defines["MAP_OF_LIGHT"] = _map_of_light(lights, self._model.nlight)
            self._draw_shadows(frame, lights, max(target.size), defines)
        if frame.positional:
            defines["POSITIONAL"] = 1
        if full:
            defines["FULL"] = 1
            if has_sky:
                defines["HAZE"] = 1

        # First stage: the nearest surface of each sample, and transparent ones apart.
        meshes = self._meshes_of(_level_of_detail(target, full))
        target.begin_surfaces()
        for surface in meshes.kinds(self._surfaces.textured if has_colour else None):
            self._use("surfaces", {"LIGHTS": self._model.nlight, **surface.defines})
            meshes.buffers.draw(surface.key, layers)
        has_overlay = has_colour and bool(self._surfaces.transparent.any() or frame.parts)
        if has_overlay:
            target.begin_overlay()
            self._draw_transparent(meshes, frame, table, defines)

        # Second stage: pixels. What is added is drawn where their depth is larger than `closer`:
        # at edges (1), where the sky is seen (0.5), but not where all is drawn (0).
        draw_whole = meshes.buffers.draw_whole
        target.begin_pictures()
        self._use("shading", {**defines, "COLOUR": int(has_colour)}, closer=0.0)
        draw_whole(layers)
        if full:
            target.add()
            self._use("shading", {**defines, "EDGES": 1}, closer=0.75)
            draw_whole(layers)
        if has_colour:
            target.add_behind()
            self._use("sky", {**defines, "SKY": 1} if has_sky else defines, closer=0.25)
            draw_whole(layers)
        if has_overlay:
            target.add_over()
            self._use("overlay", defines, closer=0.0)
            draw_whole(layers)
        self._mark("draw")
        pictures = {name: target.read(name) for name in target.outputs}
        self._mark("read")
        return pictures

    def _meshes_of(self, level: int) -> _Meshes:
        if level not in self._meshes:
            detail = _DETAILS[level]
            geometry = SceneGeometry.of_model(self._model, detail.slices, detail.triangles)
            self._meshes[level] = _Meshes(geometry, self._model)
        return self._meshes[level]

    def _use(self, name: str, defines: dict[str, object], **uniforms: float) -> None:
        """Make the program of a kind and of `defines` current."""
        key = name, *defines.items()
        program = self._programs.get(key)
        if program is None:
            vertex, fragment = getattr(shaders, name)(defines)
            program = Program(vertex, fragment)
            self._programs[key] = program
        program.use({**self._uniforms, **uniforms})

    def _set_uniforms(self, far: float, geom_count: int) -> None:
        headlight = self._model.vis.headlight
        brightness = 1.0 if headlight.active else 0.0
        self._uniforms = {
            "geomCount": geom_count,
            "far": far,
            "sky": float(self._textures.sky),
            "haze": tuple(self._model.vis.rgba.haze[:3].tolist()),
            "hazeReach": float(self._model.vis.map.zfar * self._model.stat.extent),
            "headDiffuse": tuple((brightness * headlight.diffuse).tolist()),
            "headSpecular": tuple((brightness * headlight.specular).tolist()),
        }

    def _draw_transparent(
        self,
        meshes: _Meshes,
        frame: _Frame,
        table: NDArray[np.float32],
        defines: dict[str, object],
    ) -> None:
        """Draw transparent geoms of every picture, those far from its eye first."""
        in_scene = [g for g in np.flatnonzero(self._surfaces.transparent) if g in meshes.geoms]
        in_overlay = range(self._model.ngeom, self._model.ngeom + len(frame.parts))
        geoms = np.array([*in_scene, *in_overlay], np.int64)
        if not len(geoms):
            return
        eyes = table.reshape(-1, VIEW_ROWS, 4)[:, EYE_ROW]
        rows = eyes[:, 3].astype(np.int64)
        offsets = frame.poses[rows][:, geoms][..., 3] - eyes[:, None, :3]
        ranks = np.argsort(-(offsets**2).sum(axis=2), axis=1, kind="stable")
        # The k-th geom of pictures is drawn before the next of any; pictures that agree, at once.
        order: list[NDArray[np.int64]] = []
        draws: list[tuple[int, int, int]] = []
        first = 0
        for rank in ranks.T:
            for place in np.unique(rank):
                layers = np.flatnonzero(rank == place)
                draws.append((int(geoms[place]), first, len(layers)))
                order.append(layers)
                first += len(layers)
        numbers = np.zeros((first, 4), np.float32)
        numbers[:, 0] = np.concatenate(order)
        self._numbers["order"].upload(numbers)
        for geom, start, count in draws:
            if geom >= self._model.ngeom:
                self._use("transparent", defines, firstOfOrder=start)
                self._meshes_of_overlay(frame.parts).buffers.draw(geom, count)
                continue
            surface = meshes.single(geom, self._surfaces.textured)
            self._use("transparent", {**defines, **surface.defines}, firstOfOrder=start)
            meshes.buffers.draw(surface.key, count)

    def _meshes_of_overlay(self, parts: Sequence[Part]) -> _OverlayMeshes:
        kinds = tuple(part.kind for part in parts)
        if self._overlay_meshes is None or self._overlay_meshes.kinds != kinds:
            if self._overlay_meshes is not None:
                self._overlay_meshes.close()
            self._overlay_meshes = _OverlayMeshes(kinds, first=self._model.ngeom)
        return self._overlay_meshes

    def _draw_shadows(
        self, frame: _Frame, lights: tuple[int, ...], pixels: int, defines: dict[str, object]
    ) -> None:
        """Draw what lights see, unless it is what they saw in the last call."""
        meshes = self._meshes_of(_SHADOW_DETAIL)
        # 0.8 of the picture's side, rounded up to 128 pixels.
        side = int(np.clip(128 * -(-0.8 * pixels // 128), 256, 2048))
        layers = len(frame.rows) * len(lights)
        views = shadow_views(frame.state, frame.rows, lights, meshes.solid)
        same = self._shadows_same([views, frame.poses, self._surfaces.table, frame.lights])
        maps = self._shadow_maps
        if maps is None or (maps.pixels, maps.layers) != (side, layers):
            if maps is not None:
                maps.close()
            maps = ShadowMaps(side, layers)
            self._shadow_maps = maps
        elif same:
            return
        self._numbers["shadowViews"].upload(views)
        maps.begin()
        self._use("shadows", {name: defines[name] for name in ("LIGHTS", "SHADOW_MAPS")})
        meshes.buffers.draw("solid", layers)
        maps.open_surfaces()
        meshes.buffers.draw("fields", layers)
        maps.end()

    def close(self) -> None:
        """Free the context and everything in it."""
        self.context.make_current()
        parts: list[Any] = [*self._meshes.values(), *self._programs.values(), self._textures]
        if self._overlay_meshes is not None:
            parts.append(self._overlay_meshes)
        for part in [*parts, *self._numbers.values(), *self._targets.values()]:
            part.close()
        if self._shadow_maps is not None:
            self._shadow_maps.close()
        self.context.close()


def _warn_of_what_is_not_drawn(model: mujoco.MjModel) -> None:
    for name, kind, count in (
        ("flexes", mujoco.mjtObj.mjOBJ_FLEX, model.nflex),
        ("skins", mujoco.mjtObj.mjOBJ_SKIN, model.nskin),
    ):
        if count:
            names = [mujoco.mj_id2name(model, int(kind), i) or str(i) for i in range(count)]
            _say_once(f"{name} are not drawn: {', '.join(names)}")


@cache
def _say_once(message: str) -> None:
    _log.warning(message)


class _Frame:
    """Numbers of the environments that are drawn at once."""

    def __init__(self, state: DrawnState, rows: Index, surfaces: SurfaceTable) -> None:
        model = state.model
        self.state = state
        self.rows = rows
        overlay = state.overlay if isinstance(state, MarkedState) else Overlay()
        self.parts = overlay.parts()
        is_all = len(rows) == state.num_envs and bool((rows == np.arange(len(rows))).all())
        index: Any = slice(None) if is_all else rows  # a slice copies once less
        count = model.ngeom + len(self.parts)
        self.poses = np.empty((len(rows), count, 3, 4), np.float32)
        matrices = state.derived("geom_xmat").reshape(state.num_envs, model.ngeom, 3, 3)
        self.poses[:, : model.ngeom, :, :3] = matrices[index]
        self.poses[:, : model.ngeom, :, 3] = state.derived("geom_xpos")[index]
        for geom, part in enumerate(self.parts, model.ngeom):
            self.poses[:, geom, :, :3] = part.axes[index]
            self.poses[:, geom, :, 3] = part.positions[index]
        self.looks = surfaces.table
        if self.parts:
            self.looks = _with_parts(surfaces.table, self.parts)
        looks_are_shared = len(self.looks) == 1
        look_rows = np.zeros_like(rows) if looks_are_shared else rows
        self.lights = light_table(state, rows, look_rows)
        self.positional = positional(state)


def _with_parts(table: NDArray[np.float32], parts: Sequence[Part]) -> NDArray[np.float32]:
    """(N, ngeom + len(parts), 4, 4) a table of `SurfaceTable` with the parts of an overlay."""
    num_envs = len(parts[0].positions)
    extra = np.zeros((num_envs, len(parts), 4, 4), np.float32)
    extra[:, :, 2] = _OVERLAY_FINISH
    extra[:, :, 3, 2] = -1.0
    for place, part in enumerate(parts):
        extra[:, place, 0, :3] = part.sizes
        extra[:, place, 1] = part.colors
    scene = np.broadcast_to(table, (num_envs, *table.shape[1:]))
    return np.concatenate([scene, extra], axis=1)


class _OverlayMeshes:
    """Triangles of the parts of an overlay; the list of each is its id among the geoms."""

    def __init__(self, kinds: tuple[PartKind, ...], first: int) -> None:
        self.kinds = kinds
        geometry = overlay_geometry(kinds, first, slices=_DETAILS[_FULL_DETAIL].slices)
        self.buffers = VertexBuffers(geometry.vertices)
        for geom, triangles in geometry.triangles.items():
            self.buffers.put(geom, [triangles])

    def close(self) -> None:
        """Free it."""
        self.buffers.close()


@dataclass(frozen=True)
class _SurfaceKind:
    """Surfaces that one program draws.

    Attributes:
        defines: What the program is compiled for.
        key: The list of their triangles in the buffers.
    """

    defines: dict[str, object]
    key: Any


class _Meshes:
    """Triangles of one level of detail, in lists of what one program draws."""

    def __init__(self, geometry: SceneGeometry, model: mujoco.MjModel) -> None:
        self._triangles = geometry.triangles
        self.geoms = set(geometry.triangles)
        self.buffers = VertexBuffers(geometry.vertices)
        casting = [g for g in geometry.triangles if model.geom_castshadow[g]]
        solid = [g for g in casting if g not in geometry.planes]
        self.solid = np.array(solid, np.int64)
        # Height fields have no inside: both of their sides are drawn into shadow maps.
        fields = [geometry.triangles[g] for g in solid if g in geometry.fields]
        closed = [geometry.triangles[g] for g in solid if g not in geometry.fields]
        self.buffers.put("solid", closed)
        self.buffers.put("fields", fields)
        self._textured = Unchanged()

    def kinds(self, textured: NDArray[np.bool_] | None) -> list[_SurfaceKind]:
        """Return every kind of surface; geoms without texture are first.

        Args:
            textured: (ngeom, 2) see `SurfaceTable`; None draws all without.
        """
        if textured is None:
            textured = np.zeros((max(self.geoms, default=0) + 1, 2), bool)
            lists = "all"
            is_current = True
        else:
            lists = "kinds"
            is_current = self._textured([textured])
        kind_of = {g: (bool(textured[g, 0]), bool(textured[g, 1])) for g in self._triangles}
        kinds = sorted(set(kind_of.values()))
        for kind in kinds:
            key = (lists, kind)
            if not is_current or not self.buffers.has(key):
                triangles = [t for g, t in self._triangles.items() if kind_of[g] == kind]
                self.buffers.put(key, triangles)
        return [_SurfaceKind(_texture_defines(kind), (lists, kind)) for kind in kinds]

    def single(self, geom: int, textured: NDArray[np.bool_]) -> _SurfaceKind:
        """Return one geom, as a kind of its own."""
        if not self.buffers.has(geom):
            self.buffers.put(geom, [self._triangles[geom]])
        return _SurfaceKind(_texture_defines(textured[geom]), geom)

    def close(self) -> None:
        """Free it."""
        self.buffers.close()


def _texture_defines(kind: Any) -> dict[str, object]:
    has_square, has_cube = kind
    defines: dict[str, object] = {}
    if has_square:
        defines["TEXTURE_2D"] = 1
    if has_cube:
        defines["TEXTURE_CUBE"] = 1
    return defines


def _map_of_light(lights: tuple[int, ...], count: int) -> str:
    """GLSL of an array: for each of `count` lights its shadow map, or -1."""
    maps = [lights.index(light) if light in lights else -1 for light in range(count)]
    numbers = ", ".join(map(str, maps))
    return f"int[{count}]({numbers})"


def _samples(view: View) -> int:
    """Samples of a pixel along each side, of what takes most of a view's memory."""
    return 2 if view.look == "full" else 1


def _level_of_detail(target: PictureTarget, full: bool) -> int:
    """Return the first of `_DETAILS` that is fine enough for a target."""
    if full:
        return _FULL_DETAIL
    longest = max(target.size)
    return sum(longest > detail.longest_side for detail in _DETAILS)


def _by_target(views: Sequence[View]) -> dict[_TargetKind, list[int]]:
    """Group views, as their indices, whose pictures are layers of one target."""
    groups: dict[_TargetKind, list[int]] = {}

    def add(index: int, outputs: tuple[Output, ...], is_full: bool) -> None:
        optics = views[index].optics
        kind = _TargetKind(optics.width, optics.height, outputs, is_full=is_full)
        groups.setdefault(kind, []).append(index)

    for index, view in enumerate(views):
        outputs = view.outputs
        if "color" in outputs and view.look == "full":
            add(index, ("color",), is_full=True)
            outputs = tuple(name for name in outputs if name != "color")
        if outputs:
            add(index, outputs, is_full=False)
    return groups


def _joined(parts: Sequence[Pictures]) -> Pictures:
    """Join the pictures of one view from several environments."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
