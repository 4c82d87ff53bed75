"""Events that change the look of a scene: materials, colours, textures, lights."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from embodichain.lab.gym.envs.managers.param_types import Box3, Frames, NamedEntity, Range, Whole
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term, Uniform
from embodichain.lab.gym.envs.managers.terms.registry import register_term
from embodichain.lab.gym.envs.mdp._rows import norm
from embodichain.lab.sim.compiler.names import SUN
from embodichain.lab.sim.configs.scene_cfg import LightCfg
from embodichain.lab.sim.shapes import VisualMaterialCfg
from embodichain.utils.arrays import rows_at
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.lab.sim.objects.light import Light
    from embodichain.utils.array_types import Floats

__all__ = [
    "RandomizeLight",
    "RandomizeTexture",
    "RandomizeVisualMaterial",
    "SetRigidObjectVisualMaterial",
]

_HIDDEN_GROUP = 3
_NO_GEOM_COLOR = (0.5, 0.5, 0.5, 1.0)
"""MuJoCo's default of a geom's colour, for which it draws the material's."""


class _Surface:
    """The colours of an entity's visible shapes, and the materials of an object.

    An object has its own materials. Links and geoms may share materials, so for a robot, or for
    picked geoms, the colours of shapes are written, which override a material's in MuJoCo.
    """

    def __init__(self, entity: ResolvedEntity) -> None:
        asset = entity.asset
        self._engine = asset.engine
        model = asset.engine.model
        geoms = np.asarray(asset.index.geom_ids)
        if entity.kind == "geom":
            geoms = np.arange(model.ngeom)[entity.frames.ids]
        elif entity.link_ids:
            picked_bodies = np.arange(model.nbody)[entity.frames.bodies]
            geoms = geoms[np.isin(model.geom_bodyid[geoms], picked_bodies)]
        visible_geoms = [int(geom) for geom in geoms if model.geom_group[geom] < _HIDDEN_GROUP]
        if not visible_geoms:
            raise ConfigError([Problem("entity_cfg", f"no part of {entity.uid!r} is visible")])
        self._geoms = visible_geoms
        self._materials = sorted({int(model.geom_matid[geom]) for geom in visible_geoms})
        self.is_object = not entity.is_articulation and entity.kind != "geom"
        if self.is_object:
            self._color_field = "mat_rgba"
            rows = self._materials
        else:
            self._color_field = "geom_rgba"
            rows = visible_geoms
        # Red, green and blue, of four columns each: opacity does not change.
        self._columns: NDArray[np.int64] = np.concatenate([4 * row + np.arange(3) for row in rows])
        self._seen_colors = self._compiled_colors()

    def _compiled_colors(self) -> Floats:
        """(3 k,) the colours that are seen of the shapes: a material's where a geom has none."""
        model = self._engine.model
        if self._color_field == "mat_rgba":
            return np.asarray(model.mat_rgba[self._materials, :3], np.float64).reshape(-1)
        colors: list[Floats] = []
        for geom in self._geoms:
            rgba = model.geom_rgba[geom]
            material = model.geom_matid[geom]
            if material >= 0 and (rgba == _NO_GEOM_COLOR).all():
                rgba = model.mat_rgba[material]
            colors.append(np.asarray(rgba[:3], np.float64))
        return np.concatenate(colors)

    def paint(self, rgb: Floats, env_ids: EnvIndex | None, strength: float = 1.0) -> None:
        """Set the colours (n, 3) of all shapes; opacity does not change.

        Args:
            rgb: The colours at strength 1.
            env_ids: (n,) environments, or None for all.
            strength: See `EventCfg.strength`; 0 is the compiled colours.
        """
        count = len(self._columns) // 3
        colors = np.tile(rgb, (1, count))
        if strength == 0.0:
            compiled = getattr(self._engine.model, self._color_field).reshape(-1)
            colors = np.tile(np.asarray(compiled[self._columns], np.float64), (len(rgb), 1))
        elif strength < 1.0:
            colors = self._seen_colors + strength * (colors - self._seen_colors)
        self._engine.write_model(self._color_field, colors, env_ids, self._columns)

    def fade(self, alpha: float, env_ids: EnvIndex | None) -> None:
        """Set an object's opacity."""
        self._write("mat_rgba", alpha, env_ids, width=4, column=3)

    def finish(
        self,
        metallic: Floats | float | None,
        roughness: Floats | float | None,
        env_ids: EnvIndex | None,
    ) -> None:
        """Set an object's metallic value and roughness, (n, 1) or one for all.

        MuJoCo's rasterizer draws highlights instead: specular = (1 - roughness) / 2, shininess =
        1 - roughness, as in the scene compiler.
        """
        if metallic is not None:
            self._write("mat_metallic", metallic, env_ids)
        if roughness is not None:
            self._write("mat_roughness", roughness, env_ids)
            self._write("mat_specular", 0.5 * (1.0 - roughness), env_ids)
            self._write("mat_shininess", 1.0 - roughness, env_ids)

    def compiled_finish(self, name: str) -> float:
        """The compiled ``metallic`` or ``roughness`` of an object, which has one material."""
        values = getattr(self._engine.model, f"mat_{name}")
        return float(values[self._materials[0]])

    def emit(self, strength: float, env_ids: EnvIndex | None) -> None:
        """Set an object's emission."""
        self._write("mat_emission", strength, env_ids)

    def _write(
        self, field: str, values: Any, env_ids: EnvIndex | None, width: int = 1, column: int = 0
    ) -> None:
        """Write one column of a field with `width` columns per material."""
        for material in self._materials:
            start = width * material + column
            self._engine.write_model(field, values, env_ids, slice(start, start + 1))


@register_term("event", name="randomize_texture", takes_strength=True)
class RandomizeTexture(Term):
    """Draws one of an object's textures in each environment.

    The textures are those of its `visual_material`; each environment has the index of one.

    Args:
        entity_cfg: A rigid object with `shape.visual_material.textures`.

    Example:
        ``{func: randomize_texture, mode: reset, params: {of: {uid: painted}}}``
    """

    def __init__(self, env: TermContext, entity_cfg: Whole) -> None:
        from embodichain.lab.sim.compiler.geoms.textures import declared_textures  # imports MuJoCo

        self._engine = env.sim.engine
        ids, self._column = declared_textures(self._engine.model, entity_cfg.uid)
        if not ids:
            message = f"{entity_cfg.uid!r} has no shape.visual_material.textures"
            raise ConfigError([Problem("entity_cfg.uid", message)])
        self._ids = np.array(ids, np.float64)
        # At a strength below 1 the first ones are drawn more often; at 0 it is always the first.
        self._index = Uniform("texture", [0.0], [float(len(ids))], default=0.0)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the texture of the object in these environments."""
        drawn = self._index(env.event_manager, env_ids).astype(np.int64)
        # A number just below the upper bound may round up to it.
        ids = rows_at(self._ids, np.minimum(drawn, len(self._ids) - 1))
        self._engine.write_model("mat_texid", ids, env_ids, slice(self._column, self._column + 1))


def _check_unit_interval(name: str, values: Any) -> None:
    """Refuse values outside of [0, 1]."""
    array = np.asarray(values, np.float64)
    if (array < 0).any() or (array > 1).any():
        raise ConfigError([Problem(name, f"must be within [0, 1], got {values}")])


@register_term("event", name="randomize_visual_material", takes_strength=True)
class RandomizeVisualMaterial(Term):
    """Sets a random colour, roughness and metallic value of an entity in each environment.

    Visible in images and viewers. EmbodiChain's event of the same name without textures
    and refraction: MuJoCo compiles textures into the model, and its rasterizer does not refract.

    Args:
        entity_cfg: A rigid object or a robot, or links or geoms of it.
        base_color_range: [[r, g, b] low, [r, g, b] high] in [0, 1]; uniform per channel.
        metallic_range: [low, high] in [0, 1]; rigid objects only. Kept in the model, but MuJoCo's
            rasterizer does not show it.
        roughness_range: [low, high] in [0, 1]; rigid objects only.
        random_texture_prob: Accepted without effect: there are no textures.
        texture_path: Not available: an error.
        ior_range: Not available: an error.

    Example:
        ``{func: randomize_visual_material, mode: reset, params: {of: {uid: cube}, base_color_range: [[0.2, 0, 0], [1, 0.6, 0.6]], roughness_range: [0.2, 0.9]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        entity_cfg: Frames,
        base_color_range: Box3 | None = None,
        metallic_range: Range | None = None,
        roughness_range: Range | None = None,
        random_texture_prob: Annotated[float, Field(ge=0, le=1)] = 0.5,
        texture_path: str | None = None,
        ior_range: Range | None = None,
    ) -> None:
        if texture_path is not None:
            reason = "textures are compiled into the model: there are none"
            raise ConfigError([Problem("texture_path", f"not available: {reason}; leave it out")])
        if ior_range is not None:
            reason = "MuJoCo's renderer has no refraction"
            raise ConfigError([Problem("ior_range", f"not available: {reason}; leave it out")])
        self._surface = _Surface(entity_cfg)
        if base_color_range is None and metallic_range is None and roughness_range is None:
            message = "missing: give this, metallic_range or roughness_range, else nothing changes"
            raise ConfigError([Problem("base_color_range", message)])
        if base_color_range is not None:
            _check_unit_interval("base_color_range", base_color_range)
        self._color = Uniform.within("base_color", base_color_range)
        self._finish: list[Uniform] = []
        for name, bounds in (("metallic", metallic_range), ("roughness", roughness_range)):
            if bounds is None:
                continue
            _check_unit_interval(f"{name}_range", bounds)
            if not self._surface.is_object:
                message = "only of whole rigid objects: geoms and links share materials"
                raise ConfigError([Problem(f"{name}_range", message)])
            compiled = self._surface.compiled_finish(name)
            self._finish.append(Uniform(name, [bounds[0]], [bounds[1]], default=compiled))

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the look of the entity in these environments."""
        if self._color is not None:
            draws = env.event_manager
            self._surface.paint(self._color(draws, env_ids), env_ids, draws.strength)
        drawn = {value.name: value(env.event_manager, env_ids) for value in self._finish}
        self._surface.finish(drawn.get("metallic"), drawn.get("roughness"), env_ids)


@register_term("event", name="set_rigid_object_visual_material")
class SetRigidObjectVisualMaterial(Term):
    """Sets the material of a rigid object: EmbodiChain's event of the same name.

    Args:
        entity_cfg: The object.
        mat_cfg: Keys of `VisualMaterialCfg`: `base_color` (RGBA in [0, 1]), `metallic`,
            `roughness`, `emissive`, `emissive_intensity`; absent keys have their defaults.

    Example:
        ``{func: set_rigid_object_visual_material, mode: startup, params: {of: {uid: cube}, mat_cfg: {base_color: [0.1, 0.5, 0.2, 1.0], roughness: 0.3}}}``
    """  # noqa: E501  (an example is one line)

    def __init__(self, env: TermContext, entity_cfg: Whole, mat_cfg: VisualMaterialCfg) -> None:
        self._surface = _Surface(entity_cfg)
        if not self._surface.is_object:
            message = f"{entity_cfg.uid!r} is not a rigid object"
            raise ConfigError([Problem("entity_cfg.uid", message)])
        if len(mat_cfg.base_color) != 4:
            message = f"RGBA has 4 values, got {mat_cfg.base_color}"
            raise ConfigError([Problem("mat_cfg.base_color", message)])
        for name in ("base_color", "metallic", "roughness", "emissive"):
            _check_unit_interval(f"mat_cfg.{name}", getattr(mat_cfg, name))
        self._cfg = mat_cfg

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Write the material in these environments."""
        cfg = self._cfg
        surface = self._surface
        count = env.num_envs if env_ids is None else len(env_ids)
        surface.paint(np.tile(np.asarray(cfg.base_color[:3], np.float64), (count, 1)), env_ids)
        surface.fade(float(cfg.base_color[3]), env_ids)
        surface.finish(float(cfg.metallic), float(cfg.roughness), env_ids)
        surface.emit(float(cfg.emissive_intensity) * float(max(cfg.emissive)), env_ids)


def _light_called(env: TermContext, uid: str) -> Light:
    """The handle of a declared light, or of the sun.

    Raises:
        ConfigError: If there is no such light.
    """
    from embodichain.lab.sim.objects import light as light_handle  # imports torch

    lights = env.sim.lights
    if uid in lights:
        return lights[uid]
    model = env.sim.engine.model
    compiled_names = [model.light(i).name for i in range(model.nlight)]
    if uid != SUN or lights or SUN not in compiled_names:
        there_are = list(lights) or [name for name in compiled_names if name == SUN]
        message = f"no light is called {uid!r}; there are: {', '.join(there_are) or 'none'}"
        hint = did_you_mean(uid, there_are).strip()
        raise ConfigError([Problem("entity_cfg.uid", message, hint)])
    sun = model.light(SUN)
    brightest = float(sun.diffuse.max())
    cfg = LightCfg(
        light_type="directional",
        color=tuple(float(channel) / brightest for channel in sun.diffuse),
        intensity=light_handle.FULL_INTENSITY * brightest,
        direction=tuple(float(component) for component in sun.dir),
    )
    handle = light_handle.Light(cfg, SUN, env.sim)
    handle.bind(env.sim.engine, sun.id)
    return handle


@register_term("event", name="randomize_light", takes_strength=True)
class RandomizeLight(Term):
    """Changes position, colour and intensity of a declared light, separately per environment.

    EmbodiChain's event of the same name (where all environments share a light).

    Args:
        entity_cfg: A light of the task's section `lights`; `default` is the sun of a scene that
            declares none.
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
        if color_range is not None and not all(0 <= c <= 1 for row in color_range for c in row):
            raise ConfigError([Problem("color_range", f"RGB in [0, 1], got {color_range}")])
        self._light = _light_called(env, entity_cfg.uid)
        cfg = self._light.cfg
        compiled_light = env.sim.engine.model.light(entity_cfg.uid)
        self._pos0: Floats = np.array(compiled_light.pos, np.float64)
        self._dir0: Floats = np.asarray(cfg.direction, np.float64)
        self._color0: Floats = np.asarray(cfg.color, np.float64)
        self._intensity0 = float(cfg.intensity)
        self._move = Uniform.within("position", position_range, default=0.0)
        self._turn = Uniform.within("direction", direction_range, default=0.0)
        self._color = Uniform.within("color", color_range, default=self._color0)
        self._intensity = Uniform.within("intensity", intensity_range, default=0.0)

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
        color: Floats = self._color0[None, :]
        if self._color is not None:
            color = self._color(draws, env_ids)
        strength: Floats = np.full((1, 1), self._intensity0)
        if self._intensity is not None:
            strength = self._intensity0 + self._intensity(draws, env_ids)
        self._light.write_emission(color, np.maximum(strength, 0.0), env_ids)
