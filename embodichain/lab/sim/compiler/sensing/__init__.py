"""Cameras, views and sensors of a scene."""
