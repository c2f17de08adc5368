"""The completed execution in C: one library that evaluates the formulas of any problem.

`tape` compiles formulas to instructions, `program` compiles a problem to tapes, and `run` simulates
an execution through all its events. The plain Python simulator in the room `simulation` is the
reference. A test compares both, event by event. `source` and `library` find or build the library.

Offers: `program_of` a problem's functions. A `LoopRun` with `RunSettings` returns a `LoopRecord`.
`loop_account` and `refusals` describe the library in use. `controller_files` of an
`ExportedController` (`controller_of` a machine) are its held states in C, and the
`exported_controller_unit` of a `ControllerUnit` is its unit.

Imports: model, integrators, work, arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
