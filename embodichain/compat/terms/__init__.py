"""Terms under the names and parameters of EmbodiChain, Isaac Lab and mjlab."""

import embodichain.compat.terms.affordances
import embodichain.compat.terms.events
import embodichain.compat.terms.names_of_others
import embodichain.compat.terms.observations
import embodichain.compat.terms.other_names
import embodichain.compat.terms.rewards  # noqa: F401  (each registers its terms)
