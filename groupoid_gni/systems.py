"""What moves: a mechanical system with affine constraints on the Lie algebroid of a groupoid.

``L(a) = 1/2 G_x(a, a) + <A_x, a> - V(x)`` on AG, with constraints ``mu(x) (xi - Y(x)) = 0``.
The functions are recorded once; a system is frozen and its recordings are shared by every copy
that ``with_parameters`` makes.
"""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from reprlib import repr as short
from types import MappingProxyType
from typing import Any

import numpy as np

from groupoid_gni.array_types import Array, ArrayLike, FloatArray
from groupoid_gni.errors import DependentConstraintsWarning, InputError
from groupoid_gni.expressions import RecordedFunction, record, verify
from groupoid_gni.expressions.explanation import location
from groupoid_gni.groupoids import LieGroupoid

BaseFunction = Callable[[Any, Any], Any]

_RANK_TOLERANCE = 1e-10
# the step gives up when a row is within 3e-7 of the span of the others
_NEARLY_DEPENDENT = 1e-5
_EPSILON = float(np.finfo(float).eps)
_CONSTRAINT_TOLERANCE = 1e-9
_GROUP_TOLERANCE = 1e-9


class Parameters:
    """The physical parameters of a system, read as attributes: ``p.m``, ``p.Theta``."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        self.__dict__.update(values)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        known = ", ".join(self.__dict__) or "none"
        raise AttributeError(f"the system has no parameter {name!r}; its parameters are: {known}")

    def __repr__(self) -> str:
        return "Parameters(" + ", ".join(f"{k}={v!r}" for k, v in self.__dict__.items()) + ")"


@dataclass(frozen=True)
class ParameterLayout:
    """How named parameters of fixed shapes lie in one flat vector."""

    shapes: tuple[tuple[str, tuple[int, ...]], ...]

    @property
    def size(self) -> int:
        """Length of the flat vector."""
        return sum(int(np.prod(shape)) for _, shape in self.shapes)

    def flatten(self, values: Mapping[str, FloatArray]) -> FloatArray:
        """One flat float vector from named values."""
        parts = [np.ravel(values[name]) for name, _ in self.shapes]
        return np.concatenate(parts) if parts else np.zeros(0)

    def namespace(self, flat: Array) -> Parameters:
        """Named views into a flat (possibly recorded) vector."""
        values, start = {}, 0
        for name, shape in self.shapes:
            size = int(np.prod(shape))
            part = flat[start : start + size]
            values[name] = part[0] if shape == () else part.reshape(shape)
            start += size
        return Parameters(values)


@dataclass(frozen=True, eq=False)
class State:
    """A consistent start: base point, velocity in the frame of AG, momentum; read-only.

    active_rows : the constraint rows kept at this state (dependent ones are left out).
    """

    base: FloatArray
    velocity: FloatArray
    momentum: FloatArray
    active_rows: tuple[int, ...]

    def __post_init__(self) -> None:
        for array in (self.base, self.velocity, self.momentum):
            array.setflags(write=False)


@dataclass(frozen=True)
class _Rows:
    """Which constraint rows are independent at a point, and what is wrong with the others."""

    kept: tuple[int, ...]
    zero: tuple[int, ...]
    dependent: tuple[int, ...]
    nearly: tuple[int, ...]

    def warn(self, stacklevel: int) -> None:
        """Warn of rows that are left out, and of rows that soon may be."""
        parts = []
        if self.dependent:
            parts.append(f"row(s) {list(self.dependent)} depend on the rows {list(self.kept)}")
        if self.zero:
            parts.append(f"row(s) {list(self.zero)} are zero")
        if parts:
            text = (
                f"constraint {' and '.join(parts)} at the start: left out of the step; the motion "
                "is checked against them"
            )
            warnings.warn(text, DependentConstraintsWarning, stacklevel=stacklevel + 1)
        if self.nearly:
            text = (
                f"constraint row(s) {list(self.nearly)} nearly depend on the rows before them at "
                "the start: digits are lost, and the run fails where they become dependent. Leave "
                "the redundant row out, or start away from that point"
            )
            warnings.warn(text, DependentConstraintsWarning, stacklevel=stacklevel + 1)


class MechanicalSystem:
    """A mechanical system on a Lie groupoid, from plain NumPy functions.

    Parameters
    ----------
    space : LieGroupoid
        Where it moves. ``rank`` r is the number of velocity components, ``base_size`` the length
        of a base point x.
    metric : function (x, p) -> (r, r), or a constant (r, r) array
        The bundle metric G_x; symmetric and positive definite.
    constraints : function (x, p) -> (m, r), or array, optional
        The rows mu^a of the constraints ``mu(x) (xi - Y(x)) = 0``. Left out: no constraints.
    potential : function (x, p) -> scalar, optional
    drift : function (x, p) -> (r,), or array, optional
        The section Y of the affine constraints (24). Left out: linear constraints.
    gyroscopic : function (x, p) -> (r,), or array, optional
        The one-form A of a term ``<A_x, xi>`` in the Lagrangian.
    parameters : mapping name -> number or array, optional
        Physical parameters, read as ``p.name``. They stay inputs of the machine code.

    Raises
    ------
    InputError, RecordingError
        When a function has a wrong shape or cannot be recorded.
    """

    def __init__(
        self,
        space: LieGroupoid,
        metric: BaseFunction | ArrayLike,
        constraints: BaseFunction | ArrayLike | None = None,
        potential: BaseFunction | None = None,
        drift: BaseFunction | ArrayLike | None = None,
        gyroscopic: BaseFunction | ArrayLike | None = None,
        parameters: Mapping[str, Any] | None = None,
    ) -> None:
        _check_space(space)
        self.space = space
        self.parameters = _checked_parameters({} if parameters is None else parameters)
        self._layout = ParameterLayout(tuple((k, v.shape) for k, v in self.parameters.items()))
        self._plain: dict[str, BaseFunction] = {}
        r = space.rank
        self._shapes = {"metric": (r, r), "potential": (), "drift": (r,), "gyroscopic": (r,)}
        self._register("metric", metric)
        self._register("constraints", constraints)
        self._register("potential", potential)
        self._register("drift", drift)
        self._register("gyroscopic", gyroscopic)
        if drift is not None and constraints is None:
            raise InputError("drift needs constraints: it is the section Y in mu (xi - Y) = 0")
        self._shapes["constraints"] = (self._count_rows(), r)
        self._recorded: dict[str, RecordedFunction] = {}
        self._compiled: dict[Any, Any] = {}
        for name in self._plain:
            self.recorded(name)
        self._frozen = True

    def __setattr__(self, name: str, value: Any) -> None:
        if "_frozen" in self.__dict__:
            raise AttributeError(
                f"a MechanicalSystem is frozen, {name!r} cannot be set; use "
                "system.with_parameters(...) or build a new one"
            )
        super().__setattr__(name, value)

    def _register(self, name: str, given: BaseFunction | ArrayLike | None) -> None:
        if given is None:
            return
        if callable(given):
            _check_signature(name, given)
            self._plain[name] = given
            return
        constant = _constant_array(name, given, self._shapes.get(name))
        self._plain[name] = _constant_function(constant)

    def _count_rows(self) -> int:
        if "constraints" not in self._plain:
            return 0
        point = np.array(self.space.example_base_point, dtype=float)
        try:
            with np.errstate(all="ignore"):
                value = self._plain["constraints"](point, self._namespace())
            shape = np.shape(value)
        except Exception as error:
            raise InputError(
                f"constraints ({location(self._plain['constraints'])}) failed at the example base "
                f"point {point}: {type(error).__name__}: {error}"
            ) from error
        if len(shape) != 2 or shape[1] != self.space.rank:
            raise InputError(
                f"constraints must return an array of shape (m, {self.space.rank}), one row per "
                f"constraint and one column per velocity component; got shape {shape}. "
                "A single constraint is [[...]], with two brackets"
            )
        return int(shape[0])

    @property
    def constraint_count(self) -> int:
        """m, the number of constraint rows as given."""
        return int(self._shapes["constraints"][0])

    @property
    def parameter_layout(self) -> ParameterLayout:
        """Order and shapes of the parameters in the flat vector the machine code reads."""
        return self._layout

    @property
    def parameter_vector(self) -> FloatArray:
        """The current parameter values as one flat vector."""
        return self._layout.flatten(self.parameters)

    def _namespace(self) -> Parameters:
        return self._layout.namespace(self.parameter_vector)

    def has(self, name: str) -> bool:
        """Whether the system was given a ``potential``, ``drift``, ``gyroscopic`` term, ..."""
        return name in self._plain

    def recorded(self, name: str) -> RecordedFunction:
        """The recording of one of the functions, taking (base point, flat parameters)."""
        self._check_name(name)
        if name not in self._recorded:
            if name not in self._plain:
                raise InputError(
                    f"this system has no {name}; it has: {', '.join(self._plain)}"
                )
            self._recorded[name] = self._record(name)
        return self._recorded[name]

    def _check_name(self, name: str) -> None:
        if name not in self._shapes:
            raise InputError(f"unknown term {name!r}; the terms are: {', '.join(self._shapes)}")

    def _record(self, name: str) -> RecordedFunction:
        inputs = {"x": (self.space.base_size,), "parameters": (self._layout.size,)}
        return record(self._with_flat_parameters(name), inputs, self._shapes[name], name=name)

    def _with_flat_parameters(self, name: str) -> Callable[[Array, Array], Any]:
        plain, layout = self._plain[name], self._layout

        def with_flat_parameters(x: Array, flat: Array) -> Any:
            return plain(x, layout.namespace(flat))

        with_flat_parameters.__wrapped__ = plain  # type: ignore[attr-defined]
        return with_flat_parameters

    def compiled(
        self, method: Any = None, active_rows: tuple[int, ...] | None = None
    ) -> Any:
        """The machine code of a method (``GNI()`` when left out); ``.source`` is its LLVM IR.

        active_rows : constraint rows to keep; all of them when left out.
        """
        from groupoid_gni.discretization import DiscreteLagrangian
        from groupoid_gni.integrators import GNI, compiled_step

        method = GNI() if method is None else method
        if not isinstance(method, (DiscreteLagrangian, GNI)):
            raise InputError(f"method must be gni.GNI() or a discrete Lagrangian, not {method!r}")
        count = self.constraint_count
        rows = tuple(range(count)) if active_rows is None else tuple(active_rows)
        if not all(isinstance(row, int) and 0 <= row < count for row in rows):
            raise InputError(f"active_rows must be numbers from 0 to {count - 1}, got {rows}")
        return compiled_step(self, method, rows).code  # type: ignore[attr-defined]

    def with_parameters(self, **changes: Any) -> MechanicalSystem:
        """The same system with some parameters changed; recordings and machine code are shared."""
        unknown = sorted(set(changes) - set(self.parameters))
        if unknown:
            raise InputError(
                f"unknown parameter {unknown[0]!r}; this system has: "
                f"{', '.join(self.parameters) or 'none'}"
            )
        values = _checked_parameters({**self.parameters, **changes})
        for name, shape in self._layout.shapes:
            if values[name].shape != shape:
                raise InputError(
                    f"parameter {name!r} has shape {values[name].shape}, the system was built "
                    f"with {shape}; build a new MechanicalSystem to change a shape"
                )
        copy = object.__new__(type(self))
        copy.__dict__.update(self.__dict__)
        copy.__dict__["parameters"] = values
        return copy

    def evaluate(self, name: str, base: ArrayLike) -> FloatArray:
        """Value of ``metric``, ``constraints``, ... at base points (..., base_size).

        Terms that were left out are zero.
        """
        self._check_name(name)
        point = real_array("base", base)
        if point.shape[-1:] != (self.space.base_size,):
            raise InputError(
                f"base points must have shape (..., {self.space.base_size}), got {point.shape}"
            )
        if name not in self._plain:
            return np.zeros(point.shape[:-1] + self._shapes[name])
        return np.asarray(self.recorded(name)(point, self.parameter_vector))

    def velocities(self, base: FloatArray, momenta: FloatArray) -> FloatArray:
        """``G^-1 (p - A)`` at many nodes: (n, base_size), (n, rank) -> (n, rank)."""
        shifted = momenta - self.evaluate("gyroscopic", base)
        metric = self.evaluate("metric", base)
        try:
            return np.asarray(np.linalg.solve(metric, shifted[..., None])[..., 0])
        except np.linalg.LinAlgError:
            return np.full_like(shifted, np.nan)

    def constraint_residuals(
        self, base: FloatArray, velocities: FloatArray, relative: bool = False
    ) -> FloatArray:
        """``mu (xi - Y)`` of all rows at many nodes: (n, base_size), (n, rank) -> (n, m).

        relative : divided by ``|mu^a| (|xi| + |Y|)`` in the norms of the metric.
        """
        mu, drift = self.evaluate("constraints", base), self.evaluate("drift", base)
        residuals = np.einsum("nar,nr->na", mu, velocities - drift)
        if relative and self.constraint_count:
            size = _largest_violations(mu, self.evaluate("metric", base), velocities, drift)
            residuals = residuals / np.where(size > 0.0, size, 1.0)
        return np.asarray(residuals)

    def state(
        self,
        base: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        *,
        project_start: bool = False,
    ) -> State:
        """A checked start.

        base : (base_size,); may be left out when the base is a point (a Lie group).
        velocity : (rank,), components in the frame of AG: base part first, then group part.
        project_start : move the velocity to the nearest one (in the metric) that satisfies the
            constraints, and the base point to the nearest one on the base manifold, instead of
            refusing.
        Raises InputError naming the violation and the mend.
        """
        start, rows = self._state(base, velocity, project_start)
        rows.warn(stacklevel=2)
        return start

    def checked_again(self, start: State) -> State:
        """A start made earlier, perhaps with other parameters, checked for this system; silent."""
        base = start.base if self.space.base_size else None
        return self._state(base, start.velocity, False)[0]

    def _state(
        self, base: ArrayLike | None, velocity: ArrayLike | None, project: bool
    ) -> tuple[State, _Rows]:
        x = self._checked_base(base, velocity, project)
        v = _finite_vector("velocity", velocity, self.space.rank)
        # what is not finite is refused by name below, whatever NumPy was told to do about it
        with np.errstate(all="ignore"):
            self._verify_recordings(x)
            metric = self._checked_metric(x)
            self._check_finite_terms(x)
            rows = self._independent_rows(x, metric)
            v = self._on_constraints(x, v, metric, rows.kept, project)
            momentum = metric @ v + self.evaluate("gyroscopic", x)
        if not np.all(np.isfinite(momentum)):
            raise InputError(f"the momentum G xi + A overflows {_place(x)}: {momentum}")
        return State(x, v, momentum, rows.kept), rows

    def _checked_base(
        self, base: ArrayLike | None, velocity: ArrayLike | None, project: bool
    ) -> FloatArray:
        size = self.space.base_size
        if size == 0 and velocity is None and base is not None:
            raise InputError(
                f"velocity is missing: the base of {type(self.space).__name__} is a point, so "
                "call state(velocity=...)"
            )
        if base is None:
            if size:
                raise InputError(
                    f"base is missing: a base point of {type(self.space).__name__} has {size} "
                    f"components, for example {np.asarray(self.space.example_base_point)}"
                )
            return np.zeros(0)
        x = _finite_vector("base", base, size)
        defect = float(np.max(self.space.base_defect(x), initial=0.0)) if size else 0.0
        if project:
            for _ in range(50):
                if not _GROUP_TOLERANCE / 1e4 < defect < 1.0:
                    break
                x = np.asarray(self.space.restore_base(x))
                defect = float(np.max(self.space.base_defect(x)))
        if defect > _GROUP_TOLERANCE:
            raise InputError(
                f"base lies off the base manifold of {type(self.space).__name__} by {defect:.3g} "
                f"(allowed {_GROUP_TOLERANCE:.0e}): a rotation block is not orthogonal, or has "
                "determinant -1. Mend the matrix, or pass project_start=True if it is only "
                "slightly off"
            )
        return x

    def _verify_recordings(self, x: FloatArray) -> None:
        points = [x]
        rng = np.random.default_rng(20150225)
        for size in (0.01, 0.05):
            xi = size * rng.uniform(-1.0, 1.0, self.space.rank)
            points.append(np.asarray(self.space.target(self.space.retract(x, xi)), dtype=float))
        arguments = [(point, self.parameter_vector) for point in points]
        for name in self._plain:
            verify(self.recorded(name), self._with_flat_parameters(name), arguments)

    def _check_finite_terms(self, x: FloatArray) -> None:
        """The terms of the Lagrangian and of the constraints must be finite at the start."""
        for name in self._plain:
            value = self.evaluate(name, x)
            if not np.all(np.isfinite(value)):
                raise InputError(
                    f"{name} ({location(self._plain[name])}) is not finite {_place(x)}: {value}; "
                    "start inside its domain"
                )
        if "potential" not in self._plain:
            return
        slope = np.asarray(self.recorded("potential").derivative(0)(x, self.parameter_vector))
        if not np.all(np.isfinite(slope)):
            raise InputError(
                f"potential ({location(self._plain['potential'])}) has no finite derivative "
                f"{_place(x)}: {slope}; start elsewhere, or smooth it (a norm has none at zero)"
            )

    def _checked_metric(self, x: FloatArray) -> FloatArray:
        metric = self.evaluate("metric", x)
        where = _place(x)
        if not np.all(np.isfinite(metric)):
            raise InputError(f"metric is not finite {where}:\n{metric}")
        asymmetry = float(np.max(np.abs(metric - metric.T)))
        if asymmetry > 1e-12 * float(np.max(np.abs(metric))):
            i, j = np.unravel_index(np.argmax(np.abs(metric - metric.T)), metric.shape)
            raise InputError(
                f"metric is not symmetric {where}: entry [{i},{j}] is {metric[i, j]:.6g} but "
                f"[{j},{i}] is {metric[j, i]:.6g}; return (G + G.T) / 2 if that is what you mean"
            )
        scale = np.sqrt(np.abs(np.diag(metric)))
        scale[scale == 0.0] = 1.0
        smallest = float(np.min(np.linalg.eigvalsh(metric / np.outer(scale, scale))))
        if smallest <= len(scale) * _EPSILON:
            raise InputError(
                f"metric is not positive definite {where}: its smallest eigenvalue is "
                f"{float(np.min(np.linalg.eigvalsh(metric))):.3g}; every direction needs inertia "
                "(leave a massless direction out of the model, or give it a small mass)"
            )
        return metric

    def independent_rows(self, base: FloatArray) -> tuple[int, ...]:
        """Constraint rows that are independent at a base point; warns about the others."""
        rows = self._independent_rows(base, self._checked_metric(base))
        rows.warn(stacklevel=3)
        return rows.kept

    def _independent_rows(self, x: FloatArray, metric: FloatArray) -> _Rows:
        """Gram-Schmidt, twice, in the inverse metric."""
        mu = self.evaluate("constraints", x)
        if not np.all(np.isfinite(mu)):
            raise InputError(f"constraints are not finite {_place(x)}: {mu}")
        orthonormal: list[FloatArray] = []
        kept, zero, dependent, nearly = [], [], [], []
        for a, row in enumerate(np.linalg.solve(np.linalg.cholesky(metric), mu.T).T):
            size = float(np.linalg.norm(row))
            if size == 0.0:
                zero.append(a)
                continue
            rest = row / size
            for q in orthonormal * 2:
                rest = rest - q * (q @ rest)
            left = float(np.linalg.norm(rest))
            if left <= _RANK_TOLERANCE:
                dependent.append(a)
                continue
            if left <= _NEARLY_DEPENDENT:
                nearly.append(a)
            kept.append(a)
            orthonormal.append(rest / left)
        return _Rows(tuple(kept), tuple(zero), tuple(dependent), tuple(nearly))

    def _on_constraints(
        self,
        x: FloatArray,
        v: FloatArray,
        metric: FloatArray,
        rows: tuple[int, ...],
        project: bool,
    ) -> FloatArray:
        mu = self.evaluate("constraints", x)
        drift = self.evaluate("drift", x)
        violation = mu @ (v - drift)
        size = _largest_violations(mu[None], metric[None], v[None], drift[None])[0] + 1e-300
        nearest = _nearest_velocity(v, metric, mu[list(rows)], violation[list(rows)])
        if not project and np.max(np.abs(violation) / size, initial=0.0) > _CONSTRAINT_TOLERANCE:
            raise InputError(
                f"the start violates the constraints {_place(x)}: mu (xi - Y) = {violation}, row "
                f"by row. Give a velocity that satisfies them; the nearest one, which "
                f"project_start=True takes, is {nearest}"
            )
        return nearest


def _largest_violations(
    mu: FloatArray, metric: FloatArray, v: FloatArray, drift: FloatArray
) -> FloatArray:
    """``|mu^a| (|xi| + |Y|)`` in the norms of the metric, (n, m): no violation can be larger."""
    raised = np.linalg.solve(metric, np.swapaxes(mu, 1, 2))
    rows = np.sqrt(np.einsum("nar,nra->na", mu, raised))
    speed = sum(np.sqrt(np.einsum("nr,nrs,ns->n", u, metric, u)) for u in (v, drift))
    return np.asarray(rows * np.reshape(speed, (-1, 1)))


def _nearest_velocity(
    v: FloatArray, metric: FloatArray, mu: FloatArray, violation: FloatArray
) -> FloatArray:
    """The velocity nearest to v in the metric with ``mu (nearest - v) = -violation``."""
    if not len(mu):
        return v
    lower = np.linalg.cholesky(metric)
    change = np.linalg.lstsq(np.linalg.solve(lower, mu.T).T, violation, rcond=None)[0]
    return np.asarray(v - np.linalg.solve(lower.T, change))


def _place(x: FloatArray) -> str:
    return f"at the base point {x}" if x.size else "at the only base point"


def _check_space(space: Any) -> None:
    if isinstance(space, type):
        raise InputError(
            f"space is the class {space.__name__}; pass an instance of it: {space.__name__}(...)"
        )
    if not isinstance(space, LieGroupoid):
        raise InputError(
            f"space must be a LieGroupoid, not {type(space).__name__}; a Lie group or "
            "PairGroupoid(n) will do, or subclass gni.LieGroupoid"
        )


def _checked_parameters(values: Mapping[str, Any]) -> Mapping[str, FloatArray]:
    if not isinstance(values, Mapping):
        raise InputError(
            f"parameters must be a mapping from names to numbers, such as dict(m=1.5), not "
            f"{values!r}"
        )
    checked = {}
    for name, value in values.items():
        if not isinstance(name, str) or not name.isidentifier() or name.startswith("__"):
            raise InputError(
                f"parameter name {name!r} cannot be read as p.name; use letters, digits and _"
            )
        array = np.array(real_array(f"parameter {name!r}", value))
        if not np.all(np.isfinite(array)):
            raise InputError(f"parameter {name!r} is not finite: {value!r}")
        array.setflags(write=False)
        checked[name] = array
    return MappingProxyType(checked)


def _check_signature(name: str, function: BaseFunction) -> None:
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return
    try:
        signature.bind(None, None)
    except TypeError as error:
        raise InputError(
            f"{name} must take two arguments (x, p): the base point and the parameters; "
            f"its signature is {signature}"
        ) from error


def _constant_function(constant: FloatArray) -> BaseFunction:
    def constant_function(x: Any, p: Any) -> FloatArray:
        return constant

    return constant_function


def _constant_array(name: str, given: ArrayLike, shape: tuple[int, ...] | None) -> FloatArray:
    constant = np.array(real_array(f"{name}, unless it is a function (x, p),", given))
    if not np.all(np.isfinite(constant)):
        raise InputError(f"{name} holds NaN or infinity:\n{constant}")
    if shape is not None and constant.shape != shape:
        raise InputError(f"{name} must have shape {shape}, got {constant.shape}")
    constant.setflags(write=False)
    return constant


def real_array(name: str, given: Any) -> FloatArray:
    """Real numbers of any kind as floats; text, complex, masked and ragged input is refused."""
    if isinstance(given, np.ma.MaskedArray) and np.ma.is_masked(given):
        raise InputError(f"{name} has masked entries; fill them first: array.filled(value)")
    try:
        array = np.asarray(given)
        if array.dtype.kind == "O":
            array = np.array(given, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} must hold real numbers, got {short(given)}: {error}") from error
    if array.dtype.kind not in "biuf":
        raise InputError(f"{name} must hold real numbers, got {array.dtype}: {short(given)}")
    return array.astype(float, copy=False)


def _finite_vector(name: str, given: ArrayLike | None, size: int) -> FloatArray:
    if given is None:
        raise InputError(f"{name} is missing; it needs {size} components")
    vector = np.array(real_array(name, given))
    if vector.shape != (size,):
        raise InputError(
            f"{name} must have shape ({size},), got {vector.shape}; components are ordered base "
            "part, then group part, rotations before translations"
        )
    bad = np.flatnonzero(~np.isfinite(vector))
    if bad.size:
        raise InputError(f"{name}[{bad[0]}] is {vector[bad[0]]}; every component must be finite")
    return vector
