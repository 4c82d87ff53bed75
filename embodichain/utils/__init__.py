"""Small helpers that know nothing of simulation: poses, random streams, errors, config classes."""
