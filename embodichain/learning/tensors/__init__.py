"""Learners that read tensors of the environment: rsl_rl and skrl."""
