"""Helpers independent of simulation: poses, random streams, errors, config classes."""

# EmbodiChain's scripts import the decorator, not the module of the same name, from here. The module
# is loaded by this line, so that no later import can put itself in the decorator's place.
from embodichain.utils.configclass import configclass as configclass
from embodichain.utils.configclass import is_configclass as is_configclass
