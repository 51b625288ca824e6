"""The commands as a user meets them: output, exit codes, messages, and what is left behind."""

from __future__ import annotations

import csv
import io
import json
import os
import resource
import shlex
import signal
import subprocess
import sys
import time

import pytest
import typer
from conftest import ROOT
from scenes import scene, write

from thzcl.commands import app
from thzcl.commands.app import COMMANDS
from thzcl.commands.options import changes
from thzcl.pipeline import prepare
from thzcl.scenario.source import shipped

STAGES = [
    "surrogate",
    "humidity-field",
    "temperature-field",
    "trace",
    "path-emission",
    "ground",
    "boxes",
    "billboards",
    "meshes",
    "sky",
    "scattering",
    "outgoing-path",
    "optics",
    "noise",
    "figure",
]


@pytest.fixture
def help_of(monkeypatch, capsys):
    """What `--help` prints of a command, or of all, on a terminal of so many columns."""

    def call(*command, columns=80):
        monkeypatch.setenv("COLUMNS", str(columns))
        assert app.call([*command, "--help"]) == 0
        return capsys.readouterr().out

    return call


def test_help_names_every_command_with_all_that_it_says_of_itself(help_of):
    told = " ".join(help_of().split())
    for command in COMMANDS:
        says = " ".join(help_of(command).partition("\n\n")[2].partition("\n\n")[0].split())
        assert f" {command} {says}" in told


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_an_example_swallows_nothing_and_fits(help_of, command):
    narrow = help_of(command)
    assert narrow.endswith(f"\n  Example:\n    {COMMANDS[command]}\n")
    assert f" {command}" in COMMANDS[command]
    wide = help_of(command, columns=200)
    assert narrow.split() == wide.split()
    for parameter in typer.main.get_command(app.app).get_command(None, command).params:
        names = parameter.opts if parameter.param_type_name == "option" else [parameter.metavar]
        assert {*names} <= {word.strip(",") for word in narrow.split()}
    for columns in (80, 100, 200):
        assert max(map(len, help_of(command, columns=columns).splitlines())) <= columns


@pytest.mark.parametrize("command", COMMANDS)
def test_the_example_in_a_help_is_a_line_that_the_command_takes(command):
    """Its options are known and well formed, and its scene is one that comes along."""
    name, *arguments = shlex.split(COMMANDS[command].partition(" >")[0])[1:]
    assert name == command
    made = typer.main.get_command(app.app).get_command(None, command)
    given = made.make_context(command, arguments).params
    assert given.get("scenario") in (None, *shipped())
    if "settings" in given:
        prepare(given["scenario"], changes(given["settings"]), given["variant"] or ())


def test_help_takes_brackets_for_no_markup(help_of):
    assert "as [sensor] kind" in help_of("new-sensor")


def test_help_without_a_command_and_advice_for_a_mistyped_one(thzcl_command):
    bare = thzcl_command()
    assert (bare.returncode, bare.stdout) == (2, "")
    assert "Usage: thzcl" in bare.stderr
    assert "Did you mean 'run'" in thzcl_command("rum").stderr


def test_run_writes_what_it_says(thzcl_json, tmp_path):
    found = thzcl_json("run", "quick")
    assert found["files"] == ["quick.nc", "quick.png"]
    assert {path.name for path in tmp_path.iterdir()} == {"quick.nc", "quick.png"}
    assert (tmp_path / "quick.png").read_bytes().startswith(b"\x89PNG")
    assert set(found) >= {
        "scenario",
        "files",
        "device",
        "seed",
        "seconds",
        "left_out",
        "warnings",
        "error_budget",
        "variants",
    }
    assert {item["stage"] for item in found["left_out"]} < set(STAGES)
    assert set(found["variants"][0]["targets"]["box"]) == {
        "pixels", "mean_contrast_k", "std_k", "optical_depth", "transmission",
        "snr", "netd_k", "cnr", "contrast_db",
    }  # fmt: skip
    assert all(set(part) >= {"rms", "max", "unit"} for part in found["error_budget"].values())


def test_run_in_text_has_units_and_no_progress_in_a_pipe(thzcl_command):
    done = thzcl_command("run", "quick", "--no-figure", "-o", "out")
    assert done.returncode == 0
    assert done.stderr == ""
    assert "contrast to air / K" in done.stdout
    assert "wrote out/quick.nc" in done.stdout
    assert "\x1b" not in done.stdout
    assert thzcl_command("run", "quick", "--no-figure", "--quiet").stdout == ""


def test_set_and_variant_reach_the_run(thzcl_json):
    found = thzcl_json(
        "run", "figure6", "--variant", "(b) 268 K", "--set", "camera.pixels=[8,8]", "--no-figure"
    )
    assert [variant["name"] for variant in found["variants"]] == ["(b) 268 K"]
    assert sum(target["pixels"] for target in found["variants"][0]["targets"].values()) == 64


def test_a_result_runs_again(thzcl_command, tmp_path):
    import h5netcdf

    assert (
        thzcl_command("run", "quick", "--no-figure", "--set", "camera.pixels=[20,10]").returncode
        == 0
    )
    assert thzcl_command("run", "quick.nc", "--no-figure", "-o", "again").returncode == 0
    with (
        h5netcdf.File(tmp_path / "quick.nc") as one,
        h5netcdf.File(tmp_path / "again" / "quick.nc") as other,
    ):
        assert one["image"].shape == (1, 10, 20)
        assert (one["image"][...] == other["image"][...]).all()
        assert one.attrs["scenario_toml"] == other.attrs["scenario_toml"]


def test_plan_tells_what_is_needed_and_computes_nothing(thzcl_json, tmp_path):
    found = thzcl_json(
        "plan", "figure6", env={"OCL_ICD_VENDORS": str(tmp_path / "nowhere")}
    )  # no device is in reach
    assert [stage["name"] for stage in found["stages"]] == STAGES
    assert all(stage["reason"] for stage in found["stages"])
    needed = {stage["name"] for stage in found["stages"] if stage["needed"]}
    assert needed == {"surrogate", "humidity-field", "trace", "ground", "boxes", "figure"}
    assert found["frequencies_ghz"] == [650.0]
    assert set(found) >= {"memory_bytes", "voxel_segments", "moments", "surrogate_error"}
    uniform = {
        stage["name"] for stage in thzcl_json("plan", "uniform")["stages"] if stage["needed"]
    }
    assert uniform == {"surrogate", "ground", "boxes", "figure"}


SMALL = (
    "--repeat",
    "1",
    "--set",
    "camera.pixels=[32,32]",
    "--set",
    "atmosphere.fluctuations.grid=32",
)


def test_bench_measures_every_stage(thzcl_json, tmp_path):
    found = thzcl_json("bench", *SMALL)
    assert found["scenario"] == "slide"
    assert found["repeat"] == 1
    assert found["machine"]["processor"] and found["machine"]["cores"] >= 1
    assert found["versions"]["thzcl"]
    stages = {stage["name"]: stage for stage in found["stages"]}
    units = {
        "field": "voxels",
        "surfaces": "rays",
        "trace": "segments",
        "shading": "pixel_frequencies",
        "image": "images",
    }
    for name, unit in units.items():
        rate = stages[name][f"{unit}_per_second"]
        assert rate == pytest.approx(stages[name][unit] / stages[name]["seconds"])
    assert (stages["field"]["voxels"], stages["surfaces"]["rays"], stages["image"]["images"]) == (
        32**3,
        32**2,
        6,
    )
    assert stages["shading"]["pixel_frequencies"] == 6 * 32**2
    roofline = {row["name"]: row for row in found["roofline"]}
    assert set(roofline) == {"memory-bandwidth", "gather-coherent", "gather-random"}
    share = (
        stages["trace"]["segments_per_second"] / roofline["gather-coherent"]["voxels_per_second"]
    )
    assert stages["trace"]["share"] == pytest.approx(share)
    assert list(tmp_path.iterdir()) == []


def test_bench_leaves_out_what_a_scene_does_not_have(thzcl_json):
    """Uniform air: no field, no trace, and no cube to gather from."""
    found = thzcl_json("bench", "uniform", "--repeat", "1", "--set", "camera.pixels=[32,32]")
    assert not {"field", "trace"} & {stage["name"] for stage in found["stages"]}
    assert [row["name"] for row in found["roofline"]] == ["memory-bandwidth"]


def test_bench_where_emission_is_carried_along_the_path(thzcl_json):
    """No shading of its own, and humidity and temperature read from every voxel."""
    warm = ("--set", "atmosphere.fluctuations.temperature_sigma_k=0.5", "--variant", "284 K")
    found = thzcl_json("bench", *SMALL, *warm)
    stages = {stage["name"]: stage for stage in found["stages"]}
    gather = next(row for row in found["roofline"] if row["name"] == "gather-coherent")
    share = 2 * stages["trace"]["segments_per_second"] / gather["voxels_per_second"]
    assert stages["trace"]["share"] == pytest.approx(share)
    assert set(stages["shading"]) == {"name", "seconds"}


@pytest.mark.slow
def test_an_interrupted_bench_exits_130(tmp_path):
    command = [sys.executable, "-m", "thzcl", "bench", "--repeat", "10000"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        command, env=environment, cwd=tmp_path, stderr=subprocess.PIPE, text=True
    ) as process:
        time.sleep(4)  # until it is at work; it would go on for an hour
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "Traceback" not in errors


def test_bench_as_table_and_csv(thzcl_command):
    done = thzcl_command("bench", *SMALL, "--variant", "284 K")
    assert (done.returncode, done.stderr) == (0, "")
    assert (
        "segments/s" in done.stdout
        and "time / ms" in done.stdout
        and "% of gather-coherent" in done.stdout
    )
    rows = list(
        csv.DictReader(io.StringIO(thzcl_command("bench", *SMALL, "--format", "csv").stdout))
    )
    assert {row["unit"] for row in rows if row["name"] in ("trace", "field")} == {
        "segments/s",
        "voxels/s",
    }


def test_check(thzcl_command, tmp_path):
    assert "sound, 6 images" in thzcl_command("check", "figure6").stdout
    done = thzcl_command(
        "check", write(tmp_path, scene(camera__pixels=[0, 0], ground__temperature_k=-1.0))
    )
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 3
    assert "Traceback" not in done.stderr


def test_absorption_in_every_form(thzcl_command, thzcl_json, tmp_path):
    arguments = (
        "--frequency-ghz",
        "600:700:50",
        "--temperature-k",
        "280,290",
        "--relative-humidity-percent",
        "50",
    )
    records = thzcl_json("absorption", *arguments)["records"]
    assert len(records) == 6
    assert records[0]["total_db_km"] == pytest.approx(
        records[0]["dry_db_km"] + records[0]["vapour_db_km"]
    )
    assert {r["frequency_ghz"] for r in records} == {600, 650, 700}
    rows = list(
        csv.DictReader(
            io.StringIO(thzcl_command("absorption", *arguments, "--format", "csv").stdout)
        )
    )
    assert [float(row["total_per_m"]) for row in rows] == [r["total_per_m"] for r in records]
    done = thzcl_command("absorption", *arguments, "--figure", "a.png")
    assert "total_db_km" in done.stdout
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    thzcl_command("absorption", *arguments, "--figure", "a.pdf")
    assert (tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")
    dry = thzcl_json("absorption", "--frequency-ghz", "600")["records"][0]
    assert (dry["temperature_k"], dry["pressure_hpa"], dry["vapour_pressure_hpa"]) == (
        288.15,
        1013.25,
        0,
    )
    assert "stated to 1000 GHz" in thzcl_command("absorption", "--frequency-ghz", "1500").stderr


WRONG = {
    "no such scene": (("run", "figur6"), "did you mean figure6"),
    "--set without value": (("run", "quick", "--set", "camera.pixels"), "write table.key=value"),
    "--set of a list whose quotes the shell took": (
        ("plan", "quick", "--set", "atmosphere.compare=[r24]"),
        "a shell takes double quotes away",
    ),
    "--set in other letters": (("plan", "quick", "--set", "camera.\udce9=1"), "is not UTF-8"),
    "--variant of none": (
        ("plan", "quick", "--variant", "a"),
        "no such variant (the scene has none; leave it out)",
    ),
    "--set of nothing known": (
        ("plan", "quick", "--set", "camera.pixel=[1,1]"),
        "did you mean pixels",
    ),
    "frequency out of range": (("absorption", "--frequency-ghz", "2000"), "up to 1780 GHz"),
    "picture of another kind": (
        ("absorption", "--frequency-ghz", "600", "--figure", "a.jpg"),
        "written as .png, .pdf or .svg",
    ),
    "frequency no number": (("absorption", "--frequency-ghz", "x"), "not a number"),
    "two humidities": (
        (
            "absorption",
            "--frequency-ghz",
            "600",
            "--relative-humidity-percent",
            "1",
            "--vapour-pressure-hpa",
            "1",
        ),
        "only one humidity",
    ),
    "no run to bench": (("bench", "--repeat", "0"), "--repeat"),
    "too humid": (
        ("absorption", "--frequency-ghz", "600", "--vapour-pressure-hpa", "2000"),
        "vapour pressure",
    ),
    "degrees Celsius": (
        ("absorption", "--frequency-ghz", "600", "--temperature-k", "20"),
        "--temperature-k: must be at least 100 K, not 20.0; 20 degrees Celsius are 293.15 K",
    ),
    "one temperature of many": (
        ("absorption", "--frequency-ghz", "600", "--temperature-k", "280,500"),
        "--temperature-k: must be at most 400 K, not 500.0",
    ),
    "two limits": (
        ("absorption", "--frequency-ghz", "6", "--temperature-k", "1e9", "--pressure-hpa", "inf"),
        "--pressure-hpa: must be a finite number, not inf",
    ),
    "frequencies without end": (
        ("absorption", "--frequency-ghz", "1:1e300:1"),
        '--frequency-ghz: "1:1e300:1" holds more than 1,000,000 numbers',
    ),
    "more rows than are computed": (
        ("absorption", "--frequency-ghz", "1:1000:.01", "--temperature-k", "200:300:1"),
        "more than 1,000,000 rows",
    ),
    "a vapour pressure that is none": (
        ("absorption", "--frequency-ghz", "600", "--vapour-pressure-hpa", "nan"),
        "must lie between 0 and the total of 1013.25 hPa, not nan",
    ),
    "unknown model": (
        ("absorption", "--frequency-ghz", "600", "--model", "itu"),
        'no constituent "itu" is installed',
    ),
    "no such sensor": (("sensors", "camera"), "no sensor"),
    "no such command": (("rum",), "No such command"),
    "no such option": (("run", "quick", "--fast"), "No such option"),
    "file exists": (("new", "taken.toml"), "exists already"),
    "no such folder": (("new", "nowhere/x.toml"), "No such file"),
    "device": (("run", "quick", "--device", "99"), "there is no device 99"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_input_is_explained_and_exits_2(thzcl_command, tmp_path, case):
    (tmp_path / "taken.toml").touch()
    arguments, expected = WRONG[case]
    done = thzcl_command(*arguments)
    assert done.returncode == (3 if case == "device" else 2)
    assert expected in done.stderr.replace("\n", " ")
    assert "Traceback" not in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["taken.toml"]


def test_a_scene_too_large_is_refused_before_anything_is_allocated(thzcl_command):
    big = ("--set", "camera.pixels=[16384,16384]", "--set", "camera.samples_per_pixel=16")
    done = thzcl_command("run", "quick", *big)
    assert done.returncode == 2
    assert "GiB" in done.stderr
    assert "lower grid, pixels" in done.stderr


def test_an_unwritable_folder_is_named_before_the_work_is_done(thzcl_command, tmp_path):
    (tmp_path / "file").touch()
    done = thzcl_command("run", "quick", "-o", "file")
    assert done.returncode == 2
    assert "file" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_full_disk_leaves_nothing_half_written(thzcl_command, tmp_path):
    large = ("run", "quick", "--set", "camera.pixels=[512,512]", "-o")
    thzcl_command(*large, "warm", "--no-figure")  # so that caches need not be written

    def small_files_only():  # large enough for what is tried where kernels are built
        resource.setrlimit(resource.RLIMIT_FSIZE, (1_500_000, 1_500_000))

    done = thzcl_command(*large, "out", preexec_fn=small_files_only)
    assert done.returncode == 2
    assert done.stderr.startswith("out/quick.nc: File too large; raise the limit")
    assert len(done.stderr.splitlines()) == 1
    assert list((tmp_path / "out").iterdir()) == []


def test_listings(thzcl_command, thzcl_json):
    assert "figure6" in thzcl_command("scenarios").stdout
    assert "passive-spectral" in thzcl_command("sensors").stdout
    manual = thzcl_command("sensors", "passive-spectral").stdout
    assert "frequency_ghz" in manual and "GHz" in manual
    assert "O'Brien" in manual
    assert json.loads(thzcl_command("schema").stdout)["title"] == "thzcl scenario"
    assert thzcl_json("devices")["devices"][0]["name"]
    healthy = thzcl_command("doctor")
    assert healthy.returncode == 0
    assert "AMISS" not in healthy.stdout


def test_new_writes_a_scene_that_runs(thzcl_command):
    assert thzcl_command("new", "mine.toml").returncode == 0
    assert thzcl_command("run", "mine.toml", "--no-figure", "--quiet").returncode == 0
