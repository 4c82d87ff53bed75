"""Stable-Baselines3: its environment, its algorithms, and policies for it."""
