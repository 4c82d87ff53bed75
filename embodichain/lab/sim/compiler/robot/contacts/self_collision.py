"""Which links of a robot collide with each other: its file's rule, and `self_collision`.

An MJCF decides for itself. Links of a URDF collide as in MuJoCo, which leaves out parent and child;
those that are in each other at the start are left out too. Contact bits never change: pairs are
left out by MuJoCo's excludes, so that everything else meets the links as before.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np

from embodichain.lab.sim.cfg import ArticulationCfg
from embodichain.lab.sim.compiler.index import F64, Ids, Mask
from embodichain.lab.sim.compiler.names import match
from embodichain.lab.sim.compiler.robot.contacts.link_siblings import Pair, sibling_pairs
from embodichain.lab.sim.compiler.robot.contacts.postures import DEPTH, deepest_contacts
from embodichain.utils.errors import Problem

__all__ = ["LinkOrigins", "SelfCollision", "set_self_collision"]

_OFF = "off: disable_self_collision"
_MJCF = "its file decides"
_URDF = "not parent and child, not links that overlap at the start"
_NEAR = 0.01
"""Metres between shapes that are near each other."""
_TURNS = 361
"""Positions of a hinge within its range at which its link is compared with the base."""
_WITH_PARENTS = int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
_MEMORY = 2**30
"""Bytes for contacts, where MuJoCo's own estimate is too small."""


@dataclass(frozen=True)
class LinkOrigins:
    """Which file each link of a robot is from.

    Attributes:
        is_urdf: Prefix of the links of an attached file (``NAME/``; "" of the robot's own file) ->
            whether it is a URDF; else it is an MJCF.
        added: Links that the config adds: attachments and tool points.
        static: Links of a fixed robot that the files alone fix to the world too.
    """

    is_urdf: Mapping[str, bool]
    added: Collection[str]
    static: Collection[str]

    def file_of(self, link: str) -> str | None:
        """Return the prefix of a link's file, or None for a link that the config adds."""
        if link in self.added:
            return None
        attached = (p for p in self.is_urdf if p and link.startswith(p))
        return max(attached, key=len, default="")

    def of_mjcf(self, link: str) -> str | None:
        """Return the prefix of a link's file if that is an MJCF, else None."""
        file = self.file_of(link)
        return None if file is None or self.is_urdf[file] else file


@dataclass(frozen=True)
class SelfCollision:
    """What was decided for one robot, by names of links.

    Attributes:
        rule: The rule, in words.
        overlapping: Pairs that the rule leaves out because they overlap at the start -> metres.
        siblings: Pairs that it leaves out with them: their mirrored and repeated ones.
        excluded: Pairs that the config leaves out, and that would collide without it.
        included: Pairs that the config lets collide.
    """

    rule: str = _MJCF
    overlapping: Mapping[tuple[str, str], float] = field(default_factory=dict)
    siblings: tuple[tuple[str, str], ...] = ()
    excluded: tuple[tuple[str, str], ...] = ()
    included: tuple[tuple[str, str], ...] = ()

    def note(self) -> str:
        """Return what the rule left out as one line; empty if it is nothing."""
        left_out = [*self.overlapping, *self.siblings]
        if not left_out:
            return ""
        lists: list[str] = []
        if self.overlapping:
            pairs = [
                f"{a} and {b} ({1e3 * depth:.3g} mm)" for (a, b), depth in self.overlapping.items()
            ]
            lists.append(", ".join(pairs))
        if self.siblings:
            pairs = [f"{a} and {b}" for a, b in self.siblings]
            lists.append("those named like pairs that are: " + ", ".join(pairs))
        a, b = left_out[0]
        return (
            f"links that are in each other at the start do not collide: {'; '.join(lists)}. "
            f"self_collision: {{include: [[{a}, {b}]]}} lets a pair collide, exclude leaves it out"
        )


@dataclass(frozen=True, eq=False)
class _Links:
    """What MuJoCo does with pairs of bodies: (B, B) symmetric masks over the bodies of a model.

    Attributes:
        names: (B,) their names.
        meet: Their shapes have contact bits that meet.
        rigid: They do not move against each other.
        related: MuJoCo leaves them out as parent and child.
        excluded: The file excludes them.
        paired: The file lists a contact pair of their shapes.
    """

    names: tuple[str, ...]
    meet: Mask
    rigid: Mask
    related: Mask
    excluded: Mask
    paired: Mask

    @property
    def colliding(self) -> Mask:
        """Pairs that MuJoCo lets collide."""
        by_bits: Mask = self.meet & ~self.rigid & ~self.related & ~self.excluded
        return by_bits | self.paired


def set_self_collision(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    cfg: ArticulationCfg,
    origins: LinkOrigins,
    qpos: F64,
) -> tuple[SelfCollision, list[Problem], bool]:
    """Decide which links collide, and write the excludes and contact pairs into a spec.

    Args:
        spec: The robot, its root already fixed or free; its elements have names.
        model: `spec` compiled.
        cfg: The robot's config.
        origins: Which file each link is from.
        qpos: (nq,) the start, in the model's order.

    Returns:
        What was decided, every mistake with paths that begin with ``self_collision``, and whether
        the spec changed. With mistakes it did not.
    """
    links = _read_links(model)
    excluded, problems = _read_pairs(cfg, "exclude", links)
    included, mistakes = _read_pairs(cfg, "include", links)
    problems += mistakes
    problems += _contradictions(cfg)
    if problems:
        return SelfCollision(), problems, False

    is_off = cfg.disable_self_collision
    colliding = links.colliding
    overlapping: dict[Pair, float] = {}
    siblings: set[Pair] = set()
    if is_off:
        left_out = set(_pairs(colliding))
    else:
        overlapping = _overlapping_pairs(spec, model, qpos, origins, links)
        parents = model.body_parentid.tolist()
        siblings = {
            pair
            for pair in sibling_pairs(overlapping, links.names, parents)
            if colliding[pair] and _is_left_out_of_urdf(pair, origins, links)
        }
        left_out = {*overlapping, *siblings}
    left_out |= {pair for pair in excluded if colliding[pair]}
    left_out -= included
    to_collide = {pair for pair in included if links.meet[pair] and not links.paired[pair]}
    if not is_off:
        lost_pairs = _pairs_of_static_base(origins, links) - excluded
        to_collide |= _within_reach(model, qpos, lost_pairs)
    is_changed = _exclude_pairs(spec, model, left_out, links)
    is_changed |= _let_collide(spec, model, to_collide, links)

    def names_of(pair: Pair) -> tuple[str, str]:
        return links.names[pair[0]], links.names[pair[1]]

    by_config = excluded | included
    decision = SelfCollision(
        rule=_OFF if is_off else _rule(origins),
        overlapping={
            names_of(pair): depth
            for pair, depth in sorted(overlapping.items())
            if pair not in by_config
        },
        siblings=tuple(names_of(pair) for pair in sorted(siblings - by_config)),
        excluded=() if is_off else tuple(names_of(p) for p in sorted(left_out & excluded)),
        included=tuple(names_of(pair) for pair in sorted(included)),
    )
    return decision, [], is_changed


def _rule(origins: LinkOrigins) -> str:
    """Return the rule of each file in words; the robot's own has no name."""
    rules: list[str] = []
    for name, is_urdf in origins.is_urdf.items():
        rule = _URDF if is_urdf else _MJCF
        rules.append(f"{name}: {rule}" if name else rule)
    return "; ".join(rules)


# ---------------------------------------------------------------------------------------- the model


def _read_links(model: mujoco.MjModel) -> _Links:
    """Read what MuJoCo does with each pair of bodies."""
    count = model.nbody
    weld: Ids = model.body_weldid.astype(np.int64)
    parent = weld[model.body_parentid[weld]]
    # As MuJoCo's filter of parent and child, for which the world is not a parent.
    moving = (weld[:, None] != 0) & (weld[None, :] != 0)
    related = moving & ((weld[:, None] == parent[None, :]) | (parent[:, None] == weld[None, :]))
    excluded = np.zeros((count, count), bool)
    paired = np.zeros((count, count), bool)
    signatures = model.exclude_signature.astype(np.int64)
    excluded[signatures >> 16, signatures & 0xFFFF] = True
    bodies = model.geom_bodyid
    paired[bodies[model.pair_geom1], bodies[model.pair_geom2]] = True
    paired[0, :] = False  # pairs with shapes of the world
    paired[:, 0] = False
    return _Links(
        names=tuple(model.body(i).name for i in range(count)),
        meet=_meeting_bodies(model),
        rigid=weld[:, None] == weld[None, :],
        related=related,
        excluded=excluded | excluded.T,
        paired=paired | paired.T,
    )


def _meeting_bodies(model: mujoco.MjModel) -> Mask:
    """(B, B) bodies, except for the world, with shapes whose contact bits meet."""
    # Few combinations of bits occur: pairs of these are compared, not pairs of shapes.
    bodies_with: dict[tuple[int, int], set[int]] = {}
    for geom, body in enumerate(model.geom_bodyid.tolist()):
        bits = _bits(model, geom)
        if body != 0 and any(bits):
            bodies_with.setdefault(bits, set()).add(body)
    meet = np.zeros((model.nbody, model.nbody), bool)
    for bits, bodies in bodies_with.items():
        for other_bits, others in bodies_with.items():
            if _bits_meet(bits, other_bits):
                meet[np.ix_(sorted(bodies), sorted(others))] = True
    np.fill_diagonal(meet, False)
    return meet


def _bits_meet(bits: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether shapes with some (contype, conaffinity) collide."""
    return bool(bits[0] & other[1] or other[0] & bits[1])


def _bits(model: mujoco.MjModel, geom: int) -> tuple[int, int]:
    return int(model.geom_contype[geom]), int(model.geom_conaffinity[geom])


def _pairs(mask: Mask) -> Iterator[Pair]:
    """Pairs of a symmetric mask, in ascending order."""
    rows, columns = np.nonzero(np.triu(mask, 1))
    yield from zip(rows.tolist(), columns.tolist(), strict=True)


# ---------------------------------------------------------------------------------------- the rules


def _is_left_out_of_urdf(pair: Pair, origins: LinkOrigins, links: _Links) -> bool:
    """Whether links are left out if they overlap at the start: not those of one MJCF."""
    if links.paired[pair]:  # the file says that they collide
        return False
    first, second = (origins.of_mjcf(links.names[link]) for link in pair)
    return first is None or first != second


def _overlapping_pairs(
    spec: mujoco.MjSpec, model: mujoco.MjModel, qpos: F64, origins: LinkOrigins, links: _Links
) -> dict[Pair, float]:
    """Return pairs that the URDF rule leaves out -> how deep they are in each other, m."""
    is_one_mjcf = len(origins.is_urdf) == 1 and not any(origins.is_urdf.values())
    if is_one_mjcf and not origins.added:
        return {}
    data = mujoco.MjData(model)
    depths = deepest_contacts(model, data, qpos)
    if data.warning[mujoco.mjtWarning.mjWARN_CONTACTFULL].number:
        # Links deep in each other may have more contacts than the robot's memory has room for.
        larger = spec.copy()
        larger.memory = _MEMORY
        model = larger.compile()
        depths = deepest_contacts(model, mujoco.MjData(model), qpos)
    return {
        pair: depth
        for pair, depth in depths.items()
        if depth > DEPTH and links.colliding[pair] and _is_left_out_of_urdf(pair, origins, links)
    }


def _pairs_of_static_base(origins: LinkOrigins, links: _Links) -> set[Pair]:
    """Return pairs of an MJCF that collide only because the file fixes one of them to the world.

    MuJoCo lets the children of a body that is fixed to the world collide with it. Here the base is
    a mocap body, whose children do not.
    """
    is_static = np.array([name in origins.static for name in links.names])
    one_is_static = is_static[:, None] != is_static[None, :]
    lost = links.meet & links.related & ~links.excluded & ~links.paired & one_is_static
    pairs: set[Pair] = set()
    for pair in _pairs(lost):
        first, second = (origins.of_mjcf(links.names[link]) for link in pair)
        if first is not None and first == second:
            pairs.add(pair)
    return pairs


def _within_reach(model: mujoco.MjModel, qpos: F64, pairs: set[Pair]) -> set[Pair]:
    """Return those of some pairs of a fixed body and its child that may come near each other.

    Most arms turn on their base without ever touching it, and a contact pair would cost time in
    every step. A child on one hinge is turned through its whole range; any other child is taken to
    reach its parent.
    """
    hinges = sorted({_single_hinge(model, body) for pair in pairs for body in pair} - {-1})
    turned_bodies = {int(model.jnt_bodyid[hinge]) for hinge in hinges}
    weld = model.body_weldid.tolist()
    near_pairs = {(a, b) for a, b in pairs if turned_bodies.isdisjoint((weld[a], weld[b]))}
    if not hinges:
        return near_pairs
    columns = model.jnt_qposadr[hinges]
    low, high = _ranges(model, hinges)
    # With margins MuJoCo reports shapes that come near each other as contacts.
    geom_margin = model.geom_margin.copy()
    body_margin = model.body_margin.copy()
    model.geom_margin += _NEAR / 2
    model.body_margin += _NEAR / 2
    data = mujoco.MjData(model)
    posture = qpos.copy()
    for share in np.linspace(0.0, 1.0, _TURNS):
        posture[columns] = low + share * (high - low)
        near_pairs |= pairs & set(deepest_contacts(model, data, posture, _WITH_PARENTS))
    model.geom_margin[:] = geom_margin
    model.body_margin[:] = body_margin
    return near_pairs


def _single_hinge(model: mujoco.MjModel, body: int) -> int:
    """Return the one hinge on which a body, with what it is welded to, turns; -1 if not one."""
    carrier = int(model.body_weldid[body])
    joint = int(model.body_jntadr[carrier])
    has_one_joint = model.body_jntnum[carrier] == 1
    if has_one_joint and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE:
        return joint
    return -1


def _ranges(model: mujoco.MjModel, joints: Sequence[int]) -> tuple[F64, F64]:
    """Return (J,) bounds of hinges; one without limits turns once around."""
    is_limited = model.jnt_limited[joints].astype(np.bool_)
    low = np.where(is_limited, model.jnt_range[joints, 0], -np.pi)
    high = np.where(is_limited, model.jnt_range[joints, 1], np.pi)
    return low, high


# --------------------------------------------------------------------------------------- the config


def _contradictions(cfg: ArticulationCfg) -> list[Problem]:
    excluded = [set(entry) for entry in cfg.self_collision.exclude]
    return [
        Problem(f"self_collision.include.{i}", f"{list(entry)} is excluded too")
        for i, entry in enumerate(cfg.self_collision.include)
        if set(entry) in excluded
    ]


def _read_pairs(cfg: ArticulationCfg, key: str, links: _Links) -> tuple[set[Pair], list[Problem]]:
    """Return the pairs that one key of `self_collision` names, and every mistake."""
    named_pairs: set[Pair] = set()
    problems: list[Problem] = []
    names = links.names[1:]  # the first is the world
    for number, entry in enumerate(getattr(cfg.self_collision, key)):
        path = f"self_collision.{key}.{number}"
        if isinstance(entry, str) or len(entry) != 2:
            problems.append(Problem(path, f"expected two links (regexes), got {entry!r}"))
            continue
        sides: list[tuple[int, ...]] = []
        for i, pattern in enumerate(entry):
            matching_links, mistakes = match(str(pattern), names, "link", f"{path}.{i}")
            problems += mistakes
            sides.append(tuple(link + 1 for link in matching_links))
        if not (sides[0] and sides[1]):
            continue
        pairs = {(min(a, b), max(a, b)) for a in sides[0] for b in sides[1] if a != b}
        if not pairs:
            problems.append(Problem(path, f"{list(entry)} is one link: name two"))
            continue
        usable = {pair for pair in pairs if not links.rigid[pair]}
        if key == "include":
            usable = {pair for pair in usable if links.meet[pair] or links.paired[pair]}
        if not usable:
            problems.append(Problem(path, _why_never_colliding(pairs, links)))
        named_pairs |= usable
    return named_pairs, problems


def _why_never_colliding(pairs: set[Pair], links: _Links) -> str:
    """Return why pairs cannot collide."""
    a, b = min(pairs)
    names = f"{links.names[a]!r} and {links.names[b]!r}"
    if all(links.rigid[pair] for pair in pairs):
        return f"{names} are fixed to each other: they never collide"
    return f"{names} have no shapes whose contact bits meet (contype, conaffinity)"


# ----------------------------------------------------------------------------------------- the spec


def _exclude_pairs(
    spec: mujoco.MjSpec, model: mujoco.MjModel, pairs: set[Pair], links: _Links
) -> bool:
    """Exclude pairs, and remove the file's contact pairs of their shapes."""
    for a, b in sorted(pairs):
        if not links.excluded[a, b] and not links.related[a, b]:
            spec.add_exclude(bodyname1=links.names[a], bodyname2=links.names[b])
    for pair in list(spec.pairs):
        a, b = (int(model.geom(name).bodyid[0]) for name in (pair.geomname1, pair.geomname2))
        if (min(a, b), max(a, b)) in pairs:
            spec.delete(pair)
    return bool(pairs)


def _let_collide(
    spec: mujoco.MjSpec, model: mujoco.MjModel, pairs: set[Pair], links: _Links
) -> bool:
    """Remove the file's excludes of pairs, and list those that MuJoCo leaves out by itself."""
    index_of = {name: i for i, name in enumerate(links.names)}
    is_changed = False
    for exclude in list(spec.excludes):
        a = index_of[exclude.bodyname1]
        b = index_of[exclude.bodyname2]
        if (min(a, b), max(a, b)) in pairs:
            spec.delete(exclude)
            is_changed = True
    for pair in sorted(pairs):
        if not links.related[pair]:
            continue
        for first, second in _meeting_shapes(model, pair):
            _add_contact_pair(spec, model, first, second)
            is_changed = True
    return is_changed


def _add_contact_pair(spec: mujoco.MjSpec, model: mujoco.MjModel, first: int, second: int) -> None:
    """List a pair of shapes, with the parameters that MuJoCo gives a contact of the two.

    The pair has the parameters that the shapes have now: changing theirs later does not change it.
    """
    pair = spec.add_pair(geomname1=model.geom(first).name, geomname2=model.geom(second).name)
    # NaN: MuJoCo combines the values of the shapes.
    pair.friction = np.full(5, np.nan)
    pair.solref = np.full(2, np.nan)
    pair.solimp = np.full(5, np.nan)
    pair.solreffriction = np.zeros(2)
    # MuJoCo takes the larger condim of the shapes with the higher priority.
    highest = max(model.geom_priority[[first, second]])
    deciding = [geom for geom in (first, second) if model.geom_priority[geom] == highest]
    pair.condim = int(max(model.geom_condim[deciding]))
    pair.margin = float(model.geom_margin[first] + model.geom_margin[second])
    pair.gap = float(model.geom_gap[first] + model.geom_gap[second])


def _meeting_shapes(model: mujoco.MjModel, pair: Pair) -> Iterator[tuple[int, int]]:
    """Yield shapes of two bodies whose contact bits meet."""
    firsts, seconds = (np.flatnonzero(model.geom_bodyid == body).tolist() for body in pair)
    for first in firsts:
        for second in seconds:
            if _bits_meet(_bits(model, first), _bits(model, second)):
                yield first, second
