"""A RecordedFunction: batches, inlining, derivatives; conversions between arrays and columns."""

import dataclasses
import pickle
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from groupoid_gni import expressions as gni
from groupoid_gni.errors import InputError, RecordingError

X = np.array([0.3, -0.7, 1.4])


def energy_and_more(x, m, A):
    return np.array([m * x @ A @ x, np.sin(x[0]) * m]) * A[0, 1]


@pytest.fixture
def recorded():
    inputs = {"x": (3,), "m": (), "A": (3, 3)}
    return gni.record(energy_and_more, inputs, (2,), name="energy and more")


def matrix(*batch):
    return np.random.default_rng(3).normal(size=(*batch, 3, 3))


def test_one_point_and_a_float_for_shape_zero(recorded):
    np.testing.assert_allclose(
        recorded(X, 1.3, matrix()), energy_and_more(X, 1.3, matrix()), rtol=1e-14
    )
    norm = gni.record(lambda x: np.linalg.norm(x), {"x": (3,)}, (), name="norm")
    assert type(norm(X)) is float
    assert norm(X[None]).shape == (1,)


def test_leading_axes_broadcast(recorded):
    rng = np.random.default_rng(5)
    x, m, A = rng.normal(size=(4, 1, 3)), rng.normal(size=(5,)), matrix()
    result = recorded(x, m, A)
    assert result.shape == (4, 5, 2)
    assert result.flags.c_contiguous
    for i, j in np.ndindex(4, 5):
        np.testing.assert_allclose(result[i, j], energy_and_more(x[i, 0], m[j], A), rtol=1e-13)
    assert recorded(np.zeros((0, 3)), 1.5, A).shape == (0, 2)


def test_wrong_arguments(recorded):
    with pytest.raises(InputError, match="takes 3 arguments; 1 came"):
        recorded(X)
    with pytest.raises(InputError, match=r"argument 0 has shape \(2,\); \(\.\.\., 3\) is expected"):
        recorded(X[:2], 1.5, matrix())
    with pytest.raises(InputError, match="batch axes"):
        recorded(np.zeros((2, 3)), np.zeros(4), matrix())
    with pytest.raises(InputError, match="argument 1 must hold real numbers; dtype complex128"):
        recorded(X, 1j, matrix())
    with pytest.raises(InputError, match=r"energy and more: argument 0: .*\(2,\) came"):
        recorded(gni.symbols("x", (2,))[0], 1.5, matrix())
    with pytest.raises(InputError, match="has arguments 0 to 2; 3 came"):
        recorded.derivative(3)


def test_frozen(recorded):
    with pytest.raises(dataclasses.FrozenInstanceError):
        recorded.name = "other"


def test_recorded_arguments_are_inlined(recorded):
    def outer(x):
        return recorded(2.0 * x, x[1], np.outer(x, X))[0] ** 2

    direct = gni.record(outer, {"x": (3,)}, (), name="outer")
    expected = energy_and_more(2.0 * X, X[1], np.outer(X, X))[0] ** 2
    assert direct(X) == pytest.approx(expected, rel=1e-13)
    scalar = gni.record(lambda x: x @ x, {"x": (3,)}, (), name="square")
    x, _ = gni.symbols("x", (3,))
    assert isinstance(scalar(x), gni.Scalar)
    assert isinstance(recorded(x, 1.5, matrix()), gni.RecordedArray)
    assert recorded.call_sx(*(ca.SX.sym("u", n) for n in (3, 1, 9))).shape == (2, 1)


@pytest.mark.parametrize("argument", [0, 1, 2])
def test_derivative_agrees_with_differences(recorded, argument):
    arguments = [X, np.array(1.3), matrix()]
    shape = recorded.input_shapes[argument]
    derivative = recorded.derivative(argument)
    assert derivative is recorded.derivative(argument)
    assert derivative.output_shape == (2, *shape)
    value = derivative(*arguments)
    for index in np.ndindex(shape):
        sides = []
        for step in (1e-5, -1e-5):
            moved = [a.copy() for a in arguments]
            moved[argument][index] += step
            sides.append(recorded(*moved))
        np.testing.assert_allclose(
            value[(slice(None), *index)], (sides[0] - sides[1]) / 2e-5, rtol=1e-7, atol=1e-8
        )


def test_second_derivatives_are_symmetric(recorded):
    hessian = recorded.derivative(0).derivative(0)(X, 1.3, matrix())
    assert hessian.shape == (2, 3, 3)
    np.testing.assert_allclose(hessian, np.swapaxes(hessian, 1, 2), atol=1e-14)
    mixed = recorded.derivative(0).derivative(2)(X, 1.3, matrix())
    other = recorded.derivative(2).derivative(0)(X, 1.3, matrix())
    np.testing.assert_allclose(mixed, np.moveaxis(other, -1, 1), atol=1e-13)


def test_empty_shapes():
    nothing = gni.record(lambda x: np.zeros((0, 3)) * x, {"x": (3,)}, (0, 3), name="constraints")
    assert nothing(X).shape == (0, 3)
    assert nothing.derivative(0)(X).shape == (0, 3, 3)
    fixed = gni.record(lambda x: np.array([1.5, 2.5]), {"x": (0,)}, (2,), name="fixed")
    np.testing.assert_array_equal(fixed(np.zeros(0)), [1.5, 2.5])
    np.testing.assert_array_equal(fixed(np.zeros((4, 0))), [[1.5, 2.5]] * 4)
    assert fixed.derivative(0)(np.zeros(0)).shape == (2, 0)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    values=array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4).flatmap(
        lambda shape: arrays(float, shape, elements=st.sampled_from([0.0, -1.5, 2.0, 3.7]))
    )
)
def test_columns_round_trip(values):
    column = gni.to_sx(values, values.shape)
    assert column.shape == (values.size, 1)
    assert column.nnz() == np.count_nonzero(values)
    back = gni.from_sx(column, values.shape)
    assert isinstance(back, gni.RecordedArray)
    np.testing.assert_array_equal(np.asarray(back, dtype=float), values)


def test_matrices_keep_rows_and_columns_apart():
    x, column = gni.symbols("x", (2, 3))
    made = gni.to_sx_matrix(x * [[1.0, 0.0, 2.0]], (2, 3))
    assert made.shape == (2, 3)
    assert made.nnz() == 4
    values = np.arange(1.0, 7.0)
    numbers = ca.Function("f", [column], [made])(values).full()
    np.testing.assert_array_equal(numbers, values.reshape(2, 3) * [[1.0, 0.0, 2.0]])
    back = gni.to_sx(gni.from_sx(made, (2, 3)), (2, 3))
    flat = ca.Function("f", [column], [back])(values).full()[:, 0]
    np.testing.assert_array_equal(flat, numbers.ravel())
    with pytest.raises(InputError, match="does not fill the shape"):
        gni.from_sx(made, (3, 3))
    with pytest.raises(InputError, match=r"shape \(2, 3\) came, shape \(3, 2\) is expected"):
        gni.to_sx_matrix(x, (3, 2))


def test_structural_zeros_leave_nothing_in_the_graph():
    x, _ = gni.symbols("x", (3,))
    sparse = np.diag([3.0, 5.0, 7.0]) @ x
    assert [str(v.sx) for v in sparse] == ["(3*x_0)", "(5*x_1)", "(7*x_2)"]
    assert 0.0 * x[0] == 0.0
    assert np.einsum("ij,j->i", np.eye(3), x)[1].sx.name() == "x_1"


def test_is_recorded():
    x, _ = gni.symbols("x", (3,))
    assert gni.is_recorded(1.0, x)
    assert gni.is_recorded(x[0])
    assert gni.is_recorded(np.array([x[0], 1.0]))
    assert not gni.is_recorded(1.0, X, [1.0], None)


def test_results_stay_recorded_arrays():
    x, _ = gni.symbols("x", (3,))
    for result in (X * x, x[1] * X, np.array([x[0], 1.0, x[1]]) + x, np.zeros_like(x), x[1:],
                   np.stack([x[0], x[1]]), np.outer(X, x).T, gni.array([1.0, x[0]])):  # fmt: skip
        assert isinstance(result, gni.RecordedArray)
    for result in (x @ X, np.sum(x), np.maximum(x[0], 0.5), np.where(x[0] > 0, 1.5, x[1])):
        assert isinstance(result, gni.Scalar)


def test_gni_array():
    assert gni.array([1, 2]).dtype == np.float64
    with pytest.raises(InputError, match="inhomogeneous"):
        gni.array([[1.0], [1.0, 2.0]])
    with pytest.raises(InputError, match="dtype <U1"):
        gni.array(["a"])
    x, _ = gni.symbols("x", (2,))
    with pytest.raises(InputError, match="None came"):
        gni.array([x[0], None])


def test_where_on_floats_is_numpy():
    assert gni.where(True, 1.5, 2.5) == 1.5
    np.testing.assert_array_equal(gni.where(X > 0, X, [1.5, 2.5, 3.5]), np.where(X > 0, X, 2.5))


def test_scalar_equality_with_other_things_is_false():
    x, _ = gni.symbols("x", (2,))
    assert (x[0] == None) is False  # noqa: E711
    with pytest.raises(TypeError, match="unhashable"):
        hash(x[0])
    with pytest.raises(RecordingError, match="no truth value"):
        assert x[0] == x[1]


def test_recording_leaves_the_numpy_settings_alone():
    before = np.geterr()
    gni.record(lambda x: np.log(x * x), {"x": (3,)}, (3,), name="logarithm", check_points=[(X,)])
    assert np.geterr() == before


def test_many_threads_may_record_and_evaluate_at_once(recorded):
    def work(seed):
        x = np.random.default_rng(seed).normal(size=3)
        for _ in range(10):
            own = gni.record(lambda x: x @ x * np.sin(x), {"x": (3,)}, (3,), name="own")
            np.testing.assert_allclose(own(x), x @ x * np.sin(x), rtol=1e-14)
            np.testing.assert_allclose(
                recorded(x, 1.3, matrix()), energy_and_more(x, 1.3, matrix()), rtol=1e-12
            )
        return True

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(work, range(32)))


def test_functions_can_be_pickled(recorded):
    again = pickle.loads(pickle.dumps(recorded))
    np.testing.assert_array_equal(again(X, 1.3, matrix()), recorded(X, 1.3, matrix()))


def test_import_takes_neither_scipy_nor_matplotlib():
    code = (
        "import sys, groupoid_gni.expressions;"
        "print([m for m in ('scipy', 'matplotlib', 'hypothesis', 'geomstats') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True, text=True, check=True, env={"PYTHONPATH": ":".join(sys.path)},
    )  # fmt: skip
    assert done.stdout.strip() == "[]"


def test_recording_ten_thousand_operations_is_quick():
    def chain(x):
        y = x
        for _ in range(1000):
            y = np.cos(y) * x + 0.3 * y
        return y

    start = time.perf_counter()
    gni.record(chain, {"x": (3,)}, (3,), name="chain")
    # Measured 0.05 s; with CasADi's Python operators it would be about 0.5 s and more.
    assert time.perf_counter() - start < 0.4
