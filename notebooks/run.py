"""Run the notebooks and store what they show, pictures small; or compare it with what is stored.

    python notebooks/run.py [01 ...]            store
    python notebooks/run.py --compare [01 ...]  exit code 1 if a word or number differs

A cell with the tag `varies` is not compared: it prints times.
"""

from __future__ import annotations

import argparse
import base64
import io
import re
import sys
from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path
from tempfile import TemporaryDirectory

import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode
from PIL import Image

FOLDER = Path(__file__).parent
WIDEST = 900
"""Pixels of a stored picture."""
COLOURS = 48
"""A drawing of lines needs no more, and has a third of the bytes."""
SAME = 1e-6
"""Numbers that agree to this are the same, relative."""
ROUNDING = 1e-9
"""Below this a number is the size of an error: two of them need not agree."""
_NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?(?![\w.]*\w)", re.IGNORECASE)


def executed(notebook: NotebookNode) -> NotebookNode:
    """Return a notebook as a fresh kernel leaves it."""
    fresh = nbformat.from_dict(notebook)
    with TemporaryDirectory() as folder:
        where = {"metadata": {"path": folder}}
        NotebookClient(
            fresh,
            timeout=600,
            # By default an output that is 4 s late is left out without an error.
            iopub_timeout=60,
            raise_on_iopub_timeout=True,
            kernel_name="python3",
            resources=where,
        ).execute()
    return fresh


def slim(notebook: NotebookNode) -> NotebookNode:
    """Return a notebook without what a run leaves beside its outputs, and with small pictures."""
    small = nbformat.from_dict(notebook)
    for cell in small.cells:
        cell.metadata.pop("execution", None)
        for output in cell.get("outputs", ()):
            if "image/png" in output.get("data", {}):
                output.data["image/png"] = _small(output.data["image/png"])
    return small


def _small(picture: str) -> str:
    image = Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB")
    image.thumbnail((WIDEST, WIDEST))
    packed = io.BytesIO()
    image.quantize(COLOURS, dither=Image.Dither.NONE).save(packed, "PNG", optimize=True)
    return base64.b64encode(packed.getvalue()).decode()


def differences(stored: NotebookNode, fresh: NotebookNode) -> Iterator[str]:
    """Yield what a fresh run prints otherwise than the stored one, a line each, if it is stored."""
    if not any(cell.get("outputs") for cell in stored.cells):
        return
    for k, (old, new) in enumerate(zip(stored.cells, fresh.cells, strict=True)):
        if old.cell_type == "code" and "varies" not in old.metadata.get("tags", ()):
            for before, after in zip_longest(_printed(old), _printed(new)):
                if before is None:
                    yield f"cell {k}: the line `{after}` is new"
                elif after is None:
                    yield f"cell {k}: the line `{before}` is missing"
                elif not _same(before, after):
                    yield f"cell {k}: stored `{before}`, now `{after}`"


def _printed(cell: NotebookNode) -> list[str]:
    """Return the lines that a cell prints and shows, pictures left out."""
    lines: list[str] = []
    for output in cell.outputs:
        data = output.get("data", {})
        if output.output_type == "stream" and output.name == "stdout":
            lines += output.text.splitlines()
        elif "text/plain" in data and "image/png" not in data:
            lines += data["text/plain"].splitlines()
    return lines


def _same(before: str, after: str) -> bool:
    """Return True if two lines have the same words, and numbers that agree."""
    words = [re.sub(r"\s+", " ", _NUMBER.sub("#", line)) for line in (before, after)]
    if words[0] != words[1]:
        return False
    pairs = zip(_NUMBER.findall(before), _NUMBER.findall(after), strict=True)
    return all(_agree(a, b) for a, b in pairs)


def _agree(before: str, after: str) -> bool:
    """Return True if two numbers are the same, but for one in the last digit that is printed."""
    a, b = float(before), float(after)
    return abs(a - b) <= max(SAME * max(abs(a), abs(b)), ROUNDING, _last_digit(before))


def _last_digit(number: str) -> float:
    """Return a little more than one in the last digit of a number with a decimal point."""
    digits, _, power = number.lower().partition("e")
    places = len(digits.partition(".")[2])
    return 1.01 * 10.0 ** (int(power or 0) - places) if places else 0.0


def main() -> int:
    """Store or compare the notebooks that are named, or all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NUMBER", help="01 for instance")
    parser.add_argument(
        "--compare", action="store_true", help="change nothing, and say what differs"
    )
    asked = parser.parse_args()
    found = False
    for path in sorted(FOLDER.glob("*.ipynb")):
        if asked.names and not path.name.startswith(tuple(asked.names)):
            continue
        stored = nbformat.read(path, as_version=4)
        fresh = executed(stored)
        if asked.compare:
            for line in differences(stored, fresh):
                found = True
                print(f"{path.name}, {line}")
        else:
            nbformat.write(slim(fresh), path)
            print(f"{path.name}: {path.stat().st_size // 1000} kB")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
