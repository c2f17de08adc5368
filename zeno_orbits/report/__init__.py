"""Results for people: pictures, one page for a browser, and tables in a terminal.

`plots` draws with matplotlib, and `terminal` prints with rich. Neither needs the other. `page` is a
single HTML file. `table` defines the columns of all tables, for terminal and page. `motion`
simulates an orbit at its own parameter values. `zeno_neighbourhood` extracts the part of an
execution that leads to a Zeno point.

Offers: `figure_of` (the figure of any result). The report page: `Subject`, `load_bundle` and
`page_of` (the page of an orbit). Progress: `line_for_watcher` (in a terminal or a notebook, if
there is a terminal or a notebook).

Imports: experiment, precision, proof, continuation, maps, search, verification, orbits, simulation,
model, work, arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
