"""Terms of a terrain, `scene.terrain`: where environments are on it, and heights above it.

The terrain moves, not the robot: at a reset its pose puts the middle of the environment's patch at
the environment's origin. So initial poses and all terms have the same meaning on every patch.
"""

from __future__ import annotations

from collections.abc import Mapping
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
    found: Terrain | None = env.sim.scene.terrain
    if found is None:
        raise ConfigError([Problem("", "the task has no scene.terrain")])
    return found


def _heights(env: TermContext) -> GroundHeights:
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
        self.terrain = terrain = _terrain(env)
        most = terrain.levels - 1 if max_init_level is None else max_init_level
        if most >= terrain.levels:
            message = f"the levels are 0 to {terrain.levels - 1}, got {most}"
            raise ConfigError([Problem("max_init_level", message)])
        number = np.arange(env.num_envs) + env.cfg.first_env
        kinds = len(terrain.kinds)
        self.column: NDArray[np.int64] = number % kinds
        self.level: NDArray[np.int64] = number // kinds % (most + 1)
        self._any = Uniform("level", [0.0], [float(terrain.levels)])
        self._engine, self._columns = env.sim.engine, _heights(env).columns
        # Levels of training by column, where an evaluation holds them, and where a column begins.
        self._reached: tuple[NDArray[np.int64], NDArray[np.int64]] | None = None

    def draw_from(self, levels: NDArray[np.int64], columns: NDArray[np.int64]) -> None:
        """Draw the level of each episode from (M,) levels of environments of the same column.

        Args:
            levels: Levels; one above the highest is a random one, as in training.
            columns: Their columns. An environment of a column without a level draws from all.
        """
        count = self.terrain.levels
        # (M, count) equally likely levels of each environment of the training.
        likely = np.where((levels >= count)[:, None], np.arange(count), levels[:, None])
        found = [likely[columns == k].ravel() for k in range(len(self.terrain.kinds))]
        found = [part if len(part) else likely.ravel() for part in found]
        self._reached = np.concatenate(found), np.cumsum([0, *map(len, found)])

    def go_on(self) -> None:
        """Keep levels from episode to episode again."""
        self._reached = None

    def _level(self, ids: Any, drawn: NDArray[np.float64]) -> NDArray[np.int64]:
        """(n,) levels of episodes that begin, from draws (n,) of [0, number of levels)."""
        if self._reached is not None:
            levels, starts = self._reached
            first = starts[self.column[ids]]
            count = starts[self.column[ids] + 1] - first
            chosen = np.minimum((drawn / self.terrain.levels * count).astype(np.int64), count - 1)
            return levels[first + chosen]
        level = self.level[ids]
        return np.where(level >= self.terrain.levels, drawn.astype(np.int64), level)

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> None:
        """Write the pose of the terrain in these environments."""
        ids = np.arange(env.num_envs) if env_ids is None else env_ids
        # Always drawn, so that the numbers of an environment do not depend on its level.
        drawn = self._any(env.event_manager, env_ids)[:, 0]
        self.level[ids] = level = self._level(ids, drawn)
        places = 0.0 - self.terrain.origins[level, self.column[ids]]
        self._engine.write("mocap_pos", places, env_ids, self._columns)


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
        promote: m; None is half the edge of a patch.
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
        built = (term.instance for term in env.managers["events"].terms.values())
        places = [instance for instance in built if isinstance(instance, PlaceTerrain)]
        if len(places) != 1:
            message = f"needs one event place_terrain, there are {len(places)}"
            raise ConfigError([Problem("", message)])
        self._place, self._of, self._command = places[0], of, command_name
        self._by_success = by == "success"
        self._far = 0.5 * terrain.size if promote is None else promote
        self._share, self._seconds = demote, env.max_episode_steps * env.step_dt
        names = dict.fromkeys(terrain.kinds)
        kinds = {name: np.isin(terrain.kinds, name)[self._place.column] for name in names}
        self._kinds = {name: mask for name, mask in kinds.items() if mask.any()}

    @classmethod
    def check_task(cls, task: EnvCfg, params: Mapping[str, Any], allow_import: bool) -> Any:
        """Return mistakes that depend on the whole task, and parameters without a meaning."""
        given = [name for name in ("demote", "command_name") if name in params]
        message = "has no meaning with by: success; remove it"
        by_success = params.get("by") == "success"
        problems = [Problem(name, message) for name in given if by_success]
        count = sum(event.func == "place_terrain" for event in task.events.values())
        if count != 1:
            problems.append(Problem("", f"needs one event place_terrain, there are {count}"))
        return problems

    def __call__(self, env: TermContext, env_ids: EnvIndex | None) -> Mapping[str, float]:
        """Change the levels of environments whose episodes end."""
        place, far = self._place, self._far
        place.go_on()
        ids = np.arange(env.num_envs) if env_ids is None else env_ids
        walked = norm(self._of.position()[ids, :2])
        if self._by_success:
            success = env.arrays.of(env.is_task_success())[ids]
            up, down = success & (walked > far), ~success
        else:
            expected: Any = far
            if self._command is not None:
                expected = norm(self._command()[ids, :2]) * self._seconds
            up, down = walked > far, walked < self._share * expected
        began = env.arrays.of(env.elapsed_steps)[ids] > 0
        change = np.where(up, 1, np.where(down, -1, 0)) * began
        place.level[ids] = np.maximum(place.level[ids] + change, 0)
        return self._means()

    def _means(self) -> dict[str, float]:
        place = self._place
        levels = np.minimum(place.level, place.terrain.levels - 1)
        means = {name: float(levels[mask].mean()) for name, mask in self._kinds.items()}
        return {"mean": float(levels.mean()), **means}

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
        self._terrain, self._ground = _terrain(env), _heights(env)

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
        self._of, self._ground = of, _heights(env)

    def __call__(self) -> Floats:
        """(N,) m."""
        place = self._of.position()
        return place[:, 2] - self._ground.read(place[:, 0], place[:, 1])[0]


@quantity(name="terrain_edge_distance")
class TerrainEdgeDistance(Term):
    """(N,) m: distance of an entity from the edge of the terrain; negative beyond it.

    Args:
        of: The entity or link.

    Example:
        ``{func: terrain_edge_distance, kind: time_out, shape: {below: 1.0}, params: {of: {uid: go}}}``
    """  # noqa: E501  (an example is one line)

    def __init__(self, env: TermContext, of: Body) -> None:
        self._of, self._half, self._ground = of, _terrain(env).half, _heights(env)

    def __call__(self) -> Floats:
        """(N,) m."""
        place = np.abs(self._of.position()[:, :2] - self._ground.offset()[:, :2])
        return np.minimum(self._half[0] - place[:, 0], self._half[1] - place[:, 1])
