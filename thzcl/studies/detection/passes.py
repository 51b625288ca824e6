"""What a pass over the airs has told so far, and its file: an answer goes on where it was."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from thzcl.files import write_whole
from thzcl.studies.detection.observer import Training

Array = NDArray[np.float64]
Key = tuple[int, str]  # number of a pair of scenes, and absorption model
# What is raised where a file does not hold what thzcl writes.
_BROKEN = AttributeError, EOFError, LookupError, OSError, TypeError, ValueError, zipfile.BadZipFile


@dataclass
class Pass:
    """What `airs` airs have told: what was learnt, the statistics, and the target's pixels.

    `null` and `present` are the statistics without and with the target, (air, draw).
    """

    airs: int = 0
    training: dict[Key, Training] = field(default_factory=dict)
    null: dict[Key, list[list[float]]] = field(default_factory=dict)
    present: dict[Key, list[list[float]]] = field(default_factory=dict)
    pixels: dict[int, float] = field(default_factory=dict)

    def write(self, path: Path) -> None:
        """Writes it, whole or not at all. Raises OSError."""
        keys = list(self.training)
        told = {"airs": self.airs, "keys": keys, "pixels": list(self.pixels.items())}
        arrays = {"told": np.array(json.dumps(told))}
        for place, key in enumerate(keys):
            learnt = self.training[key].arrays()
            arrays |= {f"{place} {name}": values for name, values in learnt.items()}
            arrays[f"{place} null"] = np.array(self.null.get(key, []))
            arrays[f"{place} present"] = np.array(self.present.get(key, []))
        content = io.BytesIO()
        np.savez(content, **arrays)  # type: ignore[arg-type]
        write_whole(path, lambda part: part.write_bytes(content.getvalue()))

    @classmethod
    def read(cls, path: Path) -> Pass:
        """Returns what a file holds, or an empty one if there is no such file, or another's."""
        if not path.is_file():
            return cls()
        try:
            with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
                told, found = json.loads(str(file["told"])), cls()
                found.airs = int(told["airs"])
                found.pixels = {int(number): float(pixels) for number, pixels in told["pixels"]}
                for place, (number, model) in enumerate(told["keys"]):
                    key, own = (int(number), str(model)), f"{place} "
                    arrays = {name: file[own + name] for name in Training.ARRAYS}
                    found.training[key] = Training.of(arrays)
                    for name, lists in (("null", found.null), ("present", found.present)):
                        if len(file[own + name]):
                            lists[key] = file[own + name].tolist()
                return found
        except _BROKEN:
            return cls()
