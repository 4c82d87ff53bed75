"""Numpy's protocols over torch: arrays on a device in numpy's syntax. A library of its own."""
