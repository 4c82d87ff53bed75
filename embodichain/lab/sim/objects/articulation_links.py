"""`ArticulationLinks`: poses, velocities, masses and inertias of an articulation's links."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.sim.body_motion import origin_velocities
from embodichain.lab.sim.objects._arrays import columns_of
from embodichain.utils.suggest import did_you_mean

if TYPE_CHECKING:
    from embodichain.lab.sim.compiler.index import EntityIndex
    from embodichain.lab.sim.engine.base import F64, EnvIndex
    from embodichain.lab.sim.host import Binding

__all__ = ["ArticulationLinks"]


class ArticulationLinks:
    """L links in N environments; reads are float64 copies.

    Args:
        binding: The articulation's place in the simulation.
        names: (L,) the links.
    """

    def __init__(self, binding: Binding[EntityIndex], names: Sequence[str]) -> None:
        self._binding = binding
        self._names = tuple(names)

    def body_of(self, link: str | None) -> int:
        """MuJoCo body id of a link; None is the root link.

        Raises:
            ValueError: If there is no such link; lists the links.
        """
        index = self._binding.index
        if link is None:
            return index.root_body_id
        if link not in self._names:
            raise ValueError(
                f"{self._binding.uid} has no link {link!r}; there are: {', '.join(self._names)}."
                f"{did_you_mean(link, self._names)}"
            )
        return int(index.body_ids[self._names.index(link)])

    def bodies_of(self, links: Sequence[str] | None) -> NDArray[np.int64]:
        """(k,) MuJoCo body ids of links; None is all L."""
        return np.asarray([self.body_of(link) for link in links or self._names], np.int64)

    def pose(self, body: int) -> F64:
        """(N, 7) pose of a body: x, y, z, qw, qx, qy, qz."""
        engine = self._binding.engine
        pos, quat = engine.derived("xpos")[:, body], engine.derived("xquat")[:, body]
        return np.concatenate([pos, quat], axis=1)

    def velocity(self, body: int) -> F64:
        """(N, 6) linear velocity of a body's origin, then angular velocity, world axes."""
        return np.concatenate(origin_velocities(self._binding.engine, body), axis=1)

    def masses(self, bodies: NDArray[np.int64]) -> NDArray[np.float64]:
        """(N, k) kg."""
        found: F64 = self._binding.engine.model_field("body_mass")[:, bodies]
        return found

    def write_mass(
        self, mass: F64, bodies: NDArray[np.int64], ids: EnvIndex | None, inertia: bool = True
    ) -> None:
        """Set masses (n, k) of bodies (k,) from checked arrays, and their inertias with them.

        Args:
            mass: Positive, kg.
            bodies: MuJoCo body ids.
            ids: (n,) environments, or None for all.
            inertia: False leaves inertias as they are.
        """
        engine = self._binding.engine
        engine.write_model("body_mass", mass, ids, columns_of(bodies))
        if inertia:
            self.write_inertia(mass / engine.model.body_mass[bodies], bodies, ids)
        else:
            engine.set_const_later(ids)

    def write_inertia(self, factor: F64, bodies: NDArray[np.int64], ids: EnvIndex | None) -> None:
        """Set inertias of bodies (k,) to (n, k) times the compiled ones."""
        engine = self._binding.engine
        moments = engine.model.body_inertia[bodies] * factor[:, :, None]
        columns = columns_of((3 * bodies[:, None] + np.arange(3)).reshape(-1))
        engine.write_model("body_inertia", moments.reshape(len(factor), -1), ids, columns)
        engine.set_const_later(ids)
