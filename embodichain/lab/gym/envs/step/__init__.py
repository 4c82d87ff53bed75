"""What a step computes beside physics: observations, judgements, ends of episodes."""
