"""Scanning: another sensor's pixels are taken one after the other while wind moves the air."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar, Literal

import numpy as np

from thzcl.sensor import Image, Needs, Parameters, Sensor, User, View, hookimpl, parameter


class RasterScan(Sensor):
    """Another sensor, described in [sensor.detector], whose pixels are taken at times of their own.

    Turbulence is frozen and moves with the wind U ([atmosphere.fluctuations] wind_m_s): at time t,
    the start of a ray has moved by exactly -U t in the cube. With `timing = "raster"` pixel n is
    taken at n dwell times, row by row from the top left, or column by column, back and forth or
    always in one direction. With "focal-plane" all pixels are taken together, and the mean of
    `samples` instants spread over the integration time is recorded.

    Noise: that of the detector, which gets the dwell time (with "focal-plane" the integration time)
    as its time on a pixel. A detector's own `integration_time_s` may be shorter, as where a mirror
    has to settle, and is refused if it is longer.

    Left out: the air's motion within a dwell time, time lost between pixels and rows, errors of
    pointing, targets that move.

    Validation: without wind it is the snapshot to the bit; a reversed scan in reversed wind is the
    forward one; pixels are those of snapshots at their own times, through optics too
    (tests/test_scanning.py, tests/test_pairs.py); with every other feature it is the oracle's
    (tests/test_matrix.py).
    """

    name = "raster-scan"
    contract = 1
    wraps = True

    class Params(Parameters):
        """Parameters of the scan."""

        used_by: ClassVar = {
            **dict.fromkeys(
                ("dwell_s", "order", "back_and_forth", "reverse"), User(("timing",), ("raster",))
            ),
            **dict.fromkeys(("integration_time_s", "samples"), User(("timing",), ("focal-plane",))),
        }
        timing: Literal["raster", "focal-plane"] = parameter(
            "raster", help="one pixel after the other, or all together"
        )
        dwell_s: float | None = parameter(
            None, gt=0, le=1e6, unit="s", help="time from one pixel to the next"
        )
        order: Literal["rows", "columns"] = parameter("rows", help="along rows, or along columns")
        back_and_forth: bool = parameter(
            False, help="every other row (or column) in the opposite direction"
        )
        reverse: bool = parameter(False, help="the last pixel first")
        integration_time_s: float | None = parameter(
            None, gt=0, le=1e6, unit="s", help="time over which a focal plane integrates"
        )
        samples: int = parameter(
            8, ge=1, le=1000, help="instants averaged over the integration time"
        )

        def troubles(self) -> list[Any]:
            """Returns what is wrong with keys that belong together."""
            if self.timing == "raster" and self.dwell_s is None:
                return [self.trouble("timing", '"raster" needs dwell_s')]
            if self.timing == "focal-plane" and self.integration_time_s is None:
                return [self.trouble("timing", '"focal-plane" needs integration_time_s')]
            return []

    def needs(self, view: View) -> Needs:
        """Returns what the detector needs, at the times of the scan."""
        needs = self.detector.needs(replace(view, dwell_s=self._dwell_s()))
        return replace(
            needs,
            times_s=self._times(*view.pixels),
            notes=(*needs.notes, *self._notes(needs)),
        )

    def _dwell_s(self) -> float | None:
        """Returns how long the detector sees each pixel, s."""
        p = self.params
        time_s: float | None = p.integration_time_s if p.timing == "focal-plane" else p.dwell_s
        return time_s

    def _notes(self, needs: Needs) -> list[str]:
        """Returns what is told of the detector's time, where it has noise."""
        if not needs.noise:
            return []
        name, dwell_s = self.detector.name, self._dwell_s()
        if needs.integration_time_s is None:
            told = f"the noise of {name} does not follow from the scan's {dwell_s:g} s a pixel"
            return [f"{told}, but from what [sensor.detector] says"]
        if needs.integration_time_s == dwell_s:
            return [f"{name} integrates for the scan's {dwell_s:g} s a pixel"]
        own_s = needs.integration_time_s
        return [f"{name} integrates for {own_s:g} s of the scan's {dwell_s:g} s a pixel"]

    def _times(self, width: int, height: int) -> Any:
        """Returns when each pixel is taken, s, (sample, y, x)."""
        p = self.params
        if p.timing == "focal-plane":
            instants = (np.arange(p.samples) + 0.5) / p.samples * p.integration_time_s
            return instants[:, None, None]
        lines, along = (height, width) if p.order == "rows" else (width, height)
        number = np.arange(lines * along).reshape(lines, along)
        if p.back_and_forth:
            number[1::2] = number[1::2, ::-1]
        if p.reverse:
            number = lines * along - 1 - number
        return (number if p.order == "rows" else number.T)[None] * p.dwell_s

    def observe(self, sight: Any, rng: np.random.Generator) -> Image:
        """Returns the image that the detector records."""
        return self.detector.observe(sight, rng)


@hookimpl
def register_sensors() -> list[type[Sensor]]:
    """Returns the sensor of this file."""
    return [RasterScan]
