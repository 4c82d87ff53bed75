"""Helpers independent of simulation: poses, random streams, errors, config classes."""

# EmbodiChain's scripts import the decorator `configclass` from here. Loading the module of the same
# name first keeps a later import from replacing the decorator.
from embodichain.utils.configclass import configclass as configclass
from embodichain.utils.configclass import is_configclass as is_configclass
