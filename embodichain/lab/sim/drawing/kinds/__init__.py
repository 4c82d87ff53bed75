"""The renderers of this package, a module each, called as the renderer."""
