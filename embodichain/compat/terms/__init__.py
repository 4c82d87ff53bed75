"""Terms under the names and parameters of EmbodiChain, Isaac Lab and mjlab."""

import embodichain.compat.terms.affordances
import embodichain.compat.terms.joint_actions
import embodichain.compat.terms.observations
import embodichain.compat.terms.places
import embodichain.compat.terms.poses
import embodichain.compat.terms.pushes
import embodichain.compat.terms.randomizers
import embodichain.compat.terms.rewards
import embodichain.compat.terms.values  # noqa: F401  (each registers its terms)
