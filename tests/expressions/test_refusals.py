"""What cannot be recorded is refused, with the place, what happened, and the mend."""

import functools
import math
import re
from math import atan2

import numpy as np
import pytest

from groupoid_gni import expressions as gni
from groupoid_gni.errors import InputError, RecordingError

POINT = np.array([0.4, -1.2, 0.7])
COUNTER = [0.0]


def branch(x):
    if x[0] > 0:
        return x
    return -x


def assign(x):
    out = np.zeros(3)
    out[0] = x[1]
    return out


def assign_slice(x):
    out = np.zeros((2, 3))
    out[0, :] = x
    return out[0]


def assign_in_the_middle_of_a_line(x):
    M = np.zeros((2, 2)); M[0, 1] += x[0]  # fmt: skip # noqa: E702
    return M


def add_in_place(x):
    out = np.array([1.0, 2.0, 3.0])
    out += x
    return out


def mutate(x):
    x[0] = 2.0 * x[1]
    return x


def mutate_by_operator(x):
    x *= 2.0
    return x


def mask(x):
    y = x.copy()
    y[y > 0] = 0.0
    return y


def scipy_expm(x):
    from scipy.linalg import expm

    return expm(np.array([[0.0, x[0]], [-x[0], 0.0]]))[:, 0]


def fresh_inverse(x):
    return np.linalg.inv(np.array([[x[0], 1.0, 0.0], [0.0, x[1], 0.0], [0.0, 0.0, 1.0]])) @ x


def own_error(x):
    raise KeyError("mass")


def stored_in_element(x):
    y = np.zeros_like(x)
    y[0] = x[:1]
    return y


ADVICE = [
    (branch, "if x[0] > 0:", "gni.where(condition, a, b)"),
    (lambda x: max(x[0], x[1]) * x, "max(x[0]", "gni.where(condition, a, b)"),
    (lambda x: np.array(sorted(x)), "sorted(x)", "gni.where(condition, a, b)"),
    (lambda x: math.sin(x[0]) * x, "math.sin(x[0])", "Use np.sin in place of math.sin"),
    (lambda x: atan2(x[0], x[1]) * x, "atan2(x[0]", "Use np.arctan2 in place of math.atan2"),
    (lambda x: math.floor(x[0]) * x, "math.floor(", "Use np.floor in place of math.floor"),
    (lambda x: float(x[0]) * x, "float(x[0])", "float() , the math module".replace(" ,", ",")),
    (lambda x: int(x[0]) * x, "int(x[0])", "Use np.floor"),
    (lambda x: [1.0, 2.0, 3.0][x[0]] * x, "[x[0]]", "cannot be an index"),
    (lambda x: complex(x[0]) * x, "complex(x[0])", "Keep real and imaginary part apart"),
    (lambda x: x * 1j, "x * 1j", "complex numbers cannot be recorded"),
    (lambda x: x * np.array([1j, 2.0, 3.0]), "1j", "complex arrays cannot be recorded"),
    (assign, "out[0] = x[1]", "gni.array([...]), or start from np.zeros_like(x)"),
    (assign_slice, "out[0, :] = x", "gni.array([...]), or start from np.zeros_like(x)"),
    (assign_in_the_middle_of_a_line, "M[0, 1] += x[0]", "Mend: Build the array with gni.array"),
    (add_in_place, "out += x", "gni.array([...]), or start from np.zeros_like(x)"),
    (mutate, "x[0] = 2.0 * x[1]", "work on a copy: x = x.copy()"),
    (mutate_by_operator, "x *= 2.0", "work on a copy: x = x.copy()"),
    (mask, "y[y > 0] = 0.0", "Masks cannot be recorded. Use gni.where"),
    (fresh_inverse, "np.linalg.inv(np.array", "Build the matrix with gni.array([...])"),
    (scipy_expm, "expm(", "Use group.exp, or gni.array arithmetic"),
    (lambda x: np.sin(np.array([x[0], 1.0, 2.0])), "np.sin(", "Build the array with gni.array"),
    (lambda x: np.maximum(np.array([x[0], 1.0, 2.0]), 0.0), "np.maximum", "fresh np.array"),
    (lambda x: np.sort(x), "np.sort(x)", "np.sort cannot be recorded"),
    (lambda x: x[np.argmax(x)] * x, "np.argmax(x)", "np.argmax cannot be recorded"),
    (lambda x: np.linalg.eigvals(np.outer(x, x)), "eigvals", "np.linalg.eigvals cannot be record"),
    (lambda x: x * np.isfinite(x), "np.isfinite", "Leave the test out"),
    (lambda x: np.nextafter(x, 1.0), "np.nextafter", "np.nextafter cannot be recorded"),
    (lambda x: np.interp(x, POINT, POINT), "np.interp", "np.interp cannot be recorded"),
    (lambda x: x[np.where(x > 0)], "np.where(x > 0)", "Use gni.where(condition, a, b)"),
    (lambda x: np.add(x, 1.0, where=[True, False, True]), "np.add(", "Use gni.where"),
    (lambda x: np.sum(x, dtype=int) * x, "dtype=int", "it needs numbers"),
    (lambda x: x.astype(int), "astype(int)", "it needs numbers"),
    (lambda x: np.round(x, 2), "np.round(x, 2)", "only with decimals=0"),
    (lambda x: np.linalg.norm(x, 3) * x, "np.linalg.norm(x, 3)", "ord=3 cannot be recorded"),
    (lambda x: np.linalg.norm(np.outer(x, x), 2) * x, "np.outer", "ord=2 cannot be recorded"),
    (stored_in_element, "y[0] = x[:1]", "assigned to a single element"),
    (lambda x: np.linalg.inv(np.outer(x, [0.0, 1.0, 2.0])) @ x, "linalg.inv", "Singular matrix"),
    (lambda x: np.linalg.solve(np.outer(x, x)[:2], x), "linalg.solve", "it must be square"),
    (own_error, 'raise KeyError("mass")', "KeyError: 'mass'"),
    (lambda x: undefined_name * x, "undefined_name", "NameError"),  # noqa: F821
    (lambda x, y: x, "", "TypeError"),
]


@pytest.mark.parametrize(("function", "source", "advice"), ADVICE, ids=[a[1] for a in ADVICE])
def test_message_names_place_source_and_mend(function, source, advice):
    with pytest.raises(RecordingError) as caught:
        gni.record(function, {"x": (3,)}, (3,), name="drift")
    text = str(caught.value)
    first = function.__code__.co_firstlineno
    line = int(re.search(rf"{re.escape(__file__)}:(\d+)", text)[1])
    assert text.startswith("drift cannot be recorded; it stopped at ")
    assert first <= line <= first + 6
    assert source in text
    assert advice in text


def noisy(x):
    return x + np.random.default_rng().normal(size=3)


def counting(x):
    COUNTER[0] += 1.0
    return x * COUNTER[0]


def type_dependent(x):
    return x if x.dtype == object else 2.0 * x


@pytest.mark.parametrize("function", [noisy, counting, type_dependent])
def test_numbers_that_differ_from_a_plain_call_are_found(function):
    expected = r"drift \(.*test_refusals.py:\d+\) gave different numbers when recorded"
    with pytest.raises(RecordingError, match=expected):
        gni.record(function, {"x": (3,)}, (3,), name="drift", check_points=[(POINT,)])


def mutate_when_plain(x):
    if x.dtype != object:
        x[0] = 3.0
    return x * 1.0


def raise_when_plain(x):
    return x if x.dtype == object else x[7]


def nothing_when_plain(x):
    return x if x.dtype == object else "text"


def shape_when_plain(x):
    return x if x.dtype == object else x[:2]


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (mutate_when_plain, "changed its argument 0 in place"),
        (raise_when_plain, "raised when run plainly at .*IndexError"),
        (nothing_when_plain, "gave no numbers when run plainly"),
        (shape_when_plain, r"gave shape \(2,\) when run plainly and \(3,\) when recorded"),
    ],
)
def test_faults_of_the_plain_call_are_reported(function, message):
    with pytest.raises(RecordingError, match=message):
        gni.record(function, {"x": (3,)}, (3,), name="drift", check_points=[(POINT,)])


@pytest.mark.parametrize(
    ("function", "shape", "message"),
    [
        (lambda x: None, (3,), "returned None.*Is a return missing"),
        (lambda x: x[:2], (3,), r"array of shape \(2,\) came, shape \(3,\) is expected"),
        (lambda x: x[:1], (), r"array of shape \(1,\) came, shape \(\) is expected"),
        (lambda x: x[0], (1,), r"array of shape \(\) came, shape \(1,\) is expected"),
        (lambda x: "text", (), "dtype <U4"),
        (lambda x: 2.0 + 1j, (), "complex numbers"),
        (lambda x: [x[0], None, 1.0], (3,), "an entry is None"),
        (lambda x: [x[0], [1.0, 2.0], 1.0], (3,), "inhomogeneous"),
        (lambda x: x * (np.inf - x / np.inf - np.inf), (3,), "contains the constant inf"),
        (lambda x: x + np.array([0.5, np.inf, 2.0]), (3,), "contains the constant inf"),
        (lambda x: np.array([0.5, np.nan, 2.0]), (3,), "the constant nan: a 0/0"),
    ],
)
def test_results_that_are_not_the_expected_array_are_refused(function, shape, message):
    with pytest.raises(InputError, match=message) as caught:
        gni.record(function, {"x": (3,)}, shape, name="potential")
    assert f"potential ({__file__}:{function.__code__.co_firstlineno})" in str(caught.value)


@pytest.mark.parametrize("function", [lambda x: x * np.nan, lambda x: x[0] + np.nan * x])
def test_nan_is_refused_where_it_enters(function):
    with pytest.raises(
        InputError, match=r"test_refusals.py:\d+\n.*np.nan(.|\n)*constant nan: a 0/0"
    ):
        gni.record(function, {"x": (3,)}, (3,), name="potential")


def test_values_of_another_recording_are_refused():
    kept = []
    gni.record(lambda y: kept.append(y) or y, {"y": (3,)}, (3,), name="first")
    with pytest.raises(RecordingError, match="uses values of another recording: y_0, y_1, y_2"):
        gni.record(lambda x: x + kept[0], {"x": (3,)}, (3,), name="second")


class Model:
    def __call__(self, x):
        return None


@pytest.mark.parametrize("function", [functools.partial(lambda a, x: None, 2.0), Model()])
def test_place_of_partials_and_callable_objects(function):
    with pytest.raises(InputError, match=r"test_refusals.py:\d+\) returned None"):
        gni.record(function, {"x": (3,)}, (3,), name="drift")


def test_builtin_functions_are_named_by_what_they_are():
    with pytest.raises(InputError, match=r"drift \(<ufunc 'sin'>\) returned a RecordedArray"):
        gni.record(np.sin, {"x": (3,)}, (2,), name="drift")


def test_a_missing_branch_of_where_is_refused_outside_recording_too():
    x, _ = gni.symbols("x", (3,))
    with pytest.raises(RecordingError, match="cannot be recorded"):
        np.where(x > 0)
    with pytest.raises(RecordingError, match="no truth value"):
        bool(x[0] > 0)
