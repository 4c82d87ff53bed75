"""A robot of its files and its config: root, links, joints, notes."""
