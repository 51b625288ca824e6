"""The folder of a study: what it is, a file for each member, and one table of them all."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from thzcl.errors import FileError, UsageError
from thzcl.files import RECORD, make_folder, part_beside, read_json, write_whole
from thzcl.results.rows import KEYS, METRICS
from thzcl.studies.many.members import Study

DESCRIPTION, INDEX, MEMBERS = "study.json", "index.csv", "members"
DETECTION = "detection"
STRENGTHS = ("d_prime", "d_prime_low", "d_prime_high", "area", "area_low", "area_high")
# What files of the folder hold, with the types of it: all of them, and those of members.
HELD: dict[str, Any] = {"state": str, "rows": list, "message": str}
OF_MEMBER = HELD | {"member": int, "settings": dict, "seed": int | None, "seconds": float}
OWN = ("seed", "state", "seconds")


class Store:
    """The folder of one study. Whatever is in it is whole."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.members = folder / MEMBERS
        self.index = folder / INDEX

    def described(self) -> dict[str, Any] | None:
        """Returns what the folder says that it holds, or None for a folder of no study.

        Raises UsageError if that cannot be read.
        """
        path = self.folder / DESCRIPTION
        if not path.exists():
            return None
        try:
            found = read_json(path, RECORD)
        except FileError as error:
            raise UsageError(f"{error}, or choose another folder") from None
        if not isinstance(found, dict) or not isinstance(found.get("seed"), int):
            raise UsageError(f"{path}: describes no study; choose another folder")
        return found

    def claim(self, study: Study) -> None:
        """Says whose folder this is. Raises UsageError if it is another study's.

        Of several processes that begin at once the first counts.
        """
        make_folder(self.members)
        path = self.folder / DESCRIPTION
        text = json.dumps(study.identity, indent=1, default=str)
        with part_beside(path) as part:
            part.write_text(text, encoding="utf-8")
            part.chmod(0o644)
            with suppress(FileExistsError):
                os.link(part, path)
        stored = self.described()
        own = json.loads(text)
        if stored is not None and stored != own:
            differs = ", ".join(name for name in own if stored.get(name) != own[name])
            raise UsageError(
                f"{self.folder}: holds another study ({differs} differ); choose another folder, or "
                "give the same again"
            )

    def state(self, name: str) -> str | None:
        """Returns the state of a member by the name of its file, or None if it has none."""
        found = self._read(self.members / f"{name}.json", OF_MEMBER)
        return None if found is None else str(found["state"])

    def write(self, name: str, found: dict[str, Any]) -> None:
        """Writes a member's file, whole or not at all. Raises OSError."""
        text = json.dumps(found, indent=1)
        write_whole(
            self.members / f"{name}.json", lambda part: part.write_text(text, encoding="utf-8")
        )

    def detected(self, name: str) -> dict[str, Any] | None:
        """Returns what a file of d' and area holds, or None if there is none."""
        return self._read(self.folder / DETECTION / f"{name}.json", HELD)

    def write_detection(self, name: str, found: dict[str, Any]) -> None:
        """Writes a file of d' and area, whole or not at all. Raises OSError."""
        (self.folder / DETECTION).mkdir(exist_ok=True)
        text = json.dumps(found, indent=1)
        write_whole(
            self.folder / DETECTION / f"{name}.json",
            lambda part: part.write_text(text, encoding="utf-8"),
        )

    def records(self) -> Iterator[dict[str, Any]]:
        """Yields what the members' files hold, by number; a file that cannot be read is no file."""
        for path in sorted(self.members.glob("*.json"), key=_number):
            found = self._read(path, OF_MEMBER)
            if found is not None:
                yield found

    def _read(self, path: Path, held: dict[str, Any]) -> dict[str, Any] | None:
        """Returns what a file holds, or None for one that this program has not written so."""
        try:
            found = read_json(path, RECORD)
        except FileError:
            return None
        sound = isinstance(found, dict) and all(
            isinstance(found.get(name), kind) for name, kind in held.items()
        )
        return found if sound and all(isinstance(row, dict) for row in found["rows"]) else None

    def write_index(self, keys: tuple[str, ...], detections: Sequence[str] = ()) -> dict[str, int]:
        """Writes the table of all members, made from their files; returns how many are in a state.

        `keys` are the settings that are varied, `detections` names the files of d' and area by
        the point of the grid. Raises OSError.
        """
        counts: dict[str, int] = {}
        told = self._strengths(detections)
        more = STRENGTHS if detections else ()

        def write(part: Path) -> None:
            with part.open("w", encoding="utf-8", newline="") as file:
                writer = csv.writer(file, lineterminator="\n")
                writer.writerow(("member", *keys, *OWN, *KEYS, *METRICS, *more, "message"))
                for found in self.records():
                    counts[found["state"]] = counts.get(found["state"], 0) + 1
                    point = found["member"] % max(len(detections), 1)
                    for row in found["rows"]:
                        key = point, *(row[name] for name in ("variant", "target", "model"))
                        row.update(told.get(key, {}))
                    writer.writerows(_rows(found, keys, more))

        write_whole(self.index, write)
        return counts

    def _strengths(self, names: Sequence[str]) -> dict[tuple[Any, ...], dict[str, Any]]:
        """Returns d' and area by point, variant, target and model."""
        files = ((point, self.detected(name)) for point, name in enumerate(names))
        return {
            (point, row["variant"], row["target"], row["model"]): row
            for point, found in files
            if found is not None
            for row in found["rows"]
        }


def _number(path: Path) -> tuple[int, str]:
    number = path.name.partition("-")[0]
    return (int(number) if number.isdecimal() else -1), path.name


def _rows(
    found: dict[str, Any], keys: tuple[str, ...], more: tuple[str, ...]
) -> Iterator[list[Any]]:
    """Yields the rows of one member: of one without numbers a single one."""
    settings = [_cell(found["settings"].get(key)) for key in keys]
    first = [found["member"], *settings, *(found[name] for name in OWN)]
    for row in found["rows"] or [{}]:
        yield [*first, *(row.get(name) for name in (*KEYS, *METRICS, *more)), found["message"]]


def _cell(value: Any) -> Any:
    return json.dumps(value) if isinstance(value, list | dict | bool) else value
