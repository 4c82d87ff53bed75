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
            self._contype[geom], self._conaffinity[geom] = contype, conaffinity
        moves = np.zeros(model.nbody, np.bool_)
        for body in range(1, model.nbody):  # parents come first
            moves[body] = model.body_dofnum[body] > 0 or moves[model.body_parentid[body]]
        self._moves: Mask = moves

    def partners(self, geom: int) -> Ids:
        """Return (P,) the geoms that a geom can touch with an effect on something that moves."""
        model, bodies = self._model, self._model.geom_bodyid
        body = int(bodies[geom])
        meets = (self._contype & self._conaffinity[geom]) | (
            self._conaffinity & self._contype[geom]
        )
        weld, own = model.body_weldid[bodies], int(model.body_weldid[body])
        found = (meets != 0) & (weld != own) & (self._moves[bodies] | self._moves[body])
        if not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT):
            above = model.body_weldid[model.body_parentid[weld]]
            mine = int(model.body_weldid[model.body_parentid[own]])
            related = (weld == mine) | (above == own)
            found &= ~(related & (weld != 0) & (own != 0))
        for signature in model.exclude_signature.tolist():
            one, other = signature >> 16, signature & 0xFFFF
            if body in (one, other):
                found &= bodies != (other if body == one else one)
        for one, other in zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True):
            if geom in (one, other):
                found[other if geom == one else one] = False
        return np.flatnonzero(found).astype(np.int64)

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
        others = self.partners(geom)
        if model.nflex:
            return ""  # what a flexible body touches is not looked up
        if not len(others):
            return "nothing that moves can touch it"
        mine, theirs = int(model.geom_priority[geom]), model.geom_priority[others]
        weaker = others[theirs <= mine]
        if not len(weaker):
            message = f"has priority {mine}, and what touches it a higher one and decides"
            return f"it {message} ({self._listed(others)})"
        equal = model.geom_priority[weaker] == mine
        condim = np.where(equal, np.maximum(model.geom_condim[weaker], model.geom_condim[geom]), 0)
        condim = np.maximum(condim, model.geom_condim[geom])
        weaker, equal = weaker[condim >= _LEAST_CONDIM[axis]], equal[condim >= _LEAST_CONDIM[axis]]
        if not len(weaker):
            return f"{_NAMES[axis]} friction needs a contact with condim {_LEAST_CONDIM[axis]}"
        if (~equal | (least[weaker] < highest)).any():
            return ""
        message = f"what touches it has at least {least[weaker].min():g}, and the larger value acts"
        return f"{message} ({self._listed(weaker)})"

    def _listed(self, geoms: Ids) -> str:
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
