"""From groups of YAML and words of the command line to one plain tree that knows its lines."""
