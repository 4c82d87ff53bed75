"""Verbs that show, check and write tasks; none of them runs one."""
