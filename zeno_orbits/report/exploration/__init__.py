"""Live exploration in a notebook: sliders for gains and parameters, and the attractor they give.

``attractor`` computes the attractor at given values. ``widget`` sends it to the browser, where
``explore.js`` draws the sliders and the phase portraits.

Imports: search, orbits, simulation, model, arrays, errors.
"""
