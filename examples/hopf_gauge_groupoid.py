"""A gauge groupoid that is not a product: the Hopf bundle S^3 -> S^2, written with seven functions.

Run: python examples/hopf_gauge_groupoid.py [figure.png]

Geometry. P = S^3, the unit quaternions; the circle acts on the right, p -> p s, s = c + d k; the
base is S^2 by ``hopf(p) = p k p^-1``. An arrow of the gauge groupoid (P x P)/S^1 is a class
``[p, q] = [p s, q s]`` from hopf(p) to hopf(q), here 8 numbers that mean the same whatever s is.
There is no global section S^2 -> S^3, so ``section`` glues two of them; no class notices the seam.

Algebroid. AG = TP/S^1 has rank 3. Left turns p -> a p commute with the circle, so the three
generators of SU(2) are a frame of it, and a global one, since S^3 is a group. For the same reason
``[p, q] -> (hopf(p), q p^-1)`` is an isomorphism onto the action groupoid of SU(2) on S^2. The
functions work with pairs all the same, only retract and lift know the frame; the isomorphism is
the oracle: ``gni.ActionGroupoid`` must give the same motion. Where P is not a group, the frame must
come from elsewhere and there is no such oracle.

Mechanics. The symmetric Veselova top with a flywheel. P is the orientation of a body (twice, p and
-p are one), x = hopf(p) its axis of symmetry, the circle its spin about that axis, xi = omega its
angular velocity in space:

    L = A/2 |x'|^2 + C/2 (omega.x)^2 + s omega.x - weight x_3 - stiffness/2 (field.x)^2,
    n.omega = Omega,   x' = omega x x   (n, field unit vectors).

A, C are moments of inertia, s the momentum of the flywheel along the axis. After Kaluza and Klein:
x is a particle of charge e = C omega.x + s on a sphere round a magnetic monopole, the curvature of
the bundle. A support keeps the body from turning about n (Omega = 0) or drives it. The planes
n.omega = 0 are not closed under the bracket, and the support changes e, which is constant without
it. With Omega = 0 the energy E is constant; with n vertical and stiffness = 0 the moving energy
``E - Omega n.M`` is, M = A x x x' + e x the angular momentum.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import groupoid_gni as gni
from groupoid_gni.plotting import plot_constraints, plot_energy, style
from groupoid_gni.verification import check_groupoid, check_retraction

STEP, T_END = 0.02, 40.0
NO_LIFT = 1e6  # components of no arrow
BASE, VELOCITY = [0.6, 0.0, 0.8], [1.1, -0.7, 0.9]


def product(a: Any, b: Any) -> Any:
    """The product of two quaternions, scalar part first."""
    vector = a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])
    return np.concatenate([gni.array([a[0] * b[0] - a[1:] @ b[1:]]), vector])


def conjugate(a: Any) -> Any:
    """a^-1 of a unit quaternion."""
    return np.concatenate([a[:1], -a[1:]])


def times_k(p: Any) -> Any:
    """p k: where the circle moves p, the direction of the fibre."""
    return gni.array([-p[3], p[2], -p[1], p[0]])


def hopf(p: Any) -> Any:
    """The vector p k p^-1."""
    return gni.array([
        2 * (p[1] * p[3] + p[0] * p[2]),
        2 * (p[2] * p[3] - p[0] * p[1]),
        p[0] * p[0] + p[3] * p[3] - p[1] * p[1] - p[2] * p[2],
    ])  # fmt: skip


def section(x: Any) -> Any:
    """A unit quaternion over x/|x|: one formula for each half of the sphere, each smooth there."""
    # with 1 for |x| a point slightly off the sphere would not come back along its radius
    radius = np.sqrt(x @ x)
    north = gni.array([radius + x[2], -x[1], x[0], 0.0])
    south = gni.array([x[0], 0.0, radius - x[2], x[1]])
    # chosen before the division, so that the half not taken is finite at its pole
    p = gni.where(x[2] > 0, north, south)
    return p / np.sqrt(p @ p)


def turn(xi: Any) -> Any:
    """cay(xi/4) = (1 + v)/(1 - v), v = xi/4: a turn about xi by the angle 4 arctan(|xi|/4)."""
    v = xi / 4
    square = v @ v
    return np.concatenate([gni.array([1 - square]), 2 * v]) / (1 + square)


class HopfGaugeGroupoid(gni.LieGroupoid):
    """(S^3 x S^3)/S^1 over S^2: arrows [p, q], a pair of unit quaternions up to a common phase.

    ``multiply`` keeps p, so that ``run.reconstruct()`` gives pairs (p_0, p_k): the motion on S^3.
    """

    rank = 3
    example_base_point = np.array([0.48, -0.6, 0.64])

    def source(self, g: Any) -> Any:
        """Give hopf(p)."""
        return hopf(g[:4])

    def target(self, g: Any) -> Any:
        """Give hopf(q)."""
        return hopf(g[4:])

    def identity(self, x: Any) -> Any:
        """Give [p, p]."""
        return np.concatenate([section(x), section(x)])

    def multiply(self, g: Any, h: Any) -> Any:
        """Give [p, q][q', r] = [p, r s] with q = q' s, s = c + d k."""
        q, q_other, r = g[4:], h[:4], h[4:]
        c, d = q_other @ q, times_k(q_other) @ q
        return np.concatenate([g[:4], c * r + d * times_k(r)])

    def inverse(self, g: Any) -> Any:
        """Give [q, p]."""
        return np.concatenate([g[4:], g[:4]])

    def retract(self, x: Any, xi: Any) -> Any:
        """Give [p, turn(xi) p]; symmetric, since turn(-xi) undoes turn(xi) over any p."""
        p = section(x)
        return np.concatenate([p, product(turn(xi), p)])

    def lift(self, g: Any) -> Any:
        """Give 4 v / (1 + a_0) with q p^-1 = a_0 + v, for a_0 > 0: turns by less than pi."""
        a = product(g[4:], conjugate(g[:4]))
        # v vanishes at q = -p too, and [p, -p] must not pass for an identity
        return gni.where(a[0] > 0, 4 * a[1:] / (1 + np.abs(a[0])), NO_LIFT)


class SpinorCayley(gni.Retraction):
    """``turn`` in terms of SO(3): a Cayley rotation taken twice; for the oracle."""

    def tau(self, group: Any, xi: Any) -> Any:
        """Give cay(xi/2)^2."""
        return group.compose(group.cay(xi / 2), group.cay(xi / 2))

    def inverse(self, group: Any, element: Any) -> Any:
        """Give twice the half of cay^-1."""
        return 2 * group.cay_half(group.cay_inverse(element))


def oracle_groupoid() -> gni.ActionGroupoid:
    """S^2 moved by SO(3), which is SU(2) near the identity: pairs (x, R) from x to R x."""
    group = gni.SO3(side="right", retraction=SpinorCayley())
    return gni.ActionGroupoid(
        group,
        lambda x, rotation: (rotation @ x[..., None])[..., 0],
        HopfGaugeGroupoid.example_base_point,
        base_defect=lambda x: np.abs((x * x).sum(axis=-1) - 1),
        restore_base=lambda x: x * (3 - (x * x).sum(axis=-1, keepdims=True)) / 2,
    )


def veselova_top(space: gni.LieGroupoid) -> gni.MechanicalSystem:
    """The system of the docstring above on either groupoid; both have the frame of space turns."""
    return gni.MechanicalSystem(
        space,
        metric=lambda x, p: p.A * np.eye(3) + (p.C - p.A) * np.outer(x, x),
        constraints=lambda x, p: p.n[None, :],
        potential=lambda x, p: p.weight * x[2] + p.stiffness / 2 * (p.field @ x) ** 2,
        drift=lambda x, p: p.Omega * p.n,
        gyroscopic=lambda x, p: p.s * x,
        parameters={
            "A": 0.83, "C": 1.37, "s": 0.29, "n": [0.36, 0.48, 0.8], "Omega": 0.0,
            "weight": 1.9, "stiffness": 2.3, "field": [0.8, -0.6, 0.0],
        },
    )  # fmt: skip


def moving_energy(run: gni.Trajectory) -> np.ndarray:
    """E - Omega n.M, (nodes,); the momenta in the frame of space turns are M itself."""
    p = run.system.parameters
    return run.energy() - p["Omega"] * run.momenta @ p["n"]


def charge(run: gni.Trajectory) -> np.ndarray:
    """e = C omega.x + s, the momentum along the fibre, (nodes,)."""
    p = run.system.parameters
    return p["C"] * np.sum(run.velocities * run.base, axis=1) + p["s"]


# Four groupoids that their author believes in; each breaks a law.


class UnalignedProduct(HopfGaugeGroupoid):
    """[p, q][q', r] = [p, r], as if q and q' were equal and not only over the same point."""

    def multiply(self, g: Any, h: Any) -> Any:
        """Forget the phase between q and q'."""
        return np.concatenate([g[:4], h[4:]])


class UnswappedInverse(HopfGaugeGroupoid):
    """The inverse of the two quaternions instead of the inverse of the arrow."""

    def inverse(self, g: Any) -> Any:
        """Conjugate p and q where they had to change places."""
        return np.concatenate([conjugate(g[:4]), conjugate(g[4:])])


class TurnOnTheWrongSide(HopfGaugeGroupoid):
    """[p, p turn(xi)], the body frame: the circle acts there, so it depends on the section."""

    def retract(self, x: Any, xi: Any) -> Any:
        """Multiply on the side of the circle."""
        p = section(x)
        return np.concatenate([p, product(p, turn(xi))])


class BodyFrame(TurnOnTheWrongSide):
    """The wrong side with a lift that fits, but only while p is the section's."""

    def lift(self, g: Any) -> Any:
        """Give turn^-1(p^-1 q)."""
        a = product(conjugate(g[:4]), g[4:])
        return 4 * a[1:] / (1 + a[0])


def broken_copies() -> dict[str, gni.LieGroupoid]:
    """Wrong groupoids by the law that names the mistake."""
    return {
        "right_unit": UnalignedProduct(),
        "ends_of_inverse": UnswappedInverse(),
        "lift_undoes_retraction": TurnOnTheWrongSide(),
        "symmetry": BodyFrame(),
    }


def verify(examples: int = 8) -> dict[str, list[str]]:
    """All laws on the sound groupoid, then what they say of the broken ones, by class name."""
    for check in (check_groupoid, check_retraction):
        report = check(HopfGaugeGroupoid(), examples=examples)
        print(f"{report.subject}: {report.headline()}")
    broken = {}
    for law, groupoid in broken_copies().items():
        reports = [
            check(groupoid, examples=examples, on_fail="return")
            for check in (check_groupoid, check_retraction)
        ]
        failures = {found.law.name: found for report in reports for found in report.failures}
        broken[type(groupoid).__name__] = list(failures)
        print(f"\n{failures[law].explain(type(groupoid).__name__)}")
    return broken


# The runs and the picture.


def run_all(space: gni.LieGroupoid) -> dict[str, gni.Trajectory]:
    """GNI and Rattle with the support at rest, and GNI with the body driven about the vertical."""
    top = veselova_top(space)
    start = top.state(BASE, VELOCITY, project_start=True)
    driven = top.with_parameters(n=[0.0, 0.0, 1.0], Omega=0.6, stiffness=0.0)
    driven_start = driven.state(BASE, VELOCITY, project_start=True)
    settings = {"step": STEP, "t_end": T_END}
    return {
        "GNI": gni.integrate(top, start, **settings),
        "Rattle": gni.integrate(top, start, method=gni.Rattle(), **settings),
        "driven": gni.integrate(driven, driven_start, **settings),
    }


def difference(run: gni.Trajectory, other: gni.Trajectory) -> np.ndarray:
    """Largest difference of base points and momenta at every node, (nodes,)."""
    gaps = np.concatenate([run.base - other.base, run.momenta - other.momenta], axis=1)
    return np.max(np.abs(gaps), axis=1)


def off_sphere(run: gni.Trajectory) -> np.ndarray:
    """| |x| - 1 | at every node, (nodes,)."""
    return np.abs(np.linalg.norm(run.base, axis=1) - 1)


def draw_path_on_sphere(axes: Any, path: np.ndarray, n: np.ndarray) -> None:
    """The sphere with the seam of the section, the support's axis n, the path; its back pale."""
    axes.view_init(elev=20.0, azim=-40.0)
    axes.set_proj_type("ortho")
    up, around = np.radians(20.0), np.radians(-40.0)
    eye = np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
    ring = np.linspace(0, 2 * np.pi, 181)
    longitude, latitude = np.meshgrid(ring, ring[:91] - np.pi / 2)
    ball = [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude)]
    axes.computed_zorder = False
    axes.plot_surface(*ball, np.sin(latitude), color="#e9eef2", linewidth=0, shade=False, zorder=0)
    axes.plot(np.cos(ring), np.sin(ring), 0 * ring, color="#9aa7b0", linewidth=1, linestyle="--")
    front = (path @ eye > 0)[:, None]
    axes.plot(*np.where(front, np.nan, path).T, color="#2f6fab", alpha=0.3)
    axes.plot(*np.where(front, path, np.nan).T, color="#2f6fab")
    axes.plot(*path[0][:, None], "o", color="#2f6fab", markersize=5)
    axes.plot(*np.outer(n, [1.0, 1.3]), color="#c8553d", linewidth=2)
    axes.text(*(1.36 * n), "n", color="#c8553d")
    axes.set_box_aspect((1, 1, 1), zoom=1.55)
    axes.set_axis_off()


def draw(runs: dict[str, gni.Trajectory], oracle: dict[str, gni.Trajectory]) -> Figure:
    """Path of the axis, charge, energy, and what is zero up to round-off."""
    run = runs["GNI"]
    with style():
        figure = Figure(figsize=(10, 7), layout="constrained")
        FigureCanvasAgg(figure)
        sphere = figure.add_subplot(2, 2, 1, projection="3d")
        fibre, energy, small = (figure.add_subplot(2, 2, k) for k in (2, 3, 4))
        draw_path_on_sphere(sphere, run.base[run.times <= 8.0], run.system.parameters["n"])
        sphere.set_title("axis of the top until t = 8 (dashed: seam of the section)")
        fibre.plot(run.times, charge(run), label="support at rest, n tilted")
        fibre.plot(run.times, charge(runs["driven"]), label="driven about the vertical")
        fibre.set_ylim(0.3, 2.5)
        fibre.set_title("charge e, constant without the support")
        fibre.set_xlabel("t")
        fibre.legend(loc="upper left", ncols=2)
        for name in ("GNI", "Rattle"):
            plot_energy(energy, runs[name], label=name, linewidth=0.9)
        energy.set_ylim(1e-8, 1e-2)
        energy.set_title("relative energy change, support at rest")
        energy.legend(loc="upper left", ncols=2)
        gap, defect = difference(run, oracle["GNI"]), off_sphere(run)
        small.semilogy(run.times, np.maximum(gap, 1e-17), label="off the action groupoid's run")
        small.semilogy(run.times, np.maximum(defect, 1e-17), linewidth=0.6, label="off the sphere")
        plot_constraints(small, run, label="constraint (relative)")
        small.set_ylim(1e-17, 1e-9)
        small.set_title("zero up to round-off")
        small.legend(loc="upper left", ncols=2)
    return figure


def main(target: str | Path = "output/hopf_gauge_groupoid.png") -> dict[str, float]:
    """Run on both groupoids, print, compare, draw; returns the numbers printed."""
    runs, oracle = run_all(HopfGaugeGroupoid()), run_all(oracle_groupoid())
    kept = moving_energy(runs["driven"])
    numbers = {
        "difference": max(float(difference(runs[name], oracle[name]).max()) for name in runs),
        "off sphere": max(float(off_sphere(run).max()) for run in runs.values()),
        "moving energy": float(np.max(np.abs(kept / kept[0] - 1))),
        "crossings": int(np.sum(np.diff(runs["GNI"].base[:, 2] > 0))),
    }
    for run in runs.values():
        print(run.summary())
    print(f"  moving energy of the driven top: relative change {numbers['moving energy']:.2e}")
    print(f"Largest difference from the action groupoid of SO(3) {numbers['difference']:.2e}")
    print(f"Largest distance from the sphere {numbers['off sphere']:.2e}")
    print(f"The seam of the section was crossed {numbers['crossings']} times by the GNI run")
    target = Path(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    draw(runs, oracle).savefig(target)
    print(f"Figure written to {target}\n")
    verify()
    return numbers


if __name__ == "__main__":
    main(*sys.argv[1:2])
