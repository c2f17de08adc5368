"""A virtual rig: a problem as a physical machine, without a Zeno point. Always simulated.

`simulator` follows it from a state, `settle_rig` lets it settle near an orbit of the model.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
