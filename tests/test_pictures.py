"""Pictures of results for screen and print: sizes of letters, places, colours and words."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.image import imread
from matplotlib.text import Text
from scenes import ACTIVE, run, scene

from thzcl import Result, pipeline
from thzcl.errors import ScenarioError, UsageError
from thzcl.results import figure, layout
from thzcl.results.conditions import angles, conditions
from thzcl.results.contents import VariantResult
from thzcl.results.layout import bars, fold, lay_out, text_width, ticks
from thzcl.scenario.scene import Output
from thzcl.scenario.source import shipped
from thzcl.sensor import Image
from thzcl.studies.convergence import figure as convergence

POINTS_PER_MM = 72 / 25.4
PAGE_MM = 247  # height of the text on a page of A4
SMALLEST, LARGEST = 6.0, 9.0  # points


def stand_in(name):
    """A shipped scene's result as far as its picture needs it, with noise for images.

    Its names, angles, conditions and layout are the scene's; nothing is traced. Each variant of a
    noisy passive sensor has another NEDT, so that every title has it to say.
    """
    plan = pipeline.prepare(name, {"camera.pixels": [6, 4], "numerics.error_budget": False})
    rng = np.random.default_rng(1)
    output, made = plan.variants[0].scene.output, []
    for number, planned in enumerate(plan.variants):
        words = {"quantity": "brightness temperature", "unit": "K", "caption": "without noise"}
        if planned.scene.sensor.kind == "active":
            words = {"quantity": "power over the floor", "unit": "dB"}
            words["caption"] = "speckle of 4 looks, noise figure 15 dB, echo of the air"
        elif planned.needs.noise:
            words |= {"caption": "", "facts": {"NEDT at the sensor": (0.1 + number, "K")}}
        made.append(Image(250 + 20 * rng.random((4, 6)), **words))
    sights = [
        SimpleNamespace(
            nodes_hz=np.atleast_1d(planned.needs.frequency_hz),
            target=np.full((4, 6), 2),
            path_length=np.full((4, 6), planned.longest_m),
        )
        for planned in plan.variants
    ]
    return SimpleNamespace(
        scenario=name,
        variants=tuple(
            VariantResult(planned.name, None, image)
            for planned, image in zip(plan.variants, made, strict=True)
        ),
        conditions=tuple(
            conditions(one.scene.atmosphere.air, one.scene.atmosphere.model, sight, image)
            for one, sight, image in zip(plan.variants, sights, made, strict=True)
        ),
        pixel_angles_mrad=tuple(angles(one.scene.camera) for one in plan.variants),
        figure_columns=output.figure_columns,
        limits=output.limits,
        color_map=output.color_map,
        difference=output.difference,
        image_difference=lambda: made[1].values - made[0].values if output.difference else None,
        spread_shown=False,
    )


def words_of(drawn):
    """All texts of a figure that show something."""
    return [
        text
        for text in drawn.findobj(Text)
        if text.get_visible() and text.get_text().strip() and text.axes is not None
    ] + [text for text in drawn.texts if text.get_text().strip()]


def assert_fits(drawn):
    """No text is cut, small, or lies on another or on a panel."""
    drawn.draw_without_rendering()
    shown = {id(text): text for text in words_of(drawn)}.values()
    boxes = [(text.get_text(), text.get_window_extent()) for text in shown]
    for text in shown:
        assert SMALLEST <= text.get_fontsize() <= LARGEST, text.get_text()
    for said, box in boxes:
        assert box.x0 >= 0 and box.x1 <= drawn.bbox.width, said
        assert box.y0 >= 0 and box.y1 <= drawn.bbox.height, said
    for (one, box), (other, its) in itertools.combinations(boxes, 2):
        assert not box.overlaps(its), f"{one!r} lies on {other!r}"
    panels = [axes.patch.get_window_extent() for axes in drawn.axes]
    for said, box in boxes:
        assert not any(box.overlaps(panel) for panel in panels), f"{said!r} lies on a panel"
    for one, other in itertools.combinations(panels, 2):
        assert not one.overlaps(other)


@pytest.mark.parametrize("name", sorted(shipped()))
def test_every_shipped_scene_fits_a_journal(name):
    """At one and two columns: the width is exact, all words are legible and apart."""
    result = stand_in(name)
    for width_mm in figure.WIDTHS_MM:
        drawn = figure.picture(result, width_mm)
        assert drawn.get_figwidth() == pytest.approx(width_mm / 25.4)
        assert drawn.get_figheight() <= PAGE_MM / 25.4
        assert_fits(drawn)
        names = {text.get_text() for text in drawn.texts}
        assert {"x angle / mrad", "y angle / mrad"} <= names
        assert "air by mpm93" in " ".join(drawn.get_suptitle().split())
    assert_fits(figure.picture(result))


@pytest.mark.parametrize(
    ("groups", "columns", "expected"),
    [
        ("aaaaaa", 3, [("aaaaaa", (0, 1), 2)]),
        ("aaabbb", 3, [("aaa", (0, 0), 2), ("bbb", (1, 1), 2)]),
        ("aab", 3, [("aa", (0, 0), 1), ("b", (0, 0), 2)]),
        ("abab", 2, [(one, (row, row), n) for row in (0, 1) for n, one in enumerate("ab")]),
        ("aaaab", 2, [("aaaa", (0, 1), 1), ("b", (2, 2), 0)]),
        ("aaa", 2, [("aaa", (0, 1), 1)]),
        ("abbb", 2, [("a", (0, 0), 0), ("b", (0, 0), 1), ("bb", (1, 1), 1)]),
    ],
)
def test_panels_that_share_colours_share_a_bar(groups, columns, expected):
    """Neighbours in a row do, and whole rows that follow each other."""
    found = [
        ("".join(groups[n] for n in bar.panels), bar.rows, bar.column)
        for bar in bars(groups, columns)
    ]
    assert found == expected


@pytest.mark.parametrize(
    ("low", "high", "most"),
    [(246.3, 260.2, 6), (0, 50, 3), (-33.2, 33.2, 4), (0.0701, 0.0799, 5), (-4.8, 4.8, 7)],
)
def test_ticks_are_round_and_few(low, high, most):
    found = ticks(low, high, most)
    assert 1 <= len(found.values) <= most and not found.scale
    assert all(low <= value <= high for value in found.values)
    read = [float(label.replace("\N{MINUS SIGN}", "-")) for label in found.labels]
    assert read == pytest.approx(found.values, abs=1e-12)


@pytest.mark.parametrize(
    ("low", "high"), [(1.2e-9, 8.7e-9), (300.0000012, 300.0000093), (2.1e8, 9.7e8), (-3e-7, 2e-7)]
)
def test_ticks_of_odd_sizes_say_by_what_they_are_scaled(low, high):
    found = ticks(low, high, 6)
    assert len(set(found.labels)) == len(found.labels) >= 2
    assert max(map(len, found.labels)) <= 4
    plain = found.scale.replace("\N{MINUS SIGN}", "-").removeprefix("(times 1e").rstrip(")")
    cut = max(plain.find("+"), plain.find("-", 1))
    power, base = (plain, "0") if cut < 0 else (plain[:cut], plain[cut:])
    read = [
        float(base) + float(label.replace("\N{MINUS SIGN}", "-")) * 10.0 ** int(power)
        for label in found.labels
    ]
    assert read == pytest.approx(found.values, abs=1e-3 * (high - low))


def test_folded_text_is_narrow_and_whole():
    said = ["650 GHz,", "1013.25 hPa,", "a name of many words that is long,", "x" * 60]
    for width in (30.0, 60.0, 200.0):
        lines = fold(said, width, 8.0).split("\n")
        assert all(text_width(line, 8.0) <= width for line in lines)
        assert "".join("".join(lines).split()) == "".join("".join(said).split())
    assert fold(said[:2], 200.0, 8.0) == "650 GHz, 1013.25 hPa"[:8] + " 1013.25 hPa,"


def test_narrow_panels_make_shorter_rows():
    """Sixteen panels, four to a row, would be 12 mm wide on one column of a journal."""
    words = [
        layout.Words([["name"]], (-9.0, 9.0, -9.0, 9.0), (0.0, 1.0), ["unit"], n // 4)
        for n in range(16)
    ]
    rows = {
        width: len({panel.image.bottom for panel in lay_out(["x"], words, 4, 1, width).panels})
        for width in (88, 180, None)
    }
    assert rows == {88: 8, 180: 4, None: 4}


def variants(*frequencies):
    return [
        {"name": f"{n}", "set": {"sensor.frequency_ghz": ghz, "targets.box.temperature_k": kelvin}}
        for n, (ghz, kelvin) in enumerate(zip(frequencies, (280.0, 380.0, 330.0), strict=False))
    ]


def test_panels_of_one_frequency_share_colours_by_default(tmp_path):
    result = run(tmp_path, scene(variants=variants(650.0, 650.0, 350.0)))
    drawn = figure.picture(result)
    one, two, three = (axes.images[0].get_clim() for axes in drawn.axes if axes.images)
    assert one == two != three
    both = np.concatenate([v.image.values.ravel() for v in result.variants[:2]])
    assert one == pytest.approx(tuple(np.percentile(both, figure.STRETCH_PERCENT)))


def test_several_frequencies_have_a_panel_each_and_variants_of_one_share_colours(tmp_path):
    made = run(tmp_path, scene(variants=variants(*[[340, 650]] * 3)))
    made.save(tmp_path / "made.nc")
    for result in (made, Result.load(tmp_path / "made.nc")):
        drawn = figure.picture(result)
        panels = [ax for ax in drawn.axes if ax.get_title()]
        assert [ax.get_title().splitlines()[-1] for ax in panels] == 3 * ["340 GHz"] + 3 * [
            "650 GHz"
        ]
        for number, ax in enumerate(panels):
            seen = result.variants[number % 3].sight.brightness_temperature[number // 3]
            assert np.asarray(ax.images[0].get_array()) == pytest.approx(seen)
        assert len({ax.images[0].get_clim() for ax in panels[:3]}) == 1
        assert panels[0].images[0].get_clim() != panels[3].images[0].get_clim()
        assert len(drawn.axes) == 6 + 2
        assert_fits(drawn)
    bar = next(ax for ax in drawn.axes if not ax.get_title())
    assert bar.get_position().height == pytest.approx(panels[0].get_position().height)


def test_many_frequencies_have_one_panel_that_says_it_is_a_mean(tmp_path):
    result = run(tmp_path, scene(sensor__frequency_ghz=[*range(300, 370, 10)]))
    (panel, _), image = figure.picture(result).axes, result.variants[0].image
    assert np.asarray(panel.images[0].get_array()) == pytest.approx(image.values)
    assert "mean of 7 frequencies" in [text.get_text() for text in words_of(figure.picture(result))]


def test_the_scene_says_how_its_picture_looks(tmp_path):
    """Colours, format and width; what Python asks for goes before."""
    output = {"color_map": "viridis", "format": "svg", "width_mm": 88}
    result = run(tmp_path, scene(output=output))
    (axes,) = (axes for axes in figure.picture(result).axes if axes.images)
    assert axes.images[0].get_cmap().name == "viridis"
    assert result.picture_format == "svg"
    widths = {None: 88, 180: 180}
    for asked, due in widths.items():
        pixels = imread(result.figure(tmp_path / "a.png", width_mm=asked))
        assert pixels.shape[1] == pytest.approx(due / 25.4 * figure.PRINT_DOTS, abs=1)
    with pytest.raises(UsageError, match="88 or 180 mm"):
        result.figure(tmp_path / "a.png", width_mm=100)
    with pytest.raises(ScenarioError, match=r"width_mm"):
        run(tmp_path, scene(output={"width_mm": 100}))


@pytest.mark.parametrize(
    ("sensor", "expected"),
    [
        ({"kind": "passive-spectral", "frequency_ghz": 650.0}, "air by mpm93, without noise"),
        (ACTIVE, "air by mpm93, without speckle and receiver noise"),
    ],
)
def test_the_heading_says_model_and_noise(tmp_path, sensor, expected):
    assert heading(run(tmp_path, scene(sensor=sensor))).endswith(expected)


def heading(result):
    return " ".join(figure.picture(result).get_suptitle().split())


def test_the_heading_says_what_falls_unless_a_name_does(tmp_path):
    falls = {"atmosphere__rain": {"rate_mm_h": 8.0}, "atmosphere__fog": {"visibility_m": 1200.0}}
    words = heading(run(tmp_path, scene(**falls)))
    assert "fog 1200 m, rain 8 mm/h, air by mpm93" in words
    assert "rain" not in heading(run(tmp_path, scene(atmosphere__rain={"rate_mm_h": 0.0})))
    both = [{"name": name, "set": {"atmosphere.rain.rate_mm_h": rate}}
            for name, rate in (("(a) 2 mm/h", 2.0), ("(b) more", 5.0))]  # fmt: skip
    drawn = figure.picture(run(tmp_path, scene(atmosphere__rain={"rate_mm_h": 1.0}, variants=both)))
    titles = [ax.get_title() for ax in drawn.axes if ax.get_title()]
    assert titles == ["(a) 2 mm/h", "(b) more\nrain 5 mm/h"]


def test_an_image_of_a_detector_says_its_nedt_and_of_how_many_airs_it_is_the_mean(tmp_path):
    sensor = {
        "kind": "radiometer",
        "frequency_ghz": 650.0,
        "if_center_ghz": 6.0,
        "if_bandwidth_ghz": 4.0,
        "receiver_temperature_k": 3000.0,
        "integration_time_s": 0.01,
    }
    result = run(tmp_path, scene(sensor=sensor, numerics={"realizations": 2}))
    heading = " ".join(figure.picture(result).get_suptitle().split())
    kelvin = result.variants[0].image.facts["NEDT at the sensor"][0]
    assert f"NEDT {kelvin:.3g} K, mean of 2 realisations" in heading


def lightness(name):
    """CIELAB's L* along a colour map (CIE 15:2004, sRGB of IEC 61966-2-1)."""
    rgb = colormaps[name](np.linspace(0, 1, 65))[:, :3]
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    y = linear @ [0.2126, 0.7152, 0.0722]
    return np.where(y > 216 / 24389, 116 * np.cbrt(y) - 16, y * 24389 / 27)


MAPS = Output.model_fields["color_map"].annotation.__args__


@pytest.mark.parametrize("name", [*MAPS, figure.SPREAD])
def test_colour_maps_are_even_to_the_eye(name):
    """Lightness always grows, and by nearly the same in each eighth of the map."""
    found = np.diff(lightness(name)[::8])
    assert (np.diff(lightness(name)) > 0).all()
    assert found.max() < 1.7 * found.min()


def test_colours_of_differences_are_lightest_at_zero():
    found = lightness(figure.DIVERGING)
    rises = np.diff(found)
    assert (rises[:31] > 0).all() and (rises[33:] < 0).all()
    assert abs(found[0] - found[-1]) < 10


def test_labels_of_convergence_stand_apart_and_lines_join_fronts_only():
    """Though a dozen settings have nearly the same time and error."""
    rng = np.random.default_rng(3)
    points = [
        {"knob": f"knob {knob}", "setting": f"setting {knob}-{n}", "default": n == 0}
        | {"seconds": 0.02 * (1 + 0.05 * rng.random()), "error_rms": 4e-7, "on_front": n != 1}
        | {"error_max": 1e-6}
        for knob in range(6)
        for n in range(3)
    ]
    drawn = convergence.draw(
        {"points": points, "scenario": "$a$", "device": "a device " * 20, "repeat": 5}
    )
    drawn.draw_without_rendering()
    (axes,) = drawn.axes
    boxes = [Text.get_window_extent(text) for text in axes.texts]
    assert len(boxes) == 12
    assert not any(one.overlaps(other) for one, other in itertools.combinations(boxes, 2))
    ends = axes.get_window_extent()
    assert all(ends.contains(*box.min) and ends.contains(*box.max) for box in boxes)
    assert min(text.get_fontsize() for text in words_of(drawn)) >= SMALLEST
    lines = [line for line in axes.lines if line.get_linestyle() == "-" and len(line.get_xdata())]
    assert [len(line.get_xdata()) for line in lines] == [2] * 6
    box = axes.title.get_window_extent()
    assert box.x0 >= 0 and box.x1 <= drawn.bbox.width
    convergence.draw({"points": [], "scenario": "none", "device": "", "repeat": 1})
