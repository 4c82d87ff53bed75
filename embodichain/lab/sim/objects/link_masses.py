"""`LinkMasses`: masses and inertias of an articulation's links, in each environment by itself."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from embodichain.lab.sim.objects._arrays import as_rows, columns_of, to_tensor
from embodichain.lab.sim.objects.named_joints import NamedJoints
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.base import F64, EnvIndex

__all__ = ["LinkMasses"]


class LinkMasses(NamedJoints):
    """An articulation whose links' masses can be read and set."""

    def body_of(self, link: str | None) -> int:
        """MuJoCo body id of a link; None is the root link.

        Raises:
            ValueError: If there is no such link; lists the links.
        """
        if link is None:
            return self.entity.root_body_id
        try:
            return int(self.entity.body_ids[self.parsed.link_names.index(link)])
        except ValueError:
            raise ValueError(
                f"{self.uid} has no link {link!r}; there are: {', '.join(self.parsed.link_names)}."
                f"{did_you_mean(link, self.parsed.link_names)}"
            ) from None

    def get_mass(self, link_names: Sequence[str] | None = None) -> torch.Tensor:
        """(N, k) link masses in kg."""
        bodies = [self.body_of(n) for n in (link_names or self.parsed.link_names)]
        return to_tensor(self.engine.model_field("body_mass")[:, bodies])

    def set_mass(
        self, mass: Any, link_names: Sequence[str] | None = None, env_ids: Any = None
    ) -> None:
        """Set link masses (n, k) in kg; each link's inertia scales with its mass."""
        ids, rows = self._ids(env_ids)
        bodies = np.asarray([self.body_of(n) for n in (link_names or self.parsed.link_names)])
        new = as_rows(mass, rows, len(bodies), f"{self.uid}: mass")
        if (new <= 0).any():
            raise ValueError(f"{self.uid}: masses must be positive, got {new.min()}")
        self.write_mass(new, bodies, ids)

    def write_mass(
        self, mass: F64, bodies: NDArray[np.int64], ids: EnvIndex | None, inertia: bool = True
    ) -> None:
        """Set masses (n, k) of bodies (k,), and their inertias with them; the door for terms.

        Args:
            mass: Positive, kg.
            bodies: MuJoCo body ids.
            ids: (n,) environments, or None for all.
            inertia: False leaves inertias as they are.
        """
        engine, model = self.engine, self.engine.model
        engine.write_model("body_mass", mass, ids, columns_of(bodies))
        if inertia:
            self.write_inertia(mass / model.body_mass[bodies], bodies, ids)
        else:
            engine.set_const_later(ids)

    def write_inertia(self, factor: F64, bodies: NDArray[np.int64], ids: EnvIndex | None) -> None:
        """Set inertias of bodies (k,) to (n, k) times the compiled ones."""
        moments = self.engine.model.body_inertia[bodies] * factor[:, :, None]
        columns = columns_of((3 * bodies[:, None] + np.arange(3)).reshape(-1))
        self.engine.write_model("body_inertia", moments.reshape(len(factor), -1), ids, columns)
        self.engine.set_const_later(ids)
