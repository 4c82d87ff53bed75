"""A Ray cluster of several nodes on this machine, of which some can be killed."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

SMALL = 80_000_000
"""Bytes of a node's object store: Ray's least is 75 MiB."""


class Nodes:
    """A head without cores, and nodes that can be killed."""

    def __init__(self, count: int, cpus: int) -> None:
        from ray.cluster_utils import Cluster

        head = {"num_cpus": 0, "object_store_memory": SMALL, "include_dashboard": False}
        self.cluster: Any = Cluster(initialize_head=True, head_node_args=head)
        self._nodes = [
            self.cluster.add_node(num_cpus=cpus, object_store_memory=SMALL) for _ in range(count)
        ]

    @property
    def address(self) -> str:
        return str(self.cluster.address)

    def kill(self, name: str) -> None:
        """Kill the node of a shard, with all of its processes, as a power cut does."""
        identifier = name.rpartition("/")[2]
        found = [node for node in self._nodes if node.node_id.startswith(identifier)]
        self._nodes.remove(found[0])
        self.cluster.remove_node(found[0], allow_graceful=False)


@contextmanager
def ray_nodes(count: int, cpus: int) -> Iterator[Nodes]:
    """Start a cluster; at the end, stop all that was started."""
    pytest.importorskip("ray")
    # Its killer would blame us for the memory of others; the token is for clusters of people.
    changed = {"RAY_memory_monitor_refresh_ms": "0", "RAY_AUTH_MODE": "disabled"}
    changed |= {"RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0"}
    before = {name: os.environ.get(name) for name in changed}
    os.environ |= changed
    nodes = Nodes(count, cpus)
    try:
        yield nodes
    finally:
        import ray

        ray.shutdown()
        nodes.cluster.shutdown()
        for name, value in before.items():
            if value is None:
                os.environ.pop(name)
            else:
                os.environ[name] = value
