"""All checks of a config in one report: types, values, terms, scene; each mistake with its place.

Types are checked by `check_types`, terms by `lab.gym.envs.managers.terms.check`, the scene by
`lab.gym.envs.scene_setup`; values of the root and of the task are checked here. The scene of a
config with mistakes is compiled too, so that the report has the mistakes that MuJoCo finds. That of
a config without mistakes is compiled in a step of its own, after the config is resolved.
"""

from __future__ import annotations

import copy
import dataclasses
import re
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.override_parser.types import OverrideType

from embodichain.config.checks.check_result import Check
from embodichain.config.checks.compiled_scene import compile_declared
from embodichain.config.checks.embodiment_needs import check_embodiment
from embodichain.config.checks.given_keys import check_given
from embodichain.config.checks.idle_keys import idle_keys
from embodichain.config.checks.plausibility import implausible_values
from embodichain.config.checks.viewer_access import access_of
from embodichain.config.composition.composed import Composed
from embodichain.config.composition.locate import COMMAND_LINE, Locator
from embodichain.config.composition.yaml_words import quoting
from embodichain.config.keys.check_types import check_types
from embodichain.config.keys.schema import (
    JOB_VERBS,
    LARGEST_TRAINING_SEED,
    SUGGESTED_KEYS,
    JobVerb,
    PolicyCfg,
    RootCfg,
    SimCfg,
)
from embodichain.config.keys.viewers import NO_VIEWER, VIEWERS
from embodichain.config.run_folder import CHECKPOINT, checkpoint_of, newest_run
from embodichain.lab.gym.envs.cfg import EnvCfg
from embodichain.lab.gym.envs.managers.terms.check import check_terms
from embodichain.lab.gym.envs.managers.terms.registry import SECTIONS, resolve_term
from embodichain.lab.gym.policies import PRETRAINED, resolve_policy
from embodichain.lab.sim.cfg import WarpCfg, choose_engine
from embodichain.lab.sim.configs.references import REFERENCE_WORDS
from embodichain.lab.sim.engine.engine_register import ENGINES
from embodichain.utils.errors import ConfigError, Problem
from embodichain.utils.fields.type_errors import unknown_key
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.scene_setup.declared_scene import DeclaredScene

__all__ = [
    "check_composed",
    "check_training_keys",
    "check_tree",
    "named_maps",
    "source_of_values",
    "validate",
]

Chosen = Callable[[str, str], bool]
"""``chosen(path, package)``: whether a key was set outside the group option at `package`."""

_FLAGS = {"on": "true", "yes": "true", "off": "false", "no": "false"}
_ENTITY = re.compile(r"task(\.(robot|(robots|objects|articulations)(\.[^.]+)?)(\.(uid|fpath))?)?")
"""If such a key was pruned, references to entities may fail without being wrong."""
_POSE = re.compile(r"task\.(robot|robots\.[^.]+)\.init_(pos|local_pose)(\.\d+)*")
"""If such a key was pruned, the robot stands elsewhere than it should."""


def validate(composed: Composed, verb: JobVerb = "run") -> list[Problem]:
    """Return every mistake of a composed config, from composing it to compiling its scene.

    Args:
        composed: The result of `compose`.
        verb: The verb for which the task's suggestions are used.
    """
    check = check_composed(composed, verb)
    if check.problems or check.types.root is None or check.scene is None:
        return check.problems
    return _located(_mistakes_in_model(check.types.root, check.scene, ()), composed.source)


def check_composed(composed: Composed, verb: JobVerb) -> Check:
    """Check a whole composed config, with the task's suggestions for a verb."""
    check = _check_without_needs(composed, verb)
    if check.types.root is None or check.scene is None or not check.problems:
        return check
    problems = check_embodiment(
        composed,
        check.types.root.task,
        check.scene.known,
        check.problems,
        lambda other: _check_without_needs(other, verb),
    )
    return replace(check, problems=problems)


def _check_without_needs(composed: Composed, verb: JobVerb) -> Check:
    """Check a composed config, with every mistake that follows from a lack of its embodiment."""
    if not composed.usable:
        types = check_types({**composed.tree, "task": {}})
        problems = [*composed.problems, *_located(types.problems, composed.source)]
        return Check(problems, replace(types, root=None))
    locator = composed.locator
    reported = {problem.path for problem in composed.problems}
    unknown = [p for p in _unknown_entries(composed) if p.path not in reported]
    # A key that is not read as written is a mistake, but its value can be checked.
    misread = locator.misread()
    wrong_paths = [p.path for p in (*composed.problems, *unknown)]
    check = check_tree(
        composed.tree,
        source_of_values(composed, verb),
        verb,
        chosen=locator.chosen,
        lost=[path for path in wrong_paths if path not in misread],
    )
    misread_numbers = locator.misread(keys=False)  # these are reported already
    causes = [p for p in _causes(check.problems) if p.path not in misread_numbers]
    problems = [*composed.problems, *_located(unknown, composed.source)]
    problems += [_advised(problem, locator) for problem in causes]
    notes = check.notes
    if check.types.root is not None:
        notes = (*notes, *idle_keys(check.types.root, locator.overrides, verb))
    return replace(check, problems=problems, notes=notes)


def source_of_values(composed: Composed, verb: JobVerb) -> Callable[[str], str]:
    """Return a function from a key path to where its value was written.

    Of a value that the task suggests for a verb, that is a line of the task.
    """
    suggested = _suggested(composed.tree, verb)
    algo = composed.tree.get("algo")
    suggested_algo = suggested.get("algo")
    is_for_algo = False
    if isinstance(algo, Mapping) and isinstance(suggested_algo, Mapping):
        is_for_algo = suggested_algo.get("name", algo.get("name")) == algo.get("name")

    def source(path: str) -> str:
        root_key, _, _ = path.partition(".")
        if root_key == "algo":
            is_suggested = is_for_algo and not composed.locator.chosen(path, "algo")
        else:
            is_suggested = root_key in SUGGESTED_KEYS and composed.tree.get(root_key) is None
        if is_suggested and _has_path(suggested, path):
            return composed.source(f"task.suggested.{verb}.{path}")
        return composed.source(path)

    return source


def _has_path(tree: Mapping[str, Any], path: str) -> bool:
    """Whether a tree has a value other than null at a key path."""
    node: Any = tree
    for part in path.split("."):
        node = node.get(part) if isinstance(node, Mapping) else None
    return node is not None


def check_tree(
    tree: Mapping[str, Any],
    source: Callable[[str], str],
    verb: JobVerb = "run",
    *,
    chosen: Chosen | None = None,
    lost: Sequence[str] = (),
    allow_import: bool = True,
) -> Check:
    """Check a plain tree.

    Args:
        tree: A composed or dumped config.
        source: Function from a key path to where the key was set.
        verb: The verb for which the task's suggestions are used.
        chosen: Whether the user set a key of `algo`, which then overrides the task's suggestion.
            None means that the user set all of them.
        lost: Key paths known to be wrong; they are not reported again.
        allow_import: Whether ``package.module:function`` may be imported.
    """
    remaining = copy.deepcopy(dict(tree))
    for path in lost:
        _remove(remaining, path)
    problems = _check_suggested(remaining)
    for problem in problems:
        _remove(remaining, ".".join(problem.path.split(".")[:4]))  # task.suggested.VERB.KEY
    types = check_types(_with_suggestions(remaining, verb, chosen))
    problems += types.problems
    missing = [*lost, *types.pruned]
    scene: DeclaredScene | None = None
    notes: list[Problem] = []
    if types.root is not None:
        mistakes, notes = check_given(types.root, types.tree)
        problems += mistakes
        notes += implausible_values(types.root, types.tree)
        scene = _read_scene(types.root, missing, allow_import)
        further = _check_meaning(types.root, verb, missing, allow_import, scene)
        if scene is not None and (problems or lost or further):
            further += _mistakes_in_model(types.root, scene, missing)
            # Mistakes of the root, such as those of pictures in the log, come before the task's.
            further.sort(key=lambda problem: _below(problem.path, ["task"]))
        further = [_as_written(p, types.tree) for p in further]
        # What lacks a part that was left out, such as a pattern without its grid, is not wrong.
        incomplete = {path.rpartition(".")[0] for path in missing}
        # An object that lacks one of its own keys may be another one, such as a default cube.
        wrong = [p.path.split(".") for p in types.problems]
        objects = {
            parts[2] for parts in wrong if parts[:2] == ["task", "objects"] and len(parts) == 4
        }
        for problem in further:
            is_told = _below(problem.path, missing) or problem.path in incomplete
            is_told |= _follows_from_lost(problem.path, missing)
            if not is_told and not _is_about(problem, objects):
                problems.append(problem)
    distinct = {p.path + p.message: p for p in problems}.values()
    return Check(_located(distinct, source), types, scene, tuple(_located(notes, source)))


def _follows_from_lost(path: str, lost: Iterable[str]) -> bool:
    """Whether a mistake may follow from a key that was left out elsewhere.

    A pedestal takes its size and its place from the pose of the robot.
    """
    return _below(path, ["task.scene.pedestal"]) and any(_POSE.fullmatch(other) for other in lost)


def _is_about(problem: Problem, objects: Iterable[str]) -> bool:
    """Whether a mistake is one of an object, or of what is done with it, of the names given."""
    parts = problem.path.split(".")
    for name in objects:
        is_of_object = parts[:3] == ["task", "objects", name]
        is_of_relation = parts[-3:-1] == ["params", "objects"] and parts[-1] == name
        if is_of_object or is_of_relation or repr(name) in problem.message:
            return True
    return False


def _as_written(problem: Problem, tree: Mapping[str, Any]) -> Problem:
    """The problem with the key path that the config has: ``of`` may be written `entity_cfg`."""
    parts = problem.path.split(".")
    node: Any = tree
    for depth, part in enumerate(parts):
        if not isinstance(node, Mapping):
            break
        if part not in node:
            aliases = [name for name, word in REFERENCE_WORDS.items() if word == part]
            parts[depth] = next((name for name in aliases if name in node), part)
        node = node.get(parts[depth])
    return replace(problem, path=".".join(parts))


def _located(problems: Iterable[Problem], source: Callable[[str], str]) -> list[Problem]:
    return [p.at(source(p.path)) for p in problems]


def _causes(problems: Sequence[Problem]) -> list[Problem]:
    """The problems without those of a value that is of the wrong kind: `on` names no entity."""
    wrong_kind = {re.sub(r"(\.\d+)*$", "", p.path) for p in problems if p.expected}
    return [p for p in problems if p.expected or p.path not in wrong_kind]


def _advised(problem: Problem, locator: Locator) -> Problem:
    """The problem with a hint on what to write, where a word was read as another kind of value."""
    if not problem.expected or problem.hint:
        return problem
    written = locator.written(problem.path)
    if not written:
        return problem
    is_typed = problem.source == COMMAND_LINE
    if problem.expected == "text" and is_typed:
        hint = f"For the text write {problem.path}=\"'{written}'\"."
    elif problem.expected == "text":
        hint = quoting(written)
    elif "${oc.env:" in written:
        hint = f"A variable of the environment is text: write ${{oc.decode:{written}}}."
    elif is_typed and problem.expected == "flag" and written.lower() in _FLAGS:
        hint = f"Write {problem.path}={_FLAGS[written.lower()]}."
    else:
        return problem
    return replace(problem, hint=hint).at(problem.source)


def _read_scene(root: RootCfg, missing: Sequence[str], allow_import: bool) -> DeclaredScene | None:
    """Read the scene of the task; None where a mistake of type leaves entities out."""
    if any(_ENTITY.fullmatch(path) for path in missing):
        return None
    from embodichain.lab.gym.envs.scene_setup.declared_scene import describe  # imports MuJoCo

    return describe(root.task, root.num_envs, allow_import=allow_import)


def _check_meaning(
    root: RootCfg,
    verb: JobVerb,
    missing: Sequence[str],
    allow_import: bool,
    scene: DeclaredScene | None,
) -> list[Problem]:
    """Check values, terms and scene of the keys that have the right types."""
    problems = _check_root(root, allow_import)
    problems += _check_task(root.task, allow_import)
    problems += _check_backend(root, verb, allow_import)
    if verb == "train":
        problems += check_training_keys(root)
    if verb == "collect":
        problems += _check_collecting(root)
    reported = {p.path for p in problems}
    in_task = check_terms(root.task, allow_import=allow_import)
    if scene is not None:
        in_task += scene.problems
    if root.task.expert is not None and not _below("task.expert", missing):
        from embodichain.lab.gym.expert.program import check_expert  # imports the actions

        entities = None if scene is None else scene.known
        in_task += check_expert(root.task, entities, allow_import)
    for problem in in_task:
        path = f"task.{problem.path}".rstrip(".")
        if path not in reported:
            problems.append(replace(problem, path=path))
    if verb != "train" and _policy_name(root) == "teleop" and not _below("task.actions", missing):
        problems += _check_teleop(root, allow_import)
    return problems


def _mistakes_in_model(
    root: RootCfg, scene: DeclaredScene, missing: Sequence[str]
) -> list[Problem]:
    """The mistakes that only the compiled scene shows; none if it cannot be compiled."""
    if scene.problems:
        return []
    images = not any(_below(path, ["record.images"]) for path in missing)
    try:
        compile_declared(root, scene, images=images)
    except ConfigError as error:
        return list(error.problems)
    return []


def check_training_keys(root: RootCfg) -> list[Problem]:
    """Check the keys that only a training needs: its length, and a seed that SB3 accepts."""
    problems = []
    if root.total_timesteps is None:
        message = "missing value: set it, or task.suggested.train.total_timesteps"
        problems.append(Problem("total_timesteps", message))
    if root.seed is not None and root.seed > LARGEST_TRAINING_SEED:
        message = f"training needs a seed from 0 to {LARGEST_TRAINING_SEED}, got {root.seed}"
        problems.append(Problem("seed", message))
    return problems


def _unknown_entries(composed: Composed) -> list[Problem]:
    """Overrides without `+` for an entity or term that does not exist; `+` would add it."""
    problems: dict[str, Problem] = {}
    for override in composed.locator.overrides:
        parts = override.key_or_group.split(".")
        if override.type is not OverrideType.CHANGE or len(parts) < 3:
            continue
        path = ".".join(parts[:3])  # task.SECTION.NAME
        is_named = parts[0] == "task" and parts[1] in named_maps()
        if is_named and not composed.locator.sets(path):
            problems[path] = _unknown_entry(path, composed)
    return list(problems.values())


@cache
def named_maps() -> set[str]:
    """Return the keys of a task that are maps from names to entities or terms."""
    names = set()
    for key, hint in typing.get_type_hints(EnvCfg).items():
        if typing.get_origin(hint) is not dict:
            continue
        _, value_type = typing.get_args(hint)
        if dataclasses.is_dataclass(value_type):
            names.add(key)
    return names


def _unknown_entry(path: str, composed: Composed) -> Problem:
    """The problem of an override that changes an entry that does not exist."""
    section, _, name = path.rpartition(".")
    entries: Any = composed.tree
    for part in section.split("."):
        entries = entries.get(part, {}) if isinstance(entries, dict) else {}
    names = [str(key) for key in entries if composed.locator.sets(f"{section}.{key}")]
    message = f"there is no {name!r} in {section}; there are: {', '.join(names) or 'none'}."
    hint = did_you_mean(name, names).strip() or f"Add one with +{path}={{...}}"
    return Problem(path, message, hint)


def _below(path: str, ancestors: Iterable[str]) -> bool:
    """Whether a key path is one of some others, or below one."""
    return any(path == a or path.startswith(f"{a}.") for a in ancestors)


def _remove(tree: dict[str, Any], path: str) -> None:
    """Remove a key, if there is one."""
    *parents, name = path.split(".")
    node: Any = tree
    for part in parents:
        node = node.get(part) if isinstance(node, dict) else None
    if isinstance(node, dict):
        node.pop(name, None)


def _check_root(root: RootCfg, allow_import: bool) -> list[Problem]:
    """Check the everyday keys; a policy is imported to read its signature, if that is allowed."""
    problems = _check_engine(root) + _check_policy(root, allow_import)
    count = root.num_envs or 1
    if root.record.format != "none":
        problems += _check_envs("record.view_envs", root.record.view_envs, count)
    if root.record.images is not None:
        problems += _check_envs("record.images.envs", root.record.images.envs, count)
    if root.viewer.name != "none" and root.viewer.env >= count:
        message = f"no such environment: {root.viewer.env}; num_envs is {count}"
        problems.append(Problem("viewer.env", message))
    problems += access_of(root.viewer).problems(root.viewer.host)
    if root.video and (root.record.format == "none" or root.record.state == "none"):
        message = "films are made from the log: they need record=mcap with record.state=all"
        problems.append(Problem("video", message))
    return problems


def _check_envs(key: str, envs: Sequence[int], count: int) -> list[Problem]:
    """Check that environments exist among `count`."""
    missing = [env for env in envs if env >= count]
    if not missing:
        return []
    return [Problem(key, f"no such environments: {missing}; num_envs is {count}")]


def _check_task(task: EnvCfg, allow_import: bool) -> list[Problem]:
    """Check values of a task outside its terms and entities."""
    problems = []
    if task.id is not None:
        from embodichain.config.composition.plugins import (
            require_registered,  # Gymnasium: only when needed
        )

        reason = require_registered(task.id, allow_import=allow_import)
        if reason:
            problems.append(Problem("task.id", reason))
    for section in SECTIONS:
        for name, term in getattr(task, section).items():
            if term.func == "":
                path = f"task.{section}.{name}.func"
                problems.append(Problem(path, "missing value: the name of a function"))
    return problems


def _check_suggested(tree: Mapping[str, Any]) -> list[Problem]:
    """Check `task.suggested.VERB` as values of root keys."""
    problems: list[Problem] = []
    for verb in JOB_VERBS:
        allowed = list(SUGGESTED_KEYS)
        if verb == "train":
            allowed.append("algo")
        path = f"task.suggested.{verb}"
        values = {}
        for name, value in _suggested(tree, verb).items():
            if name in allowed:
                values[name] = value
            else:
                message, hint = unknown_key(name, allowed)
                problems.append(Problem(f"{path}.{name}", message, hint))
        if values:
            mistakes = check_types({"task": {}, **values}).problems
            problems += [replace(p, path=f"{path}.{p.path}") for p in mistakes]
    return problems


def _check_engine(root: RootCfg) -> list[Problem]:
    """Check that the engine exists here and runs on the device."""
    engine, problems = choose_engine(root.sim.engine, root.device or "cpu")
    for key, value in vars(root.sim.warp).items():
        if engine != "warp" and value not in (getattr(WarpCfg(), key), "host"):
            message = f"is for sim.engine=warp, but the engine is {engine}"
            problems.append(Problem(f"sim.warp.{key}", message))
    record = root.record
    kind = ENGINES.get(engine)
    is_exact = kind is None or kind.is_exact
    if not is_exact and record.format != "none" and record.state == "keyframes":
        message = f"physics of sim.engine={engine} is not repeated to the bit; use record.state=all"
        problems.append(Problem("record.state", message))
    return problems


def _check_backend(root: RootCfg, verb: JobVerb, allow_import: bool) -> list[Problem]:
    """Check what a job in shards cannot do, and keys that only have a meaning with shards."""
    sim = root.sim
    default = SimCfg()
    if (sim.backend, sim.shards, sim.ray) == (default.backend, default.shards, default.ray):
        return []
    from embodichain.config.checks.shard_checks import check_shards

    return check_shards(root, verb, allow_import)


def _check_collecting(root: RootCfg) -> list[Problem]:
    """Check that a collection has a whole log, and a task that says what success is."""
    problems = []
    record = root.record
    task = root.task
    if record.format == "none":
        problems.append(Problem("record.format", "a collection is a log: must not be none"))
    elif record.state == "none":
        problems.append(Problem("record.state", "must be all or keyframes for a collection"))
    if record.every != 1:
        message = f"a collection has every episode: must be 1, got {record.every}"
        problems.append(Problem("record.every", message))
    ends = [term.ends_by for term in task.terminations.values()]
    if task.id is None and "success" not in task.metrics and "success" not in ends:
        message = "collect needs a task that says what success is: the metric `success`"
        problems.append(Problem("task.metrics", message))
    return problems


def _check_policy(root: RootCfg, allow_import: bool) -> list[Problem]:
    """Check that a policy exists and accepts its parameters; a trained one, that its file does."""
    policy = root.policy
    name = _policy_name(root)
    if policy is None or name is None:
        return []
    if not name:
        return [Problem("policy", "is empty: leave it out, or name a policy")]
    if name == "expert" and root.task.expert is None and root.task.id is None:
        return [Problem("policy", "the task has no section `expert`, whose steps it would perform")]
    if ":" in name and not allow_import:
        message = f"{name!r} would be imported, which is not allowed for this config"
        return [Problem("policy", message)]
    try:
        cfg: dict[str, Any] = {"func": name}
        if not isinstance(policy, str):
            cfg["params"] = policy.params
        resolve_policy(cfg, load_file=lambda path: _check_checkpoint(root, path))
    except ConfigError as error:
        return list(error.problems)
    return []


def _policy_name(root: RootCfg) -> str | None:
    """The policy, without its parameters."""
    if isinstance(root.policy, PolicyCfg):
        return root.policy.func
    return root.policy


def _check_teleop(root: RootCfg, allow_import: bool) -> list[Problem]:
    """Check that a person can move a robot: a viewer, one environment, an action for a tool."""
    from embodichain.lab.gym.teleop import check_teleop

    problems = []
    if root.viewer.name == NO_VIEWER or not VIEWERS[root.viewer.name].controls:
        names = [name for name, entry in VIEWERS.items() if entry.controls]
        names.sort(key=lambda name: name != "web")  # first the viewer that needs no display
        allowed = " or ".join(f"viewer={name}" for name in names)
        message = f"teleop needs a viewer: {allowed}, not {root.viewer.name}"
        problems.append(Problem("policy", message))
    if (root.num_envs or 1) > 1:
        message = f"policy: teleop moves one robot; set num_envs=1, not {root.num_envs}"
        problems.append(Problem("num_envs", message))
    actions = {}
    try:
        for name, term in root.task.actions.items():
            function = resolve_term("action", term.func, allow_import=allow_import).func
            actions[name] = (str(term.func), function)
    except ConfigError:
        return problems  # the check of the terms reports it
    if root.task.id is None:
        problems += check_teleop(actions)
    return problems


def _check_checkpoint(root: RootCfg, path: Path) -> Any:
    """Check that there is a checkpoint; return a policy that does nothing.

    Raises:
        ConfigError: If there is none.
    """
    if str(path) == "last":
        if newest_run(root.output_dir, CHECKPOINT) is None:
            message = f"there is no finished training in {root.output_dir} (train first)"
            raise ConfigError([Problem("policy", message)])
    elif str(path) != PRETRAINED:
        checkpoint_of(path)
    return lambda obs, env: None


def _with_suggestions(
    tree: Mapping[str, Any], verb: JobVerb, chosen: Chosen | None
) -> dict[str, Any]:
    """A copy with the task's suggestions for null keys; see `check_tree`."""
    filled = copy.deepcopy(dict(tree))
    suggested = _suggested(filled, verb)
    policy = filled.get("policy")
    if isinstance(policy, dict):
        policy = policy.get("func")
    if policy == "teleop":
        suggested["num_envs"] = 1  # a person moves one robot
    for key in SUGGESTED_KEYS:
        if filled.get(key) is None and suggested.get(key) is not None:
            filled[key] = suggested[key]
    algo = filled.get("algo")
    suggested_algo = suggested.get("algo")
    if chosen is None or not isinstance(algo, dict) or not isinstance(suggested_algo, dict):
        return filled
    name = algo.get("name")
    if suggested_algo.get("name", name) == name:  # else it is for another algorithm
        filled["algo"] = _merge_suggested(algo, suggested_algo, "algo", chosen)
    return filled


def _suggested(tree: Mapping[str, Any], verb: JobVerb) -> dict[str, Any]:
    """The task's suggestions for a verb; empty if it has none."""
    node: Any = tree
    for key in ("task", "suggested", verb):
        node = node.get(key) if isinstance(node, Mapping) else None
    if not isinstance(node, Mapping):
        return {}
    return dict(node)


def _merge_suggested(
    algo: dict[str, Any], suggested: dict[str, Any], path: str, chosen: Chosen
) -> Any:
    """Merge suggestions over the group option's values, except for keys that the user set."""
    merged = dict(algo)
    for key, suggestion in suggested.items():
        key_path = f"{path}.{key}"
        value = merged.get(key)
        if isinstance(value, dict) and isinstance(suggestion, dict):
            merged[key] = _merge_suggested(value, suggestion, key_path, chosen)
        elif not chosen(key_path, "algo"):
            merged[key] = suggestion
    return merged
