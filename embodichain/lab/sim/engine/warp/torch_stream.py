"""`torch_stream`: torch's current CUDA stream, for kernels of Warp between torch's operations."""

from __future__ import annotations

from functools import cache

import torch
import warp as wp

__all__ = ["torch_stream"]


def torch_stream(device: torch.device) -> wp.Stream | None:
    """Torch's current stream on a device as Warp's; None on the CPU.

    The same object for each stream: when one of several is deleted, Warp forgets the stream.
    """
    if device.type != "cuda":
        return None
    return _warp_stream(str(device), torch.cuda.current_stream(device).cuda_stream)


@cache
def _warp_stream(device: str, handle: int) -> wp.Stream:
    return wp.Stream(device, cuda_stream=handle)
