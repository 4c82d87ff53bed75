"""What moves joints: gains, actuators, armature, couplings."""
