"""Reading a log: its chunks, its steps, its episodes, its physics once more."""
