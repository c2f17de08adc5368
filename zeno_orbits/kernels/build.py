"""Make a library of kernels, in a process of its own.

Formulas are built, written as C, compiled, loaded and compared with the interpreter. Only then
the library takes its place; else a file beside it says why there is none.
"""

from __future__ import annotations

import json
import tempfile
from importlib import import_module
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import KernelError
from zeno_orbits.kernels.casadi_calls import caller
from zeno_orbits.kernels.compiler import Compiler
from zeno_orbits.kernels.folder import KernelFolder
from zeno_orbits.kernels.library import KernelLibrary
from zeno_orbits.kernels.requests import KernelSource

_CRASHED = "the compiled code of the kernels crashed"
_AGREES = 1e-9
"""Relative difference between compiled and interpreted that rounding does not explain."""
_PRELUDE = "#include <float.h>\n#include <math.h>\n#include <string.h>\n"
_ROWS = """
enum { MOST_PLACES = 16 };

/* Call a kernel for many rows: `places` are inputs, then outputs, `steps` from row to row. */
CASADI_SYMBOL_EXPORT int zk_rows(
    int (*kernel)(const double **, double **, long long *, double *, int),
    long long n, long long n_in, long long n_out, double **places, const long long *steps) {
    const double *given[MOST_PLACES];
    double *taken[MOST_PLACES];
    long long row, k;
    if (n_in > MOST_PLACES || n_out > MOST_PLACES) return 1;
    for (row = 0; row < n; row++) {
        for (k = 0; k < n_in; k++) given[k] = places[k] + row * steps[k];
        for (k = 0; k < n_out; k++) taken[k] = places[n_in + k] + row * steps[n_in + k];
        kernel(given, taken, 0, 0, 0);
    }
    return 0;
}
"""


def make_library(job: Path) -> int:
    """Make the library of a job; 1 if that fails."""
    try:
        content = json.loads(job.read_text(encoding="utf-8"))
        folder = KernelFolder(Path(content["folder"]))
        failure = folder.failure_of(content["key"])
        failure.write_text(_CRASHED, encoding="utf-8")
        try:
            compiled_library(folder, content)
        except (KernelError, OSError) as error:
            failure.write_text(str(error), encoding="utf-8")
            return 1
    finally:
        job.unlink(missing_ok=True)
    return 0


def compiled_library(folder: KernelFolder, content: dict[str, Any]) -> Path:
    """Make a library as a job says and return its place.

    Raises:
        KernelError: If it cannot be compiled or computes something else than the interpreter.
        OSError: If it cannot be written.
    """
    module, _, name = content["maker"].partition(":")
    functions = [ca.Function.deserialize(text) for text in content["functions"]]
    source: KernelSource = getattr(import_module(module), name)(functions, content["numbers"])
    compiler = Compiler(command=tuple(content["command"]), file=Path(content["file"]))
    with tempfile.TemporaryDirectory(dir=folder.path, prefix=".unfinished.") as name:
        code, library = Path(name) / "kernels.c", Path(name) / "kernels.so"
        code.write_text(c_code(source), encoding="utf-8")
        compiler.compile(code, library)
        require_agreement(source, KernelLibrary(library))
        return folder.store(content["key"], library)


def c_code(source: KernelSource) -> str:
    """Return the C code of a library.

    Raises:
        KernelError: If a function is more than scalar instructions, and so wants memory.
    """
    generator = ca.CodeGenerator("zeno_kernels", {"with_header": False})
    for function in source.functions:
        if not function.is_a("SXFunction"):
            raise KernelError(f"function `{function.name()}` is not made of scalar instructions")
        generator.add(function)
    return f"{_PRELUDE}{generator.dump()}{_ROWS}{source.code}"


def require_agreement(source: KernelSource, library: KernelLibrary) -> None:
    """Hold every kernel against the interpreter at some numbers, NaN and infinity among them.

    Raises:
        KernelError: If one differs by more than rounding.
    """
    rng = np.random.default_rng(0)
    for function in source.functions:
        for first in (1.0, np.nan, np.inf, -np.inf):
            given = [rng.uniform(0.5, 1.5, function.numel_in(k)) for k in range(function.n_in())]
            given[0][:1] *= first
            taken = [np.zeros(function.numel_out(k)) for k in range(function.n_out())]
            library.caller(function.name(), given, taken)()
            expected = [np.zeros_like(array) for array in taken]
            caller(function, given, expected)()
            if not all(map(_agree, taken, expected)):
                raise KernelError(f"the compiled `{function.name()}` computes something else")
    if _TINY / 2 == 0.0:
        raise KernelError("the compiled code makes the processor round tiny numbers to zero")


_TINY = np.array(np.finfo(np.float64).tiny)


def _agree(found: Vector, expected: Vector) -> bool:
    largest = float(np.max(np.abs(expected), initial=0.0, where=np.isfinite(expected)))
    return np.allclose(found, expected, rtol=0.0, atol=_AGREES * largest, equal_nan=True)
