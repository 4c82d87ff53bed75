"""The table of what is left out of EmbodiChain's own configs is the one of the code."""

from embodichain.compat.gym_config.functors import ACTIONS, LEFT_OUT
from embodichain.lab.gym.envs.managers.terms.registry import KINDS, TERMS
from scripts.gym_config_table import PAGE, filled


def test_table_is_up_to_date() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert text == filled(text), "python scripts/gym_config_table.py writes it"


def test_nothing_that_exists_is_called_left_out() -> None:
    kinds = {kind: LEFT_OUT[kind] for kind in KINDS if kind in LEFT_OUT}
    assert {k: [n for n in names if n in TERMS[k]] for k, names in kinds.items()} == {
        k: [] for k in LEFT_OUT
    }


def test_every_action_has_its_term() -> None:
    assert set(ACTIONS.values()) <= set(TERMS["action"])
