"""The door to plugins: whatever goes wrong behind it is one error; a signal stays a signal."""

from __future__ import annotations

import signal
import threading
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pytest

from thzcl.errors import PluginError, PluginFailure, ScenarioError
from thzcl.plugins import guard
from thzcl.plugins.guard import Breach
from thzcl.scenario import answers, sensors
from thzcl.sensor import Image, Layer, Needs, Optics, Parameters, Sensor, View

SHAPE = (2, 3)
PLANE = np.arange(6.0).reshape(SHAPE)


class UnspeakableError(Exception):
    """It cannot even be put into words."""

    def __str__(self):
        raise RuntimeError


def raising(error):
    def function(*_):
        raise error

    return function


def test_what_a_plugin_returns_comes_through():
    assert guard.call("it", max, 1, 3) == 3


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (ZeroDivisionError("of course"), "it: ZeroDivisionError: of course"),
        (SystemExit(0), "it: SystemExit: 0"),
        (KeyboardInterrupt(), "it: KeyboardInterrupt"),
        (GeneratorExit(), "it: GeneratorExit"),
        (Breach("returned nonsense"), "it: returned nonsense"),
        (UnspeakableError(), "it: UnspeakableError"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_whatever_is_raised_becomes_one_error(error, text):
    with pytest.raises(PluginFailure) as caught:
        guard.call("it", raising(error))
    assert str(caught.value) == text
    with pytest.raises(PluginError):
        guard.call("it", raising(error), error=PluginError)


def test_what_is_let_through_comes_through_as_it_is():
    with pytest.raises(ValueError, match="gain"):
        guard.call("it", raising(ValueError("gain")), let=(ValueError,))


def interrupted(then):
    """Sends this process an interrupt, and goes on with whatever is raised."""

    def function():
        try:
            signal.raise_signal(signal.SIGINT)
        except BaseException as error:  # noqa: BLE001 (what a plugin may do)
            return then(error)

    return function


def swallow(_):
    return 3


def disguise(error):
    raise ValueError("of mine") from error


@pytest.mark.parametrize("then", [swallow, disguise])
def test_a_signal_interrupts_whatever_a_plugin_makes_of_it(then):
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        guard.call("it", interrupted(then), let=(ValueError,))
    with pytest.raises(KeyboardInterrupt):
        guard.call("outer", guard.call, "inner", interrupted(then))
    assert signal.getsignal(signal.SIGINT) is before


def test_an_interrupt_of_the_plugins_own_is_its_failure_even_in_a_thread():
    found = []

    def work():
        try:
            guard.call("it", raising(KeyboardInterrupt()))
        except PluginFailure as error:
            found.append(str(error))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == ["it: KeyboardInterrupt"]


# What a sensor records.


def image(**changes):
    asked = {"values": PLANE, "unit": "K", "quantity": "kelvin"} | changes
    return answers.image(Image(**asked), SHAPE, np.dtype("float32"), {"radiance"})


IMAGES = {
    "shape": ({"values": PLANE.T}, "returned image of shape (3, 2); the image has (2, 3)"),
    "complex": ({"values": PLANE * 1j}, "returned image whose values are not numbers"),
    "objects": ({"values": PLANE.astype(object)}, "returned image whose values are not numbers"),
    "nan": ({"values": PLANE + np.nan}, "returned image with values that are not finite"),
    "beyond": ({"values": PLANE * 1e298}, "values that are not finite as float32"),
    "masked": ({"values": np.ma.masked_less(PLANE, 1)}, "returned image with masked values"),
    "unit": ({"unit": 3}, "the image's unit is int instead of text"),
    "nul": ({"quantity": "a\0"}, r"the image's quantity is 'a\x00', which a file cannot hold"),
    "surrogate": ({"unit": "\udce9"}, "which a file cannot hold"),
    "layers": ({"layers": [1]}, "returned Image instead of an Image, and of Layers"),
    "layer": ({"layers": {"a": PLANE}}, "returned ndarray instead of a Layer as 'a'"),
    "layer's values": ({"layers": {"a": Layer(PLANE + np.inf, "K", "x")}}, "returned layer 'a'"),
    "layer's unit": ({"layers": {"a": Layer(PLANE, None, "x")}}, "the unit of layer 'a' is NoneTy"),
    "fact": ({"facts": {"a": 3}}, "a fact 'a' that is not a value and a unit"),
    "nan fact": ({"facts": {"a": (np.float32("nan"), "K")}}, "a fact 'a' whose value is not a fin"),
    "word": ({"facts": {"a": ("3", "K")}}, "a fact 'a' whose value is not a finite number"),
    "plane as fact": ({"facts": {"a": (PLANE, "K")}}, "a fact 'a' whose value is not a finite num"),
    "fact's unit": ({"facts": {"a": (1.0, None)}}, "the unit of fact 'a' is NoneType"),
    "fact's name": ({"facts": {3: (1.0, "K")}}, "a fact's name is int instead of text"),
}


@pytest.mark.parametrize("case", IMAGES)
def test_an_image_that_the_file_cannot_hold_is_refused(case):
    changes, expected = IMAGES[case]
    with pytest.raises(Breach) as caught:
        image(**changes)
    assert expected in str(caught.value)


@pytest.mark.parametrize("name", ["", "a/b", "radiance", " a", "a ", "a\n", "-a", "a" * 256, 3])
def test_a_layer_that_cannot_be_a_variable_of_its_own_is_refused(name):
    with pytest.raises(Breach):
        image(layers={name: Layer(PLANE, "K", "x")})


def test_an_image_has_the_types_that_are_kept_and_arrays_of_its_own():
    facts = {"a": (np.float32(0.5), "K"), "b": (np.int16(3), "1"), "c": (True, "1")}
    layers = {
        "_1": Layer(PLANE.astype("float16"), "K", "x"),
        "é": Layer(PLANE.astype(">i4"), "1", "x"),
        "a b": Layer(PLANE > 2, "1", "x"),
    }
    made = image(layers=layers, facts=facts)
    assert made.values.dtype == np.float64 and not np.shares_memory(made.values, PLANE)
    kinds = [layer.values.dtype for layer in made.layers.values()]
    assert kinds == [np.float64, np.dtype("=i4"), np.int8]
    assert [layer.values.tolist() for layer in made.layers.values()][2] == (PLANE > 2).tolist()
    assert made.facts == {"a": (0.5, "K"), "b": (3.0, "1"), "c": (1.0, "1")}
    assert all(type(value) is float for value, _ in made.facts.values())


# What a sensor asks for.

NEEDS = {
    "nothing": ({"frequency_hz": []}, "not a list of ascending numbers in Hz"),
    "descending": ({"frequency_hz": [2.0, 1.0]}, "not a list of ascending numbers in Hz"),
    "zero": ({"frequency_hz": [0.0, 1.0]}, "not a list of ascending numbers in Hz"),
    "a number": ({"frequency_hz": 650e9}, "not a list of ascending numbers in Hz"),
    "infinite": ({"frequency_hz": [1.0, np.inf]}, "a list of frequencies with values that are not"),
    "words": ({"frequency_hz": ["a"]}, "a list of frequencies that is not made of numbers"),
    "weights' length": ({"weights": [1.0]}, "weights of another length than its frequencies"),
    "weights' shape": ({"weights": np.ones((1, 1, 2))}, "weights of another length"),
    "no band": ({"weights": np.ones((0, 2))}, "weights whose sum over a band is not above 0"),
    "zero weights": ({"weights": [[1.0, 1.0], [0.0, 0.0]]}, "whose sum over a band is not above 0"),
    "opposite weights": ({"weights": [[1.0, -1.0]]}, "whose sum over a band is not above 0"),
    "negative weights": ({"weights": [[-1.0, -1.0]]}, "whose sum over a band is not above 0"),
    "nan weights": ({"weights": [[1.0, np.nan]]}, "weights with values that are not finite"),
    "tiny weights": ({"weights": [[0.5, 5e-324]]}, None),
    "transmitter": ({"transmitter_m": (0.0, 1.0)}, "a transmitter of shape (2,) instead of (3,)"),
    "cut-off": ({"cutoff_depth": float("nan")}, "not above 0"),
    "times": ({"times_s": np.zeros((1, 3, 3))}, "of shape (1, 3, 3) instead of (samples, 2, 3)"),
    "no times": ({"times_s": np.zeros((0, 2, 3))}, "times of shape (0, 2, 3)"),
    "common time": ({"times_s": np.zeros((4, 1, 1))}, None),
    "optics": ({"optics": {"aperture_m": 1.0}}, "optics that are not thzcl.sensor.Optics"),
    "finer": ({"finer": ([1.0], [[1.0, 2.0]])}, "weights of another length"),
    "finer alone": ({"finer": [1.0]}, "a finer sum that is not frequencies and weights"),
    "errors": ({"errors": {"a": (float("inf"), "K")}}, "an error 'a' that is not a finite size"),
    "gain": ({"gain": "lambda"}, "the gain 'lambda'"),
}


@pytest.mark.parametrize("case", NEEDS)
def test_needs_that_make_no_sense_are_refused(case):
    changes, expected = NEEDS[case]
    asked = Needs(**{"frequency_hz": [1.0, 2.0]} | changes)
    if expected is None:
        answers.needs(asked, (3, 2))
        return
    with pytest.raises(Breach) as caught:
        answers.needs(asked, (3, 2))
    assert expected in str(caught.value)


def test_needs_become_arrays_that_nobody_can_change():
    rows, optics = np.ones(2), Optics(aperture_m=0.1)
    asked = Needs(
        frequency_hz=[1, 2], weights=rows, transmitter_m=np.arange(3), noise=np.True_, optics=optics
    )
    needs = answers.needs(asked, (3, 2))
    rows[:] = 7
    assert needs.frequency_hz.tolist() == [1.0, 2.0] and needs.weights.tolist() == [[1.0, 1.0]]
    assert needs.transmitter_m == (0.0, 1.0, 2.0) and needs.noise is True
    assert needs.optics is optics and needs.times_s is None
    for array in (needs.frequency_hz, needs.weights):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


# The calls into a sensor.


class Stranger(Sensor):
    """A sensor that does what the test says."""

    name = "active"  # of thzcl, so that it is known
    contract = 1

    class Params(Parameters):
        """No parameters."""

    def needs(self, view):
        """Does it before anything is computed."""
        return self.params(view)

    def observe(self, sight, rng):
        """Does it afterwards."""
        return self.params(sight)


@dataclass(frozen=True)
class Sight:
    """As much of what a sensor sees as is needed here."""

    target: np.ndarray
    optical_depth: np.ndarray

    @cached_property
    def slow(self):
        """Takes long to compute."""
        made = self.optical_depth + 1
        made.flags.writeable = False
        return made

    @cached_property
    def open(self):
        """May be written into."""
        return self.optical_depth + 1


def sight():
    return Sight(np.zeros(SHAPE, np.int32), np.full((1, *SHAPE), 0.5))


def observe(body, seen):
    taken = sensors.observe(Stranger(body), seen, np.random.default_rng(0), np.dtype("f4"), ())
    return taken.values


def test_a_sensor_cannot_write_into_what_it_sees():
    seen = sight()

    def spoil(given):
        given.optical_depth[...] = np.nan

    with pytest.raises(PluginFailure, match=r'sensor "active" of thzcl: ValueError: .*read-only'):
        observe(spoil, seen)
    assert (seen.optical_depth == 0.5).all()
    assert seen.optical_depth.flags.writeable


def test_what_a_sensor_had_computed_serves_the_file_unless_it_may_have_changed_it():
    seen = sight()
    made = observe(lambda given: Image(given.slow[0] + given.open[0], "1", "x"), seen)
    assert (made == 3).all()
    assert "slow" in vars(seen) and (seen.slow == 1.5).all()
    assert "open" not in vars(seen)


def view():
    lines = np.array([1e11, 2e11])
    return View((3, 2), (1e-3, 1e-3), 290.0, (1.0, 2.0), np.ones_like, lines, 1e9, lambda _: lines)


def test_a_value_error_in_needs_is_the_users_mistake_and_all_else_is_the_sensors():
    def high(_):
        raise ValueError("gain: too high")

    with pytest.raises(ScenarioError) as caught:
        sensors.ask_needs(Stranger(high), view())
    assert caught.value.problems == ("[sensor] gain: too high",)
    with pytest.raises(PluginFailure, match='"active" of thzcl: SystemExit'):
        sensors.ask_needs(Stranger(raising(SystemExit(0))), view())
    with pytest.raises(PluginFailure, match="NoneType instead of Needs"):
        sensors.ask_needs(Stranger(lambda _: None), view())
    with pytest.raises(PluginFailure, match="not made of numbers"):
        sensors.ask_needs(Stranger(lambda _: Needs(frequency_hz=["a"])), view())


def test_needs_are_asked_with_a_view_that_cannot_be_changed():
    given = view()

    def spoil(seen):
        seen.lines_hz[...] = 0

    with pytest.raises(ScenarioError, match="read-only"):
        sensors.ask_needs(Stranger(spoil), given)
    assert given.lines_hz.tolist() == [1e11, 2e11]
