"""The walks in docs/architecture.md are the ways that the code takes."""

import re
from pathlib import Path

import pytest

import embodichain
from embodichain.cli import main
from embodichain.learning.sb3.extractors import SmallCnn
from embodichain.learning.sb3.vec_env import SB3VecEnv
from tests.helpers.house import REPO, house

pytestmark = [pytest.mark.slow, pytest.mark.unmeasured]

PAGE = (REPO / "docs" / "architecture.md").read_text(encoding="utf-8")
WALKS = {
    part.partition("\n")[0].partition(":")[0]: part
    for part in PAGE.partition("## Five walks")[2].split("\n### ")[1:]
}
UNSEEN = {
    # Only data classes: no function of them runs.
    "lab/gym/envs/cfg.py",
    "lab/gym/expert/instructions.py",
    "lab/sim/configs/sensor_cfg.py",
    "lab/sim/sensors/camera_cfg.py",
    # Only mentioned: plays a trained policy, and trains one.
    "learning/policies/policy.py",
    "learning/training/train.py",
    # Runs in the thread that draws, which a walk does not follow.
    "lab/sim/drawing/layered/batch_renderer.py",
    # For names that stand for a quantity with a shape; reach has none.
    "lab/gym/envs/managers/terms/aliases.py",
}
FEW = ("num_envs=2", "scene_png=false", "output_dir=out")


def run_and_verify() -> None:
    assert main(["run", "task=reach", "max_steps=102", *FEW]) == 0
    (log,) = Path("out").rglob("rollout.mcap")
    assert main(["replay", str(log), "--verify", "--quiet"]) == 0


def draw_pictures() -> None:
    env = embodichain.make("lift_vision", num_envs=2)
    learner = SB3VecEnv(env, flatten=False)
    SmallCnn(learner.observation_space)
    learner.reset()
    env.step(env.action_manager.hold())
    learner.close()


def play_the_expert() -> None:
    words = ["task=pick_place", "policy=expert", "max_steps=3", "record=none"]
    assert main(["run", *words, *FEW, "--quiet"]) == 0


@pytest.fixture(scope="module")
def used_files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, set[str]]:
    """Name of a walk -> files of which a function runs in it."""
    used: dict[str, set[str]] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("walks"))
        for names, command in (
            (("A run", "A reward", "An event"), run_and_verify),
            (("A camera's picture into the policy",), draw_pictures),
            (("An expert's step",), play_the_expert),
        ):
            walk = house().Walk()
            with walk.traced():
                command()
            used |= dict.fromkeys(names, set(walk.files))
    return used


@pytest.mark.parametrize("name", WALKS)
def test_a_walk_goes_through_the_files_that_it_names(
    name: str, used_files: dict[str, set[str]]
) -> None:
    named = set(
        re.findall(r"`((?:cli|config|lab|learning|recording|utils)/[\w/]+\.py)`", WALKS[name])
    )
    assert len(named) > 5
    assert sorted(named - used_files[name] - UNSEEN) == []


def test_there_are_five_walks() -> None:
    assert len(WALKS) == 5


@pytest.mark.parametrize("name", sorted(set(re.findall(r"`([\w/]+/\w+\.py)`", PAGE))))
def test_files_that_are_named_exist(name: str) -> None:
    assert (REPO / name).is_file() or (REPO / "embodichain" / name).is_file()


def named_things() -> list[tuple[str, str]]:
    """Path and name, where the page says `path`, `Name`: or `name` of `path` or `name` (`path`."""
    path, name = r"`([\w/]+/\w+\.py)`", r"`([A-Za-z_]\w*)`"
    before = re.findall(rf"{path},\s+{name}", PAGE)
    after = re.findall(rf"{name}(?:\s+of|\s+in|\s+\()?\s*\(?{path}", PAGE)
    return sorted({*before, *((file, thing) for thing, file in after)})


@pytest.mark.parametrize(("path", "name"), named_things())
def test_things_are_in_the_files_that_are_named(path: str, name: str) -> None:
    file = REPO / path if (REPO / path).is_file() else REPO / "embodichain" / path
    defined = rf"(?:def|class)\s+{name}\b|^\s*(?:self\.)?{name}(?::[^=\n]+)?\s*="
    assert re.search(defined, file.read_text(encoding="utf-8"), re.MULTILINE)


def test_names_of_things_are_checked() -> None:
    assert len(named_things()) > 15
