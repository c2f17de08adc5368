"""Compiled C code of CasADi functions: find a compiler, build in the background, keep, load.

A `Recipe` says which functions a library of kernels is made of; `Kernels` loads the library if it
is on disk, and asks for it once the work that it would have saved repays its compiling. Until it
is there, or where there is no compiler, the same functions are interpreted: results are the same
to rounding. Libraries are kept in a private folder, each named by all that it depends on.

Offers: `Recipe`, `KernelSource`, `Kernels`, `KernelLibrary`; `When` to compile, `when_to_compile`;
`KernelFolder` and `kernel_folder`; `Compiler` and `usable_compiler`; `complaints` and `account` of
what became of them; `caller` for calls that are interpreted.

Imports: arrays, errors.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
