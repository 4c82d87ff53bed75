"""What a task is: environments, managers, terms, registration."""
