"""Build the library of the loop into the wheel, so that whoever installs it needs no compiler.

Where no compiler is found, the wheel is built without: the library is then built at the first use,
if there is a compiler by then, and the plain Python simulator runs elsewhere.
"""

from __future__ import annotations

import atexit
import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

_ZIG = ("-m", "ziglang", "cc", "-mcpu=baseline", "-fno-sanitize=undefined")


class LoopLibraryHook(BuildHookInterface):
    """Adds the library to a wheel."""

    PLUGIN_NAME = "custom"

    def dependencies(self) -> list[str]:
        """Ask for a compiler as a package where there is none."""
        return [] if self.target_name != "wheel" or _own_compiler() else ["ziglang>=0.13"]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile the library and add it; editable installs build it at the first use."""
        if self.target_name != "wheel" or version == "editable":
            return
        source = _module(Path(self.root) / "zeno_orbits" / "loop" / "source.py")
        folder = Path(tempfile.mkdtemp(prefix="zeno_orbits_loop_"))
        # The wheel is written after this call, by the same process.
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        library = folder / source.library_name()
        reason = _compiled(source, library)
        if reason:
            self.app.display_warning(f"the wheel has no compiled loop: {reason}")
            return
        build_data["force_include"][str(library)] = f"zeno_orbits/loop/{library.name}"
        build_data["pure_python"] = False
        platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["tag"] = f"py3-none-{platform}"


def _compiled(source: ModuleType, library: Path) -> str:
    """Compile the library; return why that failed, if it did."""
    command = _own_compiler() or _zig()
    if not command:
        return "there is no C compiler"
    code = library.with_suffix(".c")
    code.write_text(source.whole_source(), encoding="utf-8")
    words = [*command, *source.FLAGS, str(code), "-o", str(library), *source.LIBRARIES]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    return "" if done.returncode == 0 else f"`{command[0]}` failed: {done.stderr.strip()[:200]}"


def _own_compiler() -> list[str]:
    chosen = shlex.split(os.environ.get("CC", ""))
    if chosen:
        return chosen if shutil.which(chosen[0]) else []
    found = next((name for name in ("cc", "gcc", "clang") if shutil.which(name)), "")
    return [found] if found else []


def _zig() -> list[str]:
    return [sys.executable, *_ZIG] if importlib.util.find_spec("ziglang") else []


def _module(path: Path) -> ModuleType:
    """Return a module by its path: the package itself cannot be imported yet."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise FileNotFoundError(path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
