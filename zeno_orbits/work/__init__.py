"""Work spread over many processes, here or on a cluster, that survives being killed.

A task is a pure function of a chunk of points. Chunks are cut without regard to who computes them,
every result passes through JSON, and a finished chunk is kept in a checkpoint. So the same results
come out for any number of workers, and after any number of new starts.
"""

from zeno_orbits.work.checkpoint import keeps_nothing, remove_checkpoint
from zeno_orbits.work.plan import Cluster, Lost, Place, Plan, Workers
from zeno_orbits.work.pools import Pool, open_pool
from zeno_orbits.work.progress import Progress, silent
from zeno_orbits.work.scheduling import Task, claim, spread, spread_in_order

__all__ = [
    "Cluster",
    "Lost",
    "Place",
    "Plan",
    "Pool",
    "Progress",
    "Task",
    "Workers",
    "claim",
    "keeps_nothing",
    "open_pool",
    "remove_checkpoint",
    "silent",
    "spread",
    "spread_in_order",
]
