"""Results: of episodes, of policies, of trainings beside each other."""
