"""A scene: camera, ground, targets and background, as the tables of a scenario give them.

Every key says its unit, most in their names.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field

from thzcl.scenario.atmosphere import Atmosphere
from thzcl.scenario.materials import Cover, Material, unknown
from thzcl.scenario.problems import Trouble
from thzcl.scenario.table import (
    Fraction,
    Kelvin,
    LensMillimetres,
    Positive,
    Table,
    Vector,
    key,
)

CLOSEST_M = 1e-6  # distance at which two points make no direction
PixelCount = Annotated[int, Field(ge=1, le=16384)]
Face = Literal["-x", "+x", "-y", "+y", "-z", "+z"]


class Camera(Table):
    """A pinhole camera."""

    position_m: Vector = key(help="camera's position [x, y, z]", unit="m")
    look_at_m: Vector = key(help="point that the image centre shows [x, y, z]", unit="m")
    up: Vector = key(
        (0.0, 0.0, 1.0),
        help="direction that is up in the image; +y stands in where it is the line of sight",
    )
    focal_length_mm: LensMillimetres = key(help="focal length", unit="mm")
    focal_plane_mm: tuple[LensMillimetres, LensMillimetres] = key(
        help="size of the focal plane [width, height]", unit="mm"
    )
    pixels: tuple[PixelCount, PixelCount] = key(help="number of pixels [width, height]")
    samples_per_pixel: int = key(
        1,
        ge=1,
        le=256,
        help="rays per pixel, on a regular grid within it, whose radiances are averaged",
    )
    polarization_deg: float | None = key(
        None,
        ge=-360,
        le=360,
        help="direction of the electric field that is seen, from the image's right towards up; "
        "unpolarised if absent",
        unit="deg",
    )

    def troubles(self) -> list[Trouble]:  # noqa: D102 (Table's)
        found = []
        if math.dist(self.position_m, self.look_at_m) < CLOSEST_M:
            found.append(
                Trouble(
                    ("look_at_m",), "the camera looks at itself; give a point away from position_m"
                )
            )
        if max(map(abs, self.up)) < CLOSEST_M:
            found.append(Trouble(("up",), "must not be zero; [0, 0, 1] is upright"))
        return found


class Ground(Table):
    """The plane z = 0."""

    at_most_one: ClassVar = (("reflectivity", "material"),)

    temperature_k: Kelvin | None = key(
        None, help="temperature, needed wherever emission is seen", unit="K"
    )
    reflectivity: Fraction = key(0.0, help="power reflectivity, 0 to 1")
    material: str | None = key(
        None, min_length=1, help="name of a material, in place of a reflectivity"
    )


class Bars(Table):
    """Upright stripes of equal width on a face of a box.

    The first, third, ... from the left have a temperature of their own.
    """

    face: Face = key(help="the face, by the direction of its outward normal in the box's own axes")
    count: int = key(ge=1, le=10000, help="number of stripes across the face")
    temperature_k: Kelvin = key(
        help="temperature of the first, third, ... stripe; the others have the target's", unit="K"
    )


def _as_list(value: Any) -> Any:
    """Returns a list of bars: one table may stand for a list of one."""
    return (value,) if isinstance(value, dict) else value


class Box(Table):
    """A rectangular box, turned about the vertical."""

    at_most_one: ClassVar = (("reflectivity", "material"),)

    kind: Literal["box"] = key(help='"box"')
    center_m: Vector = key(help="centre [x, y, z]", unit="m")
    size_m: tuple[Positive, Positive, Positive] = key(
        help="edges along the box's own x, y, z", unit="m"
    )
    yaw_deg: float = key(
        0.0, help="turn about the vertical, counter-clockwise seen from above", unit="deg"
    )
    temperature_k: Kelvin | None = key(
        None, help="temperature, needed wherever emission is seen", unit="K"
    )
    reflectivity: Fraction = key(0.0, help="power reflectivity, 0 to 1")
    material: str | None = key(
        None, min_length=1, help="name of a material, in place of a reflectivity"
    )
    cover: Cover | None = key(None, help="a thin layer over it, such as cloth or paint")
    bars: Annotated[
        tuple[Bars, ...], BeforeValidator(_as_list, json_schema_input_type=Bars | tuple[Bars, ...])
    ] = key((), help="stripes on a face; one table, or a list of them")

    def holds(self, point: Vector) -> bool:
        """Returns whether a point lies inside."""
        yaw = math.radians(self.yaw_deg)
        x, y, z = (p - c for p, c in zip(point, self.center_m, strict=True))
        own = (math.cos(yaw) * x + math.sin(yaw) * y, math.cos(yaw) * y - math.sin(yaw) * x, z)
        return all(abs(part) < size / 2 for part, size in zip(own, self.size_m, strict=True))

    def troubles(self) -> list[Trouble]:  # noqa: D102 (Table's)
        faces = [bars.face for bars in self.bars]
        twice = {face for face in faces if faces.count(face) > 1}
        return [
            Trouble(("bars",), f'face "{face}" has two sets of bars; give one')
            for face in sorted(twice)
        ]


class Billboard(Table):
    """An upright rectangle with a picture of temperature or reflectivity on it, on both sides."""

    at_most_one: ClassVar = (("reflectivity", "material"),)

    kind: Literal["billboard"] = key(help='"billboard"')
    center_m: Vector = key(help="centre [x, y, z]", unit="m")
    size_m: tuple[Positive, Positive] = key(help="width and height", unit="m")
    facing_deg: float = key(
        help="direction of its front, counter-clockwise from +x seen from above", unit="deg"
    )
    image: str = key(
        help="PNG or TIFF of 8 or 16 bit, or .npy in kelvin or reflectivity; "
        "from the scenario's folder"
    )
    quantity: Literal["temperature", "reflectivity"] = key(help="what the image shows")
    range: tuple[float, float] | None = key(
        None, help="the quantity's value at black and at white, for a picture"
    )
    mask: str | None = key(
        None, help="picture of the same size; where it is dark, one sees past the billboard"
    )
    interpolation: Literal["bilinear", "nearest"] = key(
        "bilinear", help="between the image's pixels"
    )
    temperature_k: Kelvin | None = key(
        None, help="temperature, where the image shows reflectivity", unit="K"
    )
    reflectivity: Fraction = key(0.0, help="power reflectivity, where the image shows temperature")
    material: str | None = key(
        None, min_length=1, help="name of a material, in place of a reflectivity"
    )
    cover: Cover | None = key(None, help="a thin layer over it, such as cloth or paint")

    def troubles(self) -> list[Trouble]:  # noqa: D102 (Table's)
        found = []
        if self.quantity == "temperature" and self.temperature_k is not None:
            found.append(Trouble(("temperature_k",), "is given by the image; remove it"))
        if self.quantity == "reflectivity" and self.reflectivity:
            found.append(Trouble(("reflectivity",), "is given by the image; remove it"))
        if self.quantity == "reflectivity" and self.material is not None:
            found.append(Trouble(("material",), "reflectivity is given by the image; remove it"))
        if self.range is not None:
            most = 1.0 if self.quantity == "reflectivity" else 1e19
            if not all(0 <= end <= most for end in self.range):
                unit = "" if most == 1.0 else " K"
                found.append(
                    Trouble(
                        ("range",), f"must lie between 0 and {most:g}{unit}, not {list(self.range)}"
                    )
                )
        return found


class MeshPart(Table):
    """A part of a mesh, which is a target of its own; what is not given is the mesh's."""

    at_most_one: ClassVar = (("reflectivity", "material"), ("temperature_k", "temperature"))

    temperature_k: Kelvin | None = key(None, help="temperature", unit="K")
    temperature: str | None = key(
        None, min_length=1, help="name of an attribute of the file's vertices or faces, in K"
    )
    shown: bool = key(True, help="whether it is there; false leaves it out of the mesh")
    reflectivity: Fraction | None = key(None, help="power reflectivity, 0 to 1")
    material: str | None = key(
        None, min_length=1, help="name of a material, in place of a reflectivity"
    )
    cover: Cover | None = key(None, help="a thin layer over it, such as cloth or paint")


class Mesh(Table):
    """Triangles from a file, as any program for solids writes them."""

    at_most_one: ClassVar = (("reflectivity", "material"), ("temperature_k", "temperature"))

    kind: Literal["mesh"] = key(help='"mesh"')
    file: str = key(
        min_length=1,
        help="OBJ, STL, PLY or GLB, or NPZ with vertices and faces; from the scenario's folder",
    )
    center_m: Vector = key(help="where the origin of the file stands [x, y, z]", unit="m")
    scale: Annotated[float, Field(gt=0, le=1e9)] = key(
        1.0, help="metres to a unit of the file; 0.001 for millimetres"
    )
    up: Literal["y", "z"] | None = key(
        None, help="axis of the file that points up; z if absent, but y for GLB"
    )
    yaw_deg: float = key(
        0.0, help="turn about the vertical, counter-clockwise seen from above", unit="deg"
    )
    pitch_deg: float = key(
        0.0, help="turn about the horizontal before that, by which +x rises", unit="deg"
    )
    temperature_k: Kelvin | None = key(
        None, help="temperature, needed wherever emission is seen", unit="K"
    )
    temperature: str | None = key(
        None,
        min_length=1,
        help="name of an attribute of the vertices or faces of a PLY or NPZ, in K",
    )
    reflectivity: Fraction = key(0.0, help="power reflectivity, 0 to 1")
    material: str | None = key(
        None, min_length=1, help="name of a material, in place of a reflectivity"
    )
    cover: Cover | None = key(None, help="a thin layer over it, such as cloth or paint")
    parts: dict[str, MeshPart] = key({}, help="parts of the file by name, each a target of its own")

    def made_of(self, part: str) -> MeshPart:
        """Returns a part with what the mesh gives to it; its reflectivity is not None."""
        own = self.parts.get(part, MeshPart())
        warm = own if own.temperature_k is not None or own.temperature is not None else self
        made = own if own.reflectivity is not None or own.material is not None else self
        return MeshPart.model_construct(
            temperature_k=warm.temperature_k,
            temperature=warm.temperature,
            reflectivity=made.reflectivity or 0.0,
            material=made.material,
            cover=own.cover or self.cover,
        )


class Background(Table):
    """What rays see that meet no surface, and what surfaces reflect."""

    temperature_k: Kelvin | None = key(
        None,
        help="temperature of what rays see that meet nothing; if absent, they see the sky where "
        "there is [sky], and else the air's",
        unit="K",
    )
    environment: Literal["air", "none", "sky"] | Kelvin = key(
        "air",
        help='what surfaces reflect: "air" (a black enclosure at air temperature), "none", '
        '"sky" (that of [sky], and the ground), or a temperature',
        unit="K",
    )
    max_range_m: float = key(
        1000.0, gt=0, le=1e6, help="length of a ray that meets no surface", unit="m"
    )


class Sky(Table):
    """The air above the scene, which rays see that meet nothing.

    Surfaces reflect it with [background] environment = "sky".
    """

    profile: Literal[
        "us-standard",
        "tropical",
        "midlatitude-summer",
        "midlatitude-winter",
        "subarctic-summer",
        "subarctic-winter",
        "file",
    ] = key(help='AFGL model atmosphere of 1986, or "file"')
    file: str | None = key(
        None,
        min_length=1,
        help="CSV of height_km or height_m above z = 0, pressure_hpa, temperature_k and one of "
        "relative_humidity_percent, absolute_humidity_g_m3, vapour_pressure_hpa, h2o_ppmv",
    )

    def troubles(self) -> list[Trouble]:  # noqa: D102 (Table's)
        if (self.profile == "file") == (self.file is not None):
            return []
        text = 'profile = "file" and file = "..." go together'
        return [self.trouble("profile", text)]


class Numerics(Table):
    """How the numbers are computed; every key has a sound default."""

    precision: Literal["float32", "float64"] | None = key(
        None, help="arithmetic on the device; float32 where the tolerance allows"
    )
    cutoff_depth: Positive | None = key(
        None, help="optical depth at which a ray ends; by default where the rest is worth 1e-7"
    )
    moments: int | None = key(
        None,
        ge=1,
        le=16,
        help="degree of the absorption polynomial; by default as accurate as the arithmetic",
    )
    ray_stride: int | None = key(
        None,
        ge=1,
        le=64,
        help="trace every so many rays both ways, and interpolate within each thing seen; "
        "1 is exact",
    )
    tolerance: float | None = key(
        None,
        ge=1e-9,
        le=0.1,
        help="bearable error, relative to the image's largest contrast; "
        "picks whatever is not given",
    )
    realizations: int = key(
        1,
        ge=1,
        le=1_000_000,
        help="independent realisations of the air and of the noise; the image is their mean, "
        "with variance, spread and percentiles",
    )
    noise_seed: int | None = key(
        None,
        ge=0,
        lt=2**63,
        help="seed of the sensor's noise; by default that of the air where the scene names it, "
        "else one is drawn and recorded",
    )
    bounces: Literal[0, 1] | None = key(
        None,
        help="1: what surfaces mirror is followed to the next surface, through mean air; 0: they "
        "mirror what stands around the scene; by default 1 where a material has things to mirror",
    )
    error_budget: bool = key(
        True, help="follow some rays again without any shortcut, to measure the errors made"
    )


class Output(Table):
    """What the result file holds beyond the images, and how the picture looks."""

    save_field: bool = key(False, help="store the humidity cube (and the temperature cube)")
    figure_columns: int | None = key(None, ge=1, le=100, help="panels to a row of the picture")
    color_map: Literal["gray", "viridis", "magma", "inferno", "plasma", "cividis"] = key(
        "gray", help="colours of the images in the picture, even to the eye"
    )
    limits: Literal["panel", "shared"] | tuple[float, float] = key(
        "shared",
        help="values at the ends of the picture's colours: the same in all panels of one quantity "
        "and frequency, each panel's own, or two values [low, high] in the image's unit",
    )
    format: Literal["png", "pdf", "svg"] = key("png", help="format of the picture")
    width_mm: Literal[88, 180] | None = key(
        None,
        help="width of the picture in print, one or two columns of a journal; none: for a screen",
        unit="mm",
    )
    difference: tuple[str, str] | None = key(
        None, help="two variants whose images' difference is shown and stored too"
    )
    model_spread: bool = key(
        False, help="show beside each image how far apart the models of [atmosphere] compare are"
    )

    def troubles(self) -> list[Trouble]:  # noqa: D102 (Table's)
        if isinstance(self.limits, str) or self.limits[0] < self.limits[1]:
            return []
        text = f"must ascend, as in [250, 310], not {list(self.limits)}"
        return [Trouble(("limits",), text)]


class SequenceTable(Table):
    """Frames of moving air: the cube is frozen, and the wind carries it along."""

    exactly_one = (("duration_s", "frames"),)

    rate_hz: Positive = key(help="frames a second", unit="Hz")
    duration_s: Positive | None = key(None, help="time that the frames span", unit="s")
    frames: int | None = key(None, ge=1, le=100_000, help="number of frames")

    @property
    def count(self) -> int:
        """Returns the number of frames."""
        return self.frames or int((self.duration_s or 0.0) * self.rate_hz + 1e-9)

    def troubles(self) -> list[Trouble]:  # noqa: D102 (Table's)
        if 1 <= self.count <= 100_000:
            return []
        text = f"makes {self.count} frames at {self.rate_hz:g} Hz; 1 to 100000 can be made"
        return [self.trouble("duration_s", text)]


class StudyTable(Table):
    """What `thzcl study` varies; other commands take no notice of it."""

    over: dict[str, Any] = key(
        {},
        help='keys and their values, a list or "start:stop:step", as in '
        '{ "targets.box.range_m" = "20:60:10" }; "a,b" = [[1, 2], [3, 4]] changes two together',
    )
    seeds: int | None = key(
        None, ge=1, le=1_000_000, help="airs, and noise, of each setting; none: the scene's own"
    )
    keep: Literal["numbers", "images"] = key(
        "numbers", help="whether a member's file holds its numbers alone, or its images too"
    )
    detect: tuple[str, ...] = key(
        (),
        help="targets whose d' and area under the ROC are told, over at least 10 seeds, each of "
        "which is then seen without the target too",
    )
    keep_pixels: bool = key(
        False, help="the focal length follows range_m, so that targets cover as many pixels"
    )


class SensorChoice(Table):
    """The sensor's kind; the other keys belong to that sensor."""

    model_config = Table.model_config | {"extra": "allow"}
    kind: str = key(help="name of the sensor, as `thzcl sensors` lists them")


class Scene(Table):
    """Everything that one image needs."""

    camera: Camera = key(help="the camera")
    atmosphere: Atmosphere = key(help="the air")
    sensor: SensorChoice = key(help="the sensor")
    ground: Ground | None = key(None, help="the plane z = 0; leave the table out for no ground")
    targets: dict[str, Annotated[Box | Billboard | Mesh, Field(discriminator="kind")]] = key(
        {}, help="targets by name"
    )
    materials: dict[str, Material] = key({}, help="what things are made of, by name")
    background: Background = key(Background(), help="what lies behind and around")
    sky: Sky | None = key(
        None, help="the air above; leave the table out for a black one of the air's temperature"
    )
    numerics: Numerics = key(Numerics(), help="how the numbers are computed")
    output: Output = key(
        Output(), help="what the result file holds beyond the images, and how the picture looks"
    )
    study: StudyTable | None = key(None, help="what `thzcl study` varies")
    sequence: SequenceTable | None = key(
        None, help="frames of moving air in place of one image; leave the table out for one"
    )

    def troubles(self) -> list[Trouble]:  # noqa: D102 (Table's)
        found = []
        if self.ground is not None and self.camera.position_m[2] <= 0:
            height = self.camera.position_m[2]
            text = f"the camera is at z = {height:g} m, not above the ground (z = 0)"
            remedy = "raise it or remove [ground]"
            found.append(Trouble(("camera", "position_m"), f"{text}; {remedy}"))
        if self.output.model_spread and not self.atmosphere.compare:
            text = "needs models to compare with: [atmosphere] compare"
            found.append(Trouble(("output", "model_spread"), text))
        if self.background.environment == "sky" and self.sky is None:
            text = 'needs a sky; add [sky] profile = "us-standard"'
            found.append(Trouble(("background", "environment"), f'"sky" {text}'))
        for path, name in self._made_of():
            wrong = unknown(name, self.materials)
            found += [] if wrong is None else [Trouble(path, wrong)]
        twice = [name for name in self.targets if self.flagged.count(name) > 1]
        text = "is the name of a mesh's part too; choose another name"
        found += [Trouble(("targets", name), f'"{name}" {text}') for name in twice]
        taken = [name for name in ("background", "ground") if name in self.targets]
        text = "names another part of the scene; choose another name"
        return found + [Trouble(("targets", name), f'"{name}" {text}') for name in taken]

    def _made_of(self) -> list[tuple[tuple[str, ...], str | None]]:
        """Returns the keys that name a material, each with the name."""
        found: list[tuple[tuple[str, ...], str | None]] = []
        if self.ground is not None:
            found.append((("ground", "material"), self.ground.material))
        for name, target in self.targets.items():
            found.append((("targets", name, "material"), target.material))
            if isinstance(target, Mesh):
                found += [
                    (("targets", name, "parts", part, "material"), one.material)
                    for part, one in target.parts.items()
                ]
        return found

    @property
    def flagged(self) -> list[str]:
        """Returns the names of all targets, each mesh followed by those of its parts."""
        found = []
        for name, target in self.targets.items():
            found.append(name)
            if isinstance(target, Mesh):
                found += [f"{name}.{part}" for part in target.parts]
        return found
