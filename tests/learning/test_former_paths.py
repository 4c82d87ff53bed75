"""Checkpoints of earlier releases name classes where they were then."""

from embodichain.learning.sb3.extractors import SmallCnn
from embodichain.learning.sb3.known_objects import known_classes
from embodichain.learning.sb3.symmetry import SymmetricActorCriticPolicy


def test_classes_are_known_by_their_former_modules() -> None:
    known = known_classes()
    former = "embodichain.learning"
    assert known[f"{former}.symmetry.SymmetricActorCriticPolicy"] is SymmetricActorCriticPolicy
    assert known[f"{former}.extractors.SmallCnn"] is SmallCnn
    assert known[f"{former}.sb3.extractors.SmallCnn"] is SmallCnn
