"""`FrictionEffect`: whether a geom's friction can act in any contact that the model allows.

A contact takes friction and condim from the geom with the higher priority, or the larger values of
both if the priorities are equal (MuJoCo's rule). Pairs that a file lists have their own friction.
"""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from embodichain.lab.sim.compiler.index import F64, Ids, Mask
from embodichain.lab.sim.compiler.names import GROUND

__all__ = ["FrictionEffect"]

_LEAST_CONDIM = (3, 4, 6)
"""Smallest condim of a contact in which sliding, torsional, rolling friction acts."""
_NAMES = ("sliding", "torsional", "rolling")
_SHOWN = 3


class FrictionEffect:
    """The contacts that a model allows.

    Args:
        model: The compiled scene.
        masks: Geoms whose bits may become others than the model's -> all of their contype and
            conaffinity bits.
    """

    def __init__(self, model: mujoco.MjModel, masks: Mapping[int, tuple[int, int]]) -> None:
        self._model = model
        self._contype = model.geom_contype.astype(np.int64)
        self._conaffinity = model.geom_conaffinity.astype(np.int64)
        for geom, (contype, conaffinity) in masks.items():
            self._contype[geom] = contype
            self._conaffinity[geom] = conaffinity
        self._moves: Mask = np.zeros(model.nbody, np.bool_)
        for body in range(1, model.nbody):  # parents come first
            has_joint = model.body_dofnum[body] > 0
            self._moves[body] = has_joint or self._moves[model.body_parentid[body]]

    def partners(self, geom: int) -> Ids:
        """Return (P,) the geoms that a geom can touch with an effect on something that moves."""
        model = self._model
        body = int(model.geom_bodyid[geom])
        bodies = model.geom_bodyid
        touches = self._bits_match(geom) & (self._moves[bodies] | self._moves[body])
        touches &= ~self._is_filtered(body)
        for signature in model.exclude_signature.tolist():
            excluded = _other_of(body, signature >> 16, signature & 0xFFFF)
            if excluded is not None:
                touches &= bodies != excluded
        for geom1, geom2 in zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True):
            paired = _other_of(geom, geom1, geom2)
            if paired is not None:
                touches[paired] = False
        return np.flatnonzero(touches).astype(np.int64)

    def _bits_match(self, geom: int) -> Mask:
        """(G,) whether the bits of each geom let it collide with this one."""
        meets_other = self._contype & self._conaffinity[geom]
        other_meets = self._conaffinity & self._contype[geom]
        return (meets_other | other_meets) != 0

    def _is_filtered(self, body: int) -> Mask:
        """(G,) whether MuJoCo leaves out a geom's contacts with a body that is near in the tree.

        These are geoms of the same rigid assembly, and unless a flag says otherwise, those of its
        parent and children, if none of both is fixed in the world.
        """
        model = self._model
        weld = model.body_weldid[model.geom_bodyid]
        own_weld = int(model.body_weldid[body])
        is_same = weld == own_weld
        if model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT):
            return is_same
        parent_weld = model.body_weldid[model.body_parentid[weld]]
        own_parent_weld = int(model.body_weldid[model.body_parentid[own_weld]])
        is_related = (weld == own_parent_weld) | (parent_weld == own_weld)
        return is_same | (is_related & (weld != 0) & (own_weld != 0))

    def why_not(self, geom: int, axis: int, highest: float, least: F64) -> str:
        """Return why a geom's friction cannot act; empty if it can.

        Args:
            geom: The geom.
            axis: 0 is sliding, 1 torsional, 2 rolling friction.
            highest: The largest value that it may have.
            least: (G,) the smallest value that each geom of the model may have.
        """
        model = self._model
        flags = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        if model.opt.disableflags & int(flags):
            return "contacts are disabled by a flag"
        if model.opt.enableflags & int(mujoco.mjtEnableBit.mjENBL_OVERRIDE):
            return "physics.o_friction is that of all contacts: the flag override is enabled"
        partners = self.partners(geom)
        if model.nflex:
            return ""  # what a flexible body touches is not looked up
        if not len(partners):
            return "nothing that moves can touch it"
        priority = int(model.geom_priority[geom])
        decided_elsewhere = model.geom_priority[partners] > priority
        if decided_elsewhere.all():
            message = f"has priority {priority}, and what touches it a higher one and decides"
            return f"it {message} ({self._list_owners(partners)})"

        # Contacts where this geom decides, alone or together with a partner of equal priority.
        partners = partners[~decided_elsewhere]
        is_equal = model.geom_priority[partners] == priority
        condim = np.full(len(partners), model.geom_condim[geom])
        condim[is_equal] = np.maximum(condim[is_equal], model.geom_condim[partners[is_equal]])
        has_axis = condim >= _LEAST_CONDIM[axis]
        partners = partners[has_axis]
        is_equal = is_equal[has_axis]
        if not len(partners):
            return f"{_NAMES[axis]} friction needs a contact with condim {_LEAST_CONDIM[axis]}"
        if (~is_equal | (least[partners] < highest)).any():
            return ""
        smallest = least[partners].min()
        message = f"what touches it has at least {smallest:g}, and the larger value acts"
        return f"{message} ({self._list_owners(partners)})"

    def _list_owners(self, geoms: Ids) -> str:
        """Names of the entities that geoms belong to."""
        names = dict.fromkeys(self._owner(int(geom)) for geom in geoms)
        more = ", ..." if len(names) > _SHOWN else ""
        return ", ".join([*names][:_SHOWN]) + more

    def _owner(self, geom: int) -> str:
        model = self._model
        name = model.geom(geom).name
        if name == GROUND:
            return GROUND
        root = model.body(int(model.geom_bodyid[geom])).name or name
        return str(root).partition("/")[0] or f"geom {geom}"


def _other_of(member: int, first: int, second: int) -> int | None:
    """Return the other one of a pair; None if the pair does not have the member."""
    if member == first:
        return second
    if member == second:
        return first
    return None
