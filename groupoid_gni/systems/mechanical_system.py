"""A mechanical system with affine constraints on the Lie algebroid of a groupoid.

``L(a) = 1/2 G_x(a, a) + <A_x, a> - V(x)`` on AG, with constraints ``mu(x) (xi - Y(x)) = 0``.
The functions are recorded once; a system is frozen and its recordings are shared by every copy
that ``with_parameters`` makes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from groupoid_gni.array_types import Array, ArrayLike, FloatArray
from groupoid_gni.errors import GNIError, InputError
from groupoid_gni.expressions import RecordedFunction, record
from groupoid_gni.expressions.explanation import location
from groupoid_gni.groupoids import LieGroupoid
from groupoid_gni.systems.input_checks import (
    BaseFunction,
    check_force_signature,
    check_signature,
    check_space,
    checked_control_size,
    constant_array,
    constant_function,
    real_array,
)
from groupoid_gni.systems.parameters import ParameterLayout, Parameters, checked_parameters
from groupoid_gni.systems.starts import (
    State,
    checked_metric,
    checked_state,
    independent_rows,
    largest_violations,
    metric_norm,
    solve_each,
)


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
    force : function (x, xi, p) -> (r,), or (x, xi, p, u) -> (r,) with control inputs, optional
        An external force in A*_x G: friction, actuation. Its power is <force, xi>.
    controls : int
        Number of control inputs u, constant over each step; ``integrate(..., controls=...)``.

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
        force: Callable[..., Any] | None = None,
        controls: int = 0,
    ) -> None:
        check_space(space)
        if metric is None:
            raise InputError("metric is missing: every system needs a bundle metric G")
        self.space = space
        self.parameters = checked_parameters({} if parameters is None else parameters)
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
        self.control_size = checked_control_size(controls, force)
        self._force = force
        if force is not None:
            check_force_signature(force, self.control_size)
        self._recorded: dict[str, RecordedFunction] = {}
        self._compiled: dict[Any, Any] = {}
        for name in self._plain:
            self.recorded(name)
        if force is not None:
            self.recorded("force")
        self._frozen = True

    def __setattr__(self, name: str, value: Any) -> None:
        if "_frozen" in self.__dict__:
            raise AttributeError(
                f"a MechanicalSystem is frozen, {name!r} cannot be set; use "
                "system.with_parameters(...) or build a new one"
            )
        super().__setattr__(name, value)

    def __delattr__(self, name: str) -> None:
        raise AttributeError(f"a MechanicalSystem is frozen, {name!r} cannot be deleted")

    def __deepcopy__(self, memo: dict[int, Any]) -> MechanicalSystem:
        return self

    def __reduce__(self) -> Any:
        raise GNIError(
            "a MechanicalSystem holds functions and machine code and cannot be pickled; build it "
            "in the other process, and send runs by run.save(path), Trajectory.load(path, system)"
        )

    def _register(self, name: str, given: BaseFunction | ArrayLike | None) -> None:
        if given is None:
            return
        if callable(given):
            check_signature(name, given)
            self._plain[name] = given
            return
        constant = constant_array(name, given, self._shapes.get(name))
        self._plain[name] = constant_function(constant)

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

    @property
    def plain(self) -> Mapping[str, BaseFunction]:
        """The functions as given, by name; constants as functions."""
        return MappingProxyType(self._plain)

    def has(self, name: str) -> bool:
        """Whether the system was given a ``potential``, ``drift``, ``force``, ..."""
        return name in self._plain or (name == "force" and self._force is not None)

    def recorded(self, name: str) -> RecordedFunction:
        """The recording of one of the functions, taking (base point, flat parameters).

        That of ``force`` takes (base point, velocity, flat parameters, control inputs).
        """
        if name != "force":
            self._check_name(name)
        if name not in self._recorded:
            if name == "force" and self._force is not None:
                self._recorded[name] = self._recorded_force(self._force)
                return self._recorded[name]
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
        return record(self.with_flat_parameters(name), inputs, self._shapes[name], name=name)

    def _recorded_force(self, force: Callable[..., Any]) -> RecordedFunction:
        layout, r, size = self._layout, self.space.rank, self.control_size

        def with_flat_parameters(x: Array, xi: Array, flat: Array, u: Array) -> Any:
            given = (x, xi, layout.namespace(flat))
            return force(*given, u) if size else force(*given)

        with_flat_parameters.__wrapped__ = force  # type: ignore[attr-defined]
        inputs = {
            "x": (self.space.base_size,), "xi": (r,), "parameters": (layout.size,), "u": (size,)
        }
        return record(with_flat_parameters, inputs, (r,), name="force")

    def with_flat_parameters(self, name: str) -> Callable[[Array, Array], Any]:
        """A term as a function of (base point, flat parameters)."""
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
        from groupoid_gni.integrators import machine_code

        return machine_code(self, method, active_rows)

    def with_parameters(self, **changes: Any) -> MechanicalSystem:
        """The same system with some parameters changed; recordings and machine code are shared."""
        unknown = sorted(set(changes) - set(self.parameters))
        if unknown:
            raise InputError(
                f"unknown parameter {unknown[0]!r}; this system has: "
                f"{', '.join(self.parameters) or 'none'}"
            )
        values = checked_parameters({**self.parameters, **changes})
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

    def has_numbers_of(self, other: MechanicalSystem) -> bool:
        """Whether both are the same system with equal parameters (see ``with_parameters``)."""
        return self is other or (
            self._recorded is other._recorded
            and np.array_equal(self.parameter_vector, other.parameter_vector)
        )

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
        """``G^-1 (p - A)`` at many nodes: (n, base_size), (n, rank) -> (n, rank).

        NaN at nodes where the metric is exactly singular.
        """
        shifted = momenta - self.evaluate("gyroscopic", base)
        return solve_each(self.evaluate("metric", base), shifted[..., None])[..., 0]

    def constraint_residuals(
        self, base: FloatArray, velocities: FloatArray, relative: bool = False
    ) -> FloatArray:
        """``mu (xi - Y)`` of all rows at many nodes: (n, base_size), (n, rank) -> (n, m).

        relative : divided by ``|mu^a| (|xi| + |Y|)`` in the norms of the metric.
        """
        mu, drift = self.evaluate("constraints", base), self.evaluate("drift", base)
        residuals = np.einsum("nar,nr->na", mu, velocities - drift)
        if relative and self.constraint_count:
            residuals = residuals / self.constraint_scales(base, self.speeds(base, velocities))
        return np.asarray(residuals)

    def speeds(self, base: FloatArray, velocities: FloatArray) -> FloatArray:
        """``|xi|`` in the metric at many nodes, (n,)."""
        return metric_norm(self.evaluate("metric", base), velocities)

    def velocity_changes(self, base: FloatArray, velocities: FloatArray) -> FloatArray:
        """``|xi_k+1 - xi_k|`` relative to the larger of ``|xi_k|``, ``|xi_k+1|``, (n - 1,)."""
        change = self.speeds(base[1:], np.diff(velocities, axis=0))
        speeds = self.speeds(base, velocities)
        return np.asarray(change / np.maximum(np.maximum(speeds[1:], speeds[:-1]), 1e-300))

    def constraint_scales(self, base: FloatArray, speeds: FloatArray) -> FloatArray:
        """``|mu^a| (speed + |Y|)`` in the norms of the metric, (n, m); one where that is zero."""
        mu, drift = self.evaluate("constraints", base), self.evaluate("drift", base)
        size = largest_violations(mu, self.evaluate("metric", base), speeds, drift)
        return np.where(size > 0.0, size, 1.0)

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
        start, rows = checked_state(self, base, velocity, project_start)
        rows.warn(stacklevel=2)
        return start

    def checked_again(self, start: State) -> State:
        """A start made earlier, perhaps with other parameters, checked for this system; silent."""
        if start.checked_by is not None and start.checked_by.has_numbers_of(self):
            return start
        base = start.base if self.space.base_size else None
        return checked_state(self, base, start.velocity, False, verified=True)[0]

    def independent_rows(self, base: FloatArray) -> tuple[int, ...]:
        """Constraint rows that are independent at a base point; warns about the others."""
        rows = independent_rows(self, base, checked_metric(self, base))
        rows.warn(stacklevel=3)
        return rows.kept
