"""Terms under the names and parameters of EmbodiChain, Isaac Lab and mjlab.

Every module of this package that does not begin with "_" is imported when terms are looked up.
"""
