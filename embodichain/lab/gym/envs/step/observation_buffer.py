"""`ObservationBuffer`: makes observations, and stores the last returned one."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.observation_manager import is_image
from embodichain.lab.gym.envs.managers.terms.term_errors import (
    declared_at,
    finite_physics,
    listed,
    warn_not_finite,
)
from embodichain.lab.gym.envs.observation import Observation, ObservationLayout
from embodichain.lab.gym.envs.step.judging import bad_rows
from embodichain.lab.gym.envs.step.step_result import none_set
from embodichain.utils.arrays import is_host, to_tensor
from embodichain.utils.short_repr import short_repr
from embodichain.utils.tensor_mapping import TensorMapping, leaves_of

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.managers.observation_manager import ObservationManager
    from embodichain.lab.gym.envs.step.episodes import Episodes
    from embodichain.lab.sim.objects.robot import Robot
    from embodichain.utils.array_types import Floats

__all__ = ["ObservationBuffer"]

logger = logging.getLogger(__name__)

Mask = NDArray[np.bool_]


class ObservationBuffer:
    """Observations of N environments as rows of one float32 array.

    Each returned observation has its own array; the buffer has a copy of the last one.

    Args:
        robot: The robot whose joints are observed, or None.
        joint_ids: Its observed joints.
        manager: The observation terms.
        plain: Whether only robot, sensors and terms are observed, so that all entries can be
            written into the array at once. Otherwise the hooks of the class receive the entries
            as nested tensors.
        episodes: Counts steps: the present one counts for terms.
        sensors: All sensors by uid.

    Attributes:
        layout: Columns of the entries; set by `build`.
        last: (N, W) the last returned observation.
    """

    layout: ObservationLayout
    last: NDArray[np.float32]

    def __init__(
        self,
        robot: Robot | None,
        joint_ids: Sequence[int],
        manager: ObservationManager,
        plain: bool,
        episodes: Episodes,
        sensors: Mapping[str, Any] = MappingProxyType({}),
    ) -> None:
        # None is all joints.
        self._joints: NDArray[np.int64] | None = None
        if robot is not None and list(joint_ids) != list(range(robot.dof)):
            self._joints = np.asarray(joint_ids, np.int64)
        self._robot_reads: dict[tuple[str, str], Callable[[], Floats]] = {}
        if robot is not None:
            self._robot_reads = {
                ("robot", "qpos"): robot.read_qpos,
                ("robot", "qvel"): robot.read_qvel,
                ("robot", "qf"): robot.read_efforts,
            }
        # Columns of these entries, and their reads; empty if a term modifies one.
        self._robot_columns: list[tuple[slice, Callable[[], Floats]]] = []
        self._manager = manager
        self._plain = plain
        self._episodes = episodes
        self._sensors = sensors
        self._warning_counts: dict[str, int] = {}
        self._built = False
        self._has_terms = False

    def __repr__(self) -> str:
        """Return N and, once built, the number of columns and the entries."""
        manager = self._manager
        if not self._built:
            return short_repr(self, num_envs=manager.num_envs)
        entries = [".".join(path) for path in self.layout.paths]
        return short_repr(self, num_envs=manager.num_envs, width=self.layout.width, entries=entries)

    def build(self, obs: Mapping[str, Any]) -> Observation:
        """Make the layout from the first observation; return that observation in it."""
        first = self._with_terms(obs)
        manager = self._manager
        images = set(manager.images)
        for path, value in leaves_of(first):
            if path[0] == "sensor" and is_image(self._sensors.get(path[1]), value):
                images.add(path)
        self.layout = ObservationLayout(
            first,
            manager.paths,
            manager.num_envs,
            images=images,
            arrays=manager.env.arrays,
        )
        manager.use(self.layout)
        if not manager.modifies:
            self._robot_columns = [
                (self.layout.columns[path], read)
                for path, read in self._robot_reads.items()
                if path in self.layout.columns
            ]
        self._built = True
        return self.layout.pack(first)

    def observe(
        self, sensors: Mapping[str, Any], extend: Callable[[TensorMapping], Any] | None
    ) -> TensorMapping:
        """Observe the robot, sensors and terms.

        Args:
            sensors: Readings by uid.
            extend: Adds to the entries before terms do, or None.

        Raises:
            TypeError: If `extend` does not return the observation.
        """
        self._has_terms = True
        if self._built and self._plain:
            obs = Observation(self.layout, self.layout.empty())
            rows = obs.rows
            joints = self._joints
            for columns, read in self._robot_columns:
                rows[:, columns] = read() if joints is None else read()[:, joints]
            rest: dict[tuple[str, ...], Any] = {}
            if not self._robot_columns:
                rest = self._entries(sensors)
            elif sensors:
                rest = _sensor_entries(sensors)
            if self._episodes.counts_present:
                self._manager.write(obs, rest)
            else:
                with self._episodes.counting(present=True):
                    self._manager.write(obs, rest)
            return obs
        entries = TensorMapping(batch_size=(self._manager.num_envs,))
        for path, value in self._entries(sensors).items():
            entries[path] = value if isinstance(value, torch.Tensor) else to_tensor(value)
        extended = entries if extend is None else extend(entries)
        if extended is None:
            raise TypeError("_extend_obs must return the observation, got None")
        nested = self._nested(extended)
        self._compute_terms(nested)
        return nested

    def _compute_terms(self, obs: TensorMapping) -> None:
        """Add the entries of terms to those of robot and sensors."""
        with self._episodes.counting(present=True):
            self._manager.compute(obs)

    def _entries(self, sensors: Mapping[str, Any]) -> dict[tuple[str, ...], Any]:
        """Return the entries that are not of terms: those of the robot and of sensors."""
        joints = slice(None) if self._joints is None else self._joints
        entries = {path: read()[:, joints] for path, read in self._robot_reads.items()}
        return entries | _sensor_entries(sensors)

    def _nested(self, obs: Mapping[str, Any]) -> TensorMapping:
        if isinstance(obs, TensorMapping):
            return obs
        return TensorMapping(obs, (self._manager.num_envs,))

    def _with_terms(self, obs: Mapping[str, Any]) -> TensorMapping:
        """Return an observation with its terms, even if an override of `get_obs` omits them."""
        nested = self._nested(obs)
        if not self._has_terms:
            self._compute_terms(nested)
        self._has_terms = False
        return nested

    def complete(self, obs: Mapping[str, Any]) -> Observation:
        """Return the result of `get_obs` as an observation of this layout, terms included."""
        if self._has_terms and type(obs) is Observation:
            self._has_terms = False
            return obs if obs.packed and obs.layout is self.layout else self.layout.pack(obs)
        return self.layout.pack(self._with_terms(obs))

    # -- rows that are replaced ----------------------------------------------------------------

    def store(self, obs: Observation) -> Observation:
        """Store a copy of a returned observation."""
        self.last = obs.rows.copy()
        return obs

    def without(self, obs: Observation, mask: Mask) -> Observation:
        """Return an observation with some rows replaced by those stored last.

        Images and integers are not in the rows: they stay as just observed.

        Args:
            obs: The observation.
            mask: (N,) environments whose rows are replaced.
        """
        return obs.with_rows(np.where(mask[:, None], self.last, obs.rows))

    def store_first(self, obs: Observation, unchanged: Mask) -> Observation:
        """Store the observation after a reset.

        Rows that are not finite become zero: there is no earlier observation of that episode. Such
        an environment is reported as diverged in its next step.

        Args:
            obs: The observation.
            unchanged: (N,) environments that were not reset: their rows are those stored.
        """
        if not none_set(unchanged):
            obs = self.without(obs, unchanged)
        bad = bad_rows(obs.rows)
        if bad is not None:
            if is_host(bad):
                self._explain(obs, bad)
            obs = obs.with_rows(np.where(bad[:, None], np.float32(0.0), obs.rows))
        return self.store(obs)

    def _explain(self, obs: Observation, bad: Mask) -> None:
        """Log why the observation of environments (N,) is not finite after a reset."""
        env = self._manager.env
        managers: Any = env.managers
        is_physics_finite = finite_physics(env)
        diverged = bad & ~is_physics_finite
        rest = bad & is_physics_finite
        if diverged.any():
            events = [
                declared_at(env, f"events.{event.name}")
                for event in managers["events"].terms.values()
                if event.cfg.mode == "reset"
            ]
            logger.error(
                "not finite after a reset: environments %s, nor is their state; events before: %s",
                listed(np.flatnonzero(diverged)),
                ", ".join(events) or "none",
            )
        if rest.any():
            causes = managers["commands"].not_finite(rest)
            causes |= self._manager.not_finite(obs, rest)
            what = "not finite after a reset, zeros are observed"
            warn_not_finite(env, causes, what, self._warning_counts)


def _sensor_entries(sensors: Mapping[str, Any]) -> dict[tuple[str, ...], Any]:
    """Return the entries of sensors, from their readings by uid."""
    if not sensors:
        return {}
    return {("sensor", *path): leaf for path, leaf in leaves_of(sensors)}
