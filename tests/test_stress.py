"""The stiff and extreme cases: they pass, and fail where what makes them pass is taken out."""

from __future__ import annotations

import json

import numpy as np
import pytest
from mutants import CASES, NOT_FINITE, Raises, Remedy, Shows, bounded, kernels, python

from thzcl.air import expansion, radiometry, sky
from thzcl.plan import numerics
from thzcl.sensing import bands
from thzcl.studies.stress import judges, truth
from thzcl.studies.stress.trial import DOUBLE, SINGLE, Case, examine
from thzcl.surfaces import geometry, mirrors, radiance
from thzcl.turbulence import cube, spectra

LINES = ("183.31", "556.936", "752.033", "987.927")
SATURATED = [f"{line} GHz saturated at 50 degC" for line in LINES]
SATURATED_WARM = [f"{line} GHz saturated, 3 K of fluctuation" for line in LINES]
ALONG_AXES = [
    f"from a voxel's corner {where}"
    for where in ("along an axis", "against an axis", "straight up")
]
ALONG_FACE = "from a voxel's corner along a face's diagonal"
FINE_NEEDLE = "10 m through voxels of 1 mm, field of view 0.01 deg"
FINE_WARM = "temperature fluctuating, 10 m through voxels of 1 mm"
THIN_WARM = "temperature fluctuating, depth of 1e-12"
RAINY = "rain of 300 mm/h as warm as all else"
MICROKELVIN, MICROKELVIN_CLEAR = (
    f"contrast of 1 microkelvin{where}" for where in ("", " in clear air")
)
LIMITED = "sigma 300 %, vapour limited to the total pressure"
DEEP_ECHOES = "dynamic range 200 dB, out and back through a depth of 17"
NARROW_LINES = "100 GHz band at 1 hPa, lines of a few MHz"
WIDE_LINE = "100 GHz band around a saturated line"
LEAST_DEPTH = 10.0  # of a voxel, where lines are saturated
WHOLE_DEPTH = 1000.0


def test_every_case_passes_by_command(thzcl_command):
    """No bound is looser than 1e-4, and most are 1e-6 in float32 and 1e-12 in float64."""
    done = thzcl_command("stress", "--format", "json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)["cases"]
    assert all(case["passed"] for case in found)
    assert {name.split(": ")[0] for name in (case["name"] for case in found)} == set(CASES)
    assert set(found[0]) == {"name", "measured", "reference", "error", "bound", "passed"}
    single, double = (
        [c["bound"] for c in found if c["name"].endswith(kind)] for kind in (SINGLE, DOUBLE)
    )
    assert max(single) <= 1e-4
    assert sum(bound <= 1e-6 for bound in single) > 0.9 * len(single)
    assert sum(bound <= 1e-12 for bound in double) > len(double) / 2


@pytest.mark.parametrize("name", SATURATED_WARM)
def test_saturated_lines_are_as_deep_as_they_should_be(name):
    """A voxel is 10 deep and more, a path a thousand and more: else the case is not stiff."""
    seen = []

    def look(run):
        seen.append((run.truth.thinnest_voxel, run.truth.optical_depth.min()))
        return judges.depth(run)

    list(examine([Case(name, CASES[name].changes, {"depth": (look, {SINGLE: 1e-6})})]))
    assert seen[0][0] > LEAST_DEPTH
    assert seen[0][1] > WHOLE_DEPTH


# --- naive forms


def quiet(formula):
    """A formula that returns what is not finite without a warning."""

    def muted(*arguments):
        with np.errstate(all="ignore"):
            return formula(*arguments)

    return muted


def degrees(most):
    """Polynomials of the same degree in all air."""
    return lambda _values, series, *_: tuple(min(most, n - 1) for n in series.shape[1:])


def exp_less_one(x):
    return np.exp(x) - 1


def subtracted(less_one):
    """Two of Planck's laws, one less the other."""

    def difference(frequency_hz, temperature_k, reference_k):
        x, other = (
            radiometry.photon_temperature(frequency_hz) / np.asarray(kelvin, float)
            for kelvin in (temperature_k, reference_k)
        )
        return radiometry.radiance_unit(frequency_hz) * (1 / less_one(x) - 1 / less_one(other))

    return quiet(difference)


def first_over_second(frequency_hz, temperature_k, reference_k):
    """Planck's difference with the surface as the hotter, whichever it is."""
    x, other = (
        radiometry.photon_temperature(frequency_hz) / np.asarray(kelvin, float)
        for kelvin in (temperature_k, reference_k)
    )
    photons = (1 + 1 / np.expm1(other)) / np.expm1(x)
    return radiometry.radiance_unit(frequency_hz) * photons * -np.expm1(x - other)


def absolute(own, reflectivity, seen, *_):
    """Returns what surfaces send by way of radiances that are not relative to the air's."""
    air = radiometry.planck(650e9, 290.0)
    return (1 - reflectivity) * (own + air) + reflectivity * (seen + air) - air


def one_rule(band, _view, _tolerance=None):
    """Returns a Gauss-Legendre rule for the whole band, fine for what is smooth; it errs unsaid."""
    x, w = np.polynomial.legendre.leggauss(15)
    half = (band.high_hz - band.low_hz) / 2
    hz = band.low_hz + half * (1 + x)
    return bands.Quadrature(hz, half * w * band.response(hz), 0.0)


def single_position(frame, *cube_of):
    frame = frame.copy()
    frame[0] = frame[0].astype(np.float32)
    return CUBE_FRAME(frame, *cube_of)


CUBE_FRAME = geometry.cube_frame
AIR_F = "3.6e-14f"  # about the air's radiance at 650 GHz
BAND_F = "3.6e-16f"  # the same of a band, weighted
ABOVE = """
above += passed *
         (alike ? (reals)row[f] : surface_value(&from, first_ray, frequencies, f));
"""
SUM_OF_BAND = "(lost < (real)0.5 ? log1p(-lost) : log(left))"
SKIES = [
    "clear sky behind turbulent air",
    "sky of dry arctic air with an inversion",
    "sky at the horizon, rays of a hundred kilometres",
    "wall that reflects half of the sky",
    "sky behind air of fluctuating temperature",
]

REMEDIES = {
    "an Earth that is round": Remedy(
        python(sky, "EARTH_M", 1e15), [Shows("sky", (1e-4, 1e-2), SKIES)]
    ),
    "polynomials of a degree that the air asks for": Remedy(
        python(expansion, "_degrees", degrees(3)),
        [
            Shows("depth", (1e-4, 1e-3), [*SATURATED, *SATURATED_WARM, "1780 GHz", "sigma 100 %"]),
            Shows(
                "depth",
                (1e-3, 2e-2),
                ["sigma 100 %, saturated at 330 K", LIMITED, "temperature fluctuating by 20 K"],
            ),
            Shows("depth", (2e-6, 2e-5), ["supersaturated, 300 %", "330 K"]),
        ],
    ),
    "powers no higher than the air asks for": Remedy(
        python(expansion, "_degrees", degrees(8)),
        [Raises(RuntimeWarning, "overflow encountered in cast", ["sigma 1e-6 %"])],
    ),
    "crossings counted, not added up": Remedy(
        kernels(
            "march.cl",
            (
                "a->following = TO_REALS(a->crossings) * a->step + a->first;",
                "a->following += crossed ? a->step : (reals)0;",
            ),
        ),
        [
            Shows("depth", (1e-5, 1e-2), ["1e18 K behind a depth of 38", FINE_NEEDLE, FINE_WARM]),
            Shows("decibels", (2e-6, 1e-3), [DEEP_ECHOES]),
        ],
    ),
    "an axis that is never crossed, infinitely far": Remedy(
        kernels("march.cl", ("d == 0 ? INFINITY : (real)(", "(real)(")),
        [Shows("depth", (1e-3, 1.0), [*ALONG_AXES])],
    ),
    "a face that belongs to the voxel above it": Remedy(
        kernels("march.cl", ("below = FLOOR(origin[lane])", "below = ceil(origin[lane]) - 1")),
        [Shows("depth", (1e-3, 1.0), [*ALONG_AXES, ALONG_FACE])],
    ),
    "a ray that goes down from a face, in the voxel below": Remedy(
        kernels(
            "march.cl",
            (
                "(d > 0 ? 1 - inside : inside) * size",
                "(d > 0 || inside == 0 ? 1 - inside : inside) * size",
            ),
        ),
        [Shows("depth", (1e-3, 1.0), [*ALONG_AXES, ALONG_FACE])],
    ),
    "contrast carried as a difference": Remedy(
        kernels(
            "shade.cl",
            (
                "STORE(source * exp(-tau),",
                f"STORE(((source + {AIR_F}) * exp(-tau) + {AIR_F} * (1.0f - exp(-tau))) - {AIR_F},",
            ),
        ),
        [
            Shows("passed", (0.05, 2.0), [MICROKELVIN, "1 GHz", "100 km through voxels of 1 km"]),
            Shows("kelvin", (0.05, 2.0), [MICROKELVIN_CLEAR]),
        ],
    ),
    "emission carried as a difference": Remedy(
        kernels(
            "emission.cl", ("STORE(contrast[f] +", f"STORE(((contrast[f] + {AIR_F}) - {AIR_F}) +")
        ),
        [Shows("emitted", (0.01, 1.0), ["temperature fluctuating by 0.1 mK", THIN_WARM])],
    ),
    "a band's contrast carried as a difference": Remedy(
        kernels(
            "shade.cl",
            (
                ABOVE,
                f"above += passed * (row[f] + {BAND_F}) + (1.0f - passed) * {BAND_F} - {BAND_F};",
            ),
        ),
        [Shows("noise", (1e-11, 1e-6), ["NEP 0"])],
    ),
    "look-ups as fine as what is reflected asks": Remedy(
        python(mirrors, "MOST", 65),
        [
            Shows(
                "seen",
                (4e-6, 0.1),
                ["ground at grazing angles", "metal ground at grazing angles"],
            )
        ],
    ),
    "light that goes to and fro under a cover": Remedy(
        kernels("source.cl", ("part / (1 - part * back)", "part")),
        [Shows("seen", (1e-6, 1e-2), ["cover over metal, both of which reflect most"])],
    ),
    "a cover that emits what it absorbs": Remedy(
        python(radiance._Layers, "_absorbed", lambda one: 0 * one.own),  # noqa: SLF001
        [Shows("seen", (1e-5, 1e-2), ["cover that takes a ten-thousandth"])],
    ),
    "a mirrored ray that crosses the air": Remedy(
        kernels("source.cl", ("sent * exp(-from->dimming[column] * there[4])", "sent")),
        [Shows("seen", (1e-4, 1.0), ["wall seen in the ground"])],
    ),
    "mirrors as differences from the air": Remedy(
        kernels(
            "source.cl",
            (
                "real sent = own + part * (seen - own);",
                f"real sent = ((1 - part) * (own + {AIR_F}) + part * (seen + {AIR_F})) - {AIR_F};",
            ),
            (
                "real sent = own + exchanged *",
                f"real sent = ((own + {AIR_F}) - {AIR_F} * (1 - 1e-7f)) + exchanged *",
            ),
        ),
        [Shows("contrast", (1e-32, 1e-18), ["materials, cover, bounce and air equal"])],
    ),
    "edges that belong to both triangles": Remedy(
        kernels(
            "mesh.cl",
            (
                "if ((u < 0 || v < 0 || w < 0) && (u > 0 || v > 0 || w > 0)) return;",
                "if ((u <= 0 || v <= 0 || w <= 0) && (u >= 0 || v >= 0 || w >= 0)) return;",
            ),
        ),
        [Shows("depth", (0.1, 100.0), ["mesh whose edges and vertices lie on rays"])],
    ),
    "surfaces as differences from the air": Remedy(
        python(radiance, "_mixed", absolute),
        [Shows("contrast", (1e-32, 1e-24), ["target, ground and air equal", RAINY])],
    ),
    "a difference of Planck's that is no subtraction": Remedy(
        python(radiometry, "planck_difference", subtracted(np.expm1)),
        [
            Shows("passed", (2e-9, 1e-6), [MICROKELVIN], DOUBLE),
            Shows("kelvin", (2e-9, 1e-6), [MICROKELVIN_CLEAR], DOUBLE),
        ],
    ),
    "expm1 in Planck's law": Remedy(
        python(radiometry, "planck_difference", subtracted(exp_less_one)),
        [Shows("passed", NOT_FINITE, ["target of 1e+18 K"])],
    ),
    "hot and cold told apart in Planck's differences": Remedy(
        python(radiometry, "planck_difference", quiet(first_over_second)),
        [Shows("passed", NOT_FINITE, ["target of 0 K"])],
    ),
    "depth summed, not told by what is left": Remedy(
        kernels("shade.cl", ("STORE(tau, depth", "STORE(-log(exp(-tau)), depth")),
        [
            Shows(
                "depth",
                (2e-6, 2.0),
                [
                    "depth of 1e-12",
                    "humidity 0",
                    "pressure 1 hPa",
                    "220 K",
                    "1 mm through voxels of 1 mm",
                ],
            ),
            Shows("depth", NOT_FINITE, SATURATED),
        ],
    ),
    "depth summed along the path too": Remedy(
        kernels(
            "emission.cl", ("STORE(depth[f], depth_out", "STORE(-log(transmission[f]), depth_out")
        ),
        [
            Shows("depth", (1e-5, 2.0), [THIN_WARM, FINE_WARM]),
            Shows("depth", NOT_FINITE, SATURATED_WARM),
        ],
    ),
    "deep segments apart from thin ones": Remedy(
        kernels("emission.cl", ("#ifdef THIN", "#if 1")),
        [Shows("emitted", NOT_FINITE, SATURATED_WARM)],
    ),
    "what air takes away by expm1": Remedy(
        kernels(
            "attenuate.cl",
            ("return 1.0f - *lost;", "*lost = 1.0f - exp(-x); return exp(-x);"),
            (
                "*lost = (1.0f - scale) - scale * series;",
                "*lost = 1.0f - (scale + scale * series);",
            ),
        ),
        [
            Shows("emitted", (0.01, 1.0), [THIN_WARM]),
            Shows("depth", (1e-3, 1.0), ["100 GHz band through a micrometre"]),
        ],
    ),
    "what a band loses summed beside what is left": Remedy(
        kernels("shade.cl", (SUM_OF_BAND, "log(left)")),
        [Shows("depth", (1e-3, 1.0), ["100 GHz band through a micrometre"])],
    ),
    "what is left of a band summed beside what it loses": Remedy(
        kernels("shade.cl", (SUM_OF_BAND, "log1p(-lost)")),
        [Shows("depth", (1.5e-6, 1e-4), ["Gaussian band, clear at its edges only"])],
    ),
    "bands summed adaptively": Remedy(
        python(bands, "resolve", one_rule),
        [
            Shows(judge, (1e-4, 10.0), [NARROW_LINES, WIDE_LINE])
            for judge in ("transmission", "contrast")
        ],
    ),
    "a cut-off no shallower than 16": Remedy(
        python(numerics, "SMALLEST_CUTOFF", 3.0),
        [Shows("passed", (5e-7, 5e-6), ["ray cut off at a depth of 16"])],
    ),
    "a cut-off as deep as the brightest surface asks for": Remedy(
        python(numerics, "NEGLIGIBLE", 1e30),
        [Shows(judge, (0.3, 0.9), ["1e18 K behind a depth of 38"]) for judge in ("depth", "faint")],
    ),
    "humidity lognormal where it fluctuates wildly": Remedy(
        python(spectra, "LOGNORMAL_FROM", np.inf),
        [Shows("logarithm", NOT_FINITE, ["sigma 100 %, humidity lognormal"])],
    ),
    "vapour limited to the total pressure": Remedy(
        python(cube, "_limit", lambda _delta, span, _ceiling: ((), span)),
        [Shows("depth", (1e-3, 1.0), [LIMITED, "pressure 1 hPa"])],
    ),
    "the camera's position reduced in float64": Remedy(
        python(geometry, "cube_frame", single_position),
        [Shows("depth", (1e-4, 1.0), ["camera 1000 km from the origin"])],
    ),
}


@pytest.mark.parametrize("remedy", REMEDIES)
def test_cases_fail_for_want_of_their_remedy(remedy):
    """Each by the error that the remedy prevents, where ordinary scenes do without it."""
    REMEDIES[remedy].check()


def mistyped(*_):
    raise ValueError("a typing mistake")


@pytest.mark.parametrize(
    ("naive", "error", "words"),
    [
        (mistyped, ValueError, "a typing mistake"),
        (degrees(0), AssertionError, "broken, not naive"),
        (expansion._degrees, AssertionError, "passes without its remedy"),  # noqa: SLF001
    ],
)
def test_a_mutant_counts_only_if_it_fails_for_the_reason_named(naive, error, words):
    """Not if it is broken everywhere, nor if it does no harm."""
    failures = REMEDIES["polynomials of a degree that the air asks for"].failures
    with pytest.raises(error, match=words):
        Remedy(python(expansion, "_degrees", naive), failures).check()


# Ends of ranges that nothing special is done for: no form was found that fails here, and holds in
# ordinary scenes.
WITHOUT_REMEDY = {
    *(f"target of {kelvin} K" for kelvin in ("2.7", "3000", "1e+06")),
    *("sigma 0", "pressure 1100 hPa", "grid 16", "grid 256"),
    *("from a voxel's corner along the cube's diagonal", "field of view 170 deg"),
    *("image of 1 x 1", "image of 4096 x 1", "depth of fog of 5 g/m3"),
}


def test_every_other_case_relies_on_a_remedy():
    failures = [failure for remedy in REMEDIES.values() for failure in remedy.failures]
    assert {name for failure in failures for name in failure.cases} == set(CASES) - WITHOUT_REMEDY


def test_cases_without_a_remedy_are_not_deaf(monkeypatch):
    """They measure an absorption that is wrong by 1e-4, to a twentieth."""
    right = truth.absorption
    monkeypatch.setattr(truth, "absorption", lambda *of: right(*of) * (1 + 1e-4))
    for outcome in examine(bounded(CASES[name], SINGLE, "depth") for name in WITHOUT_REMEDY):
        assert outcome.error == pytest.approx(1e-4, rel=0.05), outcome.name
