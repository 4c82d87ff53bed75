"""Mesh files that MuJoCo cannot read, or would draw without their colours, made into OBJ and PNG.

`mesh_conversion` converts and caches, `mesh_decomposition` splits a shape into convex parts,
`mesh_reading` reads a file into what `mesh_part` defines.
"""
