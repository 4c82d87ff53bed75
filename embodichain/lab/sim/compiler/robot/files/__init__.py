"""Robot files as `MjSpec`: formats, meshes, joints, what MuJoCo reads otherwise."""
