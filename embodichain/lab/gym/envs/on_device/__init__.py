"""Steps whose arrays are on a device: a CUDA graph, and copies for observers."""
