"""Conversion to OBJ and PNG of meshes that MuJoCo cannot read or draws without colours."""
