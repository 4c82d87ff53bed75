"""`BatchRenderer`: draws N environments x M cameras in one call, from the arrays of a batch.

Sizes, colours, textures, lights and cameras are those of each environment. Pictures do not depend
on N or on the other environments.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.drawing.geometry import SceneGeometry
from embodichain.lab.sim.drawing.gl import Context, NumberTexture, Program, VertexBuffers
from embodichain.lab.sim.drawing.layered import shaders
from embodichain.lab.sim.drawing.layered.lighting import (
    casters,
    light_table,
    positional,
    shadow_views,
)
from embodichain.lab.sim.drawing.layered.projections import view_table
from embodichain.lab.sim.drawing.layered.targets import (
    OUTPUT_BYTES,
    PictureTarget,
    ShadowMaps,
    picture_bytes,
)
from embodichain.lab.sim.drawing.layered.textures import SceneTextures
from embodichain.lab.sim.drawing.looks import SurfaceTable, Unchanged
from embodichain.lab.sim.drawing.views import DrawnState, Pictures, View
from embodichain.utils.errors import RenderError
from embodichain.utils.system import platforms

__all__ = ["BatchRenderer"]

_log = logging.getLogger(__name__)

Index = NDArray[np.int64]
_CHUNK_BYTES = 256 * 2**20
"""Memory of what is drawn at once; and of all targets that are kept."""
_DETAILS = ((128, 24, 150), (256, 24, 400), (400, 24, 1500))
"""Longest side of a picture in fast look, slices of round geoms, triangles of a mesh."""
_SLICES = 32
_SHADOW_DETAIL = 1
_TEXTURE_DEFINES = ("TEXTURE_2D", "TEXTURE_CUBE")


class BatchRenderer:
    """Draws a scene. Call it from one thread only.

    Args:
        model: The compiled scene.
        mark: Called with the name of each part when it is done: ``upload``, ``draw``, ``read``.

    Raises:
        RenderError: If OpenGL does not work here.
    """

    def __init__(
        self, model: mujoco.MjModel, mark: Callable[[str], object] = lambda name: None
    ) -> None:
        self.context = Context()
        self._model, self._mark = model, mark
        _warn_of_what_is_not_drawn(model)
        self._textures = SceneTextures(model)
        self._surfaces = SurfaceTable(model, self._textures.layers)
        self._meshes: dict[int, _Meshes] = {}
        self._programs: dict[Any, Program] = {}
        names = ("poses", "looks", "views", "lights", "shadowViews", "order")
        self._numbers = {name: NumberTexture(shaders.UNITS[name]) for name in names}
        self._targets: dict[Any, PictureTarget] = {}
        self._shadow_maps: ShadowMaps | None = None
        self._shadows_same = Unchanged()
        self._uniforms: dict[str, Any] = {}

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
        most = self._most(views)
        starts = range(0, max(len(rows), 1), most)
        chunks = [self._draw_chunk(state, views, rows[start : start + most]) for start in starts]
        if len(chunks) == 1:
            return chunks[0]
        return [
            {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
            for parts in zip(*chunks, strict=True)
        ]

    def _refuse_too_large(self, views: Sequence[View], count: int) -> None:
        total = 0
        for view in views:
            width, height = view.optics.width, view.optics.height
            samples = 2 if view.look == "full" else 1
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

    def _most(self, views: Sequence[View]) -> int:
        """How many environments are drawn at once: bounded by layers, and by memory."""
        each = sum(
            picture_bytes(v.optics.width, v.optics.height, 2 if v.look == "full" else 1)
            for v in views
        )
        by_memory = _CHUNK_BYTES // max(1, each)
        return max(1, min(by_memory, self.context.max_layers // max(1, len(views))))

    def _draw_chunk(self, state: DrawnState, views: Sequence[View], rows: Index) -> list[Pictures]:
        frame = _Frame(state, rows, self._surfaces)
        self._upload(frame)
        found: list[Pictures] = [{} for _ in views]
        for (width, height, outputs, full), members in _groups(views).items():
            of_group = [views[i] for i in members]
            table = view_table(of_group, rows)
            self._numbers["views"].upload(table)
            self._mark("upload")
            target = self._target(width, height, len(members) * len(rows), outputs, full)
            pictures = self._draw_into(target, frame, of_group, table, full)
            for name, values in pictures.items():
                parts = values.reshape(len(members), len(rows), *values.shape[1:])
                for part, index in zip(parts, members, strict=True):
                    found[index][name] = part
        return found

    def _target(
        self, width: int, height: int, layers: int, outputs: Any, full: bool
    ) -> PictureTarget:
        key = width, height, layers, outputs, full
        if key not in self._targets:
            target = PictureTarget(width, height, layers, outputs, 2 if full else 1)
            # Sizes change when films of other sizes are made: free the oldest.
            while self._targets and target.bytes + self._kept_bytes() > _CHUNK_BYTES:
                self._targets.pop(next(iter(self._targets))).close()
            self._targets[key] = target
        return self._targets[key]

    def _kept_bytes(self) -> int:
        return sum(target.bytes for target in self._targets.values())

    def _upload(self, frame: _Frame) -> None:
        self._numbers["poses"].upload(frame.poses)
        self._numbers["looks"].upload(self._surfaces.table)
        self._numbers["lights"].upload(frame.lights)

    # -- passes --------------------------------------------------------------------------------

    def _draw_into(
        self,
        target: PictureTarget,
        frame: _Frame,
        views: Sequence[View],
        table: NDArray[np.float32],
        full: bool,
    ) -> dict[str, NDArray[Any]]:
        colour, layers = "color" in target.outputs, target.layers
        self._set_uniforms(float(max(view.optics.far for view in views)))
        lit = casters(frame.state) if full else ()
        defines: dict[str, object] = {"LIGHTS": self._model.nlight, "SHADOW_MAPS": len(lit)}
        if lit:
            slots = [lit.index(i) if i in lit else -1 for i in range(self._model.nlight)]
            numbers = ", ".join(map(str, slots))
            defines["MAP_OF_LIGHT"] = f"int[{len(slots)}]({numbers})"
            self._draw_shadows(frame, lit, max(target.size), defines)
        meshes = self._meshes_for(target, full)
        if frame.positional:
            defines["POSITIONAL"] = 1
        if full:
            defines["FULL"] = 1
            if self._textures.sky >= 0:
                defines["HAZE"] = 1
        target.begin_surfaces()
        for kind, key in meshes.kinds(self._surfaces.textured if colour else None):
            self._use("surfaces", {"LIGHTS": self._model.nlight, **kind})
            meshes.buffers.draw(key, layers)
        has_overlay = colour and bool(self._surfaces.transparent.any())
        if has_overlay:
            target.begin_overlay()
            self._draw_transparent(meshes, frame, table, defines)
        target.begin_pictures()
        self._draw_whole("shading", {**defines, "COLOUR": int(colour)}, meshes, layers)
        if full:
            target.add()
            self._draw_whole("shading", {**defines, "EDGES": 1}, meshes, layers, 0.75)
        if colour:
            target.add_behind()
            has_sky = {"SKY": 1} if self._textures.sky >= 0 else {}
            self._draw_whole("sky", {**defines, **has_sky}, meshes, layers, 0.25)
        if has_overlay:
            target.add_over()
            self._draw_whole("overlay", defines, meshes, layers)
        self._mark("draw")
        found = {name: target.read(name) for name in target.outputs}
        self._mark("read")
        return found

    def _draw_whole(
        self,
        name: str,
        defines: dict[str, object],
        meshes: _Meshes,
        layers: int,
        closer: float = 0.0,
    ) -> None:
        """Draw all of every picture, or the pixels whose depth is larger."""
        self._use(name, defines, closer=closer)
        meshes.buffers.draw_whole(layers)

    def _meshes_for(self, target: PictureTarget, full: bool) -> _Meshes:
        level = len(_DETAILS)
        if not full:
            longest = max(target.size)
            level = sum(longest > most for most, _, _ in _DETAILS)
        return self._meshes_of(level)

    def _meshes_of(self, level: int) -> _Meshes:
        if level not in self._meshes:
            detail = _DETAILS[level][1:] if level < len(_DETAILS) else (_SLICES, None)
            self._meshes[level] = _Meshes(SceneGeometry.of_model(self._model, *detail), self._model)
        return self._meshes[level]

    def _use(self, name: str, defines: dict[str, object], **uniforms: float) -> None:
        """Make the program of a kind and of `defines` current."""
        key = name, *defines.items()
        program = self._programs.get(key)
        if program is None:
            program = self._programs[key] = Program(*getattr(shaders, name)(defines))
        program.use({**self._uniforms, **uniforms})

    def _set_uniforms(self, far: float) -> None:
        headlight = self._model.vis.headlight
        on = 1.0 if headlight.active else 0.0
        self._uniforms = {
            "geomCount": int(self._model.ngeom),
            "far": far,
            "sky": float(self._textures.sky),
            "haze": tuple(self._model.vis.rgba.haze[:3].tolist()),
            "hazeReach": float(self._model.vis.map.zfar * self._model.stat.extent),
            "headDiffuse": tuple((on * headlight.diffuse).tolist()),
            "headSpecular": tuple((on * headlight.specular).tolist()),
        }

    def _draw_transparent(
        self,
        meshes: _Meshes,
        frame: _Frame,
        table: NDArray[np.float32],
        defines: dict[str, object],
    ) -> None:
        """Draw transparent geoms of every picture, those far from its eye first."""
        geoms = np.array(
            [g for g in np.flatnonzero(self._surfaces.transparent) if g in meshes.geoms]
        )
        if not len(geoms):
            return
        eyes = table.reshape(-1, 9, 4)[:, 4]
        rows = eyes[:, 3].astype(np.int64)
        gaps = frame.poses[rows][:, geoms][..., 3] - eyes[:, None, :3]
        ranks = np.argsort(-(gaps**2).sum(axis=2), axis=1, kind="stable")
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
            kind, key = meshes.single(geom, self._surfaces.textured)
            self._use("transparent", {**defines, **kind}, firstOfOrder=start)
            meshes.buffers.draw(key, count)

    def _draw_shadows(
        self, frame: _Frame, lit: tuple[int, ...], pixels: int, defines: dict[str, object]
    ) -> None:
        """Draw what lights see, unless it is what they saw in the last call."""
        meshes = self._meshes_of(_SHADOW_DETAIL)
        side = int(np.clip(128 * -(-0.8 * pixels // 128), 256, 2048))
        layers = len(frame.rows) * len(lit)
        seen = shadow_views(frame.state, frame.rows, lit, meshes.solid)
        same = self._shadows_same([seen, frame.poses, self._surfaces.table, frame.lights])
        maps = self._shadow_maps
        if maps is None or (maps.pixels, maps.layers) != (side, layers):
            if maps is not None:
                maps.close()
            maps = self._shadow_maps = ShadowMaps(side, layers)
        elif same:
            return
        self._numbers["shadowViews"].upload(seen)
        maps.begin()
        self._use("shadows", {k: defines[k] for k in ("LIGHTS", "SHADOW_MAPS")})
        meshes.buffers.draw("solid", layers)
        maps.open_surfaces()
        meshes.buffers.draw("fields", layers)
        maps.end()

    def close(self) -> None:
        """Free the context and everything in it."""
        self.context.make_current()
        parts: list[Any] = [*self._meshes.values(), *self._programs.values(), self._textures]
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
        self.state, self.rows = state, rows
        whole = len(rows) == state.num_envs and bool((rows == np.arange(len(rows))).all())
        pick: Any = slice(None) if whole else rows
        self.poses = np.empty((len(rows), model.ngeom, 3, 4), np.float32)
        matrices = state.derived("geom_xmat").reshape(state.num_envs, model.ngeom, 3, 3)
        self.poses[..., :3] = matrices[pick]
        self.poses[..., 3] = state.derived("geom_xpos")[pick]
        shared = len(surfaces.table) == 1
        self.lights = light_table(state, rows, np.zeros_like(rows) if shared else rows)
        self.positional = positional(state)


class _Meshes:
    """Triangles of one level of detail, in lists of what one program draws."""

    def __init__(self, geometry: SceneGeometry, model: mujoco.MjModel) -> None:
        self._triangles = geometry.triangles
        self.geoms = set(geometry.triangles)
        self.buffers = VertexBuffers(geometry.vertices)
        casting = [g for g in geometry.triangles if model.geom_castshadow[g]]
        self.solid = np.array([g for g in casting if g not in geometry.planes], np.int64)
        for name, fields in (("solid", False), ("fields", True)):
            chosen = [int(g) for g in self.solid if (int(g) in geometry.fields) == fields]
            self.buffers.put(name, [geometry.triangles[g] for g in chosen])
        self._textured = Unchanged()

    def kinds(self, textured: NDArray[np.bool_] | None) -> list[tuple[dict[str, object], Any]]:
        """Defines and list of every kind of surface; geoms without texture are first.

        Args:
            textured: (ngeom, 2) see `SurfaceTable`; None draws all without.
        """
        if textured is None:
            textured = np.zeros((max(self.geoms, default=0) + 1, 2), bool)
            flat = "all"
        else:
            flat = "kinds"
        kinds = {g: (bool(textured[g, 0]), bool(textured[g, 1])) for g in self._triangles}
        found = sorted(set(kinds.values()))
        fresh = flat == "all" or self._textured([textured])
        for kind in found:
            key = flat, kind
            if not fresh or not self.buffers.has(key):
                self.buffers.put(key, [t for g, t in self._triangles.items() if kinds[g] == kind])
        return [(_texture_defines(kind), (flat, kind)) for kind in found]

    def single(self, geom: int, textured: NDArray[np.bool_]) -> tuple[dict[str, object], Any]:
        """Defines and list of one geom."""
        if not self.buffers.has(geom):
            self.buffers.put(geom, [self._triangles[geom]])
        return _texture_defines(textured[geom]), geom

    def close(self) -> None:
        """Free it."""
        self.buffers.close()


def _texture_defines(kind: Any) -> dict[str, object]:
    return {name: 1 for name, has in zip(_TEXTURE_DEFINES, kind, strict=True) if has}


def _groups(views: Sequence[View]) -> dict[Any, list[int]]:
    """Views whose pictures are layers of one target: of one size, look and outputs.

    Depth and mask have one sample a pixel, colour in full look has four.
    """
    groups: dict[Any, list[int]] = {}
    for index, view in enumerate(views):
        size = view.optics.width, view.optics.height
        if "color" in view.outputs and view.look == "full":
            groups.setdefault((*size, ("color",), True), []).append(index)
        rest = tuple(o for o in view.outputs if o != "color" or view.look == "fast")
        if rest:
            groups.setdefault((*size, rest, False), []).append(index)
    return groups
