"""Wait until no other process compiles here, then make a library: ``-m zeno_orbits.kernels JOB``.

One core is enough to give away. Whoever waits has loaded neither NumPy nor CasADi.
"""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path

from zeno_orbits.kernels.folder import KernelFolder


def make_alone(job: Path) -> int:
    """Make the library of a job, alone; 1 if that fails."""
    with contextlib.suppress(AttributeError, OSError):
        os.nice(10)
    with contextlib.ExitStack() as held:
        if sys.platform != "win32":
            import fcntl

            # A disk that is full is found again, and told, when the library is written.
            with contextlib.suppress(OSError):
                lock = held.enter_context(KernelFolder(job.parent).lock.open("w"))
                fcntl.flock(lock, fcntl.LOCK_EX)
        from zeno_orbits.kernels.build import make_library

        return make_library(job)


if __name__ == "__main__":
    sys.exit(make_alone(Path(sys.argv[1])))
