"""Names of other projects mean a quantity with a shape, to the byte."""

from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml

from embodichain.cli.results.terms import all_entries
from embodichain.lab.gym.envs.managers.terms.aliases import AliasSpec
from tests.helpers.example_scene import environment

Term = dict[str, Any]


def spelled_out(spec: AliasSpec, params: dict[str, Any]) -> Term:
    """What an alias stands for, as a config writes it."""
    (target, values), *steps = spec.meaning(params)
    shape = [{step.name: given} if given else step.name for step, given in steps]
    return {"func": target.name, "params": values, **({"shape": shape} if shape else {})}


def built(wrong: Term, folder: Path) -> AbstractContextManager[Any]:
    """An environment with one reward."""
    return environment("rewards", {"wrong": wrong}, folder / "task")


@pytest.mark.parametrize("section", ["rewards", "observations"])
def test_a_name_and_what_it_stands_for_are_the_same(section: str, tmp_path: Path) -> None:
    kind = section.removesuffix("s")
    terms: dict[str, Term] = {}
    for entry in all_entries():
        spec = entry.spec
        if isinstance(spec, AliasSpec) and kind in entry.kinds and not spec.makers:
            example = yaml.safe_load(entry.doc.example)
            terms[entry.name] = example
            terms[f"{entry.name} spelled out"] = spelled_out(spec, example.get("params", {}))
    assert len(terms) > 10
    with environment(section, terms, tmp_path / "task") as env:
        obs, _ = env.reset()
        for step in range(3):
            action = torch.from_numpy(env.action_manager.hold()).float() + 0.05 * step
            obs, _, _, _, info = env.step(action)
            found = info["rewards"] if section == "rewards" else obs
            for name in terms:
                if f"{name} spelled out" in terms:
                    other = found[f"{name} spelled out"]
                    assert found[name].numpy().tobytes() == other.numpy().tobytes(), name


def test_both_names_of_a_parameter_are_one_too_many(tmp_path: Path) -> None:
    cube = {"uid": "cube"}
    wrong = {"func": "height", "params": {"of": cube, "entity_cfg": cube}}
    with (
        pytest.raises(ValueError, match=r"entity_cfg: means the same as of: leave one out"),
        environment("rewards", {"wrong": wrong}, tmp_path / "task"),
    ):
        pass


@pytest.mark.parametrize(
    ("shape", "says"),
    [
        ("tahn", r"shape: unknown shape 'tahn'; allowed: l1, .* Did you mean 'tanh'\?"),
        ({"tanh": -1}, r"shape.tanh.std: must be greater than 0"),
        ({"tanh": {"width": 1}}, r"shape.tanh.width: unknown parameter of shape 'tanh'"),
        ({"tolerance": {"value_at_margin": 0.0}}, r"shape.tolerance.value_at_margin: must be in"),
        (["l2", {"below": []}], r"shape.1.below.threshold: "),
        ({"tanh": 1, "l2": {}}, r"shape: expected a name or one `name: parameters`"),
    ],
)
def test_a_wrong_shape_is_reported_by_its_path(shape: Any, says: str, tmp_path: Path) -> None:
    wrong = {"func": "height", "shape": shape, "params": {"of": {"uid": "cube"}}}
    with (
        pytest.raises(ValueError, match=says),
        environment("rewards", {"wrong": wrong}, tmp_path / "task"),
    ):
        pass


def test_a_quantity_of_several_columns_needs_a_shape(tmp_path: Path) -> None:
    wrong = {"func": "joint_velocity", "params": {"of": {"uid": "ur10"}}}
    says = r"rewards.wrong.shape: joint_velocity has 6 columns; a reward is one number"
    with (
        pytest.raises(ValueError, match=says),
        environment("rewards", {"wrong": wrong}, tmp_path / "task"),
    ):
        pass
