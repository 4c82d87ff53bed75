"""What verbs show: tables of tasks, terms and runs, and the page of a run."""
