"""Python of single tasks: importing `embodichain.tasks` registers them with Gymnasium."""
