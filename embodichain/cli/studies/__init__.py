"""Studies: arms that are trained, evaluated and compared, from one file."""
