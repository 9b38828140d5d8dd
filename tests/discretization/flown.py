"""A free flight run to round-off by repeating its Newton update, with plain numbers in and out."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

import groupoid_gni as gni
from groupoid_gni.discretization import SystemExpressions


class Flown:
    """The outward (0) or homeward (1) flight of a flow, (x, p, h) -> (x', p')."""

    def __init__(self, system: gni.MechanicalSystem, flow: Any, end: int = 0) -> None:
        e = SystemExpressions(system, ())
        x, p, h = ca.SX.sym("x", e.base_size), ca.SX.sym("p", e.rank), ca.SX.sym("h")
        theta = ca.SX.sym("theta", e.parameter_size)
        self.flight = flow.flights(e)[end].from_momentum(x, p, h, theta, "xi")
        self.theta = system.parameter_vector
        outputs = [self.flight.target, self.flight.momentum, self.flight.update,
                   self.flight.work, self.flight.energy, self.flight.force_work]
        unknowns = self.flight.unknowns
        self.run = ca.Function("run", [x, p, h, theta, unknowns], outputs)
        self.guess = ca.Function("guess", [x, p, theta], [self.flight.guess(x, p)])
        dp = ca.SX.sym("dp", e.rank)
        self.response = ca.Function("dp", [x, p, h, theta, unknowns, dp],
                                    [self.flight.response(dp)])

    def solved(self, x: Any, p: Any, h: float) -> Any:
        """The unknowns after enough updates."""
        values = np.array(self.guess(x, p, self.theta)).ravel()
        for _ in range(15 if values.size else 0):
            values = values - np.array(self.run(x, p, h, self.theta, values)[2]).ravel()
        return values

    def __call__(self, x: Any, p: Any, h: float) -> tuple[Any, Any]:
        outputs = self.run(x, p, h, self.theta, self.solved(x, p, h))
        return tuple(np.array(v).ravel() for v in outputs[:2])

    def work(self, x: Any, p: Any, h: float) -> float:
        """Of the external force."""
        return float(self.run(x, p, h, self.theta, self.solved(x, p, h))[5])
