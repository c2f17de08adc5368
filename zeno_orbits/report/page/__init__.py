"""The report of an orbit: one HTML page that works without a server and a network.

The input is values, and the output is the text of the page. ``page.html`` is its template, and
``tables`` contains its tables. Plotly draws the plots in the reader's browser, and the page
contains plotly's bundle. Values and text are visible without it.

Offers: ``Subject`` (the subject of the report), ``load_bundle`` (plotly's script), ``page_of`` (the
page). Imports: precision, maps, verification, orbits, simulation, model, arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
