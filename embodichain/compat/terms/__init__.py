"""Terms under the names and parameters of EmbodiChain, Isaac Lab and mjlab."""

import embodichain.compat.terms.randomizers  # noqa: F401  (registers its terms)
