"""MuJoCo Studio's page: the process that serves it, and who may ask it."""
