"""A result as rows of numbers: one for each variant, frequency, model and target."""

from __future__ import annotations

from typing import Any

from thzcl.results.contents import Contents, ModelResult, VariantResult, seen_at
from thzcl.results.summary import target_table

KEYS = ("variant", "frequency_ghz", "model", "target")
METRICS = (
    *("pixels", "mean_contrast_k", "std_k", "optical_depth", "transmission"),
    *("snr", "netd_k", "cnr", "contrast_db"),
)


def rows(result: Contents, model: str) -> list[dict[str, Any]]:
    """Returns a row for each variant, frequency, model and target that pixels show.

    `model` is the name of the images' own. A row holds KEYS, then METRICS at that frequency; what
    an image tells (`snr`, `netd_k`, `cnr`, `contrast_db`) is that of the frequency where the sensor
    sees one by one, else the same at all of its frequencies, and None for models that are compared.
    """
    found = []
    for variant in result.variants:
        for one in variant.by_model(model):
            whole: VariantResult | ModelResult = variant if one.sight is variant.sight else one
            for number, hz in enumerate(one.sight.frequency_hz):
                for target, values in target_table(seen_at(whole, number), result.targets).items():
                    named = (variant.name, float(hz) / 1e9, one.name, target)
                    found.append(dict(zip(KEYS, named, strict=True)) | values)
    return found
