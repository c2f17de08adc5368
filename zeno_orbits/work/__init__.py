"""Run work in processes or on a cluster, store finished parts, and write files atomically.

A task is a pure function of a chunk of points. Chunks do not depend on the workers. Every result
passes through JSON, and a checkpoint stores each finished chunk. So the results are the same for
any number of workers, and after any number of restarts.

Offers: `parallel_map` and `spread_in_order` run a task as an `ExecutionPlan` says, at a `Place`
(`Workers` or a `Cluster`), in a pool that `open_pool` opens (`Pool`), with `FailedPoint` for a
point that crashes workers; `claim_checkpoint`, `keeps_nothing` and `remove_checkpoint` for
checkpoints; `Progress` and `silent` for progress reports, `portion` for a step of several,
`report_part` and `parts_told_to` for those from inside a chunk, `BUILD_WATCH` for those of a
compilation; `write_whole` and `without_collection` for files,
`file_lock` for locks between processes; `to_plain` and `from_plain` between values and JSON;
`versions` of the software; `checked`, `require_kinds` and `Checked` refuse arguments of a wrong
kind; `enclosing_decimal`, `enclosing_disc`, `decimal_above` and `decimal_below`
for decimals that contain exact numbers, `enclosed_decimal` for those that lie in an interval,
`decimal_between` for both, and `exact_decimal` for all digits.

Imports: arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
