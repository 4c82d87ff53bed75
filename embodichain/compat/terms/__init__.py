"""Terms under the names and parameters of EmbodiChain, Isaac Lab and mjlab."""

import embodichain.compat.terms.affordances
import embodichain.compat.terms.observations
import embodichain.compat.terms.other_names
import embodichain.compat.terms.places
import embodichain.compat.terms.pushes
import embodichain.compat.terms.rewards  # noqa: F401  (each registers its terms)
