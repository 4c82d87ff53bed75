"""Mesh files that MuJoCo cannot read, or would draw without their colours, made into OBJ and PNG.

`conversion` is the way in, `decomposition` splits a shape into convex parts; `part` is what a file
is read into, `collada`, `texture` and `reading` read it, `store` is the cache on disk.
"""
