"""The viewers that `viewer.name` names, one a file."""
