"""Inverse Fourier transforms of cubes: by SciPy in the host's memory, by reikna on a device."""

from __future__ import annotations

import warnings
from typing import Any

from numpy.typing import NDArray

AXES = (0, 1, 2)


def on_host(spectrum: NDArray[Any], grid: int) -> NDArray[Any]:
    """Returns the inverse transform of a cube with `grid` points along each edge, over grid^3.

    A half spectrum (grid, grid, grid/2 + 1) gives a real cube, a full one a complex cube. The
    spectrum's own values may be lost.
    """
    import scipy.fft

    half = spectrum.shape[2] != grid
    transform = scipy.fft.irfftn if half else scipy.fft.ifftn
    result: NDArray[Any] = transform(spectrum, (grid,) * 3, AXES, overwrite_x=True, workers=-1)
    return result


class OnDevice:
    """Transforms of full spectra in a device's memory; each shape and type is compiled once."""

    def __init__(self, queue: Any) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # reikna's templates are of an older Python
            from reikna.cluda import ocl_api

        self._thread = ocl_api().Thread(queue)
        self._compiled: dict[tuple[tuple[int, ...], str], Any] = {}

    def run(self, memory: Any, shape: tuple[int, ...], dtype: Any) -> None:
        """Replaces the spectrum in an OpenCL buffer by its inverse transform, over grid^3."""
        cube = self._thread.array(shape, dtype, base=memory)
        key = (shape, str(dtype))
        if key not in self._compiled:
            self._compiled[key] = self._plan(cube)
        self._compiled[key](cube, cube, inverse=1)

    def _plan(self, cube: Any) -> Any:
        """Returns the compiled transform of cubes like this, without a driver's remarks on it."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            from reikna.fft import FFT

            return FFT(cube).compile(self._thread)
