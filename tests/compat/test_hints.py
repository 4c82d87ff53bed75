"""What is said to users of EmbodiChain: hints name what exists, and deny nothing that does."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
import yaml

from embodichain.cli import main
from embodichain.cli.app import load_verb
from embodichain.cli.verb import VERBS
from embodichain.cli.verbs.running import run_env
from embodichain.compat import unavailable
from embodichain.compat.gym_config import functors, vocabulary
from embodichain.compat.names import REASONS
from embodichain.lab.gym.envs.managers.terms.registry import TERMS
from embodichain.lab.gym.expert.steps import STEPS
from embodichain.lab.sim import SimulationManagerCfg
from tests.helpers.house import REPO

PUBLIC = (REPO / "tests/packaging/public_names.txt").read_text(encoding="utf-8")
NAMES = (
    set(re.findall(r"\w+", PUBLIC)) | {name for kind in TERMS for name in TERMS[kind]} | set(STEPS)
)


def _texts(value: object) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for item in value.values():
            yield from _texts(item)
    elif isinstance(value, tuple):
        for item in value:
            yield from _texts(item)


def _hints() -> Iterator[str]:
    for table in (
        unavailable.ANSWERS,
        unavailable.REFUSALS,
        REASONS,
        functors.LEFT_OUT,
        functors.PARAMS_LEFT_OUT,
        {flag.name: flag.why_no_effect for flag in run_env.FLAGS},
        {
            name: getattr(vocabulary, name)
            for name in vars(vocabulary)
            if re.fullmatch("[A-Z_]*[A-Z]", name) and name[0] != "_"
        },
    ):
        yield from _texts(table)
    for cls in unavailable.CLASSES.values():
        yield str(cls.__doc__)


HINTS = sorted(text for text in set(_hints()) if " " in text)

FEATURES = {
    r"\b(GPU|CPU|CUDA|card)\b": ("device", "device"),
    r"\bpoint clouds?\b": ("camera_points", "camera_points"),
    r"\b(expert|demonstrations?)\b": ("`expert:`", "expert"),
    r"\bmotions?\b": ("`expert:`", "expert"),
    r"\bconvex\b": ("`collision: decompose`", "collision"),
    r"\bcollection of demonstrations\b": ("`embodichain collect`", "collect"),
    r"\bdata sets? (is|are) made\b": ("`embodichain export", "export"),
}
"""A word of a hint -> what the hint names, and a public name that must exist for it."""


def test_there_are_hints() -> None:
    assert len(HINTS) > 80


@pytest.mark.parametrize("hint", HINTS)
def test_a_hint_names_what_exists(hint: str) -> None:
    for verb, rest in re.findall(r"embodichain ([a-z][a-z-]*)([^`;,]*)", hint):
        assert verb in VERBS
        options = {option for parameter in load_verb(verb).params for option in parameter.opts}
        assert set(re.findall(r"(?<!\S)--?[a-z][a-z-]*", rest)) <= options
    for name in re.findall(r"(?<!torch\.)\b[a-z]+_[a-z_]+\b", hint):
        assert name in NAMES
    for key in re.findall(r"\b([a-z][a-z_.]*)=", hint):
        assert key.split(".")[-1] in NAMES
    for key in re.findall(r"`([a-z_]+):", hint):
        assert key in NAMES


@pytest.mark.parametrize("hint", HINTS)
def test_no_hint_denies_what_exists(hint: str) -> None:
    assert not re.search(r"\b(yet|come later|comes later)\b", hint)
    for word, (said, name) in FEATURES.items():
        if re.search(word, hint):
            assert said in hint
            assert name in NAMES


def test_a_card_is_chosen_by_its_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    robot = {"fpath": "CartPole/cart_pole.urdf", "uid": "cart"}
    config = {"robot": robot, "env": {"sim_steps_per_control": 4}}
    (tmp_path / "gym.yaml").write_text(yaml.safe_dump(config))
    words = ["run-env", "--gym_config", "gym.yaml", "--gpu_id", "99", "max_steps=2"]
    assert main([*words, "--device", "cuda"]) == 2
    said = capsys.readouterr().err
    assert "cuda:99" in said or "there is no CUDA device" in said
    assert "--gpu_id has no effect" not in said
    assert main([*words, "--device", "cpu"]) == 0
    assert "--gpu_id has no effect: it numbers the card of --device cuda" in capsys.readouterr().err


def test_a_config_in_python_names_the_card() -> None:
    assert SimulationManagerCfg(sim_device="cuda", gpu_id=2).device_name == "cuda:2"
    assert SimulationManagerCfg(sim_device="cuda").device_name == "cuda"
    assert SimulationManagerCfg(sim_device="cuda:1", gpu_id=2).device_name == "cuda:1"
    assert SimulationManagerCfg(gpu_id=2).device_name == "cpu"
