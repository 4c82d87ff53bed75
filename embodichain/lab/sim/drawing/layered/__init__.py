"""The renderer of N x M pictures in one call: OpenGL's programs, targets and numbers."""
