"""Events that change how big objects are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from embodichain.lab.gym.envs.managers.param_types import ScaleRange
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp._model_fields import Distribution, Draw, Quantity, object_of
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import EnvIndex
    from embodichain.lab.sim.objects.solids import Solid

__all__ = ["RandomizeRigidObjectScale", "RandomizeRigidObjectsScale"]


class _Scale(Term):
    """Draws factors for some objects."""

    def __init__(
        self,
        entities: Sequence[ResolvedEntity],
        path: str,
        scale_factor_range: ScaleRange,
        same_scale_all_axes: bool,
        shared_sample: bool,
        fixed_density: bool,
        distribution: Distribution,
    ) -> None:
        self._assets = [object_of(entity).asset for entity in entities]
        self._fixed_density = fixed_density
        bounds = np.asarray(scale_factor_range, np.float64)
        if bounds.shape == (2, 1):  # EmbodiChain's way to write one factor for all axes
            bounds = bounds[:, 0]
        if bounds.ndim == 2 and same_scale_all_axes:
            message = "a range for every axis needs same_scale_all_axes: false"
            raise ConfigError([Problem("scale_factor_range", message)])
        width = 1 if same_scale_all_axes else 3
        solids = [_solid(asset, path, width) for asset in self._assets]
        # Which drawn column scales which axis: a capsule's x and y are one.
        ties = [_axes(solid, width) for solid in solids]
        self._axes = [tie if shared_sample else tie + width * i for i, tie in enumerate(ties)]
        count = width * (1 if shared_sample else len(solids))
        bounds = np.tile(bounds.reshape(2, -1), (1, count // (1 if bounds.ndim == 1 else 3)))
        names = [str(i) for i in range(count)]
        quantity = Quantity(
            "scale_factor_range", bounds.tolist(), names, np.ones(count), "abs", 1e-6
        )
        self._draw = Draw([quantity], distribution)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw and write the scales of these environments."""
        (drawn,) = self._draw(env, env_ids)
        for asset, axes in zip(self._assets, self._axes, strict=True):
            asset.write_scale(drawn[:, axes], env_ids, self._fixed_density)


def _solid(asset: object, path: str, width: int) -> Solid:
    try:
        solid: Solid = asset.solid  # type: ignore[attr-defined]
    except ValueError as error:
        raise ConfigError([Problem(f"{path}.uid", str(error))]) from error
    if width == 3 and len(solid.equal_axes) == 3:
        message = f"{solid.uid!r} is a {solid.kind}: its axes have one scale"
        raise ConfigError([Problem("same_scale_all_axes", message)])
    return solid


def _axes(solid: Solid, width: int) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    axes = np.arange(3) if width == 3 else np.zeros(3, np.int64)
    equal = list(solid.equal_axes)
    if equal:
        axes[equal] = axes[equal[0]]
    return axes


@register_term("event", name="randomize_rigid_object_scale")
class RandomizeRigidObjectScale(_Scale):
    """Gives an object a random size: a box, sphere, ellipsoid, cylinder or capsule.

    EmbodiChain's event of the same name; `fixed_density` and `distribution` are added. Factors
    multiply the declared size. Mass and inertia follow the shape; `get_body_scale` says the scale.
    Meshes and planes are refused: their size is compiled into assets that environments share. The
    pose stays: an object that grows on a table must be placed higher.

    Args:
        entity_cfg: The object.
        scale_factor_range: Factors [low, high], positive; or [[x, y, z] low, [x, y, z] high].
            [[low], [high]] is EmbodiChain's way to write the former.
        same_scale_all_axes: True draws one factor; False one an axis (round shapes keep round).
        fixed_density: True lets the mass follow the volume; False keeps the compiled mass and
            changes the inertia only. A mass event that fires later sets the mass, and keeps the
            inertia that of the size.
        distribution: ``uniform``, ``log_uniform`` or ``gaussian`` within the range.

    Example:
        ``{func: randomize_rigid_object_scale, mode: reset, params: {entity_cfg: {uid: cube}, scale_factor_range: [0.8, 1.2]}}``
    """  # noqa: E501

    def __init__(
        self,
        env: TermContext,
        entity_cfg: ResolvedEntity,
        scale_factor_range: ScaleRange,
        same_scale_all_axes: bool = True,
        fixed_density: bool = True,
        distribution: Distribution = "uniform",
    ) -> None:
        super().__init__(
            [entity_cfg],
            "entity_cfg",
            scale_factor_range,
            same_scale_all_axes,
            False,
            fixed_density,
            distribution,
        )


@register_term("event", name="randomize_rigid_objects_scale")
class RandomizeRigidObjectsScale(_Scale):
    """Gives several objects random sizes; as `randomize_rigid_object_scale`.

    EmbodiChain's event of the same name; `fixed_density` and `distribution` are added.

    Args:
        entity_cfgs: The objects.
        scale_factor_range: Factors [low, high], positive; or [[x, y, z] low, [x, y, z] high].
            [[low], [high]] is EmbodiChain's way to write the former.
        same_scale_all_axes: True draws one factor; False one an axis.
        shared_sample: True scales all objects of an environment by the same draw.
        fixed_density: True lets masses follow volumes; False keeps the compiled masses.
        distribution: ``uniform``, ``log_uniform`` or ``gaussian`` within the range.

    Example:
        ``{func: randomize_rigid_objects_scale, mode: reset, params: {entity_cfgs: [{uid: cube}, {uid: goal}], scale_factor_range: [0.9, 1.1], shared_sample: true}}``
    """  # noqa: E501

    def __init__(
        self,
        env: TermContext,
        entity_cfgs: list[ResolvedEntity],
        scale_factor_range: ScaleRange,
        same_scale_all_axes: bool = True,
        shared_sample: bool = False,
        fixed_density: bool = True,
        distribution: Distribution = "uniform",
    ) -> None:
        if not entity_cfgs:
            raise ConfigError([Problem("entity_cfgs", "names no object")])
        super().__init__(
            entity_cfgs,
            "entity_cfgs.0",
            scale_factor_range,
            same_scale_all_axes,
            shared_sample,
            fixed_density,
            distribution,
        )
