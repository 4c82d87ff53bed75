"""Events that place objects on the cells of a grid, no two in one cell."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from embodichain.lab.gym.envs.managers.param_types import Box2
from embodichain.lab.gym.envs.managers.registry import register_term
from embodichain.lab.gym.envs.managers.term import Term
from embodichain.lab.gym.envs.mdp._ranges import constant
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.context import TermContext
    from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = ["PlannerGridCellSampler"]

Count = Annotated[int, Field(ge=1)]


@register_term("event", name="planner_grid_cell_sampler")
class PlannerGridCellSampler(Term):
    """Places objects at the centres of cells of a grid, each in a cell of its own; stops them.

    The rectangle is divided into rows (along x) and columns (along y) of equal cells; cells are
    drawn uniformly without replacement (the order of one uniform number a cell). Orientations are
    the objects' initial ones. EmbodiChain's event of the same name.

    Args:
        position_range: [[x, y] low, [x, y] high] in metres, environment's frame.
        reference_height: Height of the objects' origins in metres.
        object_uid_list: Rigid objects; at most as many as there are cells.
        grid_size: [rows, columns].
        physics_update_step: Physics steps that these environments take afterwards; -1 or 0 takes
            none.

    Example:
        ``{func: planner_grid_cell_sampler, mode: reset, params: {position_range: [[0.4, -0.3], [0.8, 0.3]], reference_height: 0.06, object_uid_list: [cube, goal], grid_size: [3, 4]}}``
    """  # noqa: E501  (an example is one line)

    def __init__(
        self,
        env: TermContext,
        position_range: Box2,
        reference_height: float,
        object_uid_list: Annotated[list[str], Field(min_length=1)],
        grid_size: Annotated[list[Count], Field(min_length=2, max_length=2)],
        physics_update_step: Annotated[int, Field(ge=-1)] = -1,
    ) -> None:
        rows, columns = grid_size
        if len(object_uid_list) > rows * columns:
            message = f"{len(object_uid_list)} objects do not fit into {rows} x {columns} cells"
            raise ConfigError([Problem("grid_size", message)])
        objects = env.sim.rigid_objects
        problems = [
            Problem(
                f"object_uid_list.{number}",
                f"no rigid object is called {uid!r}; there are: {', '.join(objects) or 'none'}",
                did_you_mean(uid, objects).strip(),
            )
            for number, uid in enumerate(object_uid_list)
            if uid not in objects
        ]
        if len(set(object_uid_list)) < len(object_uid_list):
            problems.append(Problem("object_uid_list", "names an object twice"))
        if problems:
            raise ConfigError(problems)
        self._assets = [objects[uid] for uid in object_uid_list]
        self._quats = [
            np.tile(np.asarray(asset.entity.quat0, np.float64), (env.num_envs, 1))
            for asset in self._assets
        ]
        self._centres = _centres(position_range, rows, columns, reference_height)
        self._zero, self._one = constant(0.0), constant(1.0)
        self._steps = physics_update_step

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Draw cells and place the objects of these environments."""
        cells = len(self._centres)
        keys = env.event_manager.draw("cells", (cells,), self._zero, self._one, env_ids)
        order = np.argsort(keys, axis=1, kind="stable")
        for number, asset in enumerate(self._assets):
            pos = self._centres[order[:, number]]
            asset.write_pose(pos, self._quats[number][: len(pos)], env_ids)
            asset.stop(env_ids)
        if self._steps > 0:
            env.sim.engine.step(self._steps, env_ids)


def _centres(box: Box2, rows: int, columns: int, height: float) -> F64:
    """(rows * columns, 3) centres of the cells, row by row."""
    (x0, y0), (x1, y1) = box
    x = x0 + (np.arange(rows) + 0.5) * (x1 - x0) / rows
    y = y0 + (np.arange(columns) + 0.5) * (y1 - y0) / columns
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.concatenate([grid, np.full((len(grid), 1), height)], axis=1)
