"""The report of an orbit: one HTML page that needs no server and no network.

Values in, the text of the page out: ``page.html`` is its template, ``tables`` its tables. The
plots are drawn in the reader's browser by plotly, whose bundle travels inside the page; the numbers
and the words are there without it.

Offers: ``Subject`` (what to report), ``load_bundle`` (plotly's script), ``page_of`` (the page).
Imports: precision, verification, orbits, simulation, model, arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
