"""What surfaces send where it depends on the angle: look-ups at the ends of rays.

thzcl itself has no such surface yet, so that one is defined here, and a sky in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import oracle
import pytest
from scenes import ACTIVE, BROAD, DRIFTING, MOIST, lens, run, scene

from thzcl.air import radiometry
from thzcl.graph import Values
from thzcl.surfaces import mirrors, radiance
from thzcl.surfaces.geometry import BACKGROUND
from thzcl.surfaces.mirrors import Constant, Enclosure, Opening
from thzcl.surfaces.radiance import Emission, Reflecting

WARM = {**DRIFTING, "fluctuations": DRIFTING["fluctuations"] | {"temperature_sigma_k": 1.0}}
CALM = {key: value for key, value in DRIFTING["fluctuations"].items() if key != "wind_m_s"}
STILL = {**MOIST, "fluctuations": CALM}


@dataclass(frozen=True)
class Glass(mirrors.Mirror):
    """Unpolarised light on a dielectric of real refractive index: Fresnel's equations."""

    index: float = 2.0
    angular = True
    view = "mirrored"

    def reflectivity(self, frequency_hz, cosine):
        """(|r_s|^2 + |r_p|^2) / 2."""
        inner = np.sqrt(self.index**2 - 1 + cosine**2)
        s = (cosine - inner) / (cosine + inner)
        p = (self.index**2 * cosine - inner) / (self.index**2 * cosine + inner)
        shape = np.broadcast_shapes(frequency_hz.shape, cosine.shape)
        return np.broadcast_to((s**2 + p**2) / 2, shape)


@dataclass(frozen=True)
class Sky:
    """Air of 290 K that thins out upwards, above ground of 290 K; the sky is colder overhead."""

    angular = True
    knee = 0.3
    dip = 1.0

    def kelvin(self, frequency_hz, elevation):
        """The temperature of a black body as bright as the sky there."""
        with np.errstate(divide="ignore"):
            depth = (frequency_hz / 650e9) ** 2 * 0.5 / np.maximum(elevation, 0.0)
        return 290.0 * -np.expm1(-depth)

    def contrast(self, frequency_hz, elevation, air_k):
        """Planck's law, less the air's."""
        kelvin = self.kelvin(frequency_hz[:, None], elevation)
        return radiometry.planck_difference(frequency_hz[:, None], kelvin, air_k)

    def scattered(self, frequency_hz, upward, height_m, air_k):
        """Something smooth that looks different from every face and height."""
        kelvin = 290.0 - (1 + upward) * (40.0 + height_m) / (frequency_hz[:, None] / 650e9)
        return radiometry.planck_difference(frequency_hz[:, None], kelvin, air_k)


def glassy(surfaces, behind):
    """Everything of glass, before a background."""
    return [s._replace(mirror=behind if s.target == BACKGROUND else Glass()) for s in surfaces]


@pytest.fixture
def angular(monkeypatch):
    """Every scene's surfaces are of glass, under the sky."""
    emission, reflection = radiance.emission, radiance.reflection

    def emitting(scene, surfaces, *_others):
        return replace(emission(scene, glassy(surfaces, Opening())), surroundings=Sky())

    monkeypatch.setattr(radiance, "emission", emitting)

    def reflecting(surfaces, trips, **options):
        return reflection(glassy(surfaces, Constant(0.0)), trips, **options)

    monkeypatch.setattr(radiance, "reflection", reflecting)


def ends(data):
    """Yields each pixel's row, column, surface, length, cosine and mirrored direction."""
    camera, box = lens(data), data["targets"]["box"]
    block = oracle.Box(box["center_m"], box["size_m"], box["yaw_deg"])
    turn = np.radians(box["yaw_deg"])
    columns, rows = data["camera"]["pixels"]
    origin = np.array(data["camera"]["position_m"])
    for row in range(rows):
        for column in range(columns):
            d = camera.ray(row, column)
            meeting = {"sky": (data["background"]["max_range_m"], None)}
            if d[2] < 0:
                meeting["ground"] = -origin[2] / d[2], np.array([0.0, 0.0, 1.0])
            met = block.meet(origin, d)
            if met is not None:
                axis, sign = met[1:3]
                axes = np.array(
                    [[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
                )
                meeting["top" if axis == 2 else "box"] = met[0], sign * axes[axis]
            what = min(meeting, key=lambda name: meeting[name][0])
            length, normal = meeting[what]
            cosine = 1.0 if normal is None else abs(normal @ d)
            onwards = d if normal is None else d - 2 * (d @ normal) * normal
            yield row, column, what, length, cosine, onwards[2]


@pytest.mark.usefixtures("angular")
@pytest.mark.parametrize(
    ("height_m", "there"),
    [(4.0, {"sky", "ground", "box"}), (14.0, {"ground", "box", "top"})],
)
def test_the_camera_sees_the_sky_in_glass(tmp_path, height_m, there):
    """(L_surface - B) exp(-tau) of every pixel, from the equations of Fresnel and Planck."""
    ghz = [340.0, 650.0]
    sensor = {"kind": "passive-spectral", "frequency_ghz": ghz}
    data = scene(atmosphere=MOIST, sensor=sensor, camera__position_m=[1.0, -2.0, height_m])
    found = run(tmp_path, data, settings={"numerics.error_budget": False})
    grams = 0.70 * oracle.saturation_hpa(290.0) * 100 / 461.525 / 290.0 * 1e3
    seen = set()
    for number, hz in enumerate(np.array(ghz) * 1e9):
        air = oracle.planck(hz, 290.0)
        absorption = oracle.absorption_per_m(hz, 290.0, 1013.25, grams)
        expected = np.zeros((12, 16))
        for row, column, what, length, cosine, up in ends(data):
            seen.add(what)
            own = {"sky": 290.0, "ground": 285.0}.get(what, 300.0)
            part = 1.0 if what == "sky" else float(Glass().reflectivity(hz, np.array(cosine)))
            behind = oracle.planck(hz, float(Sky().kelvin(hz, np.array(up))))
            sent = (1 - part) * oracle.planck(hz, own) + part * behind - air
            expected[row, column] = sent * np.exp(-absorption * length)
        overhead = np.abs(Sky().contrast(np.array([hz]), np.ones(1), 290.0)).max()
        contrast = found.variants[0].radiances.contrast[number]
        assert np.abs(contrast - expected).max() < mirrors.TOLERANCE * overhead
    assert seen == there
    assert any("COSINES=" in options for options in found.build_options)


BOARD = {
    "kind": "billboard",
    "center_m": [20.0, 4.0, 2.0],
    "size_m": [4.0, 3.0],
    "facing_deg": 200.0,
    "quantity": "temperature",
    "image": "board.png",
    "range": [280.0, 310.0],
    "reflectivity": 0.3,
}
OPTICS = {"aperture_m": 0.1, "pixel": False}
SPECTRAL = {"kind": "passive-spectral", "frequency_ghz": 650.0}
SCAN = {"kind": "raster-scan", "dwell_s": 0.01, "detector": SPECTRAL}
BLURRED_SCAN = SCAN | {"detector": SPECTRAL | {"optics": OPTICS}}
PAIRS = {
    "even air": {"atmosphere": MOIST},
    "turbulent air": {"atmosphere": STILL},
    "warm air": {"atmosphere": WARM},
    "several frequencies": {
        "atmosphere": STILL,
        "sensor": {"kind": "passive-spectral", "frequency_ghz": [340.0, 500.0, 650.0]},
    },
    "warm air at many frequencies": {
        "atmosphere": WARM,
        "sensor": {
            "kind": "passive-spectral",
            "frequency_ghz": [600.0 + 10 * n for n in range(11)],
        },
    },
    "a band": {"sensor": BROAD},
    "a band in warm air": {"atmosphere": WARM, "sensor": BROAD},
    "float64": {"numerics": {"precision": "float64"}},
    "samples": {"camera__samples_per_pixel": 4},
    "a scan": {"sensor": SCAN, "atmosphere": DRIFTING},
    "a scan in warm air": {"sensor": SCAN, "atmosphere": WARM},
    "optics": {"sensor": SPECTRAL | {"optics": OPTICS}},
    "a scan through optics": {"sensor": BLURRED_SCAN, "atmosphere": DRIFTING},
    "a tolerance": {"numerics": {"tolerance": 1e-3}},
    "realisations": {"numerics": {"realizations": 2}},
    "a stride": {"camera__pixels": [64, 48], "numerics": {"ray_stride": 2}},
    "echoes": {"sensor": ACTIVE},
    "echoes in warm air": {"atmosphere": WARM, "sensor": ACTIVE},
    "bistatic": {"sensor": ACTIVE | {"arrangement": "bistatic", "transmitter_m": [0.0, 3.0, 5.0]}},
    "a picture": {"targets__board": BOARD},
    "a picture in warm air": {"targets__board": BOARD, "atmosphere": WARM},
    "a picture in a band": {"targets__board": BOARD, "sensor": BROAD},
}


@pytest.mark.usefixtures("angular")
@pytest.mark.parametrize("changes", PAIRS.values(), ids=PAIRS)
def test_look_ups_join_every_feature(tmp_path, changes):
    """The budget's twin knows the laws themselves, and no look-up."""
    picture(tmp_path)
    budget = run(tmp_path, scene(**changes)).error_budget
    assert budget["arithmetic"]["relative"] < 2e-6


def picture(folder):
    from PIL import Image

    values = np.random.default_rng(8).integers(256, size=(9, 12)).astype(np.uint8)
    Image.fromarray(values).save(folder / "board.png")


@pytest.mark.usefixtures("angular")
def test_the_budget_sees_a_look_up_that_is_too_coarse(tmp_path, monkeypatch):
    monkeypatch.setattr(mirrors, "FEWEST", 3)
    monkeypatch.setattr(mirrors, "MOST", 3)
    budget = run(tmp_path, scene(atmosphere=STILL)).error_budget
    assert budget["arithmetic"]["relative"] > 1e-3


@pytest.mark.parametrize("index", [1.05, 2.0, 8.0])
def test_look_ups_are_as_fine_as_the_law_needs(index):
    hz, cosine = np.array([650e9]), np.linspace(0, 1, 100_001)
    nodes = mirrors.by_cosine((Glass(index),), hz)
    found = np.interp(np.sqrt(cosine), np.linspace(0, 1, nodes.shape[3]), nodes[0, 0, 0])
    assert np.abs(found - Glass(index).reflectivity(hz, cosine)).max() < 2e-6


def test_constants_need_no_look_up(tmp_path):
    """What is the same at every angle is one number of a table, and no angle is computed."""
    found = run(tmp_path, scene())
    assert not any("COSINE" in options for options in found.build_options)


def test_black_surfaces_need_no_look_up_of_the_sky(tmp_path, monkeypatch):
    emission = radiance.emission
    monkeypatch.setattr(
        radiance, "emission", lambda *given: replace(emission(*given), surroundings=Sky())
    )
    black, grey = (
        run(tmp_path, scene(targets__box__reflectivity=part, ground__reflectivity=0.0))
        for part in (0.0, 0.1)
    )
    assert not any("COSINE" in options for options in black.build_options)
    assert any("COSINES" in options for options in grey.build_options)


def test_surfaces_emit_and_reflect():
    """L = (1 - R) B(T) + R L_environment, less the air's radiance."""
    kelvin, reflectivity = [263.0, 273.0], [0.2, 0.5]
    hz, air = np.array([650e9]), oracle.planck(650e9, 275.0)
    reflecting = Reflecting(tuple(map(Constant, reflectivity)), Values.of([0, 1], np.int32))
    for around in (275.0, 0.0, 100.0):
        sources = Emission(Values.of(kelvin), reflecting, 275.0, Enclosure(around))
        for row, t, r in zip(sources.table(hz).sent, kelvin, reflectivity, strict=True):
            expected = (1 - r) * oracle.planck(650e9, t) + r * oracle.planck(650e9, around) - air
            assert row[0] == pytest.approx(expected, rel=1e-11)
