"""The files of a new task, and what they need to know of its robot."""
