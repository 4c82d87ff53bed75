"""`Uncopied`: objects that own memory of a simulation; they are neither copied nor pickled."""

from __future__ import annotations

from typing import NoReturn, SupportsIndex

__all__ = ["Uncopied"]


class Uncopied:
    """Refuses `copy.copy`, `copy.deepcopy` and `pickle` with what to do instead."""

    def __reduce_ex__(self, protocol: SupportsIndex) -> NoReturn:
        """Raise TypeError, as Python does for what cannot be copied."""
        raise TypeError(
            f"{type(self).__name__} cannot be copied or pickled: its simulation is memory of "
            "MuJoCo in this process. Make another environment by the same call, in the process "
            "that needs it; other.load_state_dict(env.state_dict()) continues from the same state"
        )
