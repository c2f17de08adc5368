"""Live exploration in a notebook: sliders for gains and parameters, and the attractor they give.

``attractor`` computes the attractor at given values. ``widget`` sends it to the browser, where
``explore.js`` draws the sliders and the phase portraits.

Offers: ``explore`` (the widget) and ``attractor_at`` (its computation). Imports: search, orbits,
simulation, model, arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
