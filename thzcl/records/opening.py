"""Opens a record's text: plain, gzipped or zipped, in UTF-8 or UTF-16; names a binary's converter.

LI-COR's GHG files are zip archives with a .data part.
"""

from __future__ import annotations

import codecs
import gzip
import io
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, TextIO

from thzcl.errors import RecordError

EXPECTED = "expected Campbell TOA5, CSV with a header, or a LI-COR GHG archive"
TEXTS = (".data", ".csv", ".dat", ".txt", ".tsv", ".asc")
# How a binary file begins, what it is, and what turns it into text.
BINARIES = (
    (b'"TOB', "Campbell binary (TOB)", "convert it to TOA5 with LoggerNet's CardConvert"),
    (b"TOB", "Campbell binary (TOB)", "convert it to TOA5 with LoggerNet's CardConvert"),
    (b"\x89HDF", "HDF5 or NetCDF", "write it as CSV, with xarray's to_dataframe().to_csv"),
    (b"CDF", "NetCDF", "write it as CSV, with xarray's to_dataframe().to_csv or ncdump"),
    (b"TDSm", "a LabVIEW TDMS file", "write it as CSV, with nptdms or LabVIEW's exporter"),
    (b"MATLAB", "a MATLAB file", "write it as CSV, with MATLAB's writetable"),
    (b"PAR1", "a Parquet file", "write it as CSV, with pandas' to_csv"),
    (b"\xd0\xcf\x11\xe0", "an old spreadsheet (xls)", "save it as CSV"),
    (b"BZh", "packed with bzip2", "unpack it with bunzip2"),
    (b"\xfd7zXZ", "packed with xz", "unpack it with unxz"),
    (b"7z\xbc\xaf", "packed with 7-Zip", "unpack it"),
)  # fmt: skip
BY_NAME = {
    ".slt": "EdiSol or EddyMeas binary (SLT); convert it to text with EddyPro or EddySoft",
    ".tob1": "Campbell binary (TOB1); convert it to TOA5 with LoggerNet's CardConvert",
    ".tob3": "Campbell binary (TOB3); convert it to TOA5 with LoggerNet's CardConvert",
    ".xlsx": "a spreadsheet; save it as CSV",
}


@contextmanager
def opened(path: Path) -> Iterator[TextIO]:
    """Opens the text of a file, or of the data part of an archive.

    Raises RecordError if the file holds no text; the message names the converter where one is
    known.
    """
    with path.open("rb") as file:
        start = file.read(4096)
        file.seek(0)
        if not start.strip():
            raise RecordError(f"{path}:1: empty; {EXPECTED}")
        if start.startswith(b"PK"):
            with _archived(path) as stream:
                yield stream
        elif start.startswith(b"\x1f\x8b"):
            with _gunzipped(path, file) as stream:
                yield stream
        else:
            yield _text(path, file, start)


def _text(path: Path, file: BinaryIO, start: bytes) -> TextIO:
    """Returns the text of an open file. Raises RecordError if it is binary."""
    for magic, what, remedy in BINARIES:
        if start.startswith(magic):
            raise RecordError(f"{path}:1: {what}, not text; {remedy}")
    if start.startswith((b"\xff\xfe", b"\xfe\xff")):
        return io.TextIOWrapper(file, encoding="utf-16", errors="replace", newline="")
    if b"\0" in start or sum(byte < 9 for byte in start) > len(start) // 50:
        known = BY_NAME.get(path.suffix.lower())
        told = f"binary, not text: {known}" if known else f"binary, not text; {EXPECTED}"
        raise RecordError(f"{path}:1: {told}, or convert it with its logger's own program")
    return io.TextIOWrapper(file, encoding=_encoding(start), errors="replace", newline="")


def _encoding(start: bytes) -> str:
    """Returns the encoding of a text by its beginning: UTF-8, or else Windows' western one."""
    decoder = codecs.getincrementaldecoder("utf-8")()  # the beginning may end within a letter
    try:
        decoder.decode(start)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


@contextmanager
def _gunzipped(path: Path, file: BinaryIO) -> Iterator[TextIO]:
    """Opens the text in a gzipped file. Raises RecordError if it is broken or binary."""
    try:
        with gzip.GzipFile(fileobj=file) as plain:
            start = plain.read(4096)
            if not start.strip():
                raise RecordError(f"{path}:1: empty; {EXPECTED}")
            plain.seek(0)
            yield _text(path, plain, start)  # type: ignore[arg-type]
    except (OSError, EOFError, zlib.error) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        raise RecordError(f"{path}: a broken gzip file ({error}); copy it again") from None


@contextmanager
def _archived(path: Path) -> Iterator[TextIO]:
    """Opens the data part of an archive. Raises RecordError if there is none, or several."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = [i.filename for i in archive.infolist() if not i.is_dir()]
            with archive.open(_part(path, names)) as part:
                start = part.read(4096)
            if not start.strip():
                raise RecordError(f"{path}:1: empty; {EXPECTED}")
            with archive.open(_part(path, names)) as part:
                yield _text(path, part, start)  # type: ignore[arg-type]
    except (zipfile.BadZipFile, EOFError, zlib.error, NotImplementedError, RuntimeError) as error:
        if isinstance(error, RuntimeError) and "password" not in str(error):
            raise
        raise RecordError(
            f"{path}: a broken archive ({error}); fetch it again from the logger"
        ) from None


def _part(path: Path, names: list[str]) -> str:
    """Returns the name of an archive's data part."""
    if any(name.startswith("xl/") for name in names):
        raise RecordError(f"{path}: a spreadsheet, not text; save it as CSV")
    data = [name for name in names if name.endswith(".data") and "/" not in name]
    if data:  # beside the fast data there may be those of a weather station, NAME-biomet.data
        return min(data, key=len)
    texts = [n for n in names if n.lower().endswith(TEXTS) and not n.startswith("__MACOSX")]
    if not texts:
        raise RecordError(f"{path}: an archive without a .data part or a text file; {EXPECTED}")
    if len(texts) > 1:
        told = ", ".join(texts)[:200]
        raise RecordError(f"{path}: an archive of several texts ({told}); unpack it, give them all")
    return texts[0]
