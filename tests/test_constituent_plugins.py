"""The door for other people's constituents: what is wrong with one is named."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys

import pytest
from packages import ODD, install, plugin, prepare
from scenes import BROAD, MOIST, scene, write

from thzcl import pipeline
from thzcl.air import composition, spectrum, spectrum_figure
from thzcl.air.composition import HOOK, gases, part
from thzcl.air.mean import Air
from thzcl.constituent import OpticalProperties, Span
from thzcl.errors import PluginError, PluginFailure, RangeError, ScenarioError
from thzcl.plugins.loader import Origin, load, origins
from thzcl.plugins.template import write_package

ANSWER = "return OpticalProperties(absorption=1e-3)"

# --- the door ------------------------------------------------------------------------------------


LOADING = {
    "raises": ("raise RuntimeError('no licence')", "RuntimeError: no licence"),
    "exits": ("import sys; sys.exit(0)", "SystemExit: 0"),
    "another version": (
        ODD.replace("= 1\n", "= 9\n"),
        "version 9 of the constituent contract",
    ),
    "no optics": (ODD.replace("def optics", "def optic"), "does not define optics()"),
    "no Params": (
        ODD.replace("class Params", "class Parms"),
        "its Params is not a subclass",
    ),
    "no Constituent": (
        ODD.replace("Odd(Constituent)", "Odd"),
        "not a subclass of thzcl.constituent.Constituent",
    ),
    "misspelt hook": (ODD.replace("_constituents()", "_constituent()"), "unknown hook"),
    "varies in words": (
        ODD.replace("contract", 'varies = "no"\n    contract'),
        "its varies is",
    ),
    "gas in words": (
        ODD.replace("contract", 'gas = "yes"\n    contract'),
        "its gas is 'yes'",
    ),
    "no span": (
        ODD.replace("contract", "valid = (1, 2)\n    contract"),
        "its valid is not a",
    ),
    "span of nothing": (
        ODD.replace("contract", 'valid = (Span("height_m", 0, 1),)\n    contract'),
        "no range of frequency_ghz",
    ),
    "warning of one end": (
        ODD.replace("contract", 'valid = (Span("frequency_ghz", 1, 2, warn=(1,)),)\n    contract'),
        "no range of frequency_ghz",
    ),
    "span upside down": (
        ODD.replace("contract", 'valid = (Span("frequency_ghz", 2, 1),)\n    contract'),
        "no range of frequency_ghz",
    ),
}


@pytest.mark.parametrize("case", LOADING)
def test_one_that_cannot_be_loaded_is_named(tmp_path, odd, case):
    body, expected = LOADING[case]
    name = odd(body)
    with pytest.raises(ScenarioError) as caught:
        prepare(tmp_path, name)
    assert expected in str(caught.value) and f"odd-airs-{name[4:]}" in str(caught.value)
    pipeline.prepare(write(tmp_path, scene()))  # breaks no other scene


@pytest.mark.parametrize("name", ["rain", "pressure_hpa", "compare"])
def test_names_that_thzcl_keeps_are_refused(tmp_path, odd, name):
    odd(ODD, name)
    *_, owner = [one for one in origins(HOOK) if one.name == name]
    with pytest.raises(PluginError, match="keeps for itself"):
        load(HOOK, owner)
    with pytest.raises(PluginError, match=r"keeps for itself|small letters"):
        write_package(HOOK, name, tmp_path)


ANSWERS = {
    "raises": ("raise ZeroDivisionError('of course')", "ZeroDivisionError: of course"),
    "exits": ("import sys; sys.exit(0)", "SystemExit: 0"),
    "interrupts": ("raise KeyboardInterrupt", "KeyboardInterrupt"),
    "a bare number": ("return 1e-3", "returned float instead of OpticalProperties"),
    "shape": (
        "return OpticalProperties(np.ones(7))",
        "absorption of shape (7,); the state has (1,)",
    ),
    "more than asked": (
        "return OpticalProperties(np.ones((2, 1)))",
        "absorption of shape (2, 1); the state has (1,)",
    ),
    "NaN": ("return OpticalProperties(np.nan * frequency_hz)", "absorption with values that are"),
    "infinite": ("return OpticalProperties(np.inf)", "absorption with values that are not finite"),
    "negative": ("return OpticalProperties(-2.0)", "negative absorption: -2 1/m"),
    "negative scattering": ("return OpticalProperties(1.0, -2.0)", "negative scattering: -2 1/m"),
    "text": ("return OpticalProperties('thick')", "absorption that is not made of numbers"),
    "complex": ("return OpticalProperties(1j)", "absorption that is not made of numbers"),
    "ragged": ("return OpticalProperties([[1.0], [1.0, 2.0]])", "not made of numbers"),
    "masked": (
        "return OpticalProperties(np.ma.masked_all(frequency_hz.shape))",
        "not made of numbers",
    ),
    "writes into its inputs": ("frequency_hz[...] = 0", "read-only"),
}


@pytest.mark.parametrize("case", ANSWERS)
def test_one_that_answers_nonsense_is_named(tmp_path, odd, case):
    body, expected = ANSWERS[case]
    name = odd(ODD.replace(ANSWER, body))
    with pytest.raises(PluginFailure) as caught:
        prepare(tmp_path, name)
    assert caught.value.exit_code == 4
    assert expected in str(caught.value) and f"odd-airs-{name[4:]}" in str(caught.value)


PARTS = {
    "sum": ("{'a': 0.5, 'b': 0.4}", "parts that do not sum up to the absorption"),
    "names": ("[1.0]", "parts that are not arrays by name"),
    "shape": ("{'a': np.ones(7)}", "part 'a' of shape (7,)"),
    "NaN": ("{'a': np.nan}", "parts that do not sum up"),
}


@pytest.mark.parametrize("case", PARTS)
def test_parts_that_are_none_are_named_where_they_are_asked_for(odd, case):
    given, expected = PARTS[case]
    body = ODD.replace("absorption=1e-3", f"absorption=1.0, parts={given}")
    state = spectrum.states([650.0], [290.0], 1013.25, "vapour_pressure_hpa", 8.0)
    with pytest.raises(PluginFailure) as caught:
        spectrum.records(state, part(odd(body)))
    assert expected in str(caught.value) and "odd-airs" in str(caught.value)


def test_an_absorption_without_parts_has_no_dry_one(odd, tmp_path):
    """Nor does its picture."""
    state = spectrum.states([600.0, 650.0], [290.0], 1013.25, "vapour_pressure_hpa", 8.0)
    rows = spectrum.records(state, part(odd(ODD)))
    assert [row["dry_db_km"] for row in rows] == [None, None]
    assert [row["total_per_m"] for row in rows] == [1e-3, 1e-3]
    spectrum_figure.draw(rows, tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 0


EARLY = {
    "constructor": ("def __init__(self, params): raise OSError('no licence')", "OSError"),
    "troubles": (
        "class Params(Parameters):\n        def troubles(self): return int('x')",
        "troubles() raised ValueError",
    ),
    "unhashable": ("class Params(Parameters):\n        a: dict[str, float] = {}", "unhashable"),
    "valid": ("@property\n    def valid(self): return [1]", "its valid is not a tuple"),
    "lines": ("def lines(self, *_): return [3.0, 2.0], 1.0", "not a list of ascending numbers"),
    "width": ("def lines(self, *_): return [2.0], 0.0", "as width, not a number above 0"),
    "no pair": ("def lines(self, *_): return [2.0]", "did not return positions and a width"),
}


@pytest.mark.parametrize("case", EARLY)
def test_what_fails_before_its_optics_is_named_too(tmp_path, odd, case):
    body, expected = EARLY[case]
    name = odd(ODD.replace("    def optics", f"    {body}\n    def optics"))
    with pytest.raises(PluginFailure) as caught:
        prepare(tmp_path, name)
    assert expected in str(caught.value) and f"odd-airs-{name[4:]}" in str(caught.value)


NO_GAS = {
    "scattering": "1e-3, scattering=1e-3",
    "back-scatter": "1e-3, backscatter=1e-3",
    "temperature": "1e-3, temperature_k=250.0",
}


@pytest.mark.parametrize("case", NO_GAS)
def test_a_gas_that_scatters_or_is_warmer_than_the_air_is_refused(odd, case):
    name = odd(
        ODD.replace("absorption=1e-3", NO_GAS[case]).replace(
            "contract", "gas = True\n    contract", 1
        )
    )
    with pytest.raises(PluginError, match="a gas neither scatters nor") as caught:
        composition.optical_properties(part(name), 650e9, 290.0, 1013.25, 8.0)
    assert caught.value.exit_code == 2 and "choose another model" in str(caught.value)


def test_scattering_without_moments_is_refused(tmp_path, odd):
    name = odd(ODD.replace("absorption=1e-3", "1e-3, scattering=1e-3"))
    with pytest.raises(PluginFailure, match="without moments of its phase function"):
        prepare(tmp_path, name)


def test_the_airs_own_temperature_is_no_other(tmp_path, odd):
    name = odd(ODD.replace("absorption=1e-3", "1e-3, temperature_k=temperature_k"))
    assert prepare(tmp_path, name).variants


def test_a_failure_within_a_bands_sum_names_the_constituent(tmp_path, odd):
    """A sensor that asks for absorption is not blamed for it."""
    name = odd(ODD.replace(ANSWER, "raise ZeroDivisionError"))
    with pytest.raises(PluginFailure) as caught:
        prepare(tmp_path, name, sensor=BROAD)
    assert str(caught.value).startswith(f'constituent "{name}"')


# --- commands ------------------------------------------------------------------------------------


def test_built_ins_are_found_by_their_own_text():
    """A constituent is one file: no list is kept anywhere else."""
    named = dict.fromkeys(HOOK.built_ins.values())
    for module in named:
        kinds = importlib.import_module(module).register_constituents()
        assert {kind.name for kind in kinds} == {
            name for name, home in HOOK.built_ins.items() if home == module
        }
    expected = {"mpm93", "mpm93-corrected", "p676-13", "r24", "none", "table"}
    assert expected | {"rain", "fog", "snow"} <= set(HOOK.built_ins)
    assert expected <= set(gases())


@pytest.mark.parametrize("name", list(HOOK.built_ins))
def test_each_built_in_has_a_manual_page(name):
    page = load(HOOK, Origin(name, HOOK.built_ins[name], "thzcl")).__doc__
    assert "Validity" in page or "validity" in page
    assert "eference" in page or name == "none"


def test_they_are_listed_explained_and_part_of_the_schema(thzcl_command, dust):
    import jsonschema

    listed = thzcl_command("constituents", env=dust).stdout
    assert "grey-dust" in listed and "mpm93-corrected" in listed and "thzcl" in listed
    page = thzcl_command("constituents", "dust", env=dust).stdout
    assert "Dust that absorbs alike" in page and "[atmosphere.dust]" in page and "1/km" in page
    table = thzcl_command("constituents", "table").stdout
    assert '[atmosphere] model = "table"' in table and "file" in table
    assert thzcl_command("constituents", "dusk", env=dust).returncode == 2
    schema = json.loads(thzcl_command("schema", env=dust).stdout)
    valid = jsonschema.Draft202012Validator(schema).is_valid
    for air, fine in (
        ({"dust": {"per_km": 1.0}}, True),
        ({"dust": {"per_mile": 1.0}}, False),
        ({"dusk": {}}, False),
        ({"model": "table", "model_file": "a.nc"}, True),
        ({"model": "mpm39"}, False),
    ):
        assert valid(scene(atmosphere=MOIST | air)) == fine, air


def test_a_broken_one_is_told_by_list_and_doctor(thzcl_command, tmp_path):
    text = "raise RuntimeError('no licence')"
    environment = plugin(tmp_path, text, "odd", "odd_air", "odd-airs", "thzcl.constituents")
    assert "BROKEN" in thzcl_command("constituents", env=environment).stdout
    assert thzcl_command("schema", env=environment).returncode == 0
    doctor = thzcl_command("doctor", env=environment)
    assert doctor.returncode == 3 and "pip uninstall odd-airs" in doctor.stdout


def test_exit_codes_of_broken_constituents(thzcl_command, tmp_path):
    """4 for what it does, as answer no number, or scatter without a phase function."""
    for number, (given, code) in enumerate((("np.nan", 4), ("1e-3, 1e-3", 4), ("1e-3", 0))):
        body = ODD.replace("absorption=1e-3", given)
        folder = tmp_path / str(number)
        folder.mkdir()
        environment = plugin(folder, body, "odd", "odd_air", "odd-airs", "thzcl.constituents")
        file = write(folder, scene(atmosphere__odd={}))
        done = thzcl_command("check", file, env=environment)
        assert done.returncode == code, done.stderr
        assert code == 0 or "odd-airs" in done.stderr
        assert "Traceback" not in done.stderr


def test_a_new_constituent_installs_and_runs_as_it_is(thzcl_command, tmp_path):
    assert thzcl_command("new-constituent", "pollen").returncode == 0
    environment = install(tmp_path / "pollen", tmp_path / "site")
    done = thzcl_command("run", "pollen/scene.toml", "--no-figure", env=environment)
    assert done.returncode == 0, done.stderr
    tests = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "pollen"]
    done = subprocess.run(
        tests,
        cwd=tmp_path,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    for name, expected in (
        ("pollen", "exists already"),
        ("mpm93", "is a constituent of thzcl"),
        ("rain", "keeps for itself"),
        ("My Dust", "small letters"),
    ):
        done = thzcl_command("new-constituent", name)
        assert done.returncode == 2 and expected in done.stderr


@pytest.mark.parametrize("name", ["span", "constituent", "parameters", "my-constituent"])
def test_a_new_constituents_name_hides_nothing_that_it_needs(tmp_path, monkeypatch, name):
    folder = write_package(HOOK, name, tmp_path)
    (file,) = folder.glob("thzcl_*.py")
    monkeypatch.syspath_prepend(folder)
    (made,) = importlib.import_module(file.stem).register_constituents()
    answer = made(made.Params(per_km=2.0)).optics(650e9, 290.0, 1000.0, 8.0)
    assert made.name == name and isinstance(made.valid[0], Span)
    assert isinstance(answer, OpticalProperties) and answer.absorption == pytest.approx(2e-3)


def test_a_part_refuses_frequencies_of_zero():
    with pytest.raises(RangeError, match="must be above 0"):
        Air((part("none"),), 290.0, 1000.0, 8.0).absorption(0.0)
