"""Shapes as geoms: where they are, meshes of files, textures, how they touch."""
