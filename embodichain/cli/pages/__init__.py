"""HTML pages about runs, each one file that loads nothing, and the figures on them."""
