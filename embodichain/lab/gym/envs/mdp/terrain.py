"""Terms of a terrain, `scene.terrain`: where environments are on it, and heights above it.

The terrain moves, not the robot: at a reset its pose puts the middle of the environment's patch at
the environment's origin. So initial poses and all terms have the same meaning on every patch.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field

from embodichain.lab.gym.envs.managers.param_types import Body, PlanarCommand, Positive
from embodichain.lab.gym.envs.managers.term import Term, Uniform
from embodichain.lab.gym.envs.managers.terms.registry import quantity, register_term
from embodichain.lab.gym.envs.mdp._rows import norm
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from embodichain.lab.gym.envs.cfg import EnvCfg
    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.sim.compiler.scene.terrain import Terrain
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.lab.sim.reads.height_field import GroundHeights
    from embodichain.utils.array_types import Floats

__all__ = [
    "HeightAboveGround",
    "PlaceTerrain",
    "TerrainEdgeDistance",
    "TerrainLevel",
    "TerrainLevels",
]


def _terrain(env: TermContext) -> Terrain:
    """The patches of the scene.

    Raises:
        ConfigError: If it has none, or arrays are on a device.
    """
    env.arrays.require_host("terms of a terrain")
    terrain = env.sim.scene.terrain
    if terrain is None:
        raise ConfigError([Problem("", "the task has no scene.terrain")])
    return terrain


def _heights(env: TermContext) -> GroundHeights:
    """The heights of the scene's terrain.

    Raises:
        ConfigError: As `_terrain`.
    """
    from embodichain.lab.sim.reads.height_field import GroundHeights

    _terrain(env)
    return GroundHeights.of(env.sim.engine)


@register_term("event", name="place_terrain")
class PlaceTerrain(Term):
    """Puts the middle of each environment's patch of the terrain at the environment's origin.

    Of K columns, environment i is on column i mod K, at level floor(i / K) mod (most + 1) at first,
    where most is `max_init_level`: patches are shared evenly, and nothing depends on the number of
    environments. Levels change by the curriculum `terrain_levels` only. An environment that
    rises above the highest continues at a random one. At a stage that is held for an evaluation,
    each episode draws a level from those that environments of its column had in training.

    It fires before the other events of its mode, whose heights count from the ground.

    Args:
        max_init_level: The highest level at the start; None is the highest of the terrain.

    Attributes:
        level: (N,) int64 level of each environment, from 0.
        column: (N,) int64 column of each environment.

    Example:
        ``{func: place_terrain, mode: reset, params: {max_init_level: 1}}``
    """

    saved = ("level", "column")
    comes_first = True

    def __init__(
        self, env: TermContext, max_init_level: Annotated[int, Field(ge=0)] | None = None
    ) -> None:
        self.terrain = _terrain(env)
        highest_level = self.terrain.levels - 1
        if max_init_level is None:
            max_init_level = highest_level
        if max_init_level > highest_level:
            message = f"the levels are 0 to {highest_level}, got {max_init_level}"
            raise ConfigError([Problem("max_init_level", message)])
        # Of the batch, of which these environments may be a shard.
        env_numbers = np.arange(env.num_envs) + env.cfg.first_env
        column_count = len(self.terrain.kinds)
        self.column: NDArray[np.int64] = env_numbers % column_count
        self.level: NDArray[np.int64] = env_numbers // column_count % (max_init_level + 1)
        self._random_level = Uniform("level", [0.0], [float(self.terrain.levels)])
        self._engine = env.sim.engine
        self._pos_columns = _heights(env).columns
        self._training_levels: _TrainingLevels | None = None

    def draw_from(self, levels: NDArray[np.int64], columns: NDArray[np.int64]) -> None:
        """Draw the level of each episode from (M,) levels of environments of the same column.

        Args:
            levels: Levels; one above the highest is a random one, as in training.
            columns: Their columns. An environment of a column without a level draws from all.
        """
        count = self.terrain.levels
        # (M, count) equally likely levels of each environment of the training.
        likely = np.where((levels >= count)[:, None], np.arange(count), levels[:, None])
        levels_of_columns: list[NDArray[np.int64]] = []
        for column in range(len(self.terrain.kinds)):
            column_levels = likely[columns == column].ravel()
            if not len(column_levels):
                column_levels = likely.ravel()
            levels_of_columns.append(column_levels)
        self._training_levels = _TrainingLevels(
            levels=np.concatenate(levels_of_columns),
            starts=np.cumsum([0, *map(len, levels_of_columns)]),
        )

    def go_on(self) -> None:
        """Keep levels from episode to episode again."""
        self._training_levels = None

    def _next_levels(self, ids: Any, drawn: NDArray[np.float64]) -> NDArray[np.int64]:
        """(n,) levels of episodes that begin, from draws (n,) of [0, number of levels)."""
        level_count = self.terrain.levels
        if self._training_levels is not None:
            return self._training_levels.choose(self.column[ids], drawn / level_count)
        levels = self.level[ids]
        return np.where(levels >= level_count, drawn.astype(np.int64), levels)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Write the pose of the terrain in these environments."""
        ids = np.arange(env.num_envs) if env_ids is None else env_ids
        # Always drawn, so that the numbers of an environment do not depend on its level.
        drawn = self._random_level(env.event_manager, env_ids)[:, 0]
        levels = self._next_levels(ids, drawn)
        self.level[ids] = levels
        # From 0, not by a minus sign: a place of 0 is not -0.
        pos = 0.0 - self.terrain.origins[levels, self.column[ids]]
        self._engine.write("mocap_pos", pos, env_ids, self._pos_columns)


@dataclass(frozen=True)
class _TrainingLevels:
    """Levels of a training's environments, from which an evaluation draws.

    Attributes:
        levels: Those of the terrain's first column, then those of the second, and so on.
        starts: (K + 1,) where each column begins in `levels`, and where the last one ends.
    """

    levels: NDArray[np.int64]
    starts: NDArray[np.int64]

    def choose(self, columns: NDArray[np.int64], shares: NDArray[np.float64]) -> NDArray[np.int64]:
        """(n,) levels in columns (n,), by numbers (n,) in [0, 1)."""
        first = self.starts[columns]
        count = self.starts[columns + 1] - first
        chosen = np.minimum((shares * count).astype(np.int64), count - 1)
        return self.levels[first + chosen]


@register_term("curriculum", name="terrain_levels")
class TerrainLevels(Term):
    """Raises the level of environments whose robot walked far, lowers that of others.

    At the end of an episode the distance is that of the entity from the middle of its patch, in the
    plane. By ``distance``, farther than `promote` is one level up, and nearer than `demote` is one
    down: legged_gym's and Isaac Lab's rule. By ``success``, an episode that is no success of the
    task is one level down, and one that is and ends farther than `promote` is one up: the rule for
    commands with turns, where a robot that follows them walks in circles. The values are the mean
    level, and that of each kind.

    Args:
        of: The robot.
        promote: Distance in metres beyond which the level rises; None is half the edge of a patch.
        demote: The share of the distance that is expected, below which the level falls. Expected is
            the commanded speed x `max_episode_steps`, or `promote` without a command. Not to be
            given by success.
        command_name: A command whose first two columns are vx and vy, m/s; likewise.
        by: ``distance`` or ``success``.

    Example:
        ``{func: terrain_levels, params: {of: {uid: go}, command_name: velocity}}``
    """

    def __init__(
        self,
        env: TermContext,
        of: Body,
        promote: Positive | None = None,
        demote: Annotated[float, Field(ge=0, le=1)] = 0.5,
        command_name: PlanarCommand | None = None,
        by: Literal["distance", "success"] = "distance",
    ) -> None:
        terrain = _terrain(env)
        events = [term.instance for term in env.managers["events"].terms.values()]
        placing_events = [event for event in events if isinstance(event, PlaceTerrain)]
        if len(placing_events) != 1:
            message = f"needs one event place_terrain, there are {len(placing_events)}"
            raise ConfigError([Problem("", message)])
        self._place = placing_events[0]
        self._of = of
        self._command = command_name
        self._by_success = by == "success"
        self._promote_distance = 0.5 * terrain.size if promote is None else promote
        self._demote_share = demote
        self._episode_seconds = env.max_episode_steps * env.step_dt
        # Kind of patches -> the environments on them; a terrain may have several columns of a kind.
        self._is_on_kind: dict[str, NDArray[np.bool_]] = {}
        for name in dict.fromkeys(terrain.kinds):
            is_on_kind = np.isin(terrain.kinds, name)[self._place.column]
            if is_on_kind.any():
                self._is_on_kind[name] = is_on_kind

    @classmethod
    def check_task(cls, task: EnvCfg, params: Mapping[str, Any], allow_import: bool) -> Any:
        """Return mistakes that depend on the whole task, and parameters without a meaning."""
        problems: list[Problem] = []
        if params.get("by") == "success":
            message = "has no meaning with by: success; remove it"
            unused = [name for name in ("demote", "command_name") if name in params]
            problems += [Problem(name, message) for name in unused]
        count = sum(event.func == "place_terrain" for event in task.events.values())
        if count != 1:
            problems.append(Problem("", f"needs one event place_terrain, there are {count}"))
        return problems

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> Mapping[str, float]:
        """Change the levels of environments whose episodes end."""
        place = self._place
        place.go_on()
        ids = np.arange(env.num_envs) if env_ids is None else env_ids
        walked = norm(self._of.position()[ids, :2])
        is_far = walked > self._promote_distance
        if self._by_success:
            success = env.arrays.of(env.is_task_success())[ids]
            goes_up = success & is_far
            goes_down = ~success
        else:
            expected: Any = self._promote_distance
            if self._command is not None:
                expected = norm(self._command()[ids, :2]) * self._episode_seconds
            goes_up = is_far
            goes_down = walked < self._demote_share * expected
        # An environment that is reset before its first step has not walked.
        has_begun = env.read_elapsed_steps()[ids] > 0
        change = np.where(goes_up, 1, np.where(goes_down, -1, 0)) * has_begun
        place.level[ids] = np.maximum(place.level[ids] + change, 0)
        return self._mean_levels()

    def _mean_levels(self) -> dict[str, float]:
        """The mean level of all environments, and of those on each kind of patch."""
        place = self._place
        levels = np.minimum(place.level, place.terrain.levels - 1)
        means = {"mean": float(levels.mean())}
        for name, is_on_kind in self._is_on_kind.items():
            means[name] = float(levels[is_on_kind].mean())
        return means

    def stage_dict(self) -> dict[str, Any]:
        """The levels and columns of all environments."""
        return {"level": self._place.level.copy(), "column": self._place.column.copy()}

    def load_stage_dict(self, stage: Mapping[str, Any]) -> None:
        """Draw levels from those of a training."""
        self._place.draw_from(stage["level"], stage["column"])


@quantity(name="terrain_level")
class TerrainLevel(Term):
    """(N,) level of the patch of each environment, from 0.

    Example:
        ``{func: terrain_level}``
    """

    def __init__(self, env: TermContext) -> None:
        self._terrain = _terrain(env)
        self._ground = _heights(env)

    def __call__(self) -> Floats:
        """(N,) the level."""
        terrain = self._terrain
        x = 0.0 - self._ground.offset()[:, 0]
        return np.round((x - terrain.origins[0, 0, 0]) / terrain.size)


@quantity(name="height_above_ground")
class HeightAboveGround(Term):
    """(N,) m: height of an entity's origin above the terrain below it.

    Beyond the terrain the height of its edge counts. On flat ground use `height`.

    Args:
        of: The entity or link.

    Example:
        ``{func: height_above_ground, shape: {below: 0.15}, params: {of: {uid: go}}}``
    """

    def __init__(self, env: TermContext, of: Body) -> None:
        self._of = of
        self._ground = _heights(env)

    def __call__(self) -> Floats:
        """(N,) m."""
        pos = self._of.position()
        ground_height, _ = self._ground.read(pos[:, 0], pos[:, 1])
        return pos[:, 2] - ground_height


@quantity(name="terrain_edge_distance")
class TerrainEdgeDistance(Term):
    """(N,) m: distance of an entity from the edge of the terrain; negative beyond it.

    Args:
        of: The entity or link.

    Example:
        ``{func: terrain_edge_distance, kind: time_out, shape: {below: 1.0}, params: {of: {uid: go}}}``
    """  # noqa: E501  (an example is one line)

    def __init__(self, env: TermContext, of: Body) -> None:
        self._of = of
        self._half_size = _terrain(env).half
        self._ground = _heights(env)

    def __call__(self) -> Floats:
        """(N,) m."""
        from_middle = np.abs(self._of.position()[:, :2] - self._ground.offset()[:, :2])
        half_x, half_y = self._half_size
        return np.minimum(half_x - from_middle[:, 0], half_y - from_middle[:, 1])
