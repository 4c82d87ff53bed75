"""A person who moves a robot's tool: input, the state to read, the pages."""
