"""What `thzcl fluctuations` does: records read and analysed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from thzcl.fluctuations import analysis, record


def study(paths: Sequence[Path], columns: str = "") -> dict[str, Any]:
    """The statistics of one record in one file or several, as printed; `columns` as in columns.find.

    Raises RecordError for files that hold no usable record.
    """
    return analysis.analyse(record.load(paths, columns)).as_json()
