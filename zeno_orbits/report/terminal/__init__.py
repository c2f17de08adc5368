"""Output in a terminal: tables, sentences, errors and the progress of long work.

Offers: one ``print_*`` per kind of result, ``print_lines``, ``print_error``, ``ProgressLine``.
Imports: the types of all results, and rich at the first table.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
