"""Run the command line, as ``zeno-orbits`` or ``python -m zeno_orbits``."""

import os
import sys


def main() -> int:
    """Run one command and return its exit code; an interrupt while loading is an interrupt, too."""
    # Matrices are small: threads of linear algebra would only wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        from zeno_orbits import cli

        return cli.main()
    except KeyboardInterrupt:
        sys.stderr.write("zeno-orbits: interrupted; nothing was written\n")
        return 130


if __name__ == "__main__":
    sys.exit(main())
