"""The example in every registered term's docstring: it is YAML, of that term, and it works.

All examples of a section are built into one environment and stepped.
"""

import dataclasses
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest
import torch
import yaml

from embodichain.cli.results.terms import SECTION_OF, TermEntry, all_entries
from embodichain.lab.gym.envs.cfg import EnvCfg
from embodichain.lab.gym.envs.managers.terms.aliases import AliasSpec
from tests.helpers.example_scene import TERRAIN, environment

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

ENTRIES = [e for e in all_entries() if e.spec.func.__module__.startswith("embodichain.")]
HINTS = get_type_hints(EnvCfg)
KEYS = {
    kind: {field.name for field in dataclasses.fields(get_args(HINTS[section])[1])}
    for kind, section in SECTION_OF.items()
}
NO_PARAMETER = {"env", "env_ids", "obs", "action", "info", "data"}


def declared(entry: TermEntry) -> dict[str, Any]:
    """The example as a term; an error that says what is wrong with it."""
    if not entry.doc.example:
        raise ValueError("has no `Example:` in its docstring")
    example = yaml.safe_load(entry.doc.example)
    if not isinstance(example, dict) or example.get("func") != entry.name:
        raise ValueError(f"its example is not one of it: {entry.doc.example}")
    if not any(set(example) <= KEYS[kind] for kind in entry.kinds):
        raise ValueError(f"no section of {entry.kinds} has all keys of {sorted(example)}")
    return example


def example_of(entry: TermEntry, kind: str) -> dict[str, Any]:
    """The example as a section declares it; a quantity of several columns needs a shape there."""
    example = yaml.safe_load(entry.doc.example)
    is_alias = isinstance(entry.spec, AliasSpec)
    if entry.spec.lead is not None and kind != "observation" and not is_alias:
        example.setdefault("shape", "l2")
    return {k: v for k, v in example.items() if k in KEYS[kind]}


def undocumented(entry: TermEntry) -> list[str]:
    return [row["parameter"] for row in entry.parameters() if not row["what"]]


def report(wrong: dict[str, str]) -> str:
    return "\n".join([f"{len(wrong)} terms:", *(f"{name}: {what}" for name, what in wrong.items())])


def works(section: str, terms: dict[str, dict[str, Any]], folder: Path) -> None:
    """Builds, resets and steps; raises what goes wrong."""
    with environment(section, terms, folder, overrides=TERRAIN) as env:
        env.reset()
        for _ in range(3):
            action = torch.from_numpy(env.action_manager.hold()).float()
            obs, reward, _, _, info = env.step(action)
        assert not info["diverged"].any(), "it diverges"
        assert torch.isfinite(reward).all()


def test_every_term_says_what_it_does_what_it_takes_and_how_it_is_used() -> None:
    wrong = {}
    for entry in ENTRIES:
        try:
            declared(entry)
        except (ValueError, yaml.YAMLError) as error:
            wrong[entry.name] = str(error)
        if not entry.doc.summary:
            wrong[entry.name] = "has no docstring"
        if missing := undocumented(entry):
            wrong[entry.name] = f"its Args lack {', '.join(missing)}"
        if unknown := set(entry.doc.params) - set(entry.spec.params) - NO_PARAMETER:
            wrong[entry.name] = f"its Args name what it does not take: {', '.join(sorted(unknown))}"
    assert not wrong, report(wrong)


@pytest.mark.parametrize("kind", SECTION_OF)
def test_every_example_works(kind: str, tmp_path: Path) -> None:
    terms: dict[str, dict[str, Any]] = {}
    for entry in ENTRIES:
        if kind in entry.kinds and entry.doc.example:
            terms[entry.name] = example_of(entry, kind)
    assert terms
    works(SECTION_OF[kind], terms, tmp_path / "all")  # a mistake names the term's key path
