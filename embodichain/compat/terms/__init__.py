"""Terms under the names and parameters of EmbodiChain, Isaac Lab and mjlab."""

from embodichain.compat.terms import randomizers

__all__ = ["randomizers"]
