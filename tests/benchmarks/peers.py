"""What the library is compared with: DOP853 in C, heyoka's Taylor series, SciPy with NumPy.

A ``Model`` holds one system in every form: the library's scene; hand-derived equations without
multipliers, for C (``c/reference_fields.c``) and for heyoka; and the right-hand side of somebody
who derives nothing by hand, with mass matrix and multipliers solved in every call.
"""

from __future__ import annotations

import ctypes
import math
import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import step_cost

import groupoid_gni as gni

FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math")
SOURCE = step_cost.HERE / "c" / "reference_fields.c"
Expressions = Sequence[Any]


@dataclass(frozen=True)
class HandDerived:
    """Equations without multipliers in native variables.

    name : what distinguishes this form from others of the same system, or "".
    defines : for the C; empty for a form that is heyoka's only.  parameters : what the C reads.
    start : native variables, (N,).  taylor : (heyoka, variables) -> rates.
    library_state : native variables (..., N) -> base point and velocity of the library, (..., n).
    """

    name: str
    defines: tuple[str, ...]
    parameters: tuple[float, ...]
    start: np.ndarray
    taylor: Callable[[Any, Expressions], list[Any]]
    library_state: Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class NumpyForm:
    """A right-hand side y' = field(t, y) in NumPy, its start, its way to the library's state."""

    field: Callable[[float, np.ndarray], np.ndarray]
    start: np.ndarray
    library_state: Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Model:
    """One system in every form.

    forms : equivalent; the fastest one counts.
    c_forms : those that the C has.
    look : states of the library (..., n) -> energy and largest violation of what the true motion
        stays on (constraints, rotations), each (...).
    chaotic : whether positions after long times mean nothing.
    """

    name: str
    scene: gni.scenes.Scene
    forms: tuple[HandDerived, ...]
    numpy: NumpyForm
    look: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    chaotic: bool = False

    @property
    def c_forms(self) -> tuple[HandDerived, ...]:
        return tuple(form for form in self.forms if form.defines)


# The systems.


def sleigh() -> Model:
    """Chaplygin sleigh in body velocities (omega, v)."""
    scene = gni.scenes.chaplygin_sleigh()
    p = scene.system.parameters
    m, J, a = (float(p[name]) for name in ("m", "J", "a"))
    about_blade = J + m * a**2
    rate = m * a / about_blade

    def taylor(hy: Any, y: Expressions) -> list[Any]:
        return [-rate * y[0] * y[1], a * y[0] ** 2.0]

    def body_velocity(y: np.ndarray) -> np.ndarray:
        return np.stack([y[..., 0], y[..., 1], 0.0 * y[..., 0]], axis=-1)

    form = HandDerived(
        "", ("-DSLEIGH",), (a, rate), scene.start.velocity[:2].copy(), taylor, body_velocity
    )
    metric = np.array([[about_blade, 0.0, m * a], [0.0, m, 0.0], [m * a, 0.0, m]])
    blade = np.array([[0.0, 0.0, 1.0]])

    def rates(t: float, v: np.ndarray) -> np.ndarray:
        momentum = metric @ v
        torque = np.array(
            [v[2] * momentum[1] - v[1] * momentum[2], v[0] * momentum[2], -v[0] * momentum[1]]
        )
        return constrained(metric, blade, torque, np.zeros(1))

    numpy_form = NumpyForm(rates, scene.start.velocity, _itself)
    return Model("sleigh", scene, (form,), numpy_form, _kinetic(metric, blade))


def suslov() -> Model:
    """Suslov body in (Omega_1, Omega_2); the axis of the scene is e3."""
    scene = gni.scenes.suslov()
    inertia = np.asarray(scene.system.parameters["I"])
    axis = np.asarray(scene.system.parameters["a"], dtype=float)
    if np.any(axis[:2]):
        raise ValueError(f"the hand-derived equations are for the axis e3, not {axis}")
    plane, pull = inertia[:2, :2], inertia[:2, 2]
    turn = np.linalg.solve(plane, np.array([[0.0, -1.0], [1.0, 0.0]]))

    def taylor(hy: Any, y: Expressions) -> list[Any]:
        force = pull[0] * y[0] + pull[1] * y[1]
        return [force * (turn[i, 0] * y[0] + turn[i, 1] * y[1]) for i in range(2)]

    def body_velocity(y: np.ndarray) -> np.ndarray:
        return np.stack([y[..., 0], y[..., 1], 0.0 * y[..., 0]], axis=-1)

    parameters = (*turn.ravel(), *pull, plane[0, 0], plane[0, 1], plane[1, 1])
    form = HandDerived(
        "", ("-DSUSLOV",), parameters, scene.start.velocity[:2].copy(), taylor, body_velocity
    )

    def rates(t: float, omega: np.ndarray) -> np.ndarray:
        return constrained(
            inertia, axis[None, :], np.cross(inertia @ omega, omega), np.zeros(1)
        )

    numpy_form = NumpyForm(rates, scene.start.velocity, _itself)
    return Model("Suslov", scene, (form,), numpy_form, _kinetic(inertia, axis[None, :]))


def ball(table: float | None = None) -> Model:
    """Inhomogeneous ball with two rows of R or with a quaternion; L of the C file is constant."""
    scene = gni.scenes.inhomogeneous_ball(**({} if table is None else {"table": table}))
    p = scene.system.parameters
    m, r, theta = (float(p[name]) for name in ("m", "r", "Theta"))
    inertia = np.asarray(p["I"], dtype=float)
    place, R = scene.start.base[:2], scene.start.base[2:].reshape(3, 3)
    v, omega = scene.start.velocity[:2], scene.start.velocity[2:]
    conserved = R @ (inertia * omega) + m * r * np.array([-v[1], v[0], 0.0])
    over = 1.0 / (inertia + m * r**2)
    constants = (r, theta, *conserved, m * r**2, m * r * theta, *over)
    numbers = _Ball(r, theta, conserved, m * r**2, m * r * theta, over)
    forms = (
        HandDerived(
            "two rows", ("-DBALL",), constants, np.concatenate([R[0], R[1], place]),
            lambda hy, y: numbers.rates_of_rows(y),
            lambda y: numbers.state(_rotation_of_rows(y[..., :6]), y[..., 6:]),
        ),
        HandDerived(
            "quaternion", ("-DBALL_QUATERNION",), constants,
            np.concatenate([_quaternion(R), place]),
            lambda hy, y: numbers.rates_of_quaternion(y),
            lambda y: numbers.state(_rotation_of_quaternion(y[..., :4]), y[..., 4:]),
        ),
        # heyoka cannot restore the length after a step, so this one does not depend on it
        HandDerived(
            "quaternion of any length", (), (), np.concatenate([_quaternion(R), place]),
            lambda hy, y: numbers.rates_of_quaternion(y, _dot(y[1:], y[1:]) + y[0] * y[0]),
            lambda y: numbers.state(_rotation_of_quaternion(
                y[..., :4] / np.linalg.norm(y[..., :4], axis=-1, keepdims=True)), y[..., 4:]),
        ),
    )  # fmt: skip
    start = np.concatenate([scene.start.base, scene.start.velocity])
    name = "ball" if theta else "ball, fixed table"

    def look(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        R, v, omega = u[..., 2:11].reshape(*u.shape[:-1], 3, 3), u[..., 11:13], u[..., 13:]
        energy = 0.5 * (m * np.sum(v * v, axis=-1) + np.sum(inertia * omega**2, axis=-1))
        spin = np.einsum("...ij,...j->...i", R, omega)
        slip = v - r * np.stack([spin[..., 1], -spin[..., 0]], axis=-1)
        slip -= theta * np.stack([-u[..., 1], u[..., 0]], axis=-1)
        skew = np.einsum("...ij,...kj->...ik", R, R) - np.eye(3)
        off = np.maximum(np.max(np.abs(slip), axis=-1), np.max(np.abs(skew), axis=(-2, -1)))
        return energy, off

    numpy_form = NumpyForm(_ball_rates(m, r, theta, inertia), start, _itself)
    return Model(name, scene, forms, numpy_form, look)


def _kinetic(
    metric: np.ndarray, mu: np.ndarray
) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """What to look at where there is no base point."""
    return lambda v: (
        0.5 * np.einsum("...i,ij,...j->...", v, metric, v),
        np.max(np.abs(v @ mu.T), axis=-1),
    )


def _ball_rates(
    m: float, r: float, theta: float, inertia: np.ndarray
) -> Callable[[float, np.ndarray], np.ndarray]:
    metric = np.diag([m, m, *inertia])

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        R, v, omega = y[2:11].reshape(3, 3), y[11:13], y[13:]
        mu = np.zeros((2, 5))
        mu[0, 0] = mu[1, 1] = 1.0
        mu[0, 2:], mu[1, 2:] = -r * R[1], r * R[0]
        force = np.concatenate([np.zeros(2), np.cross(inertia * omega, omega)])
        # R' = R hat(Omega), so mu' v = 0
        bias = theta * np.array([-v[1], v[0]])
        change = constrained(metric, mu, force, bias)
        return np.concatenate([v, np.cross(R, omega).ravel(), change])

    return rates


@dataclass(frozen=True)
class _Ball:
    """The equations at the top of the ball in ``c/reference_fields.c``."""

    r: float
    theta: float
    momentum: np.ndarray
    heavy: float
    dragged: float
    over: np.ndarray

    def omega(self, a: Expressions, b: Expressions, c: Expressions, x: Any, y: Any) -> list[Any]:
        along = (self.momentum[0] + self.dragged * x, self.momentum[1] + self.dragged * y)
        k = [along[0] * a[i] + along[1] * b[i] + self.momentum[2] * c[i] for i in range(3)]
        ku = [self.over[i] * k[i] for i in range(3)]
        cu = [self.over[i] * c[i] for i in range(3)]
        f = self.heavy * _dot(c, ku) / (1.0 - self.heavy * _dot(c, cu))
        return [ku[i] + f * cu[i] for i in range(3)]

    def rolling(self, a: Expressions, b: Expressions, omega: Expressions, x: Any, y: Any) -> list:
        along = self.r * _dot(b, omega), self.r * _dot(a, omega)
        if not self.theta:
            return [along[0], -along[1]]
        return [along[0] - self.theta * y, self.theta * x - along[1]]

    def rates_of_rows(self, u: Expressions) -> list[Any]:
        a, b, (x, y) = u[:3], u[3:6], u[6:]
        omega = self.omega(a, b, _cross(a, b), x, y)
        return [*_cross(a, omega), *_cross(b, omega), *self.rolling(a, b, omega, x, y)]

    def rates_of_quaternion(self, u: Expressions, square: Any = 1.0) -> list[Any]:
        (w, *q), (x, y) = u[:4], u[4:]
        a, b, c = _rows_of_quaternion(u[:4], 2.0 / square)
        omega = self.omega(a, b, c, x, y)
        half = [0.5 * o for o in omega]
        turned = _cross(q, half)
        return [
            -_dot(q, half),
            *(w * half[i] + turned[i] for i in range(3)),
            *self.rolling(a, b, omega, x, y),
        ]

    def state(self, R: np.ndarray, place: np.ndarray) -> np.ndarray:
        """(x, y, R, x', y', Omega) from (..., 3, 3) and (..., 2)."""
        a, b, c = (np.moveaxis(R[..., i, :], -1, 0) for i in range(3))
        x, y = place[..., 0], place[..., 1]
        omega = self.omega(a, b, c, x, y)
        velocity = np.stack([*self.rolling(a, b, omega, x, y), *omega], axis=-1)
        return np.concatenate([place, R.reshape(*R.shape[:-2], 9), velocity], axis=-1)


def driven(
    name: str,
    variant: str,
    parameters: dict[str, float],
    driver: Callable[[Any, Any, Any], tuple[Any, Any, Any, Any]],
    pull: Callable[[Any, Any, Any], tuple[Any, Any, Any]],
    start: tuple[Sequence[float], Sequence[float]],
    chaotic: bool = False,
) -> Model:
    """Particle in R^3 with x' + f(y) z' = 0 in the potential V(y) + U(x, z).

    driver : (sin, cos as a module, y, p) -> f, f', V, V'.  pull : (x, z, p) -> U, U_x, U_z.
    start : (x, y, z) and (y', z'); x' follows.
    """
    p = _Numbers(parameters)
    (x, y, z), (w, s) = start
    base, f = np.array([x, y, z]), driver(np, y, p)[0]
    system = gni.MechanicalSystem(
        gni.PairGroupoid(3),
        metric=lambda q, p: np.eye(3),
        potential=lambda q, p: driver(np, q[1], p)[2] + pull(q[0], q[2], p)[0],
        constraints=lambda q, p: np.array([[1.0, 0.0, driver(np, q[1], p)[0]]]),
        parameters=parameters,
    )
    velocity = np.array([-f * s, w, s])
    scene = gni.scenes.Scene(system, system.state(base, velocity), name)

    def taylor(hy: Any, u: Expressions) -> list[Any]:
        f, f_prime, _, v_prime = driver(hy, u[1], p)
        _, ux, uz = pull(u[0], u[2], p)
        rate = (f * ux - uz - f * f_prime * u[3] * u[4]) / (1.0 + f * f)
        return [-f * u[4], u[3], u[4], -v_prime, rate]

    def library_state(u: np.ndarray) -> np.ndarray:
        along = -driver(np, u[..., 1], p)[0] * u[..., 4]
        return np.concatenate([u[..., :3], along[..., None], u[..., 3:]], axis=-1)

    form = HandDerived(
        "", ("-DDRIVEN", variant), tuple(parameters.values()), np.array([x, y, z, w, s]),
        taylor, library_state,
    )  # fmt: skip

    def rates(t: float, u: np.ndarray) -> np.ndarray:
        f, f_prime, _, v_prime = driver(np, u[1], p)
        _, ux, uz = pull(u[0], u[2], p)
        mu, bias = np.array([[1.0, 0.0, f]]), np.array([-f_prime * u[4] * u[5]])
        change = constrained(np.eye(3), mu, -np.array([ux, v_prime, uz]), bias)
        return np.concatenate([u[3:], change])

    def look(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        f, _, v, _ = driver(np, u[..., 1], p)
        potential = v + pull(u[..., 0], u[..., 2], p)[0]
        energy = 0.5 * np.sum(u[..., 3:] ** 2, axis=-1) + potential
        return energy, np.abs(u[..., 3] + f * u[..., 5])

    numpy_form = NumpyForm(rates, np.concatenate([base, velocity]), _itself)
    return Model(name, scene, (form,), numpy_form, look, chaotic)


class _Numbers:
    """Parameters by attribute, as the library hands them over."""

    def __init__(self, values: dict[str, float]) -> None:
        self.__dict__.update(values)


def quartic_particle() -> Model:
    """z' = y x' in V(y) + U(x), both quartic; x and z change names. Integrable, reversible.

    With u = x' sqrt(1 + y^2): u' = -U'(x) / sqrt(1 + y^2), so (x, u) moves along the level set of
    u^2/2 + U(x) in a time that y(t) alone decides.
    """
    return driven(
        "particle, quartic", "-DQUARTIC", {"k": 0.7, "c": 1.3},
        lambda m, y, p: (-y, -1.0, 0.5 * y**2.0 + 0.25 * p.k * y**4.0, y + p.k * y**3.0),
        _quartic_pull,
        ((0.0, 0.5, 0.4), (0.8, 1.0)),
    )  # fmt: skip


def _quartic_pull(x: Any, z: Any, p: Any) -> tuple[Any, Any, Any]:
    return 0.25 * p.c * z**4.0, 0.0 * z, p.c * z**3.0


def gearbox(shifted: bool = True) -> Model:
    """Continuously variable transmission with a rotating driver; not reversible.

    f = sin y, or 0.3 + sin y + 0.4 cos y + 0.5 sin 2y when ``shifted``.
    """
    offsets = (0.3, 0.4, 0.5) if shifted else (0.0, 0.0, 0.0)
    names = ("e", "w", "c", "f0", "f2", "f3")

    def driver(m: Any, y: Any, p: Any) -> tuple[Any, Any, Any, Any]:
        sine, cosine = m.sin(y), m.cos(y)
        twice_sine, twice_cosine = 2.0 * sine * cosine, 1.0 - 2.0 * sine * sine
        f = p.f0 + sine + p.f2 * cosine + p.f3 * twice_sine
        f_prime = cosine - p.f2 * sine + 2.0 * p.f3 * twice_cosine
        return f, f_prime, cosine + 0.5 * p.e * twice_sine, p.e * twice_cosine - sine

    def pull(x: Any, z: Any, p: Any) -> tuple[Any, Any, Any]:
        xx, zz = x * x, z * z
        potential = 0.5 * (xx + p.w * zz) + p.c * (0.25 * xx * xx + 0.5 * xx * zz)
        return potential, x + p.c * x * (xx + zz), p.w * z + p.c * z * xx

    name = "transmission, shifted f" if shifted else "transmission, f = sin y"
    return driven(
        name, "-DGEARBOX", dict(zip(names, (0.5, 1.7, 0.3, *offsets), strict=True)),
        driver, pull, ((1.0, 0.3, 0.5), (2.5, 0.3)),
    )  # fmt: skip


def contact_oscillator(eps: float = 0.3) -> Model:
    """McLachlan and Perlmutter 2006, section 5.2: H = 1.5, 0.5 of it along y, z = -0.55, at rest.

    With eps = 0.3 neighbouring motions part like t over 3e3 time units, with eps = 2 by 1e9 in
    3e2: the second is the chaotic case.
    """
    z = -0.55
    x = math.sqrt((2 * 1.5 - z**2 - 1.0) / (1.0 + eps * z**2))
    return driven(
        f"contact oscillator, eps = {eps:g}", "-DCONTACT", {"eps": eps},
        lambda m, y, p: (y, 1.0, 0.5 * y * y, y),
        lambda x, z, p: (
            0.5 * (x * x + z * z + p.eps * x * x * z * z),
            x + p.eps * x * (z * z),
            z + p.eps * z * (x * x),
        ),
        ((x, 1.0, z), (0.0, 0.0)), chaotic=eps > 1.0,
    )  # fmt: skip


def constrained(
    metric: np.ndarray, mu: np.ndarray, force: np.ndarray, bias: np.ndarray
) -> np.ndarray:
    """Accelerations with G a = force + mu^T lambda, mu a = bias."""
    m, n = mu.shape
    saddle = np.zeros((n + m, n + m))
    saddle[:n, :n], saddle[:n, n:], saddle[n:, :n] = metric, -mu.T, mu
    return np.linalg.solve(saddle, np.concatenate([force, bias]))[:n]


def _itself(y: np.ndarray) -> np.ndarray:
    return y


def _dot(a: Expressions, b: Expressions) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Expressions, b: Expressions) -> list[Any]:
    return [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]


def _rows_of_quaternion(
    q: Expressions, two: Any = 2.0
) -> tuple[list[Any], list[Any], list[Any]]:
    """The rows of R(q); ``two`` is 2 over the square of the length."""
    w, x, y, z = q
    return (
        [1.0 - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)],
        [two * (x * y + w * z), 1.0 - two * (x * x + z * z), two * (y * z - w * x)],
        [two * (x * z - w * y), two * (y * z + w * x), 1.0 - two * (x * x + y * y)],
    )


def _quaternion(R: np.ndarray) -> np.ndarray:
    """(w, x, y, z) of a rotation by less than half a turn."""
    w = 0.5 * math.sqrt(1.0 + np.trace(R))
    return np.array(
        [w, *((R[k, j] - R[j, k]) / (4.0 * w) for j, k in ((1, 2), (2, 0), (0, 1)))]
    )


def _rotation_of_quaternion(q: np.ndarray) -> np.ndarray:
    rows = _rows_of_quaternion(np.moveaxis(q, -1, 0))
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _rotation_of_rows(ab: np.ndarray) -> np.ndarray:
    a, b = ab[..., :3], ab[..., 3:]
    return np.stack([a, b, np.cross(a, b)], axis=-2)


# DOP853 in C.


@dataclass(frozen=True)
class Run:
    """Seconds, and the state at the end in the library's coordinates."""

    seconds: float
    end: np.ndarray
    steps: int = 0


class C:
    """DOP853 of ``c/dop853.h`` compiled for one form."""

    def __init__(self, form: HandDerived, folder: Path, extended: bool = False) -> None:
        label = "_".join(d.strip("-") for d in form.defines) + ("_long" if extended else "")
        target = folder / f"{label}.so"
        number = ["-DREAL=long double"] if extended else []
        command = [str(step_cost.c_compiler()), *FLAGS, *number, "-shared", "-fPIC", *form.defines]
        subprocess.run([*command, str(SOURCE), "-o", str(target), "-lm"], check=True)
        library = ctypes.CDLL(str(target))
        pointer, number_ = ctypes.c_void_p, ctypes.c_double
        self._solve = library.solve
        self._solve.restype = ctypes.c_int64
        self._solve.argtypes = [pointer, number_, number_, number_, pointer, pointer, pointer]
        self._look = library.look
        self._look.argtypes = [pointer, pointer, pointer]
        self.form = form
        self._real = np.longdouble if extended else np.float64
        self._parameters = np.array(form.parameters, dtype=float)
        self._counts = np.zeros(2, dtype=np.int64)

    def run(self, t_end: float, rtol: float) -> Run:
        """From the start to t_end, absolute tolerance = relative tolerance."""
        y = self.form.start.astype(self._real)
        seconds = self.advance(y, t_end, rtol)
        end = self.form.library_state(y).astype(float)
        return Run(seconds, end, int(self._counts[1]))

    def advance(
        self, y: np.ndarray, t: float, rtol: float, watched: np.ndarray | None = None
    ) -> float:
        """Move native variables by t and return the seconds; see ``solve`` for ``watched``."""
        given = (
            self._parameters.ctypes.data, t, rtol, rtol, y.ctypes.data, self._counts.ctypes.data,
            None if watched is None else watched.ctypes.data,
        )  # fmt: skip
        began = time.perf_counter()
        status = self._solve(*given)
        seconds = time.perf_counter() - began
        if status < 0:
            raise RuntimeError(f"DOP853 in C: step too small at rtol = {rtol:g}")
        return seconds

    def energy_and_violation(self, y: np.ndarray) -> np.ndarray:
        """Two numbers of one native state."""
        found = np.zeros(2)
        state = y.astype(self._real)
        self._look(self._parameters.ctypes.data, state.ctypes.data, found.ctypes.data)
        return found


# heyoka.


def heyoka_module() -> Any:
    """The module, or None when it is not installed (extra ``peers``)."""
    try:
        import heyoka
    except ImportError:
        return None
    return heyoka


class Taylor:
    """heyoka's adaptive Taylor method for one form, one integrator object per tolerance.

    high_accuracy is off; numbers are compiled in. ``compact`` compiles sooner and runs slower.
    """

    def __init__(
        self, form: HandDerived, hy: Any, fast_math: bool = False, compact: bool = False
    ) -> None:
        names = [f"y{i}" for i in range(len(form.start))]
        variables = hy.make_vars(*names)
        rates = form.taylor(hy, variables)
        self._system = [
            (v, rate + hy.expression(0.0)) for v, rate in zip(variables, rates, strict=True)
        ]
        self._hy, self.form, self._fast_math, self._compact = hy, form, fast_math, compact
        self._integrators: dict[float, Any] = {}

    def at(self, tolerance: float) -> Any:
        """The integrator of this tolerance, at the start."""
        if tolerance not in self._integrators:
            self._integrators[tolerance] = self._hy.taylor_adaptive(
                self._system, list(self.form.start), tol=tolerance, high_accuracy=False,
                compact_mode=self._compact, fast_math=self._fast_math,
            )  # fmt: skip
        integrator = self._integrators[tolerance]
        integrator.time = 0.0
        integrator.state[:] = self.form.start
        return integrator

    def run(self, t_end: float, tolerance: float) -> Run:
        """From the start to t_end; only ``propagate_until`` is timed."""
        integrator, most = self.at(tolerance), most_steps(t_end)
        began = time.perf_counter()
        outcome, _, _, steps, *_ = integrator.propagate_until(t_end, max_steps=most)
        seconds = time.perf_counter() - began
        if outcome != self._hy.taylor_outcome.time_limit:
            raise RuntimeError(f"heyoka: {outcome}")
        return Run(seconds, self.form.library_state(np.array(integrator.state)), steps)


def most_steps(t_end: float) -> int:
    """Steps after which an adaptive run has lost its way."""
    return 10_000 + round(200.0 * t_end)


# SciPy.


class SciPy:
    """``solve_ivp`` with the NumPy right-hand side."""

    def __init__(self, numpy_form: NumpyForm, method: str) -> None:
        self._form, self._method = numpy_form, method

    def run(self, t_end: float, rtol: float) -> Run:
        """From the start to t_end, absolute tolerance a hundredth of the relative one."""
        from scipy.integrate import solve_ivp

        began = time.perf_counter()
        solution = solve_ivp(
            self._form.field, (0.0, t_end), self._form.start, method=self._method,
            rtol=rtol, atol=1e-2 * rtol,
        )  # fmt: skip
        seconds = time.perf_counter() - began
        if not solution.success:
            raise RuntimeError(f"{self._method}: {solution.message}")
        return Run(seconds, self._form.library_state(solution.y[:, -1]), solution.nfev)
