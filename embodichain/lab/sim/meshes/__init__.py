"""Mesh files that MuJoCo cannot read, or draws without their colours, made into OBJ and PNG."""
