"""Names that learners, viewers and steps cannot have, and options of what packages register."""

import pytest
from hydra.core.object_type import ObjectType

from embodichain.config.composition.registered_options import PLACE, RegisteredOptions
from embodichain.config.keys.learners import LEARNERS, learner
from embodichain.config.keys.tensor_algorithms import RslRlPpoCfg
from embodichain.lab.gym.expert.step_register import expert_step
from embodichain.recording.viewers.showing import viewer


@pytest.mark.parametrize("name", ["repeat", "together"])
def test_a_step_is_not_called_as_what_contains_steps(name: str) -> None:
    with pytest.raises(ValueError, match=f"a step cannot be called '{name}'"):
        expert_step(name)


def test_a_viewer_is_not_called_none() -> None:
    with pytest.raises(ValueError, match="a viewer cannot be called 'none'"):
        viewer("none")


def test_a_learner_is_called_as_its_config_says() -> None:
    with pytest.raises(ValueError, match="learner 'mine' has the name 'rsl_rl_ppo'"):
        learner("mine", builds="mine:Mine")(RslRlPpoCfg)
    with pytest.raises(ValueError, match="is not a configclass made of"):
        learner("mine", builds="mine:Mine")(dict)
    assert "mine" not in LEARNERS


def test_ours_are_options_by_their_files_alone() -> None:
    source = RegisteredOptions("embodichain", PLACE)
    assert source.list("", ObjectType.GROUP) == ["algo", "hydra", "viewer"]
    assert source.list("hydra", None) == ["launcher"]
    assert source.list("algo", None) == []
    assert not source.is_config("algo/ppo")
