"""Checks of a composed tree: types, values, terms, the scene; each mistake with its place."""
