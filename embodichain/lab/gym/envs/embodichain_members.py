"""`EmbodiChainMembers`: attributes of an environment that only EmbodiChain's task classes use."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    import torch

__all__ = ["EmbodiChainMembers"]


class _Clock(Protocol):
    @property
    def physics_frequency(self) -> float: ...

    @property
    def control_frequency(self) -> float: ...

    @property
    def elapsed_steps(self) -> torch.Tensor: ...


class EmbodiChainMembers:
    """Names of EmbodiChain 0.2.1 beside those of `BaseEnv`.

    Attributes:
        affordance_datas: Values that a task's own code shares; `state_dict` contains only the
            entries that event terms write.
        rollout_buffer, action_bank: Always None, `current_rollout_step` 0: learners have buffers
            of their own, and there are no action banks.
    """

    affordance_datas: dict[str, Any]
    rollout_buffer: None = None
    current_rollout_step: int = 0
    action_bank: None = None

    def __init__(self) -> None:
        self.affordance_datas = {}
        self._camera_group_ids: list[int] = []

    @property
    def sim_freq(self: _Clock) -> float:
        """Physics steps a second."""
        return self.physics_frequency

    @property
    def control_freq(self: _Clock) -> float:
        """Control steps a second."""
        return self.control_frequency

    @property
    def _elapsed_steps(self: _Clock) -> torch.Tensor:
        """EmbodiChain's name of `elapsed_steps`."""
        return self.elapsed_steps

    def add_camera_group_id(self, group_id: int) -> None:
        """Store a camera group, which EmbodiChain's renderer needs; no effect here."""
        self._camera_group_ids.append(group_id)

    def set_affordance(self, key: str, value: Any) -> None:
        """Set a value of `affordance_datas`."""
        self.affordance_datas[key] = value

    def get_affordance(self, key: str, default: Any = None) -> Any:
        """Return a value of `affordance_datas`."""
        return self.affordance_datas.get(key, default)
