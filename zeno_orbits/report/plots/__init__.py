"""Figures of results. Each function returns a matplotlib ``Figure``.

The functions use neither pyplot nor global settings, so a figure is the same in every session.
Every function takes a width in inches: ``COLUMN_WIDTH`` stacks the panels for one column of a
paper, and ``FULL_WIDTH`` arranges them in a row.

Offers: ``figure_of`` (the figure of any result), one ``plot_*`` per figure, ``save_figure``.
Imports: every room except ``cli``. No other room imports matplotlib.
"""

import os
import sys
from contextlib import chdir, nullcontext, suppress
from pathlib import Path

import lazy_loader as lazy


def _import_matplotlib() -> None:
    """Import matplotlib without the settings that lie in the current folder.

    Matplotlib obeys a file `matplotlibrc` there, which can name programs to run. A backend of
    `MPLBACKEND` that does not exist does not matter, since no window is opened.
    """
    backend = os.environ.pop("MPLBACKEND", None)
    try:
        with chdir(Path(__file__).parent) if os.path.lexists("matplotlibrc") else nullcontext():
            import matplotlib as mpl
    finally:
        if backend is not None:
            os.environ["MPLBACKEND"] = backend
    if backend:
        with suppress(ValueError):
            mpl.rcParams["backend"] = backend


if "matplotlib" not in sys.modules:
    _import_matplotlib()

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
