"""The command line: words to values, a call of the rooms below, and an answer for people or JSON.

A module for each command, or for a few that read the same. Exit codes: 0, yes; 1, searched or
checked and the answer is no; 2, wrong usage or input; 130, interrupted. A command imports what it
runs when it runs: `--help` and a mistyped option need no CasADi.

Offers: `main` runs one command, `build_parser` returns the parser of all of them.

Imports: api, report, experiment, precision, continuation, maps, search, proof, verification,
orbits, simulation, model, integrators, kernels, work, arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
