"""One Newton update of a few equations, solved once and for all where they are affine."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from groupoid_gni.discretization.elimination import coupled_groups, solve_linear


@dataclass(frozen=True)
class NewtonUpdate:
    """The update of ``residual(values) = 0`` at the symbols ``values``.

    implicit : indices of the values that need a solver: groups whose equations are affine with a
        Jacobian free of the values are solved here instead, and are coupled with no others.
    residual, jacobian : of all equations.
    """

    values: ca.SX
    implicit: tuple[int, ...]
    residual: ca.SX
    jacobian: ca.SX

    @classmethod
    def of(cls, residual: ca.SX, values: ca.SX) -> NewtonUpdate:
        """Find out which values need a solver."""
        jacobian = ca.sparsify(ca.jacobian(residual, values))
        implicit: list[int] = []
        for group in coupled_groups(jacobian):
            if ca.depends_on(jacobian[group, group], values):
                implicit.extend(group)
        return cls(values, tuple(sorted(implicit)), residual, jacobian)

    @property
    def unknowns(self) -> ca.SX:
        """The values that need a solver."""
        return self.values[list(self.implicit), 0]

    @property
    def update(self) -> ca.SX:
        """Current minus better unknowns."""
        return self.response(self.residual)

    @property
    def work(self) -> ca.SX:
        """Sum of |residual * update| over the unknowns."""
        return ca.sum1(ca.fabs(self.residual[list(self.implicit), 0] * self.update))

    def response(self, residual: ca.SX) -> ca.SX:
        """What the unknowns change by, for columns of residuals of all equations."""
        rows = list(self.implicit)
        return solve_linear(self.jacobian[rows, rows], residual[rows, :])

    def better(self) -> ca.SX:
        """All values after the update, the affine ones solved for."""
        better = ca.SX(self.values)
        for group in coupled_groups(self.jacobian):
            if group[0] in self.implicit:
                continue
            residual = self.residual[group, 0]
            at_zero = ca.substitute(residual, self.values[group, 0], ca.SX.zeros(len(group), 1))
            better[group, 0] = -solve_linear(self.jacobian[group, group], at_zero)
        better[list(self.implicit), 0] = self.unknowns - self.update
        return better
