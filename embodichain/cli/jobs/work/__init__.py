"""What a job does in its folder: run, train, collect or evaluate; and what only these need."""
