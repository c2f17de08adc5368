"""Text files in pieces, and the kinds of files that are not tables in text."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from zeno_orbits.errors import DataFileError

_PIECE = 1 << 22
"""Bytes per piece: large enough for an efficient parser, and small compared with the values."""
_UTF16 = (b"\xff\xfe", b"\xfe\xff")
_AS_CSV = "save the table as CSV"
_KINDS = (
    ((b"PK\x03\x04",), "a spreadsheet or another ZIP archive", _AS_CSV),
    ((b"\xd0\xcf\x11\xe0",), "an old spreadsheet or document of Microsoft Office", _AS_CSV),
    ((b"\x1f\x8b", b"BZh", b"\xfd7zXZ", b"7z\xbc\xaf"), "a compressed file", "unpack it"),
    ((b"MATLAB ",), "a MATLAB file", _AS_CSV),
    ((b"\x89HDF",), "an HDF5 or MATLAB file", _AS_CSV),
    ((b"\x93NUMPY",), "a NumPy file", _AS_CSV),
    ((b"PAR1",), "a Parquet file", _AS_CSV),
    ((b"TDSm",), "a LabVIEW file", _AS_CSV),
    ((b"%PDF",), "a PDF document", _AS_CSV),
    ((b"\x89PNG", b"\xff\xd8\xff", b"GIF8"), "a picture", "name the file of the values"),
    ((b"{\\rtf",), "a formatted document (RTF)", "save it as plain text"),
)
"""First bytes, name and remedy of kinds of files that are given in place of a table."""
_MARKUP = (
    (("<!doctype html", "<html"), "a web page (HTML)"),
    (("<?xml", "<svg"), "an XML file"),
    (("{", "[{", "[[", "[\n"), "a JSON file"),
)
"""First characters and name of kinds of text that are given in place of a table."""


def opened(path: Path) -> BinaryIO:
    """Return a file opened for reading.

    Raises:
        DataFileError: If it cannot be read, or may not end.
    """
    try:
        if path.is_dir():
            raise DataFileError(path, "it is a folder: name a file in it")
        if path.exists() and not path.is_file():
            # A pipe or a device may not end.
            raise DataFileError(path, "it is a pipe or a device, and not a file")
        return path.open("rb")
    except OSError as error:
        raise DataFileError(path, f"it cannot be read ({error.strerror})") from error


def require_text(path: Path, data: bytes) -> None:
    """Refuse a file of another kind than a table in text.

    Args:
        path: The file, for the message.
        data: Its first bytes.

    Raises:
        DataFileError: If the file begins like another kind of file.
    """
    for marks, kind, remedy in _KINDS:
        if data.startswith(marks):
            raise DataFileError(path, f"it is {kind}: {remedy}")
    begin = data[:200].decode("latin-1").lower().removeprefix("\u00ef\u00bb\u00bf").lstrip()
    for marks, kind in _MARKUP:
        if begin.startswith(marks):
            raise DataFileError(path, f"it is {kind}: {_AS_CSV}")


def pieces_of(file: BinaryIO) -> Iterator[str]:
    """Yield a file in pieces of whole lines with normalised line ends. The last line may be cut."""
    path = Path(file.name)
    rest = b""
    first = True
    while data := file.read(_PIECE):
        if first:
            require_text(path, data)
        if first and data.startswith(_UTF16):
            data = _from_utf16(path, data + file.read())
        if b"\0" in data:
            raise DataFileError(path, "it is a binary file, with zero bytes: save the table as CSV")
        data = rest + (data.removeprefix(b"\xef\xbb\xbf") if first else data)
        first = False
        # A return at the very end may be half of the pair that ends a line in other systems.
        end = max(data.rfind(b"\n"), data.rfind(b"\r", 0, len(data) - 1)) + 1
        rest = data[end:]
        if end:
            yield _text(data[:end])
    if rest:
        yield _text(rest)


def _from_utf16(path: Path, data: bytes) -> bytes:
    """Return a text that spreadsheets write as UTF-16 as UTF-8.

    Raises:
        DataFileError: If it is cut or mixed.
    """
    try:
        return data.decode("utf-16").encode()
    except UnicodeError as error:
        raise DataFileError(path, "it is broken UTF-16 text; save it as UTF-8") from error


def _text(data: bytes) -> str:
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text
