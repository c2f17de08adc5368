"""Pictures of results: values in, a matplotlib ``Figure`` out.

No pyplot and no global settings, so a picture looks the same wherever it is drawn. Every function
takes a width in inches: ``COLUMN_WIDTH`` stacks the panels for one column of a paper,
``FULL_WIDTH`` sets them side by side.

Offers: ``figure_of`` (the picture of any result), one ``plot_*`` a picture, ``save_figure``.
Imports: every room but ``cli``; it alone imports matplotlib.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
