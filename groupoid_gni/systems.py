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
from typing import Any

import numpy as np

from groupoid_gni.array_types import Array, ArrayLike, FloatArray
from groupoid_gni.errors import DependentConstraintsWarning, InputError
from groupoid_gni.expressions import RecordedFunction, record, verify
from groupoid_gni.groupoids import LieGroupoid

BaseFunction = Callable[[Any, Any], Any]

_RANK_TOLERANCE = 1e-10
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


@dataclass(frozen=True)
class State:
    """A consistent start: base point, velocity in the frame of AG, momentum.

    active_rows : the constraint rows kept at this state (dependent ones are left out).
    """

    base: FloatArray
    velocity: FloatArray
    momentum: FloatArray
    active_rows: tuple[int, ...]


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
        if not isinstance(space, LieGroupoid):
            raise InputError(
                f"space must be a LieGroupoid, not {type(space).__name__}; a Lie group or "
                "PairGroupoid(n) will do, or subclass gni.LieGroupoid"
            )
        self.space = space
        self.parameters = _checked_parameters(parameters or {})
        self._layout = ParameterLayout(tuple((k, v.shape) for k, v in self.parameters.items()))
        self._plain: dict[str, BaseFunction] = {}
        r = space.rank
        self._register("metric", metric)
        self._register("constraints", constraints)
        self._register("potential", potential)
        self._register("drift", drift)
        self._register("gyroscopic", gyroscopic)
        if drift is not None and constraints is None:
            raise InputError("drift needs constraints: it is the section Y in mu (xi - Y) = 0")
        self._shapes = {
            "metric": (r, r),
            "potential": (),
            "drift": (r,),
            "gyroscopic": (r,),
            "constraints": (self._count_rows(), r),
        }
        self._recorded: dict[str, RecordedFunction] = {}
        self._compiled: dict[Any, Any] = {}
        for name in self._plain:
            self.recorded(name)

    def _register(self, name: str, given: BaseFunction | ArrayLike | None) -> None:
        if given is None:
            return
        if callable(given):
            _check_signature(name, given)
            self._plain[name] = given
            return
        constant = _constant_array(name, given)
        self._plain[name] = lambda x, p, constant=constant: constant

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
                f"constraints failed at the example base point {point}: "
                f"{type(error).__name__}: {error}"
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
        if name not in self._recorded:
            self._recorded[name] = self._record(name)
        return self._recorded[name]

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
        from groupoid_gni.integrators import GNI, compiled_step

        rows = tuple(range(self.constraint_count)) if active_rows is None else active_rows
        return compiled_step(self, GNI() if method is None else method, rows).code

    def with_parameters(self, **changes: Any) -> MechanicalSystem:
        """The same system with some parameters changed; recordings and machine code are shared."""
        unknown = sorted(set(changes) - set(self.parameters))
        if unknown:
            raise InputError(
                f"unknown parameter {unknown[0]!r}; this system has: {', '.join(self.parameters)}"
            )
        values = _checked_parameters({**self.parameters, **changes})
        for name, shape in self._layout.shapes:
            if values[name].shape != shape:
                raise InputError(
                    f"parameter {name!r} has shape {values[name].shape}, the system was built "
                    f"with {shape}; build a new MechanicalSystem to change a shape"
                )
        copy = object.__new__(MechanicalSystem)
        copy.__dict__.update(self.__dict__)
        copy.__dict__["parameters"] = values
        return copy

    def evaluate(self, name: str, base: ArrayLike) -> FloatArray:
        """Value of ``metric``, ``constraints``, ... at base points (..., base_size).

        Terms that were left out are zero.
        """
        point = np.asarray(base, dtype=float)
        if name not in self._plain:
            return np.zeros(point.shape[:-1] + self._shapes[name])
        return np.asarray(self.recorded(name)(point, self.parameter_vector))

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
        x = self._checked_base(base, project_start)
        v = _finite_vector("velocity", velocity, self.space.rank)
        self._verify_recordings(x)
        metric = self._checked_metric(x)
        rows = self._independent_rows(x, metric)
        v = self._on_constraints(x, v, metric, rows, project_start)
        momentum = metric @ v + self.evaluate("gyroscopic", x)
        return State(x, v, momentum, rows)

    def _checked_base(self, base: ArrayLike | None, project: bool) -> FloatArray:
        size = self.space.base_size
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
        for name in self._plain:
            verify(
                self.recorded(name),
                self._with_flat_parameters(name),
                [(point, self.parameter_vector) for point in points],
            )

    def _checked_metric(self, x: FloatArray) -> FloatArray:
        metric = self.evaluate("metric", x)
        where = f"at the base point {x}" if x.size else "at the only base point"
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
        if smallest <= 0.0:
            raise InputError(
                f"metric is not positive definite {where}: its smallest eigenvalue is "
                f"{float(np.min(np.linalg.eigvalsh(metric))):.3g}; every direction needs inertia "
                "(leave a massless direction out of the model, or give it a small mass)"
            )
        return metric

    def independent_rows(self, base: FloatArray) -> tuple[int, ...]:
        """Constraint rows that are independent at a base point; warns about the others."""
        return self._independent_rows(base, self._checked_metric(base))

    def _independent_rows(self, x: FloatArray, metric: FloatArray) -> tuple[int, ...]:
        mu = self.evaluate("constraints", x)
        drift = self.evaluate("drift", x)
        if not (np.all(np.isfinite(mu)) and np.all(np.isfinite(drift))):
            raise InputError(f"constraints or drift are not finite at the base point {x}")
        lower = np.linalg.cholesky(metric)
        orthonormal: list[FloatArray] = []
        kept: list[int] = []
        dependent: list[int] = []
        for a, row in enumerate(np.linalg.solve(lower, mu.T).T):
            rest = row.copy()
            for _ in range(2):
                for q in orthonormal:
                    rest = rest - q * (q @ rest)
            size = float(np.linalg.norm(row))
            if size == 0.0 or float(np.linalg.norm(rest)) <= _RANK_TOLERANCE * size:
                dependent.append(a)
                continue
            kept.append(a)
            orthonormal.append(rest / np.linalg.norm(rest))
        if dependent:
            warnings.warn(
                f"constraint row(s) {dependent} depend on the rows {kept} at the start and are "
                "left out of the step; the motion is checked against them at the end",
                DependentConstraintsWarning,
                stacklevel=4,
            )
        return tuple(kept)

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
        size = np.abs(mu) @ (np.abs(v) + np.abs(drift)) + 1e-300
        if rows and (project or np.max(np.abs(violation) / size) <= _CONSTRAINT_TOLERANCE):
            kept = mu[list(rows)]
            normal = np.linalg.solve(metric, kept.T)
            return np.asarray(
                v - normal @ np.linalg.solve(kept @ normal, violation[list(rows)])
            )
        if np.max(np.abs(violation) / size, initial=0.0) > _CONSTRAINT_TOLERANCE:
            raise InputError(
                f"the start violates the constraints: mu (xi - Y) = {violation} at base {x}; "
                "give a velocity that satisfies them, or pass project_start=True to take the "
                "nearest one"
            )
        return v


def _checked_parameters(values: Mapping[str, Any]) -> dict[str, FloatArray]:
    checked = {}
    for name, value in values.items():
        try:
            array = np.array(value, dtype=float)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"parameter {name!r} must be a number or an array of numbers, got {value!r}"
            ) from error
        if not np.all(np.isfinite(array)):
            raise InputError(f"parameter {name!r} is not finite: {value!r}")
        array.setflags(write=False)
        checked[name] = array
    return checked


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


def _constant_array(name: str, given: ArrayLike) -> FloatArray:
    try:
        constant = np.array(given, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be a function (x, p) or an array of numbers") from error
    if not np.all(np.isfinite(constant)):
        raise InputError(f"{name} holds NaN or infinity:\n{constant}")
    constant.setflags(write=False)
    return constant


def _finite_vector(name: str, given: ArrayLike | None, size: int) -> FloatArray:
    if given is None:
        raise InputError(f"{name} is missing; it needs {size} components")
    array = np.asarray(given)
    if array.dtype.kind not in "biuf":
        try:
            array = np.array(given, dtype=float) if array.dtype.kind == "O" else array
        except (TypeError, ValueError):
            pass
        if array.dtype.kind != "f":
            raise InputError(f"{name} must hold real numbers, got dtype {array.dtype}: {given!r}")
    vector = np.array(array, dtype=float)
    if vector.shape != (size,):
        raise InputError(
            f"{name} must have shape ({size},), got {vector.shape}; components are ordered base "
            "part, then group part, rotations before translations"
        )
    bad = np.flatnonzero(~np.isfinite(vector))
    if bad.size:
        raise InputError(f"{name}[{bad[0]}] is {vector[bad[0]]}; every component must be finite")
    return vector
