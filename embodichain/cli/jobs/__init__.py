"""What verbs that build an environment share: a job from its words to its folder and its log."""
