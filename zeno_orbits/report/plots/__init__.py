"""Figures of results. Each function returns a matplotlib ``Figure``.

The functions use neither pyplot nor global settings, so a figure is the same in every session.
Every function takes a width in inches: ``COLUMN_WIDTH`` stacks the panels for one column of a
paper, and ``FULL_WIDTH`` arranges them in a row.

Offers: ``figure_of`` (the figure of any result), one ``plot_*`` per figure, ``save_figure``.
Imports: every room except ``cli``. No other room imports matplotlib.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
