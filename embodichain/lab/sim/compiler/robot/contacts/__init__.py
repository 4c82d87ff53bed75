"""What links touch, and which links of one robot collide."""
