"""A Ray cluster on this machine for tests; each node is a raylet of its own."""

import contextlib
import os
from collections.abc import Iterator
from typing import Any

SETTINGS = {
    # Ray's monitor kills workers if other processes fill the memory; its tokens need a home folder.
    "RAY_memory_monitor_refresh_ms": "0",
    "RAY_AUTH_MODE": "disabled",
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_raylet_start_wait_time_s": "120",  # on a machine that does other things, too
}
STORE = 80_000_000
"""Bytes of each node's object store; the smallest that Ray takes is 78,643,200."""


@contextlib.contextmanager
def ray_cluster(nodes: int, cpus: int = 1) -> Iterator[tuple[Any, list[Any]]]:
    """Start a cluster with a head without cores.

    Args:
        nodes: Number of nodes besides the head.
        cpus: Cores that each of them offers.

    Yields:
        `ray.cluster_utils.Cluster` and its nodes.
    """
    os.environ.update(SETTINGS)
    from ray.cluster_utils import Cluster

    head = {"num_cpus": 0, "object_store_memory": STORE, "include_dashboard": False}
    cluster = Cluster(initialize_head=True, head_node_args=head)
    try:
        yield (
            cluster,
            [cluster.add_node(num_cpus=cpus, object_store_memory=STORE) for _ in range(nodes)],
        )
    finally:
        cluster.shutdown()
