"""The command as a process: output, progress, signals, exit codes."""
