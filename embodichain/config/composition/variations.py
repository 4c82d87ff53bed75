"""Variations: named bundles of events, noise and delays with a strength, merged into a task.

A variation is an entry ``task.variations.NAME``: files of the group `variation` are placed there.
After composing, `merge_variations` makes of each entry what the task's own sections take:

* `objects` become objects of the task: at a strength below 1 the first of them;
* an event becomes an event of the task, with ``for_each`` one for each entity of a kind;
* `noise` and `delay` of an observation or action become those of the task's own term, with ``each``
  those of every term.

What two of them set, or one of them and the task, is a mistake: neither wins in silence.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.fields.type_errors import show_value, unknown_key
from embodichain.utils.suggest import did_you_mean, listing

__all__ = ["Merged", "merge_variations"]

Tree = dict[str, Any]
EACH = "each"
"""In an event with `for_each` the entity's name; in `observations` and `actions` every term."""
_KEYS = ("description", "strength", "needs", "objects", "events", "observations", "actions")
_DISTURBANCES = ("noise", "delay")
_REFERENCES = ("of", "entity_cfg", "camera", "sensor")
"""Parameters of an event that say what it changes."""
_ADDING = ("push_by_setting_velocity", "push_articulation_by_setting_velocity")
"""Events that add to what there is, so that several of them may act on one entity."""


@dataclass(frozen=True)
class Merged:
    """A config whose variations are a part of its task.

    Attributes:
        tree: The config, without ``task.variations``.
        origins: Key path of what was merged -> its key path in a variation.
        problems: The mistakes.
        notes: Parts of variations that change nothing in this task.
    """

    tree: Tree
    origins: dict[str, str] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)
    notes: list[Problem] = field(default_factory=list)


def merge_variations(
    tree: Mapping[str, Any], source: Callable[[str], str], *, is_of_run: bool = False
) -> Merged:
    """Return a copy of a composed config whose task has its variations merged.

    Args:
        tree: Plain dicts and lists.
        source: Function from a key path to where the key was set, for messages.
        is_of_run: Whether the task is that of an earlier run. What it had of these variations, at
            whatever strength, is replaced.
    """
    merged = Merged(copy.deepcopy(dict(tree)))
    task = merged.tree.get("task")
    if not isinstance(task, dict) or "variations" not in task:
        return merged
    variations = task.pop("variations")
    if variations is None:
        return merged
    if not isinstance(variations, dict):
        message = f"expected a map, got {show_value(variations)}"
        merged.problems.append(Problem("task.variations", message))
        return merged
    merger = _Merger(merged, task, source, is_of_run=is_of_run)
    chosen = [name for name, entry in variations.items() if _has_content(entry)]
    for name, variation in variations.items():
        if variation is None:  # null takes an inherited one out
            continue
        if isinstance(variation, dict) and not _has_content(variation):
            # A key of the command line for a variation that no file has placed here.
            message = f"no such variation is chosen; chosen: {listing(chosen, name)}."
            hint = did_you_mean(name, chosen).strip() or f"Add variation=[{name}]."
            merged.problems.append(Problem(f"task.variations.{name}", message, hint))
            continue
        merger.add(name, variation)
    merger.check_fields()
    return merged


def _has_content(variation: Any) -> bool:
    """Whether a variation says more than its strength."""
    return isinstance(variation, dict) and not set(variation) <= {"strength"}


class _Field(NamedTuple):
    """What an event sets.

    Attributes:
        func: The event.
        reference: The entity, camera or sensor; empty for the scene.
        param: The parameter with the range.
    """

    func: str
    reference: str
    param: str


class _Disturbed(NamedTuple):
    """What a variation gives noise and delay.

    Attributes:
        section: ``observations`` or ``actions``.
        key: The term, or `EACH`.
        path: Key path of the entry in the variation.
    """

    section: str
    key: str
    path: str


class _Merger:
    """Merges variations into one task, in place.

    Args:
        merged: The result; the task is a part of its tree.
        task: The task.
        source: Function from a key path to where the key was set.
        is_of_run: Whether the task is that of an earlier run.
    """

    def __init__(
        self,
        merged: Merged,
        task: Tree,
        source: Callable[[str], str],
        *,
        is_of_run: bool = False,
    ) -> None:
        self._merged = merged
        self._task = task
        self._source = source
        self._is_of_run = is_of_run

    def add(self, name: str, variation: Any) -> None:
        """Merge one variation; mistakes are collected."""
        path = f"task.variations.{name}"
        if not isinstance(variation, dict):
            self._report(path, f"expected a map, got {show_value(variation)}")
            return
        for key in variation:
            if key not in _KEYS:
                message, hint = unknown_key(str(key), _KEYS)
                self._report(f"{path}.{key}", message, hint)
        strength = self._strength(variation.get("strength", 1.0), f"{path}.strength")
        missing = self._missing(variation.get("needs"), f"{path}.needs")
        if missing:
            self._note(path, f"changes nothing: this task has no {listing(missing)}")
            return
        changes_before = len(self._merged.origins) + len(self._merged.problems)
        objects = dict(self._entries(variation, "objects", path))
        if self._is_of_run:
            self._remove_earlier(variation, path)
        added = list(objects)[: round(strength * len(objects))]
        for name in added:
            self._insert("objects", name, objects[name], f"{path}.objects.{name}")
        for key, event in self._entries(variation, "events", path):
            placed = _placed_by(event, objects)
            if not placed:
                self._add_event(key, event, f"{path}.events.{key}", strength)
            elif placed & set(added):
                arranged = _without_objects(event, placed - set(added))
                self._add_event(key, arranged, f"{path}.events.{key}", 1.0)
        for section in ("observations", "actions"):
            for key, disturbance in self._entries(variation, section, path):
                where = f"{path}.{section}.{key}"
                disturbed = _Disturbed(section, key, where)
                unchanged_terms = self._disturb(disturbed, disturbance, strength)
                for name, terms in unchanged_terms.items():
                    message = f"does not change that of {listing(terms)}, which the task sets"
                    self._note(f"{where}.{name}", message)
        changes = len(self._merged.origins) + len(self._merged.problems)
        if changes == changes_before and strength > 0.0:
            self._note(path, "changes nothing: this task has none of what it is about")

    def _entries(self, variation: Tree, section: str, path: str) -> Iterator[tuple[str, Tree]]:
        """The entries of a section; null ones are left out."""
        entries = variation.get(section)
        if entries is not None and not isinstance(entries, dict):
            self._report(f"{path}.{section}", f"expected a map, got {show_value(entries)}")
            return
        for key, entry in (entries or {}).items():
            if isinstance(entry, dict):
                yield key, entry
            elif entry is not None:
                message = f"expected a map, got {show_value(entry)}"
                self._report(f"{path}.{section}.{key}", message)

    def _strength(self, value: Any, path: str) -> float:
        """A strength, 1 if it is wrong."""
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_number:
            self._report(path, f"expected a number, got {show_value(value)}")
            return 1.0
        if not 0.0 <= value <= 1.0:
            self._report(path, f"must be within [0, 1], got {value}")
            return 1.0
        return float(value)

    def _report(self, path: str, message: str, hint: str = "") -> None:
        self._merged.problems.append(Problem(path, message, hint))

    def _note(self, path: str, message: str) -> None:
        self._merged.notes.append(Problem(path, message, source=self._source(path)))

    def _missing(self, needs: Any, path: str) -> list[str]:
        """The entities that a variation needs and the task does not have."""
        if needs is None:
            return []
        if not isinstance(needs, list):
            self._report(path, f"expected a list, got {show_value(needs)}")
            return []
        furniture = [uid for uid in ("table", "pedestal") if _section(self._task, "scene").get(uid)]
        uids = {*_objects(self._task), *_robots(self._task), *furniture}
        uids.update(_section(self._task, "articulations"))
        return [str(uid) for uid in needs if uid not in uids]

    def _remove_earlier(self, variation: Tree, path: str) -> None:
        """Take out what an earlier run has of a variation, at whatever strength."""
        objects = dict(self._entries(variation, "objects", path))
        removed = _remove_alike(self._task, "objects", objects)
        events: Tree = {}
        for key, event in self._entries(variation, "events", path):
            events |= self._declared_events(key, event)
        removed += _remove_alike(self._task, "events", events)
        if removed:
            self._note(path, f"takes the place of what the run has of it: {', '.join(removed)}")

    # -- events --------------------------------------------------------------------------------

    def _add_event(self, key: str, event: Tree, path: str, strength: float) -> None:
        """Add an event to the task, or one for each entity."""
        weakened = dict(event)
        if strength != 1.0:
            strength_of_event = self._strength(event.get("strength", 1.0), f"{path}.strength")
            weakened["strength"] = strength * strength_of_event
        kind = event.get("for_each")
        if kind is not None and kind not in _ENTITIES:
            hint = did_you_mean(str(kind), _ENTITIES).strip()
            message = f"expected one of {', '.join(_ENTITIES)}, got {show_value(kind)}"
            self._report(f"{path}.for_each", message, hint)
            return
        for name, declared in self._declared_events(key, weakened).items():
            self._insert("events", name, declared, path)

    def _declared_events(self, key: str, event: Tree) -> dict[str, Tree]:
        """Return name -> event of the task: one, or one for each entity that `for_each` names."""
        declared = copy.deepcopy(event)
        kind = declared.pop("for_each", None)
        if kind is None:
            return {key: declared}
        uids = _ENTITIES[kind](self._task) if kind in _ENTITIES else []
        return {f"{key}_{uid}": _named(declared, uid) for uid in uids}

    def _insert(self, section: str, name: str, entry: Tree, path: str) -> None:
        """Add an entry to a section of the task, which must not have one of this name."""
        entries = self._task.setdefault(section, {})
        if not isinstance(entries, dict):
            return  # the check of types reports it
        if name in entries:
            what = section.removesuffix("s")
            place = self._place(section, name)
            self._report(path, f"the task has an {what} {name!r} already ({place})")
            return
        entries[name] = copy.deepcopy(entry)
        self._merged.origins[f"task.{section}.{name}"] = path

    def _place(self, section: str, name: str) -> str:
        """Where an entry of the task was set, before or by a variation."""
        path = f"task.{section}.{name}"
        return self._source(self._merged.origins.get(path, path))

    def check_fields(self) -> None:
        """Report events of variations that set what another event sets."""
        events = self._task.get("events")
        if not self._merged.origins or not isinstance(events, dict):
            return
        fields = {name: _fields_of(event) for name, event in events.items()}
        for first, second in itertools.combinations(fields, 2):
            path = self._merged.origins.get(f"task.events.{second}")
            if path is None:  # the task's own events come first
                continue
            for each in sorted(fields[first] & fields[second]):
                what = f"{each.param} of {each.reference}" if each.reference else each.param
                message = (
                    f"sets {what}, as the event {first!r} does ({self._place('events', first)})"
                )
                hint = f"Take one out: ~task.events.{first}."
                if f"task.events.{first}" in self._merged.origins:
                    hint = "Use one of them."
                self._report(path, message, hint)

    # -- noise and delay -----------------------------------------------------------------------

    def _disturb(
        self, disturbed: _Disturbed, disturbance: Tree, strength: float
    ) -> dict[str, list[str]]:
        """Give noise and delay to a term of the task, or to each one.

        Returns:
            ``noise`` or ``delay`` -> the terms that keep what the task gives them.
        """
        section = disturbed.section
        key = disturbed.key
        path = disturbed.path
        weakened: Tree = {}
        for name, value in disturbance.items():
            if name not in _DISTURBANCES:
                message, hint = unknown_key(str(name), _DISTURBANCES)
                self._report(f"{path}.{name}", message, hint)
                continue
            try:
                weakened[name] = _WEAKEN[name](value, strength)
            except (TypeError, ValueError) as error:
                self._report(f"{path}.{name}", str(error))
        terms = self._task.get(section)
        if not isinstance(terms, dict):
            terms = {}
        names = [key]
        if key == EACH:
            names = list(self._disturbed_terms(section, terms))
        elif key not in terms:
            hint = did_you_mean(key, [*terms, EACH]).strip()
            message = f"the task has no such term; there are: {listing([*terms, EACH], key)}"
            self._report(path, message, hint)
            return {}
        unchanged_terms: dict[str, list[str]] = {}
        for name in names:
            for unchanged_key in self._set_keys(disturbed, name, weakened):
                unchanged_terms.setdefault(unchanged_key, []).append(name)
        return unchanged_terms

    def _disturbed_terms(self, section: str, terms: Tree) -> Iterator[str]:
        """The terms that `each` means: of observations the policy's, without pictures."""
        for name, term in terms.items():
            if not isinstance(term, dict):
                continue
            if section == "actions":
                yield name
                continue
            is_read_by_policy = term.get("group", "policy") == "policy"
            is_modifier = term.get("mode", "add") == "modify"
            if is_read_by_policy and not is_modifier and not self._is_picture(term):
                yield name

    def _is_picture(self, term: Tree) -> bool:
        """Whether an observation is what a camera sees."""
        params = term.get("params")
        sensors = self._task.get("sensors")
        if not isinstance(params, dict) or not isinstance(sensors, dict):
            return False
        return params.get("sensor") in _cameras(self._task)

    def _set_keys(self, disturbed: _Disturbed, name: str, keys: Tree) -> list[str]:
        """Set keys of a term that has none of them.

        Args:
            disturbed: What a variation disturbs.
            name: The term.
            keys: Its `noise` and `delay`.

        Returns:
            The keys that the task has set for the term, where every term was meant.
        """
        term = self._task[disturbed.section][name]
        if not isinstance(term, dict):
            return []  # the check of types reports it
        unchanged_keys: list[str] = []
        for key, value in keys.items():
            path = f"{disturbed.path}.{key}"
            target = f"task.{disturbed.section}.{name}.{key}"
            if term.get(key) in (None, 0):
                term[key] = copy.deepcopy(value)
                self._merged.origins[target] = path
                continue
            is_of_task = target not in self._merged.origins
            if disturbed.key == EACH and is_of_task:
                unchanged_keys.append(key)
                continue
            place = self._source(self._merged.origins.get(target, target))
            self._report(path, f"{target} is set already ({place})")
        return unchanged_keys


def _fields_of(event: Any) -> set[_Field]:
    """What an event sets; empty if it is unknown, or adds to what there is."""
    if not isinstance(event, dict) or not isinstance(event.get("func"), str):
        return set()
    params = event.get("params")
    if not isinstance(params, dict) or event["func"] in _ADDING:
        return set()
    func, names = _target_of(event["func"])
    if func == "arrange_objects" and isinstance(params.get("objects"), dict):
        return {_Field(func, str(uid), "place") for uid in params["objects"]}
    references = [params[key] for key in _REFERENCES if key in params]
    reference = ", ".join(map(_reference_text, references))
    return {
        _Field(func, reference, names.get(str(key), str(key)))
        for key, value in params.items()
        if key not in _REFERENCES and isinstance(value, list | dict)
    }


def _target_of(func: str) -> tuple[str, dict[str, str]]:
    """The event that another name stands for, and its parameters by those of the name."""
    from embodichain.lab.gym.envs.managers.terms.aliases import AliasSpec
    from embodichain.lab.gym.envs.managers.terms.registry import resolve_term

    try:
        spec = resolve_term("event", func, allow_import=False)
    except ConfigError:  # the check of terms reports it
        return func, {}
    if not isinstance(spec, AliasSpec):
        return spec.name, {}
    return spec.target.name, {name: key for name, (_, key) in spec.exposed.items()}


def _reference_text(reference: Any) -> str:
    """A reference as text: ``cube``, ``robot [tool]``."""
    if not isinstance(reference, dict):
        return str(reference)
    uid = str(reference.get("uid", ""))
    picked = [value for key, value in sorted(reference.items()) if key != "uid"]
    return " ".join([uid, *map(str, picked)])


def _remove_alike(task: Tree, section: str, entries: Tree) -> list[str]:
    """Take the entries of a section that differ from given ones in their strength at most.

    Returns:
        Their names.
    """
    present = task.get(section)
    if not isinstance(present, dict):
        return []
    removed = [name for name, entry in entries.items() if _is_alike(present.get(name), entry)]
    for name in removed:
        del present[name]
    return removed


def _is_alike(entry: Any, other: Tree) -> bool:
    """Whether two entries are equal but for their strength, and for how many objects they place."""
    if not isinstance(entry, dict):
        return False
    entry = {key: value for key, value in entry.items() if key != "strength"}
    other = {key: value for key, value in other.items() if key != "strength"}
    if entry == other:
        return True
    arranged = _section(_section(entry, "params"), "objects")
    others = _section(_section(other, "params"), "objects")
    if not arranged or not all(others.get(uid) == place for uid, place in arranged.items()):
        return False
    return entry == {**other, "params": {**other["params"], "objects": arranged}}


def _placed_by(event: Tree, objects: Tree) -> set[str]:
    """The objects of a variation that an event arranges."""
    params = event.get("params")
    arranged = params.get("objects") if isinstance(params, dict) else None
    return set(objects) & set(arranged) if isinstance(arranged, dict) else set()


def _without_objects(event: Tree, names: set[str]) -> Tree:
    """A copy of an event that arranges objects, without some of them."""
    remaining = copy.deepcopy(event)
    for name in names:
        del remaining["params"]["objects"][name]
    return remaining


def _named(value: Any, uid: str) -> Any:
    """A copy of an event's entry with the entity's name in place of `EACH`."""
    if isinstance(value, dict):
        return {key: _named(part, uid) for key, part in value.items()}
    if isinstance(value, list):
        return [_named(part, uid) for part in value]
    return uid if value == EACH else value


# -- the entities that `for_each` names ----------------------------------------------------------


def _section(task: Tree, name: str) -> Tree:
    entries = task.get(name)
    return entries if isinstance(entries, dict) else {}


def _dynamic_objects(task: Tree) -> list[str]:
    objects = _section(task, "objects")
    return [
        uid
        for uid, cfg in objects.items()
        if isinstance(cfg, dict) and cfg.get("body_type", "dynamic") == "dynamic"
    ]


def _objects(task: Tree) -> list[str]:
    return list(_section(task, "objects"))


def _robots(task: Tree) -> list[str]:
    robot = task.get("robot")
    uids = list(_section(task, "robots"))
    if isinstance(robot, dict) and isinstance(robot.get("uid"), str):
        uids.insert(0, robot["uid"])
    return uids


def _floating_robots(task: Tree) -> list[str]:
    robots = _section(task, "robots")
    uids = [
        uid for uid, cfg in robots.items() if isinstance(cfg, dict) and cfg.get("fix_base") is False
    ]
    robot = _section(task, "robot")
    if robot.get("fix_base") is False and isinstance(robot.get("uid"), str):
        uids.insert(0, robot["uid"])
    return uids


def _lights(task: Tree) -> list[str]:
    from embodichain.lab.sim.compiler.names import SUN

    scene = _section(task, "scene")
    declared = [*_section(scene, "lights"), *_section(task, "lights")]
    if not declared and scene.get("fpath") is None:  # a file may have lights of its own
        return [SUN]
    return declared


def _cameras(task: Tree) -> list[str]:
    from embodichain.lab.sim.configs.sensor_cfg import SENSORS

    cameras: list[str] = []
    for name, cfg in _section(task, "sensors").items():
        kind = cfg.get("sensor_type") if isinstance(cfg, dict) else None
        if isinstance(kind, str) and kind in SENSORS and SENSORS[kind].config.reads_images:
            cameras.append(name)
    return cameras


_ENTITIES: dict[str, Callable[[Tree], list[str]]] = {
    "objects": _objects,
    "dynamic_objects": _dynamic_objects,
    "robots": _robots,
    "floating_robots": _floating_robots,
    "lights": _lights,
    "cameras": _cameras,
}
"""Value of `for_each` -> the names of the task's entities of this kind."""


# -- strength of noise and delay -----------------------------------------------------------------


def _weaken_noise(noise: Any, strength: float) -> Any:
    """A noise whose result is default + strength x (noisy - default)."""
    if strength == 1.0 or not isinstance(noise, dict):
        return noise
    operation = noise.get("operation", "add")
    if operation == "abs":
        raise ValueError("operation: abs replaces the value, so that strength has no meaning")
    weakened = dict(noise)
    for key in ("std", "mean", "low", "high", "n_min", "n_max", "bias"):
        if weakened.get(key) is None:
            continue
        is_factor = operation == "scale" and key != "std"
        weakened[key] = _weaken_numbers(weakened[key], strength, is_factor=is_factor)
    if operation == "scale" and "std" in weakened and weakened.get("mean") is None:
        weakened["mean"] = 1.0
    return weakened


def _weaken_numbers(value: Any, strength: float, *, is_factor: bool) -> Any:
    """A number, or a list or map of numbers, nearer to 0; of factors nearer to 1."""
    if isinstance(value, list):
        return [_weaken_numbers(part, strength, is_factor=is_factor) for part in value]
    if isinstance(value, dict):
        return {k: _weaken_numbers(v, strength, is_factor=is_factor) for k, v in value.items()}
    if not isinstance(value, int | float):
        raise TypeError(f"expected a number, got {show_value(value)}")
    if not is_factor:
        return strength * value
    if value < 0:
        raise ValueError(f"strength needs factors that are not negative, got {value}")
    return float(value**strength)


def _weaken_delay(delay: Any, strength: float) -> Any:
    """A delay in control steps, rounded."""
    if isinstance(delay, list):
        return [_weaken_delay(steps, strength) for steps in delay]
    if isinstance(delay, bool) or not isinstance(delay, int):
        return delay  # the check of types reports it
    return round(strength * delay)


_WEAKEN: Mapping[str, Callable[[Any, float], Any]] = {
    "noise": _weaken_noise,
    "delay": _weaken_delay,
}
