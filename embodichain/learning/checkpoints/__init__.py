"""Files of a training, without code: states, notes, what the policy was trained in."""
