"""Measurements behind docs/performance.md: speed, profile, memory, start-up.

Each module is a command, `python -m benchmarks.NAME`; nothing of embodichain imports them.
"""
