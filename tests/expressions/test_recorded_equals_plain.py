"""A function gives the same numbers recorded and run plainly: a table of NumPy expressions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from groupoid_gni import expressions as gni

X = np.array([0.31, -0.72, 1.43])
A = np.array([[2.1, 0.3, -0.4], [0.2, 1.7, 0.6], [-0.5, 0.1, 2.9]])
B = np.array([0.7, -1.1, 0.4])
W = np.array([[0.0, -1.5, 0.3], [1.5, 0.0, -0.8], [-0.3, 0.8, 0.0]])


def hat(w):
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def filled(x):
    out = np.zeros_like(x)
    out[0] = x[1] * x[2]
    out[1:] = [x[0], 2.0]
    return out


def diagonal_filled(x):
    out = np.zeros_like(x, shape=(3, 3))
    np.fill_diagonal(out, x)
    np.copyto(out[0], x)
    return out


def in_place(x):
    y = x.copy()
    y += 1.5
    y *= x
    y[1] -= x[0]
    return y


def spd(x):
    return gni.array(np.outer(x, x)) + np.diag([2.0, 3.0, 4.0])


def spd5(x):
    root = np.ones_like(x, shape=(5, 5)) * 0.1
    root[0, :3] = x
    root[3, 2:] = x
    return root @ root.T + np.diag([2.0, 3.0, 4.0, 5.0, 6.0])


def saddle(x):
    top = np.hstack([spd(x), np.stack([x, np.cos(x)], axis=1)])
    return np.vstack([top, np.hstack([np.stack([x, np.cos(x)]), np.zeros((2, 2))])])


def rotation(angle):
    c, s = np.cos(angle), np.sin(angle)
    return gni.array([[c, -s], [s, c]])


def calling(name, arguments):
    function = getattr(np, name)
    return lambda x: function(*arguments(x))


POSITIVE = {"sqrt", "log", "log2", "log10", "arccosh"}
UNARY = [
    "sin", "cos", "tan", "arctan", "sinh", "cosh", "tanh", "arcsinh", "exp", "exp2", "expm1",
    "sqrt", "log", "log2", "log10", "arccosh", "cbrt", "square", "reciprocal", "absolute", "fabs",
    "sign", "floor", "ceil", "trunc", "rint", "negative", "positive", "conjugate", "deg2rad",
    "rad2deg", "degrees", "radians",
]  # fmt: skip
SMALL = ["arcsin", "arccos", "arctanh", "log1p", "sinc"]
BINARY = ["add", "subtract", "multiply", "divide", "arctan2", "hypot", "maximum", "minimum", "fmax",
          "fmin", "mod", "fmod", "floor_divide", "copysign", "logaddexp", "heaviside"]  # fmt: skip

EXPRESSIONS = {
    **{f"{n} array": calling(n, lambda x: (x,)) for n in UNARY if n not in POSITIVE},
    **{f"{n} scalar": calling(n, lambda x: (x[2],)) for n in UNARY},
    **{f"{n} square": calling(n, lambda x: (1.1 + x * x,)) for n in UNARY},
    **{f"{n} small": calling(n, lambda x: (0.4 * x,)) for n in SMALL},
    **{f"{n} arrays": calling(n, lambda x: (x, x[::-1] + 0.1)) for n in BINARY},
    **{f"{n} with float": calling(n, lambda x: (x, 0.6)) for n in BINARY},
    **{f"float with {n}": calling(n, lambda x: (B, x[1])) for n in BINARY},
    **{f"{n} scalars": calling(n, lambda x: (x[1], x[2])) for n in BINARY},
    "arithmetic": lambda x: (x[0] + 2 * x[1]) / (3 - x[2]) - 1 / x[0] + (-x[1]) + (+x[2]),
    "integer powers": lambda x: x**2 + x**3 - x**-1 + x[0] ** 7 + x[1] ** 0,
    "roots as powers": lambda x: (x * x) ** 0.5 + (x * x) ** 1.5 + (x[2] ** -0.5),
    "recorded exponent": lambda x: 2.0**x + (1.0 + x * x) ** x,
    "python mod": lambda x: np.array([x[0] % 0.2, x[1] % 0.5, 2.0 % x[2], x[1] // 0.5]),
    "numpy scalars": lambda x: np.float64(2.0) * x[0] + x[1] * np.float64(3.0) - np.int64(2) / x[2],
    "float array times scalar": lambda x: B * x[0] + x[1] * B - B / x[2] + x[0] / B,
    "fresh array": lambda x: np.array([x[0], 1.0, x[2]]) * 2.0 + B,
    "hat": hat,
    "ellipsis index": lambda x: np.array([x[..., 0], 1.0, x[..., 2]]),
    "unpacking": lambda x: (lambda a, b, c: a * b + c)(*x),
    "python sum": lambda x: sum(v * v for v in x),
    "fancy index": lambda x: x[[2, 0, 0, 1]][::-1],
    "new axes": lambda x: x[:, None] * x[None, :],
    "zeros_like": filled,
    "ones_like": lambda x: np.ones_like(x) * 2.0 + x,
    "full_like": lambda x: np.full_like(x, x[1]),
    "empty_like": lambda x: np.empty_like(x) * 0.0 + x,
    "fill_diagonal": diagonal_filled,
    "float methods": lambda x: A.dot(x) + B.dot(x),
    "np.full": lambda x: np.full(3, x[1]) * x,
    "amax around": lambda x: np.amax(x) + np.amin(x) + np.round(x) + np.around(x),
    "list functions": lambda x: np.sum([x[0], x[1]]) + np.linalg.norm([x[0], x[1]]),
    "in place on a copy": in_place,
    "astype": lambda x: x.astype(float) + x.copy(),
    "matmul": lambda x: A @ x + x @ A + hat(x) @ B,
    "matmul of fresh": lambda x: hat(x) @ hat(x) @ x,
    "matmul scalar": lambda x: x @ A @ x,
    "matmul stack": lambda x: np.stack([A * x[0], W * x[1]]) @ x,
    "matmul no terms": lambda x: np.zeros((2, 0)) @ x[:0],
    "dot": lambda x: np.dot(A, x) + x.dot(A),
    "dot no terms": lambda x: np.dot(np.zeros((2, 0)), x[:0]),
    "vdot inner": lambda x: np.vdot(x, B) + np.inner(x, B),
    "outer": lambda x: np.outer(x, B),
    "cross": lambda x: np.cross(x, B) + np.cross(B, x * x),
    "kron": lambda x: np.kron(x, A),
    "einsum": lambda x: np.einsum("ij,j->i", A, x),
    "einsum three": lambda x: np.einsum("ij,jk,k->i", hat(x), A, x, optimize=True),
    "einsum ellipsis": lambda x: np.einsum("...i,...i->...", A * x, x),
    "einsum no terms": lambda x: np.einsum("ij,j->i", np.zeros((2, 0)), x[:0]),
    "tensordot": lambda x: np.tensordot(np.outer(x, x), A, axes=2),
    "multi_dot": lambda x: np.linalg.multi_dot([A, np.outer(x, x), W]),
    "matrix_power": lambda x: np.linalg.matrix_power(np.outer(x, B) + A, 3),
    "matrix_power negative": lambda x: np.linalg.matrix_power(gni.array(hat(x)) + A, -2),
    "trace": lambda x: np.trace(np.outer(x, B)) + np.outer(x, x).trace(),
    "sum": lambda x: np.sum(x) + x.sum() + np.outer(x, B).sum(axis=0)[1],
    "sum axes": lambda x: np.sum(np.outer(x, B)[None], axis=(0, 1), keepdims=True),
    "prod": lambda x: np.prod(x) + x.prod(),
    "mean var std": lambda x: np.mean(x) + x.mean() + np.var(x) + x.std() + np.std(x, ddof=1),
    "mean axis": lambda x: np.mean(np.outer(x, B), axis=1),
    "cumsum": lambda x: np.cumsum(x) + x.cumsum() + np.cumprod(x),
    "diff": lambda x: np.diff(x * x),
    "max min": lambda x: np.max(x) + np.min(x) * 2.0 + x.max() - x.min(),
    "max axis": lambda x: np.max(np.outer(x, B), axis=1, keepdims=True),
    "max axes": lambda x: np.max(np.outer(x, B)[None], axis=(0, 2)),
    "maximum reduce": lambda x: np.maximum.reduce(x) + np.minimum.reduce(x[:2]),
    "clip": lambda x: np.clip(x, -0.5, 0.5) + x.clip(0.0, None) + np.clip(x, None, np.inf),
    "comparisons": lambda x: (x > 0) * 1.0 + (x <= 0.31) * 2.0 + (x != 1.0) + (x <= B) + (x == x),
    "where array": lambda x: np.where(x > 0, x, x * x),
    "where scalar": lambda x: np.where(x[0] > 0, x[1], 7.0),
    "gni.where": lambda x: gni.where((x > 0) & (x < 1) | ~(x >= -0.5), 2.0 * x, B),
    "gni.where of lists": lambda x: gni.where([True, False, True], [x[0], 1.0, x[1]], 5.0),
    "logical": lambda x: gni.where(np.logical_and(x > 0, np.logical_not(x > 1)), x, -x),
    "logical xor or": lambda x: np.logical_xor(x > 0, B > 0) * 1.0 + np.logical_or(x > 0, False),
    "any all": lambda x: np.any(x > 1) * 1.0 + np.all(x > 0) * 2.0 + (x > 0).any(),
    "select": lambda x: np.select([x > 1, x > 0], [x, x * x], 3.0),
    "concatenate": lambda x: np.concatenate([x, B, x[:1]]),
    "stack": lambda x: np.stack([x, B]) + np.vstack([B, x]) * 2.0,
    "stack scalars": lambda x: np.stack([x[0], x[1] * 2.0, 3.0]),
    "hstack": lambda x: np.hstack([x, [x[0], 1.0]]),
    "column_stack": lambda x: np.column_stack([x, B]),
    "block": lambda x: np.block([[A, x[:, None]], [x[None, :], np.zeros((1, 1))]]),
    "append": lambda x: np.append(x, [1.0, x[0]]),
    "c_": lambda x: np.c_[x, B],
    "split": lambda x: np.array_split(x, 2)[0] + np.split(x, [2])[0],
    "diag": lambda x: np.diag(x) + np.diag([1.0, x[0], 2.0]),
    "tile roll flip": lambda x: np.tile(x, (2, 1)) + np.roll(x, 1) + np.flip(x),
    "transpose": lambda x: np.outer(x, B).T + np.transpose(np.outer(x, A[0])),
    "reshape": lambda x: np.outer(x, B).reshape(1, 9) + np.ravel(np.outer(B, x)),
    "tril triu": lambda x: np.tril(np.outer(x, B)) + 2.0 * np.triu(np.outer(x, B), 1),
    "moveaxis": lambda x: np.moveaxis(np.outer(x, B)[None], 0, -1),
    "broadcast_to": lambda x: np.broadcast_to(x, (2, 3)) * 1.5,
    "trapezoid": lambda x: np.trapezoid(x, dx=0.3),
    "polyval": lambda x: np.polyval(x, 2.0) + np.polyval([2.0, 1.0], x),
    "norm": lambda x: np.linalg.norm(x) + np.linalg.norm(x, 1) + np.linalg.norm(x, np.inf),
    "norm matrix": lambda x: (
        np.linalg.norm(np.outer(x, B)) + np.linalg.norm(A * x, 1) + np.linalg.norm(A * x, np.inf)
    ),
    "norm axis": lambda x: np.linalg.norm(A * x, axis=1, keepdims=True),
    "norm axes": lambda x: np.linalg.norm((A * x)[None], 1, axis=(1, 2), keepdims=True),
    "vector_norm": lambda x: np.linalg.vector_norm(A * x, axis=0),
    "matrix_norm": lambda x: np.linalg.matrix_norm(A * x),
    "norm of list": lambda x: np.linalg.norm(gni.array([x[0], 1.0])),
    "det": lambda x: np.linalg.det(spd(x)) + np.linalg.det(gni.array([[x[0]]])),
    "det 5": lambda x: np.linalg.det(saddle(x)),
    "inv 2": lambda x: np.linalg.inv(rotation(x[0])),
    "inv 3": lambda x: np.linalg.inv(A * x + np.eye(3)),
    "inv 5": lambda x: np.linalg.inv(spd5(x)),
    "inv stack": lambda x: np.linalg.inv(np.stack([A + np.diag(x), spd(x)])),
    "solve": lambda x: np.linalg.solve(spd(x), B),
    "solve float matrix": lambda x: np.linalg.solve(A, x),
    "solve matrix": lambda x: np.linalg.solve(spd5(x), np.ones((5, 2)) * x[:2]),
    "solve saddle": lambda x: np.linalg.solve(saddle(x), np.concatenate([x, B[:2]])),
    "solve zero diagonal": lambda x: np.linalg.solve(
        np.kron(np.eye(2), gni.array([[0.0, x[0]], [x[1], 3.0]])), np.append(x, 1.0)
    ),
    "cholesky": lambda x: np.linalg.cholesky(spd(x)),
    "cholesky upper": lambda x: np.linalg.cholesky(spd5(x), upper=True),
    "constant": lambda x: np.array([1.5, -2.5]),
    "list": lambda x: [x[0], 1.0, [2.0 * x[1]][0]],
    "print": lambda x: (f"{x[0]:.3f} {x}", x)[1],
}


@pytest.mark.parametrize("expression", EXPRESSIONS.values(), ids=EXPRESSIONS.keys())
def test_recorded_equals_plain(expression):
    expected = np.asarray(expression(X.copy()), dtype=float)
    other = np.array([0.83, -0.21, 1.27])
    recorded = gni.record(
        expression, {"x": (3,)}, expected.shape, name="expression", check_points=[(X,), (other,)]
    )
    np.testing.assert_allclose(recorded(X), expected, rtol=1e-13, atol=1e-14)


def test_the_table_is_broad():
    assert len(EXPRESSIONS) >= 60


@pytest.mark.parametrize("angle", [0.4, np.pi / 2, 3.0])
def test_a_rotation_with_zero_diagonal_can_be_inverted(angle):
    inverse = gni.record(lambda a: np.linalg.inv(rotation(a)), {"a": ()}, (2, 2), name="inverse")
    np.testing.assert_allclose(inverse(angle), rotation(-angle), atol=1e-15)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    matrix=arrays(float, (5, 5), elements=st.floats(-1, 1)),
    right=arrays(float, (5,), elements=st.floats(-3, 3)),
)
def test_solve_and_cholesky_of_definite_matrices(matrix, right):
    definite = matrix @ matrix.T + 0.5 * np.eye(5)
    x = gni.from_sx(gni.to_sx(definite, (5, 5)), (5, 5))
    assert x.dtype == object
    lower = np.linalg.cholesky(x).astype(float)
    np.testing.assert_allclose(np.asarray(lower @ lower.T, float), definite, rtol=1e-12, atol=1e-13)
    solution = np.asarray(np.linalg.solve(x, right), dtype=float)
    np.testing.assert_allclose(definite @ solution, right, atol=1e-11)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(a=st.floats(-50, 50), b=st.floats(0.1, 7.0), sign=st.sampled_from([-1.0, 1.0]))
def test_remainder_and_rounding_follow_numpy(a, b, sign):
    b = sign * b
    recorded = gni.record(
        lambda u, v: np.stack([u % v, u // v, np.rint(u), np.fmod(u, v), np.trunc(u)]),
        {"u": (), "v": ()},
        (5,),
        name="rounding",
    )
    expected = [np.mod(a, b), np.floor_divide(a, b), np.rint(a), np.fmod(a, b), np.trunc(a)]
    np.testing.assert_array_equal(recorded(a, b), expected)
