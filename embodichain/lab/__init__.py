"""What a scene is (`sim`) and what a task is (`gym`)."""
