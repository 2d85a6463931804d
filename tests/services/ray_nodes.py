"""A Ray cluster of three nodes on this machine, one of which claims a graphics card."""

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

MEMORY = 80 * 1024**2  # of a node's object store
_NODES: list[Any] = []
_CLUSTER: list[Any] = []


@contextlib.contextmanager
def cluster() -> Iterator[None]:
    """Start it and join it."""
    with tempfile.TemporaryDirectory(dir="/tmp") as folder:
        os.environ["RAY_TMPDIR"] = folder
        os.environ["RAY_AUTH_MODE"] = "disabled"
        os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
        import ray
        from ray.cluster_utils import Cluster

        head = {
            "num_cpus": 0,
            "num_gpus": 0,
            "object_store_memory": MEMORY,
            "include_dashboard": False,
        }
        own = Cluster(initialize_head=True, head_node_args=head)
        _CLUSTER.append(own)
        for number in range(3):
            n_cards = 1 if number == 0 else 0
            node = own.add_node(num_cpus=1, num_gpus=n_cards, object_store_memory=MEMORY)
            _NODES.append(node)
        own.wait_for_nodes()
        ray.init(address=own.address, log_to_driver=False, logging_level="ERROR")
        try:
            yield
        finally:
            ray.shutdown()
            own.shutdown()


def remove_node_of(pid: int) -> None:
    """Take away the node that a process belongs to, without warning."""
    raylet = _parent(pid)
    for node in _NODES:
        if any(process.process.pid == raylet for process in node.all_processes["raylet"]):
            _CLUSTER[0].remove_node(node, allow_graceful=False)
            _NODES.remove(node)
            return
    raise AssertionError(f"no node of process {pid}")


def _parent(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
