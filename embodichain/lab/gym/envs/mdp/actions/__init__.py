"""Action terms: how a slice of the action moves the robot.

Every module of this package that does not begin with "_" is imported when terms are looked up.
"""
