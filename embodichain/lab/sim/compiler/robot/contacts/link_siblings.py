"""Links whose names differ only by a side or a number: `FL_hip` and `RR_hip`, `finger_1`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product

__all__ = ["Pair", "sibling_pairs"]

Pair = tuple[int, int]
"""Two links, as indices in ascending order."""

_QUAD = "FL|FR|RL|RR|HL|HR|BL|BR|LF|RF|LH|RH|LB|RB|LR"
_FORE = "front|rear|hind|back|fore|middle|mid"
_TOKEN = re.compile(
    # a number
    r"(?P<number>\d+)"
    # left or right, wherever they are: `panda_leftfinger`
    r"|(?P<side>[Ll]eft|[Rr]ight|LEFT|RIGHT)"
    # a leg of a quadruped: `FL_hip`, `lf_hip`, `FLHip`
    rf"|(?<![A-Za-z])(?P<leg>(?:{_QUAD})(?=[A-Z][a-z]|[^A-Za-z]|$)"
    rf"|(?:{_QUAD.lower()})(?![A-Za-z]))"
    # the words alone: `front_hip`, `FrontHip`
    rf"|(?<![A-Za-z])(?P<fore>(?:{_FORE}|{_FORE.title()}|{_FORE.upper()})(?![a-z]))"
    # one letter: `l_hip`, `LHip`, `hip_l`, `hipL`
    r"|(?<![A-Za-z])(?P<letter>[LlRr](?![A-Za-z])|[LR](?=[A-Z][a-z]))"
    r"|(?<=[a-z0-9])(?P<last>[LR](?![A-Za-z]))"
)


@dataclass(frozen=True)
class _Name:
    """A link's name without its sides and numbers.

    Attributes:
        stem: What is left of the name.
        sides: (kind, which of that kind in the name) -> value; kinds are ``side`` and ``fore``.
        numbers: Its numbers, in order.
    """

    stem: str
    sides: dict[tuple[str, int], str]
    numbers: tuple[int, ...]


def sibling_pairs(pairs: Iterable[Pair], names: Sequence[str], parents: Sequence[int]) -> set[Pair]:
    """Return the mirrored and repeated pairs of links, without the pairs themselves.

    A pair is a sibling of another if both of its names differ from those of the other only by
    sides (``left``, ``L``, ``FL``, ``front``) and numbers, if one renaming of sides and one shift
    of numbers make both names, and if the links have the same places in the tree. So ``FR_hip,
    FR_calf`` is a sibling of ``FL_hip, FL_calf``, and ``FL_hip, FR_calf`` is not.

    Args:
        pairs: Pairs of links.
        names: The names of all links.
        parents: The parent of each link, which comes before it; the first is its own.
    """
    split_names = [_split(name) for name in names]
    depths = [0]
    for parent in parents[1:]:
        depths.append(depths[parent] + 1)
    alike: dict[tuple[str, int], list[int]] = {}
    for link, (name, depth) in enumerate(zip(split_names, depths, strict=True)):
        alike.setdefault((name.stem, depth), []).append(link)

    original_pairs = set(pairs)
    siblings: set[Pair] = set()
    for a, b in original_pairs:
        depth_of_fork = depths[_common((a, b), parents)]
        firsts = alike[split_names[a].stem, depths[a]]
        seconds = alike[split_names[b].stem, depths[b]]
        for first, second in product(firsts, seconds):
            if first == second or not _is_renamed(split_names, (a, b), (first, second)):
                continue
            if depths[_common((first, second), parents)] == depth_of_fork:
                siblings.add((min(first, second), max(first, second)))
    return siblings - original_pairs


def _common(pair: Pair, parents: Sequence[int]) -> int:
    """The last link above both links of a pair, or one of them."""
    first, second = pair
    while first != second:
        if first < second:
            second = parents[second]
        else:
            first = parents[first]
    return first


def _is_renamed(names: Sequence[_Name], old: Pair, new: Pair) -> bool:
    """Whether one renaming of sides and one shift of numbers make both new names."""
    renamed: dict[tuple[tuple[str, int], str], str] = {}
    shifts: dict[int, int] = {}
    for old_link, new_link in zip(old, new, strict=True):
        before = names[old_link]
        after = names[new_link]
        for place, value in before.sides.items():
            if renamed.setdefault((place, value), after.sides[place]) != after.sides[place]:
                return False
        for order, number in enumerate(before.numbers):
            shift = after.numbers[order] - number
            if shifts.setdefault(order, shift) != shift:
                return False
    new_sides = [(place, value) for (place, _), value in renamed.items()]
    return len(new_sides) == len(set(new_sides))  # two sides do not become one


def _split(name: str) -> _Name:
    sides: dict[tuple[str, int], str] = {}
    numbers: list[int] = []

    def add_side(kind: str, value: str) -> str:
        order = sum(1 for other, _ in sides if other == kind)
        sides[kind, order] = value
        return f"<{kind}>"

    def replace_token(token: re.Match[str]) -> str:
        kind = str(token.lastgroup)
        text = token[0].lower()
        if kind == "number":
            numbers.append(int(text))
            return "<number>"
        if kind == "fore":
            return add_side("fore", text[0])
        if kind != "leg":
            return add_side("side", text[0])
        first = text[0]
        second = text[1]
        if first in "lr" and second not in "lr":  # LF, RH
            return add_side("side", first) + add_side("fore", second)
        return add_side("fore", first) + add_side("side", second)

    return _Name(_TOKEN.sub(replace_token, name), sides, tuple(numbers))
