"""Run the command line with ``python -m zeno_orbits``."""

import sys

from zeno_orbits.cli import main

sys.exit(main())
