"""Reads of the state that handles and terms share: frames, motion, gravity, the ground."""
