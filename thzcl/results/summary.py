"""A summary of a result, as `thzcl run --format json` prints it and notebooks show it."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterator, Mapping
from html import escape
from typing import Any

import numpy as np

from thzcl import metrics
from thzcl.results.contents import Array, Contents, ModelResult, VariantResult, seen_at
from thzcl.sensor import Echoes, Image, Radiances

TWO_WAYS = "out and back"  # the path of an active sensor's light, whose depth is told of both ways


def summary(result: Contents) -> dict[str, Any]:
    """Returns what `thzcl run --format json` prints, the names of files not included."""
    return {
        "scenario": result.scenario,
        "device": result.device,
        "seed": result.seed,
        "noise_seed": result.noise_seed,
        "seconds": result.seconds,
        "left_out": list(result.left_out),
        "warnings": list(result.warnings),
        "error_budget": result.error_budget,
        "voxel_segments": result.voxel_segments,
        "variants": [of_variant(variant, result) for variant in result.variants],
        "air": _named(result.airs[0]) if result.airs else None,
        "airs": list(result.airs),
        "sky": list(result.skies),
    }


def _named(air: dict[str, Any]) -> dict[str, Any]:
    """Returns how the air of a variant fluctuates, without the variant's name."""
    return {name: value for name, value in air.items() if name != "variant"}


def of_variant(variant: VariantResult, result: Contents) -> dict[str, Any]:
    """Returns the summary of one variant: its targets, facts about its image, and its models."""
    facts, names = _facts(variant), result.targets
    valued = {name: {"value": value, "unit": unit} for name, (value, unit) in facts.items()}
    several = len(variant.sight.frequency_hz) > 1
    of_targets = _of_targets(variant, names, several)
    path = TWO_WAYS if isinstance(variant.sight, Echoes) else "one way"
    found = {"name": variant.name, "path": path, **of_targets, "facts": valued}
    if not variant.compared:
        return found
    main, *others = variant.by_model(result.models[0])
    tables = {main.name: of_targets} | {
        one.name: _of_targets(one, names, several) for one in others
    }
    frequencies = {one.name: (one.sight.frequency_hz / 1e9).tolist() for one in (main, *others)}
    models = {name: {**table, "frequency_ghz": frequencies[name]} for name, table in tables.items()}
    return found | {"models": models}


def _of_targets(
    one: VariantResult | ModelResult, names: tuple[str, ...], several: bool
) -> dict[str, Any]:
    """Returns the targets by name: means, and of several frequencies also each by itself."""
    found: dict[str, Any] = {"targets": target_table(one, names)}
    if several:
        found["frequencies"] = [
            {
                "frequency_ghz": float(hz) / 1e9,
                "targets": target_table(seen_at(one, number), names),
            }
            for number, hz in enumerate(one.sight.frequency_hz)
        ]
    return found


def by_frequency(told: Mapping[str, Any]) -> list[tuple[float | None, Mapping[str, Any]]]:
    """Returns the targets of a variant, or of a model, by the frequency in GHz.

    `told` is what a summary says of the variant or model. The frequency is None of the only one.
    """
    every = [(one["frequency_ghz"], one["targets"]) for one in told.get("frequencies", ())]
    return every or [(None, told["targets"])]


def by_model(
    variant: Mapping[str, Any],
) -> Iterator[tuple[float | None, str, str, Mapping[str, Any]]]:
    """Yields the frequency in GHz, the target, the model and what it tells, of a variant's summary.

    Nothing is yielded if no models are compared. The frequency is None of the only one.
    """
    models = {name: dict(by_frequency(told)) for name, told in variant.get("models", {}).items()}
    for ghz, targets in by_frequency(variant) if models else ():
        for target in targets:
            for model, told in models.items():
                if ghz in told:  # else it is not valid there
                    yield ghz, target, model, told[ghz][target]


def two_ways(told: Mapping[str, Any]) -> str | None:
    """Returns that depths and transmissions are those of the way out and back, if so of a variant.

    `told` is what a summary says of the variant.
    """
    return TWO_WAYS if told.get("path") == TWO_WAYS else None


def _image(variant: VariantResult | ModelResult) -> Image | None:
    """Returns the image, which there is not of models to compare with, nor if the sensor failed."""
    return variant.image if isinstance(variant, VariantResult) else None


def _facts(variant: VariantResult | ModelResult) -> Mapping[str, tuple[float, str]]:
    """Returns the facts about a variant's image; none if there is no image."""
    image = _image(variant)
    return image.facts if image else {}


def _signal_to_noise(
    variant: VariantResult | ModelResult, flag: int, contrast_k: float | None, passed: float
) -> dict[str, float | None]:
    """Returns a target's ratio of signal to noise, and its NETD behind the air, K.

    That of an active sensor is the mean of its layer `snr`. That of a passive one is the target's
    contrast to the air over the noise. Both are None if the sensor has no noise, and of a model to
    compare with.
    """
    image, noise_k = _image(variant), _facts(variant).get("NEDT at the sensor")
    if image is not None and "snr" in image.layers:
        ratio = np.asarray(image.layers["snr"].values)[variant.sight.target == flag]
        return {"snr": float(ratio.mean()), "netd_k": None}
    if noise_k is None or contrast_k is None:
        return {"snr": None, "netd_k": None}
    kelvin = noise_k[0]
    return {"snr": abs(contrast_k) / kelvin, "netd_k": kelvin / max(passed, 1e-300)}


def _visibility(variant: VariantResult | ModelResult, flag: int) -> Mapping[str, float | None]:
    """Returns `cnr` and `contrast_db` of a target: None of a model to compare with."""
    image = _image(variant)
    if image is None or not isinstance(variant, VariantResult):
        return {"cnr": None, "contrast_db": None}
    return metrics.of_target(image, variant.sight, flag, variant.cell)


def target_table(
    variant: VariantResult | ModelResult, names: tuple[str, ...]
) -> dict[str, dict[str, float | None]]:
    """Returns, by the target's name, its number of pixels and means over them and all frequencies.

    The means are those of the contrast to the air in K, with its standard deviation, of the optical
    depth and of the transmission. With an active sensor there is no contrast, and depth and
    transmission are those of the way out and back. A target that no pixel shows is left out. Where
    the sensor has noise, `snr` and `netd_k` tell what it means for the target, else they are None.
    `cnr` is the target's contrast to its surroundings in the image over what varies there, for one
    resolution cell; `contrast_db` that of an active sensor's mean power.
    """
    sight = variant.sight
    flags = sight.target.ravel().astype(np.intp)
    pixels = np.bincount(flags, minlength=len(names))

    def means(plane: Array) -> Array:
        sums = np.bincount(flags, weights=plane.ravel(), minlength=len(names))
        return np.asarray(sums / np.maximum(pixels, 1))

    depth = means(sight.optical_depth.mean(axis=0))
    passed = means(np.exp(-sight.optical_depth).mean(axis=0))
    contrast = spread = None
    if isinstance(sight, Radiances):
        above = sight.brightness_temperature_contrast.mean(axis=0).ravel()
        contrast = means(above)
        spread = np.sqrt(means((above - contrast[flags]) ** 2))
    return {
        name: {
            "pixels": int(pixels[flag]),
            "mean_contrast_k": None if contrast is None else float(contrast[flag]),
            "std_k": None if spread is None else float(spread[flag]),
            "optical_depth": float(depth[flag]),
            "transmission": float(passed[flag]),
            **_signal_to_noise(
                variant,
                flag,
                None if contrast is None else float(contrast[flag]),
                float(passed[flag]),
            ),
            **_visibility(variant, flag),
        }
        for flag, name in enumerate(names)
        if pixels[flag]
    }


def seeds_in_words(seed: int, noise_seed: int | None) -> str:
    """Returns the seeds of a run in words; noise is told of where it has a seed of its own."""
    own = noise_seed is not None and noise_seed != seed
    return f"seed {seed}, noise seed {noise_seed}" if own else f"seed {seed}"


def html(result: Contents, picture: bytes | None) -> str:
    """Returns a picture in PNG and a short table of the targets, for notebooks.

    Notebooks that show HTML show no other form beside it.
    """
    head = ("variant", "frequency", "target", "pixels", "contrast to air", "transmission", "path")
    told = [of_variant(variant, result) for variant in result.variants]
    rows = [
        (
            variant["name"],
            "" if ghz is None else f"{ghz:g} GHz",
            target,
            str(values["pixels"]),
            _kelvins(values["mean_contrast_k"]),
            f"{values['transmission']:.3g}",
            two_ways(variant) or "",
        )
        for variant in told
        for ghz, targets in by_frequency(variant)
        for target, values in targets.items()
    ]
    shown = [n for n in range(len(head)) if any(row[n] for row in rows)]
    top, *below = ([row[n] for n in shown] for row in (head, *rows))
    body = "".join(_row("td", row) for row in below)
    seeds = seeds_in_words(result.seed, result.noise_seed)
    drawn = b64encode(picture or b"").decode("ascii")
    image = f'<img alt="{escape(result.scenario)}" src="data:image/png;base64,{drawn}">'
    image = image if picture else ""
    return (
        f"<h4>{escape(result.scenario)}</h4>{image}<p>{escape(result.device)}, {seeds}</p>"
        f"<table>{_row('th', top)}{body}</table>"
    )


def _row(tag: str, cells: list[str]) -> str:
    """Returns a row of an HTML table, with cells of the element `tag`."""
    return f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in cells)}</tr>"


def _kelvins(value: float | None) -> str:
    """Returns a difference in kelvins with its sign and unit, or nothing for None."""
    return "" if value is None else f"{value:+.4g} K"
