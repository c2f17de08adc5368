"""Results for people: pictures, one page for a browser, and tables in a terminal.

`plots` draws with matplotlib and `terminal` prints with rich, each alone; `page` is one HTML file.
`table` says which column shows what, for terminal and page alike; `motion` simulates an orbit
from its own numbers, and `zeno_neighbourhood` cuts out what leads to a Zeno point.

Offers: `figure_of` (the picture of any result) and `save_figure`; `Subject`, `load_bundle` and
`page_of` (the page of an orbit); `ProgressLine` (the progress of long work in a terminal) and
`line_for_watcher` (the same, or that of a notebook, if anybody watches).

Imports: experiment, precision, continuation, maps, search, verification, orbits, simulation, model,
work, arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
