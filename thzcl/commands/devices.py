"""`thzcl devices`: the devices that OpenCL sees."""

from __future__ import annotations

from thzcl.commands.options import HowText, TextFormat


def devices(how: HowText = TextFormat.text) -> None:
    """List the devices that OpenCL sees."""
    from dataclasses import asdict

    from thzcl.commands.tables import Column, Table, show, show_json
    from thzcl.device import choose
    from thzcl.errors import DeviceError

    found = choose.devices()
    if not found:
        raise DeviceError("OpenCL sees no device; run `thzcl doctor`")
    if how is TextFormat.json:
        show_json({"devices": [asdict(info) for info in found]})
        return
    columns = (
        *map(Column, ("device", "kind", "name", "platform", "driver")),
        Column("memory", "GiB", ".1f"),
    )
    rows = tuple(
        (i.number, i.kind, i.name, i.platform, i.driver, i.memory_bytes / 2**30) for i in found
    )
    show(Table("", columns, rows))
