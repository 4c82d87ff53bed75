"""The tables of docs/coming-from: our side of each row exists, by name, key or command."""

import importlib
import importlib.util
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from embodichain.cli.app import load_verb
from embodichain.cli.verb import VERBS
from embodichain.config import resolve
from embodichain.config.keys.check_types import key_names, schema_at
from embodichain.lab.gym.envs.base_env import BaseEnv
from embodichain.lab.gym.envs.managers.terms.registry import KINDS, SHAPES, TERMS
from embodichain.lab.sim.objects import RigidObject, Robot
from embodichain.utils.errors import ConfigError

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

REPO = Path(__file__).parents[2]
PAGES = sorted((REPO / "docs" / "coming-from").glob("*.md"))
TABLE = re.compile(r"^\|(?P<head>.*)\|\n\| --- .*\n(?P<rows>(?:\|.*\n)+)", re.MULTILINE)
PACKAGES = ("embodichain.learning", "embodichain.recording", "embodichain.lab.gym.envs")
TASK_KEYS = set(key_names(schema_at(["task"], {})))
SECTIONS = ("actions", "events", "commands", "observations", "rewards", "terminations", "metrics")
ITEM_KEYS = {
    *(key for name in SECTIONS for key in key_names(schema_at(["task", name, "NAME"], {}))),
    *("bias", "sensor_type", "data_types", "of", "from", "to", "entity_cfg"),
}
"""Keys of a term or a sensor, whichever section it is in."""
PYTHON = {"flatten", "autoreset_mode", "render_mode"}
"""Arguments of our vector environments and of `gymnasium.make_vec`."""
FILES = "".join(
    (REPO / "docs" / name).read_text(encoding="utf-8")
    for name in (
        "cli.md",
        "training.md",
        "resuming.md",
        "evaluation.md",
        "comparing.md",
        "policies.md",
        "learners.md",
        "exporting.md",
        "symmetry.md",
        "critic.md",
        "sweeps.md",
        "log.md",
        "gpu.md",
        "extending.md",
    )
)
"""Pages, tested themselves, that name files of run folders, Hydra's keys and signatures."""


def rows(page: Path) -> Iterator[tuple[str, str]]:
    """Row and our cell: the last one, in tables whose last heading begins with our name."""
    for table in TABLE.finditer(page.read_text(encoding="utf-8")):
        if table["head"].split("|")[-1].strip().startswith("embodichain"):
            for row in table["rows"].splitlines():
                yield row, re.split(r"(?<!\\)\|", row.strip().strip("|"))[-1].strip()


def is_term(name: str) -> bool:
    return name in SHAPES or any(name in TERMS[kind] for kind in KINDS)


def has_key(path: str) -> bool:
    """Whether a task, or the root of a job, has a key at this path; `NAME` is any name."""
    parts = path.split(".")
    algo = "sac" if "noise" in path else "ppo"
    if parts[0] == "task" or parts[0] not in TASK_KEYS:
        tree: dict[str, Any] = {"algo": {"name": algo}, "record": {}, "viewer": {}}
    else:
        parts, tree = ["task", *parts], {}
    for depth, part in enumerate(parts):
        schema = schema_at(parts[:depth], tree)
        if part not in schema.get("properties", ()) and not schema.get("additionalProperties"):
            return False
    return True


def is_override(text: str) -> bool:
    key, _, value = text.partition("=")
    if (REPO / "conf" / key).is_dir():
        return (REPO / "conf" / key / f"{value}.yaml").is_file()
    return has_key(key) or f"| `{key}` |" in FILES


def is_mapping(text: str) -> bool:
    """YAML in flow style: of a term, or of a reference to an entity."""
    found = yaml.safe_load(text)
    if "func" not in found:
        return set(found) <= {"uid", "joint_names", "link_names"}
    shapes = found.get("shape", [])
    shapes = shapes if isinstance(shapes, list) else [shapes]
    names = [next(iter(s)) if isinstance(s, dict) else s for s in shapes]
    spec = next(TERMS[kind][found["func"]] for kind in KINDS if found["func"] in TERMS[kind])
    return all(n in SHAPES for n in names) and set(found.get("params", {})) <= (
        spec.params.keys() | {"of", "from", "to"}
    )


def is_command(text: str) -> bool:
    """A verb with its options, parsed but not run; jobs are composed and checked."""
    _, name, *arguments = shlex.split(text)
    if name not in VERBS:
        return False
    command = load_verb(name)
    values = [a for a in arguments if "=" in a and not a.startswith("-")]
    job = name in ("run", "train", "collect") and any(v.startswith("task=") for v in values)
    if job and "-m" not in arguments:
        values = [v for v in values if not v.startswith("device=cuda")]
        return bool(resolve(values, "run" if name == "run" else name).task_name)
    known = {option for parameter in command.params for option in parameter.opts}
    return all(a in known for a in arguments if a.startswith("-")) and all(map(is_override, values))


def is_python(text: str) -> bool:
    """A dotted path, an attribute of the environment or a handle, or a public class."""
    name = re.match(r"[\w.]+", text)[0]
    if name.startswith("embodichain."):
        module, _, attribute = name.rpartition(".")
        found = importlib.util.find_spec(module)
        return found is not None and hasattr(importlib.import_module(module), attribute)
    owner, _, attribute = name.partition(".")
    if owner == "env":
        top = attribute.split(".")[0]
        return hasattr(BaseEnv, top) or top in BaseEnv.__annotations__ or f"env.{top}" in FILES
    if owner == "robot":
        return hasattr(Robot, attribute)
    if owner == "body":
        return hasattr(RigidObject, attribute)
    return any(name in importlib.import_module(package).__all__ for package in PACKAGES)


def exists(text: str) -> bool:
    """Whether what is between backticks is something of ours."""
    if text.startswith("embodichain "):
        return is_command(text)
    if text.startswith("{"):
        return is_mapping(text)
    if match := re.fullmatch(r'info\["(\w+)"\]', text):
        return f"``{match[1]}``" in (BaseEnv.step.__doc__ or "") or match[1] == "final_obs"
    if match := re.fullmatch(r"(\w+): (\w+)", text):
        return match[1] in ITEM_KEYS
    if text.startswith("hydra") or f"`{text}`" in FILES:
        return text in FILES
    if text.startswith("gymnasium.") or text.startswith("conf/") or text.startswith("./conf/"):
        return "embodichain/" in text or (REPO / text.removeprefix("./")).is_dir()
    if "=" in text:
        return text.partition("=")[0] in PYTHON or is_override(text)
    known = is_term(text) or has_key(text) or text in ITEM_KEYS | PYTHON
    return known or is_python(text)


def test_there_is_a_page_for_each() -> None:
    names = {"index", "embodichain", "isaac-lab", "mjlab", "maniskill", "rl-zoo3"}
    assert {page.stem for page in PAGES} == names


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_our_side_of_each_row_exists(page: Path) -> None:
    found = list(rows(page))
    assert len(found) > 25 or page.stem == "index"
    unknown = [
        f"{text}    in {row}"
        for row, cell in found
        for text in re.findall(r"`([^`]+)`", cell)
        if not exists(text)
    ]
    assert unknown == [], "\n".join(unknown)


@pytest.mark.parametrize(
    "text",
    [
        "embodichain trian task=reach",
        "embodichain replay last --verfy",
        "joint_velocty",
        "{func: distance, shape: {tan: 0.1}}",
        "{func: randomize, params: {mas: [0.1, 1]}}",
        "observations.NAME.history",
        "robot.drive_pros.max_force",
        "algo.learning_rte=0.01",
        "algo=pppo",
        'info["final_observations"]',
        "env.observation_space_of_things",
        "robot.get_position",
        "kinds: time_out",
        "SB3VectorEnv",
    ],
)
def test_what_does_not_exist_is_found(text: str) -> None:
    assert not found_or_refused(text)


def found_or_refused(text: str) -> bool:
    try:
        return exists(text)
    except (ConfigError, StopIteration):
        return False
