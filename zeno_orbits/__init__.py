"""Find, verify and follow Zeno periodic orbits of electromechanical hybrid systems.

``import zeno_orbits as zo`` offers ``zo.simulate``, ``zo.find_orbit``, ``zo.verify``,
``zo.Problem`` and the other names of ``__init__.pyi``. Each is imported when it is first used:
importing the package loads neither NumPy nor CasADi.

The rooms, top first; each imports from those below it:
``cli``, ``api`` (the functions of this door), ``report``, ``experiment`` and ``precision``,
``continuation`` and ``maps``, ``search``, ``verification``, ``orbits``, ``simulation``, ``model``,
``integrators``, ``kernels`` and ``work``; at the bottom the modules ``arrays`` and ``errors``.
"""

import lazy_loader as lazy

__version__ = "0.2.0"

__getattr__, __dir__, _names = lazy.attach_stub(__name__, __file__)
__all__ = ["__version__", *_names]  # pyright: ignore[reportUnsupportedDunderAll]
