"""Run work in processes, here or on a cluster, keep what is finished, and write files whole.

A task is a pure function of a chunk of points. Chunks do not depend on who computes them, every
result passes through JSON, and a finished chunk is kept in a checkpoint. So the results are the
same for any number of workers, and after any number of restarts.

Offers: `spread` and `spread_in_order` run a `Task` as a `Plan` says, at a `Place` (`Workers` or a
`Cluster`), in a pool that `open_pool` opens (`Pool`), with `LostPoint` for a point that kills
workers; `claim`, `keeps_nothing` and `remove_checkpoint` for checkpoints; `Progress` and `silent`
for progress reports, `portion` for a step of several, `tell_part` and `parts_told_to` for those
from inside a chunk; `write_whole` for files; `plain` and `restored` between values and JSON;
`versions` of the software.

Imports: arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
