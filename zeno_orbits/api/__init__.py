"""The functions of `import zeno_orbits`: from a problem or an orbit to a result, in one call each.

A problem is an object, the name of a bundled problem, or the path of its file. Values that are not
given keep their defaults. Functions of an orbit find its problem by its name, and ``problem=``
overrides it. Work of more than a second shows its progress in terminals and notebooks.
``on_progress=`` receives it instead. The command line calls these functions and prints.

Offers: `find_orbit`, `search_gains`, `verify`, `prove`, `continue_orbit`, `compare`,
`simulate_rig` and the others of ``__init__.pyi``.

Imports: report, experiment, precision, continuation, maps, search, proof, verification, orbits,
simulation, loop, model, integrators, work, arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
