"""Kinematics of serial chains: forward, differential, inverse (iterative and closed form)."""
