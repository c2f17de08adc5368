"""The command line: it parses arguments, calls `api`, and prints text or JSON.

A module contains one command, or several commands with the same input. Exit codes: 0 for a positive
result, 1 for a negative result of a search or a check, 2 for wrong usage or input, 130 for an
interrupt. A command imports its dependencies when it runs. `--help` and a mistyped option do not
load CasADi.

Offers: `main` runs one command, `build_parser` returns the parser of all of them.

Imports: api, report, maps, simulation, loop, model, work, aliases, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
