"""`Light`: handle of one light in N environments, for rendering; physics ignores it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from embodichain.lab.sim.objects.entity import Handle
from embodichain.utils.arrays import to_tensor

if TYPE_CHECKING:
    from embodichain.lab.sim.cfg import LightCfg
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.lab.sim.objects.sim_context import SimContext
    from embodichain.utils.array_types import Floats

__all__ = ["Light"]

FULL_INTENSITY = 30.0
"""`LightCfg.intensity` at which MuJoCo's diffuse colour is the light's colour."""
SPECULAR = 0.3
"""Ratio of a light's specular colour to its diffuse colour, as compiled."""


class Light(Handle[int]):
    """One light in N environments, each with its own position, colour and intensity.

    Its index in the compiled model is MuJoCo's light id.

    Args:
        cfg: Its config (not modified).
        uid: Its name in the scene.
        host: The simulation.
    """

    def __init__(self, cfg: LightCfg, uid: str, host: SimContext) -> None:
        super().__init__(uid, host)
        self.cfg = cfg
        count = self.num_instances
        color = np.asarray(cfg.color, np.float64)
        full = host.arrays.full
        self._color: Floats = host.arrays.put(np.tile(color, (count, 1)))
        self._intensity: Floats = full((count, 1), float(cfg.intensity))
        self._falloff: Floats = full((count, 1), float(cfg.radius))

    def _repr_facts(self) -> dict[str, Any]:
        """Return the kind of light."""
        return {"light_type": self.cfg.light_type}

    # -- reads, and writes from checked arrays ---------------------------------------------------

    def read_position(self) -> Floats:
        """(N, 3) metres."""
        start = 3 * self.index
        return self.engine.model_field("light_pos")[:, start : start + 3]

    def write(self, field: str, values: Floats, ids: EnvIndex | None) -> None:
        """Set ``light_pos`` or ``light_dir``, (n, 3), from checked arrays."""
        start = 3 * self.index
        self.engine.write_model(field, values, ids, slice(start, start + 3))

    def write_emission(self, color: Floats, intensity: Floats, ids: EnvIndex | None) -> None:
        """Set colours (n, 3) in [0, 1] and intensities (n, 1); negative ones count as 0."""
        where: Any = slice(None) if ids is None else ids
        self._color[where] = color
        self._intensity[where] = intensity
        diffuse = self._color[where] * (np.maximum(self._intensity[where], 0.0) / FULL_INTENSITY)
        self.write("light_diffuse", diffuse, ids)
        self.write("light_specular", SPECULAR * diffuse, ids)

    def emission(self, ids: EnvIndex | None = None) -> tuple[Floats, Floats]:
        """Current colours (n, 3) and intensities (n, 1) (copies)."""
        where: Any = slice(None) if ids is None else ids
        return self._color[where].copy(), self._intensity[where].copy()

    # -- for users: tensors in and out, checked; see `Handle` ----------------------------------

    def _scalars(self, values: Any, env_ids: Any, what: str) -> tuple[Floats, EnvIndex | None]:
        """Return values (n,), (n, 1) or a single one as (n, 1)."""
        array = _array(values)
        is_single = array.size <= 1
        array = array.reshape(-1) if is_single else array.reshape(-1, 1)
        return self._checked(array, 1, env_ids, what, shared=True)

    def set_color(self, colors: Any, env_ids: Any = None) -> None:
        """Set RGB in [0, 1], (n, 3), or (3,) for all n environments."""
        values, ids = self._checked(colors, 3, env_ids, "color", shared=True)
        if not ((values >= 0) & (values <= 1)).all():
            raise ValueError(f"{self.uid}: RGB in [0, 1], got {values.tolist()}")
        self.write_emission(values, self.emission(ids)[1], ids)

    def set_intensity(self, intensities: Any, env_ids: Any = None) -> None:
        """Set intensities (n,), or one for all n environments; 30 is MuJoCo's full colour."""
        values, ids = self._scalars(intensities, env_ids, "intensity")
        if (values < 0).any():
            raise ValueError(f"{self.uid}: intensity must not be negative, got {values.min()}")
        self.write_emission(self.emission(ids)[0], values, ids)

    def set_falloff(self, falloffs: Any, env_ids: Any = None) -> None:
        """Store radii (n,), or one. No effect: MuJoCo's lights have no falloff radius."""
        values, ids = self._scalars(falloffs, env_ids, "falloff")
        self._falloff[slice(None) if ids is None else ids] = values

    def get_local_pose(self, to_matrix: bool = False) -> torch.Tensor:
        """Positions (N, 3) in metres, or matrices (N, 4, 4) with identity rotation."""
        position = to_tensor(self.read_position())
        if not to_matrix:
            return position
        matrices = torch.eye(4).repeat(len(position), 1, 1)
        matrices[:, :3, 3] = position
        return matrices

    def set_local_pose(self, pose: Any, env_ids: Any = None, to_matrix: bool = False) -> None:
        """Set positions: (n, 3) or (3,), or with `to_matrix` those of (n, 4, 4) or (4, 4)."""
        array = _array(pose)
        if to_matrix:
            if array.shape[-2:] != (4, 4):
                raise ValueError(f"{self.uid}: pose must be (n, 4, 4) or (4, 4), got {array.shape}")
            array = array[..., :3, 3]
        values, ids = self._checked(array, 3, env_ids, "pose", shared=True)
        self.write("light_pos", values, ids)

    def reset(self, env_ids: Any = None) -> None:
        """Reset the light to its configured position, colour and intensity."""
        self.set_local_pose(self.cfg.init_pos, env_ids)
        self.set_color(self.cfg.color, env_ids)
        self.set_intensity(self.cfg.intensity, env_ids)
        self.set_falloff(self.cfg.radius, env_ids)

    # -- state -------------------------------------------------------------------------------------

    def state_dict(self) -> dict[str, Floats]:
        """Colour, intensity and falloff (copies); the engine stores the rest."""
        return {
            "color": self._color.copy(),
            "intensity": self._intensity.copy(),
            "falloff": self._falloff.copy(),
        }

    def load_state_dict(self, state: dict[str, Floats]) -> None:
        """Continue where `state_dict` was taken; the engine restores model fields."""
        self._color[:] = state["color"]
        self._intensity[:] = state["intensity"]
        self._falloff[:] = state["falloff"]


def _array(values: Any) -> Any:
    if isinstance(values, torch.Tensor):
        return values.detach().numpy()
    return np.asarray(values)
