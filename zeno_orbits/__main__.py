"""Run the command line, as ``zeno-orbits`` or ``python -m zeno_orbits``."""

import os
import signal
import sys

# Matrices are small: threads of linear algebra would only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
try:
    from zeno_orbits.cli import main
except KeyboardInterrupt:
    # An interrupt while loading is an interrupt, too. A second one must not end its report.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.stderr.write("zeno-orbits: interrupted, nothing was written\n")
    sys.exit(130)

if __name__ == "__main__":
    sys.exit(main())
