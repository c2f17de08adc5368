"""Tests: one file a module, and problems whose answers are known in closed form."""

import os

# Matrices are small: threads of linear algebra would only wait for each other. NumPy reads this
# when it is loaded, and `conftest.py` loads it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
