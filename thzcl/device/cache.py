"""The folder in which thzcl keeps what it can make again: built kernels, and what was tried."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path


def cache_folder() -> Path:
    """Returns the folder of thzcl's cache; it need not exist."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "thzcl"


def can_be_written() -> bool:
    """Returns whether anything can be kept in the cache."""
    folder = cache_folder()
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    return os.access(folder, os.W_OK)


def entry(kind: str, identity: Iterable[str]) -> Path:
    """Returns the path of an entry, by everything that it depends on."""
    digest = hashlib.sha256("\0".join(identity).encode()).hexdigest()
    return cache_folder() / kind / digest


def load(path: Path) -> bytes | None:
    """Returns the content of an entry, or None if it is missing or spoilt."""
    try:
        whole = path.read_bytes()
    except OSError:
        return None
    digest, content = whole[:32], whole[32:]
    return content if hashlib.sha256(content).digest() == digest else None


def keep(path: Path, content: bytes) -> None:
    """Writes an entry, whole, with its digest, if the cache can be written."""
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(f".{os.getpid()}")
        part.write_bytes(hashlib.sha256(content).digest() + content)
        part.replace(path)
