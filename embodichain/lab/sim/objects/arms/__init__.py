"""A robot's tool: where it is, how joints move it, which efforts hold it."""
