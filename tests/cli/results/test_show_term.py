"""`show term NAME`, and what it is made of: docstrings and types in words."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import pytest
from pydantic import AfterValidator, Field

from embodichain.cli import main
from embodichain.cli.results.terms import parse_doc, type_words
from embodichain.lab.gym.envs.cfg import TermCfg
from embodichain.lab.gym.envs.managers.param_types import Box3, NonNegative, Positive, Range, Vec3
from embodichain.lab.gym.envs.managers.scene_entity import ResolvedEntity


def test_a_term_is_shown_with_kinds_parameters_and_example(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["show", "term", "within_distance", "--json"]) == 0
    (term,) = json.loads(capsys.readouterr().out)["terms"]
    assert {"reward", "metric", "termination"} == set(term["kinds"])
    rows = {row["parameter"]: row for row in term["parameters"]}
    assert list(rows) == ["from", "to", "threshold", "use_xy_only"]
    assert rows["from"]["type"] == "entity"
    of_type = (
        "The entity, or a link, site or geom of one."  # its type describes it, not the docstring
    )
    assert rows["from"]["what"] == rows["to"]["what"] == of_type
    assert rows["threshold"] == {
        "parameter": "threshold",
        "type": "number > 0",
        "default": "",
        "what": "In the quantity's unit.",
    }
    assert (rows["use_xy_only"]["type"], rows["use_xy_only"]["default"]) == (
        "true or false",
        "false",
    )
    assert term["signature"].startswith("within_distance(from, to, ")
    assert "Alias of ``{func: distance, shape: {below: THRESHOLD}}``." in term["doc"]
    assert "less than a threshold" in term["doc"]
    assert "Args:" not in term["doc"]


def test_a_shape_is_shown_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", "term", "tolerance"]) == 0
    text = capsys.readouterr().out
    for word in ("for: `shape` of a term", "value_at_margin", "shape: {tolerance: {bounds: "):
        assert word in text
    assert main(["show", "term", "tolerence"]) == 2
    assert "Did you mean 'tolerance'?" in capsys.readouterr().err


def test_it_fits_80_columns(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["show", "term", "randomize_rigid_object_pose"]) == 0
    text = capsys.readouterr().out
    for word in ("for: events", "position_range", "(needed)", "[low, high], each 3", "defined in"):
        assert word in text
    assert [line for line in text.splitlines() if len(line) > 80 and "defined in" not in line] == []


def test_an_unknown_term_is_reported_with_the_closest(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", "term", "within_distanc"]) == 2
    assert "Did you mean 'within_distance'?" in capsys.readouterr().err
    assert main(["show", "term"]) == 2
    assert "one name" in capsys.readouterr().err


@dataclass
class RandomStep:
    low: float
    high: float = 1.0


DOC = """Draws a length, in metres.

Uniform within bounds;
two lines of one paragraph.

Args:
    env: Unused.
    length: [low, high], as
        Someone's book says: eq. 3.
    *names: More.

Raises:
    ValueError: If not.

Example:
    ``{func: draw,
      params: {length: [0, 1]}}``
"""


def test_a_docstring_is_taken_apart() -> None:
    doc = parse_doc(DOC)
    assert doc.summary == "Draws a length, in metres."
    assert doc.text.endswith("\n\nUniform within bounds; two lines of one paragraph.")
    assert doc.params == {
        "env": "Unused.",
        "length": "[low, high], as Someone's book says: eq. 3.",
        "names": "More.",
    }
    assert doc.example == "{func: draw, params: {length: [0, 1]}}"
    assert parse_doc("") == parse_doc("\n")


@pytest.mark.parametrize(
    ("hint", "words"),
    [
        (float, "number"),
        (bool | None, "true or false or null"),
        (Positive, "number > 0"),
        (NonNegative | None, "number >= 0 or null"),
        (Annotated[int, Field(ge=1, le=9)], "integer >= 1 and <= 9"),
        (Range, "[low, high]"),
        (Box3, "[low, high], each 3 numbers"),
        (Vec3, "3 numbers"),
        (Annotated[Sequence[Positive], Field(min_length=2, max_length=2), AfterValidator(list)],
         "[low, high], each number > 0"),
        (Annotated[list[str], Field(min_length=1)], "list of text, at least 1"),
        (list[float] | float, "list of number or number"),
        (tuple[float, float], "2 numbers"),
        (tuple[str, float], "[text, number]"),
        (Mapping[str, float], "map of number"),
        (dict, "map"),
        (Literal["a", "b"], "a or b"),
        (ResolvedEntity, "entity"),
        (list[TermCfg], "list of term"),
        (RandomStep, "map with low, high"),
        (Any, "anything"),
        (Annotated[Positive, Field(lt=2)], "number > 0 and < 2"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)  # fmt: skip
def test_types_in_words(hint: Any, words: str) -> None:
    assert type_words(hint) == words


def test_a_chain_of_shapes_is_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    """Not one description after the other, of which only the last is what the term gives."""
    assert main(["show", "term", "action_rate_l2", "--json"]) == 0
    (term,) = json.loads(capsys.readouterr().out)["terms"]
    alias, meaning = term["doc"].split("\n\n")
    assert alias.startswith("Alias of ``{func: action, shape: [{rate: ")
    assert " ".join(meaning.split()) == (
        "The value is `l2` (sum of squares) of `rate` (change since the last control step, column "
        "by column; 0 in the first step of an episode) of `action` ((N, A) the action as given to "
        "`step` (after `_preprocess_action`), in the action's units)."
    )
