"""Python of single tasks: classes of ``register_env``, imported here from modules beside this file.

A YAML task needs none; ``embodichain/NAME-v0`` is `config.gymnasium_ids`.
"""
