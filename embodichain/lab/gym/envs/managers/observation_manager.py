"""`ObservationManager`: evaluates observation terms, and returns groups of them as one vector.

`ObservationEntry` is one term with its noise, clip, scale, delay and history.
"""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.cfg import ObservationCfg
from embodichain.lab.gym.envs.managers.manager import BuiltTerm, Manager
from embodichain.lab.gym.envs.managers.pipeline import Advancing, Delay, Noise, Past
from embodichain.lab.gym.envs.managers.terms.term_columns import TermColumns
from embodichain.lab.gym.envs.managers.terms.term_errors import FAILURES, kind_of_values
from embodichain.lab.gym.envs.observation import Columns, Observation, as_array, new_tensor
from embodichain.utils.arrays import contiguous, may_be_set, tensor_of
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.managers.context import TermContext
    from embodichain.lab.gym.envs.observation import ObservationLayout
    from embodichain.lab.sim.engine.api import EnvIndex

__all__ = [
    "ObservationEntry",
    "ObservationManager",
    "is_image",
    "no_vector",
]


class ObservationEntry:
    """Computes one entry.

    Args:
        env: The environment.
        term: The term.
        corrupted: Whether its noise is on.

    Attributes:
        term: The term; `set_params` replaces it.
        path: The path of the entry in the observation.
        modifies: Whether it changes an existing entry.
        key: Its key path in the config.
        remembers: Whether it has a state between steps.
        scales: The factor of each column of the term's value, once there is a value; None is 1.
        is_image: Whether its value is an image, known after the first one (`is_image`).
    """

    def __init__(self, env: TermContext, term: BuiltTerm[ObservationCfg], corrupted: bool) -> None:
        cfg = term.cfg
        self.term = term
        self.path = tuple((cfg.name or term.name).split("/"))
        self.key = f"observations.{term.name}"
        self.modifies = cfg.mode == "modify"
        self._env = env
        self._clip = cfg.clip
        self._scale: Any = cfg.scale
        self._noise_cfg = cfg.noise if corrupted else None
        self._noise: Noise | None = None
        self._delay: Delay | None = None
        if cfg.delay not in (0, [0, 0]):
            self._delay = Delay(cfg.delay, f"{self.key}.delay", env.streams, env.arrays)
        self._past: Past | None = None
        if cfg.history_length:
            self._past = Past(env.num_envs, cfg.history_length, env.arrays)
        self._flat = cfg.flatten_history_dim
        self.remembers = bool(self._delay or self._past or self._noise_cfg is not None)
        self._changes = self.remembers or self._clip is not None or self._scale is not None
        self._checked = False
        self.scales: NDArray[np.float32] | None = None
        self.is_image = False

    def value(self, obs: Any, advancing: Advancing) -> NDArray[Any]:
        """Evaluate the term.

        Args:
            obs: The argument of the term: the observation, or the entry to modify.
            advancing: Environments for which noise is drawn, and delay and history advance.

        Returns:
            (N, ...); it may share memory with the simulation.

        Raises:
            ConfigError: If the term's value is not (N, ...); names the term.
        """
        value = self.term.call(self._env, obs)
        if not self._checked:
            self._prepare(value)
        if type(value) is not np.ndarray:
            value = self._env.arrays.of(value)
        if not self._changes:
            return value
        if value.dtype == np.float64:
            value = value.astype(np.float32)
        if self._noise is not None:
            value = _in_type_of(value, self._noise.apply(value, advancing.stepped))
        if self._clip is not None:
            value = _in_type_of(value, np.clip(value, self._clip[0], self._clip[1]))
        if self._scale is not None:
            value = value * self._scale
        if self._delay is not None:
            value = self._delay(value, advancing)
        if self._past is None:
            return value
        history = self._past.append(value, advancing)
        if not self._flat:
            return history
        if self.is_image:  # along the channels
            return history.reshape(len(history), -1, *value.shape[2:])
        return history.reshape(len(history), -1)

    def restart(self, env_ids: EnvIndex | None) -> None:
        """Begin the episode of these environments; (n,), or None for all."""
        if self._delay is None:
            return
        delays = self._delay.restart(env_ids)
        if delays is not None and self._env.observers:
            self._env.log_event(self.key, "delay", env_ids, {"delay": delays})

    def _prepare(self, value: Any) -> None:
        """Check the shape of the first value, and build the scale and the noise that fit it."""
        self._require_rows(value)
        self.is_image = is_image(self.term.spec.func, value)
        shape = tuple(value.shape[1:])
        columns = self.term.columns
        if self._scale is not None:
            self._scale = np.float32(columns.numbers(self._scale, shape, f"{self.key}.scale"))
            self.scales = np.broadcast_to(self._scale, shape).reshape(-1)
            if "float" in str(value.dtype):
                # With a row for every environment: broadcasting one row takes four times as long.
                rows = np.broadcast_to(self._scale, tuple(value.shape))
                self._scale = self._env.arrays.put(rows)
        if self._noise_cfg is not None:
            self._noise = Noise(
                self._noise_cfg,
                shape=shape,
                path=self.key,
                streams=self._env.streams,
                arrays=self._env.arrays,
                columns=columns,
            )
        self._checked = True

    def _require_rows(self, value: Any) -> None:
        """Refuse a value that does not have a row for each environment."""
        num_envs = self._env.num_envs
        if not hasattr(value, "shape") or not hasattr(value, "dtype"):
            kind = type(value).__name__
        elif tuple(value.shape[:1]) != (num_envs,):
            kind = str(tuple(value.shape))
        else:
            return
        raise ConfigError(
            f"observation term {self.term.name!r} must return a tensor of shape "
            f"({num_envs}, ...), got {kind}"
        )

    def labels(self, count: int) -> list[str]:
        """The joint, link or other name of each of its columns, flattened; "" if there is none.

        Values of earlier steps, of which a history has several, are marked by their age.
        """
        columns = self.term.columns
        names = getattr(self.term.instance, "column_names", ())
        if names:
            columns = TermColumns(tuple(names))
        depth = self.term.cfg.history_length or 1
        if count % depth:
            return [""] * count
        labels = columns.labels(count // depth)
        if not any(labels):  # one number of several links
            labels = [", ".join(columns.names)] * len(labels)
        all_labels: list[str] = []
        for age in range(depth - 1, 0, -1):
            all_labels += [f"{label} ({age} before)".strip() for label in labels]
        return all_labels + [label.strip() for label in labels]

    # -- saving --------------------------------------------------------------------------------

    def state_dict(self) -> dict[str, Any]:
        """Noise, delay and history (copies)."""
        state: dict[str, Any] = {}
        if self._noise is not None:
            state["noise"] = self._noise.last.copy()
        if self._delay is not None:
            state["lag"] = self._delay.lag.copy()
            state["delayed"] = _copy(self._delay.past.values)
        if self._past is not None:
            state["history"] = _copy(self._past.values)
        return state

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        if self._noise is not None:
            self._noise.last = state["noise"].copy()
        if self._delay is not None:
            self._delay.lag[:] = state["lag"]
            self._delay.past.values = _copy(state["delayed"])
        if self._past is not None:
            self._past.values = _copy(state["history"])


def _in_type_of(value: NDArray[Any], changed: NDArray[Any]) -> NDArray[Any]:
    """A changed value; that of integers, such as an image's, is rounded to their type."""
    if value.dtype.kind not in "iu":
        return changed
    info = np.iinfo(value.dtype)
    return np.clip(np.rint(changed), info.min, info.max).astype(value.dtype)


def _copy(values: NDArray[Any] | None) -> NDArray[Any] | None:
    return None if values is None else values.copy()


@dataclass(frozen=True, slots=True, eq=False)
class _EntryPlace:
    """Where the value of an entry is written.

    Attributes:
        entry: The entry.
        columns: Its columns in the rows of the observation, if its value is (N, K); else None.
        shape: The shape of its value.
        is_last: Whether no later term modifies it: only then it is written.
    """

    entry: ObservationEntry
    columns: Any
    shape: tuple[int, ...]
    is_last: bool


@dataclass(frozen=True, slots=True, eq=False)
class _VectorPart:
    """Consecutive columns of a group's flat vector.

    Attributes:
        columns: Its columns in the vector.
        source: Its columns in the rows of the observation; None if it is an entry outside of them.
        path: The path of that entry.
    """

    columns: slice
    source: Columns | None
    path: tuple[str, ...] = ()


_NONE: NDArray[np.int64] = np.zeros(0, np.int64)
_BETWEEN_STEPS = Advancing(_NONE, None)


class ObservationManager(Manager[ObservationCfg]):
    """Evaluates observation terms in declared order.

    Noise is drawn, and delays and histories advance, once for each environment that stepped or was
    reset: the environment sets `stepped` before it observes. Other calls change nothing.

    Args:
        env: The environment; its scene is complete.
        cfgs: Name -> observation.

    Attributes:
        stepped: (n,) environments that the next observation is for, or None for all.
        layout: Columns of all entries; set after the first observation.
    """

    def __init__(self, env: TermContext, cfgs: Mapping[str, ObservationCfg]) -> None:
        self._entries: list[ObservationEntry] = []
        self.layout: ObservationLayout | None = None
        super().__init__(env, "observations", "observation", cfgs)
        corruption = env.cfg.enable_corruption  # of all terms, or by group
        for term in self.terms.values():
            if isinstance(corruption, bool):
                is_corrupted = corruption
            else:
                is_corrupted = corruption.get(term.cfg.group, True)
            self._entries.append(ObservationEntry(env, term, is_corrupted))
        self._groups: dict[str, dict[tuple[str, ...], None]] = {}
        for entry in self._entries:
            # A modifying term has the path of an existing entry; each path is in the vector once.
            self._groups.setdefault(entry.term.cfg.group, {})[entry.path] = None
        # Path of an entry that is modified -> the index of the last term that does it.
        self._modified = {
            entry.path: index for index, entry in enumerate(self._entries) if entry.modifies
        }
        self._remembers = any(entry.remembers for entry in self._entries)
        self._fresh: NDArray[np.bool_] = env.arrays.full(env.num_envs, True, np.bool_)
        self.stepped: EnvIndex | None = _NONE
        self._places: list[_EntryPlace] = []
        self._vectors: dict[str, list[_VectorPart]] = {}

    def _bind(self) -> None:
        for entry in self._entries:
            entry.term = self.terms[entry.term.name]

    def use(self, layout: ObservationLayout) -> None:
        """Write later observations into this layout, made from the first one."""
        self.layout = layout
        self._places = []
        for index, entry in enumerate(self._entries):
            shape = layout.shapes.get(entry.path, ())
            place = _EntryPlace(
                entry=entry,
                columns=layout.columns[entry.path] if len(shape) == 1 else None,
                shape=(self.num_envs, *shape),
                is_last=self._modified.get(entry.path, index) <= index,
            )
            self._places.append(place)
        self._vectors = {
            group: self._vector_parts(group)
            for group in self._groups
            if not self.image_terms(group)
        }

    def _vector_parts(self, group: str) -> list[_VectorPart]:
        """Return the parts of a group's flat vector: one, if all its entries are in the rows."""
        layout = cast("ObservationLayout", self.layout)
        columns = layout.groups[group]
        if columns is not None:
            return [_VectorPart(slice(None), columns)]
        parts: list[_VectorPart] = []
        start = 0
        for path in self._paths(group):
            stop = start + layout.widths[path]
            parts.append(_VectorPart(slice(start, stop), layout.columns.get(path), path))
            start = stop
        return parts

    @property
    def modifies(self) -> bool:
        """Whether a term modifies an entry."""
        return bool(self._modified)

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of the groups, in order of appearance."""
        return tuple(self._groups)

    @property
    def paths(self) -> dict[str, tuple[tuple[str, ...], ...]]:
        """Paths of each group's entries, in declared order."""
        return {name: tuple(paths) for name, paths in self._groups.items()}

    def group_terms(self, group: str = "policy") -> tuple[str, ...]:
        """Names of a group's entries ("/" nests) in the order of the flattened vector.

        Raises:
            ValueError: If no term is in the group; lists the groups.
        """
        return tuple("/".join(path) for path in self._paths(group))

    def _paths(self, group: str) -> dict[tuple[str, ...], None]:
        try:
            return self._groups[group]
        except KeyError:
            groups = ", ".join(self._groups) or "none"
            raise ValueError(
                f"no observation is in group {group!r}; there are: {groups}."
                f"{did_you_mean(group, self._groups)}"
            ) from None

    def compute(self, obs: MutableMapping[Any, Any]) -> None:
        """Add or modify the declared entries of nested tensors.

        Args:
            obs: The entries so far; new ones are set in it, float32 or not floating point.

        Raises:
            ConfigError: If a term's value is not (N, ...); names the term.
            ConfigError: If a term modifies an entry that does not exist.
        """
        advancing = self._take_advancing()
        for entry in self._entries:
            argument: Any = obs
            if entry.modifies:
                if entry.path not in obs:
                    raise _nothing_to_modify(entry, obs)
                argument = obs[entry.path]
            obs[entry.path] = new_tensor(self._value(entry, argument, advancing))

    def write(self, obs: Observation, own: Mapping[tuple[str, ...], Any]) -> None:
        """Write entries into an observation whose layout is known.

        Args:
            obs: The observation.
            own: Path -> value (N, ...) of the entries that are not of terms.

        Raises:
            ValueError: If the shape of a term's value has changed.
        """
        unfinished: dict[tuple[str, ...], Any] = {}
        for path, value in own.items():
            if path in self._modified:
                unfinished[path] = value
            else:
                obs.layout.write(obs, path, value)
        advancing = self._take_advancing()
        numbers = obs.rows
        for place in self._places:
            entry = place.entry
            argument: Any = obs
            if entry.modifies:
                argument = new_tensor(unfinished[entry.path])
            try:
                value = entry.value(argument, advancing)
            except FAILURES as error:
                self.fail(entry.term.name, error)
            if not place.is_last:
                unfinished[entry.path] = value
            elif place.columns is not None and value.shape == place.shape:
                numbers[:, place.columns] = value
            else:
                obs.layout.write(obs, entry.path, value)

    def _value(self, entry: ObservationEntry, obs: Any, advancing: Advancing) -> NDArray[Any]:
        try:
            return entry.value(obs, advancing)
        except FAILURES as error:
            self.fail(entry.term.name, error)

    def not_finite(
        self, obs: Observation, rows: NDArray[np.bool_]
    ) -> dict[str, tuple[str, NDArray[np.bool_]]]:
        """Return the entries that are not finite in some environments.

        Args:
            obs: The observation.
            rows: (N,) the environments.

        Returns:
            ``observations.NAME`` of a term, or the entry's own path, such as ``robot/qpos`` -> what
            its values are, and in which environments, (N,).
        """
        terms = {entry.path: entry.key for entry in self._entries}
        causes: dict[str, tuple[str, NDArray[np.bool_]]] = {}
        for path, columns in obs.layout.columns.items():
            values = obs.rows[:, columns]
            bad = rows & ~np.isfinite(values).all(axis=1)
            if bad.any():
                name = terms.get(path, "the observation " + "/".join(path))
                causes[name] = (kind_of_values(values[bad]), bad)
        return causes

    def _take_advancing(self) -> Advancing:
        """Return the environments that stepped or were reset; the next call returns none."""
        if not self._remembers:
            return _BETWEEN_STEPS
        stepped = self.stepped
        self.stepped = _NONE
        fresh = self._fresh if may_be_set(self._fresh) else None
        if fresh is not None and (stepped is None or len(stepped)):
            self._fresh = fresh.copy()
            self._fresh[slice(None) if stepped is None else stepped] = False
        return Advancing(stepped, fresh)

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Begin the episodes of these environments: draw delays and refill histories."""
        super().reset(env_ids)
        if self._remembers:
            self._fresh[slice(None) if env_ids is None else env_ids] = True
            for entry in self._entries:
                entry.restart(env_ids)

    def columns(self, group: str = "policy") -> dict[str, int]:
        """Widths of a group's entries in the flattened vector, by name, in its order.

        Available once the environment is built.

        Raises:
            ValueError: If no term is in the group; lists the groups.
        """
        widths = {} if self.layout is None else self.layout.widths
        return {"/".join(path): widths.get(path, 0) for path in self._paths(group)}

    def column_table(self, name: str, count: int) -> list[tuple[str, float]]:
        """What each column of a flattened entry belongs to (a joint, a link), and its factor.

        Available once the environment is built.

        Args:
            name: The entry ("/" nests).
            count: Number of its columns.
        """
        path = tuple(name.split("/"))
        labels: list[str] | None = None
        scales = np.ones(count)
        for entry in self._entries:
            if entry.path != path:
                continue
            if labels is None and not entry.modifies:
                labels = entry.labels(count)
            if entry.scales is not None and count % len(entry.scales) == 0:
                # Each value of a history has the factors of one value.
                scales *= np.tile(entry.scales.astype(np.float64), count // len(entry.scales))
        factors = [float(f"{scale:.6g}") for scale in scales]
        return list(zip(labels or [""] * count, factors, strict=True))

    @property
    def images(self) -> set[tuple[str, ...]]:
        """Paths of the entries that are images; complete after the first observation."""
        return {entry.path for entry in self._entries if entry.is_image}

    def image_terms(self, group: str = "policy") -> tuple[str, ...]:
        """Names of a group's entries that are images.

        Available once the environment is built.

        Raises:
            ValueError: If no term is in the group; lists the groups.
        """
        return tuple("/".join(path) for path in self._paths(group) if path in self.images)

    def flatten(self, obs: Mapping[Any, Any], group: str = "policy") -> torch.Tensor:
        """Return a group's entries in declared order, as one vector per environment.

        Args:
            obs: An observation of the environment.
            group: The group.

        Returns:
            (N, K) float32; it may share memory with the observation.

        Raises:
            ValueError: If no term is in the group (lists the groups), or one is an image.
        """
        return tensor_of(self.flat_rows(obs, group))

    def flat_rows(self, obs: Mapping[Any, Any], group: str = "policy") -> NDArray[np.float32]:
        """`flatten` as an array."""
        parts = self._vectors.get(group)
        if parts and isinstance(obs, Observation) and obs.layout is self.layout and obs.packed:
            first = parts[0]
            if len(parts) == 1 and first.source is not None:
                return contiguous(obs.rows[:, first.source])
            if not self._arrays.on_device:
                return _joined(parts, obs)
        images = self.image_terms(group)
        if images:
            raise ValueError(no_vector(group, images))
        import torch  # lists of terms are made without it

        entries = [
            obs[path].reshape(self.num_envs, -1).to(torch.float32) for path in self._paths(group)
        ]
        return self._arrays.of(torch.cat(entries, dim=1))

    def memory(self) -> dict[str, Any]:
        """Noise, delays, histories and states of terms (copies): what an observation advances."""
        memory: dict[str, Any] = {"terms": self.term_states()}
        if self._remembers:
            memory["memories"] = {entry.term.name: entry.state_dict() for entry in self._entries}
            memory["fresh"] = self._fresh.copy()
        return memory

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Continue where `memory` was taken, with the same parameters."""
        self.load_term_states(memory["terms"])
        self._recall(memory)

    def state_dict(self) -> dict[str, Any]:
        """Noise, delays and histories, and the state of terms that are classes (copies)."""
        return {**super().state_dict(), **self.memory()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        super().load_state_dict(state)
        self._recall(state)

    def _recall(self, state: Mapping[str, Any]) -> None:
        if self._remembers:
            self._fresh[:] = state["fresh"]
            for entry in self._entries:
                entry.load_state_dict(state["memories"][entry.term.name])


def is_image(source: object, value: Any) -> bool:
    """Whether a value (N, ...) is an image, which no vector of numbers contains.

    It is one if the term or the sensor that it comes from says so by `reads_images`; and if it has
    pixels, uint8 in three dimensions, whatever it comes from.

    Args:
        source: The term's function or class, or the sensor.
        value: Its value, an array or a tensor.
    """
    has_pixels = str(value.dtype).endswith("uint8") and len(value.shape) > 3
    return has_pixels or getattr(source, "reads_images", False)


def _joined(parts: Sequence[_VectorPart], obs: Observation) -> NDArray[np.float32]:
    """(N, K) the parts of a flat vector, side by side."""
    count = len(obs.rows)
    vector = np.empty((count, parts[-1].columns.stop), np.float32)
    for part in parts:
        if part.source is not None:
            vector[:, part.columns] = obs.rows[:, part.source]
        else:
            vector[:, part.columns] = as_array(obs.others[part.path]).reshape(count, -1)
    return vector


def no_vector(group: str, images: Sequence[str]) -> str:
    """Return the message that a group with images has no flat vector."""
    names = ", ".join(images)
    are_images = f"{names} is an image" if len(images) == 1 else f"{names} are images"
    return (
        f"observation group {group!r} is not a flat vector: {are_images}; "
        "read it as a dict of its entries"
    )


def _nothing_to_modify(entry: ObservationEntry, obs: Any) -> ConfigError:
    """Return the error that a term modifies an entry that does not exist."""
    name = "/".join(entry.path)
    entries = [key if isinstance(key, str) else "/".join(key) for key in obs.keys(True, True)]
    message = f"nothing to modify is called {name!r}; before it: {', '.join(entries)}"
    hint = did_you_mean(name, entries).strip()
    return ConfigError([Problem(f"{entry.key}.name", message, hint)])
