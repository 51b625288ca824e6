"""The line on which each key of a TOML text stands, which TOML readers do not tell."""

from __future__ import annotations

import re
from collections.abc import Iterator

import tomli

Path = tuple[str | int, ...]

_TOKEN = re.compile(
    r'''
      """ (?: [^"\\]++ | \\. | "{1,2}(?!") )*+ "{3,5}   # text over several lines
    | \'\'\' (?: [^']++ | '{1,2}(?!') )*+ '{3,5}
    | " (?: [^"\\\n]++ | \\. )*+ "
    | ' [^'\n]*+ '
    | \# [^\n]*+
    | [\[\]{},=\n]
    | [A-Za-z0-9_-]++                                   # a bare key, or a part of a value
    ''',
    re.VERBOSE | re.DOTALL,
)


def line_numbers(text: str) -> dict[Path, int]:
    """Returns the line (from 1) of each table and key of valid TOML, by path.

    Keys of inline tables and values of lists are among them. Tables must not be nested so deep
    that Python's stack does not hold them.
    """
    return _Scanner(text).lines


class _Scanner:
    """Reads a text from one token to the next."""

    def __init__(self, text: str) -> None:
        self.lines: dict[Path, int] = {}
        self._last: dict[Path, int] = {}  # of each list of tables, its last one's position
        self._tokens = self._split(text)
        self._here, self._line = "", 0
        self._next()
        self._statements()

    def _split(self, text: str) -> Iterator[tuple[str, int]]:
        """Yields tokens, comments aside, and the lines on which they begin; at the end, "" once."""
        line = 1
        for match in _TOKEN.finditer(text):
            if match[0][0] != "#":
                yield match[0], line
            line += match[0].count("\n")
        yield "", line

    def _next(self) -> str:
        """Moves on; returns the token that was passed."""
        passed = self._here
        self._here, self._line = next(self._tokens, ("", self._line))
        return passed

    def _statements(self) -> None:
        table: Path = ()
        while self._here:
            if self._here == "\n":
                self._next()
            elif self._here == "[":
                table = self._header()
            else:
                self._pair(table)

    def _header(self) -> Path:
        """Passes [a.b] or [[a.b]]; returns the path of the table that begins."""
        line, depth = self._line, 0
        while self._here == "[":
            depth += 1
            self._next()
        *tables, name = self._names("]")
        if depth == 2:
            self._next()
            path = (*self._located((), tables, line), name)
            self.lines.setdefault(path, line)
            self._last[path] = self._last.get(path, -1) + 1
            path = (*path, self._last[path])
            self.lines[path] = line
            return path
        return self._located((), [*tables, name], line)

    def _names(self, end: str) -> list[str]:
        """Passes a dotted name and the token that ends it; returns its parts."""
        names = []
        while self._here != end:
            names.append(_unquoted(self._next()))
        self._next()
        return names

    def _located(self, table: Path, names: list[str], line: int) -> Path:
        """Returns where names lead from a table; what they are the first to name has their line."""
        path = table
        for name in names:
            path = (*path, name)
            self.lines.setdefault(path, line)
            if path in self._last:  # a list of tables: its last one is meant
                path = (*path, self._last[path])
        return path

    def _pair(self, table: Path) -> None:
        line = self._line
        self._value(self._located(table, self._names("="), line), line)

    def _value(self, path: Path, line: int) -> None:
        """Passes a value, which stands where a path leads and whose key has a line."""
        if self._here == "[":
            self._next()
            number = 0
            while self._here != "]":
                if self._here in (",", "\n"):
                    number += self._next() == ","
                    continue
                if self._line != line:
                    self.lines[*path, number] = self._line
                self._value((*path, number), self._line)
            self._next()
        elif self._here == "{":
            self._next()
            while self._here != "}":
                if self._here in (",", "\n"):
                    self._next()
                else:
                    self._pair(path)
            self._next()
        else:  # a number or a date may be of several tokens
            while self._here not in ("", ",", "]", "}", "\n"):
                self._next()


def _unquoted(name: str) -> str:
    return next(iter(tomli.loads(f"{name} = 0"))) if name[0] in "\"'" else name
