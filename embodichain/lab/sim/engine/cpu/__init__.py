"""States and models on the host, and `mujoco.batch`, which steps them."""
