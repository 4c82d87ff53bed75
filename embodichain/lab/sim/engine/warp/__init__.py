"""MuJoCo Warp: engines with arrays on the host, or on its device."""
