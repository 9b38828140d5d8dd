"""MechanicalSystem and its starts: what is accepted, what is refused, and in which words."""

from __future__ import annotations

import pickle
import re
import warnings

import numpy as np
import pytest

import groupoid_gni as gni
from groupoid_gni import DependentConstraintsWarning, InputError, RecordingError
from groupoid_gni.integrators import compiled_step

MASSES = (1.3, 0.7, 2.1)
BASE = (0.3, -0.2, 0.5)


def motion(system, base, velocity, **keywords):
    start = system.state(base, velocity)
    return gni.integrate(system, start, **{"step": 0.04, "n_steps": 25, **keywords})


# ---------------------------------------------------------------- construction


def test_a_constant_array_means_the_same_as_a_function_that_returns_it(particle):
    row, drift, one_form = [[1.0, 0.5, -0.3]], [0.2, -0.4, 0.7], [0.3, 0.1, -0.6]
    arrays = particle(constraints=row, drift=drift, gyroscopic=one_form, potential=2.5)
    functions = particle(
        metric=lambda x, p: np.diag(MASSES),
        constraints=lambda x, p: np.array(row),
        drift=lambda x, p: np.array(drift),
        gyroscopic=lambda x, p: np.array(one_form),
        potential=lambda x, p: 2.5,
    )
    velocity = np.add(drift, [0.3, -0.6, 0.0])
    first, second = (motion(system, BASE, velocity) for system in (arrays, functions))
    assert first.rows.tobytes() == second.rows.tobytes()


def test_a_constant_array_is_copied_so_that_changing_it_later_changes_nothing(particle):
    metric = np.diag(MASSES)
    system = particle(metric=metric)
    metric[0, 0] = -5.0
    assert system.evaluate("metric", BASE)[0, 0] == 1.3


def test_a_system_cannot_be_changed_after_it_is_made(knife_edge):
    with pytest.raises(AttributeError, match=r"'space' cannot be set; use .*with_parameters"):
        knife_edge.space = gni.PairGroupoid(2)
    with pytest.raises(TypeError):
        knife_edge.parameters["k"] = np.array(3.0)
    with pytest.raises(ValueError, match="read-only"):
        knife_edge.parameters["k"][...] = 3.0


@pytest.mark.parametrize(
    ("terms", "message"),
    [
        ({"space": 3}, "space must be a LieGroupoid, not int"),
        ({"space": gni.SO3}, r"space is the class SO3; pass an instance of it: SO3\("),
        ({"metric": np.eye(2)}, r"metric must have shape \(3, 3\), got \(2, 2\)"),
        ({"metric": "heavy"}, "metric.* must hold real numbers, got <U5"),
        ({"metric": np.eye(3) * 1j}, "metric.* must hold real numbers, got complex128"),
        ({"metric": np.diag([1.0, np.nan, 2.0])}, "metric holds NaN or infinity"),
        ({"metric": lambda x: np.eye(3)}, r"metric must take two arguments \(x, p\).*\(x\)"),
        ({"metric": lambda x, p: np.eye(2)}, r"metric \(.*test_systems.py:\d+\).*\(3, 3\)"),
        ({"constraints": [1.0, 0.5, 0.2]}, r"shape \(m, 3\).*\[\[\.\.\.\]\], with two brackets"),
        ({"constraints": [[1.0, 0.5]]}, r"shape \(m, 3\).*got shape \(1, 2\)"),
        (
            {"constraints": lambda x, p: np.array([[1.0, p.r, 0.2]])},
            r"constraints \(.*test_systems.py:\d+\) failed .*no parameter 'r'",
        ),
        ({"drift": [1.0, 0.5, 0.2]}, r"drift needs constraints: .*mu \(xi - Y\) = 0"),
        (
            {"constraints": [[1.0, 0.0, 0.0]], "drift": [0.4, 0.5]},
            r"drift must have shape \(3,\), got \(2,\)",
        ),
        ({"gyroscopic": [0.4, 0.5]}, r"gyroscopic must have shape \(3,\), got \(2,\)"),
        ({"potential": lambda x, p: x}, r"potential .*an array of shape \(3,\) came"),
        ({"potential": lambda x, p: None}, "potential .*returned None.*Is a return missing"),
        ({"potential": [1.0, 2.0]}, r"potential must have shape \(\), got \(2,\)"),
    ],
)
def test_a_term_of_a_wrong_kind_is_refused_by_name_with_what_was_expected(
    particle, terms, message
):
    with pytest.raises(InputError, match=f"(?s){message}"):
        particle(**terms)


@pytest.mark.parametrize(
    ("potential", "message"),
    [
        (lambda x, p: 1.0 if x[0] > 0 else 2.0, r"no truth value.*gni.where"),
        (lambda x, p: __import__("math").sin(x[0]), r"math module.*NumPy"),
        (lambda x, p: p.stiffness * x[0], r"no parameter 'stiffness'; its parameters are: k"),
    ],
    ids=["branch", "math.sin", "unknown parameter"],
)
def test_a_function_that_cannot_be_recorded_is_refused_with_file_line_and_mend(
    particle, potential, message
):
    with pytest.raises(RecordingError, match=rf"(?s)potential.*test_systems.py:\d+.*{message}"):
        particle(potential=potential, parameters={"k": 1.4})


def test_an_unknown_keyword_is_an_error(particle):
    with pytest.raises(TypeError, match="potental"):
        particle(potental=lambda x, p: x[0])


# ---------------------------------------------------------------- parameters


def test_parameters_may_be_scalars_vectors_and_matrices(particle):
    inertia = np.array([[1.3, 0.2, 0.0], [0.2, 0.7, 0.1], [0.0, 0.1, 2.1]])
    system = particle(
        metric=lambda x, p: p.G,
        potential=lambda x, p: p.k * (p.a @ x),
        parameters={"k": np.float32(1.5), "a": [1, 2, -3], "G": inertia, "unused": True},
    )
    np.testing.assert_array_equal(system.evaluate("metric", BASE), inertia)
    assert system.evaluate("potential", BASE) == pytest.approx(1.5 * (0.3 - 0.4 - 1.5))
    assert system.parameter_vector.size == 1 + 3 + 9 + 1


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"k": "1.4"}, "parameter 'k' must hold real numbers, got <U3"),
        ({"k": 1.4 + 0j}, "parameter 'k' must hold real numbers, got complex128"),
        ({"k": object()}, "parameter 'k' must hold real numbers, got <object"),
        ({"k": [[1.0, 2.0], [3.0]]}, "parameter 'k' must hold real numbers"),
        ({"k": 10**400}, "parameter 'k' must hold real numbers, got 1000.*too large"),
        ({"k": np.datetime64("2015-02-25")}, "parameter 'k' must hold real numbers"),
        ({"k": np.ma.array([1.0, 2.0], mask=[0, 1])}, "parameter 'k' has masked entries"),
        ({"k": None}, "parameter 'k' is not finite: None"),
        ({"k": [1.4, np.inf]}, "parameter 'k' is not finite"),
        ({"spring constant": 1.4}, "'spring constant' cannot be read as p.name"),
        ({7: 1.4}, "parameter name 7 cannot be read"),
        ({"__dict__": 1.4}, "'__dict__' cannot be read"),
        ([("k", 1.4)], "parameters must be a mapping from names to numbers"),
        ("k", "parameters must be a mapping"),
    ],
)
def test_a_bad_parameter_is_refused_by_name(particle, parameters, message):
    with pytest.raises(InputError, match=message):
        particle(parameters=parameters)


def test_with_parameters_gives_another_motion_from_the_same_compiled_code(
    knife_edge, allowed_velocity
):
    soft = motion(knife_edge, BASE, allowed_velocity)
    stiff_system = knife_edge.with_parameters(k=5.9)
    stiff = motion(stiff_system, BASE, allowed_velocity)
    assert stiff_system.compiled() is knife_edge.compiled()
    assert stiff_system.recorded("potential") is knife_edge.recorded("potential")
    assert knife_edge.parameters["k"] == 1.4
    assert not np.allclose(stiff.base[-1], soft.base[-1])

    afresh = gni.MechanicalSystem(
        knife_edge.space,
        np.diag(MASSES),
        constraints=lambda x, p: np.array([[1.0, 0.4 * x[1], -0.3]]),
        potential=lambda x, p: 0.5 * p.k * (x @ x),
        parameters={"k": 5.9},
    )
    assert motion(afresh, BASE, allowed_velocity).rows.tobytes() == stiff.rows.tobytes()


def test_with_parameters_keeps_the_class_of_a_subclass():
    class Sleigh(gni.MechanicalSystem):
        """A user's own name for a system."""

    system = Sleigh(gni.SE2(), np.diag(MASSES), parameters={"a": 0.3})
    assert type(system.with_parameters(a=0.4)) is Sleigh


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kk": 2.0}, "unknown parameter 'kk'; this system has: k"),
        ({"k": [2.0, 3.0]}, r"'k' has shape \(2,\).*built with \(\); build a new"),
        ({"k": np.nan}, "parameter 'k' is not finite"),
    ],
)
def test_with_parameters_refuses_unknown_names_other_shapes_and_nan(knife_edge, changes, message):
    with pytest.raises(InputError, match=message):
        knife_edge.with_parameters(**changes)


def test_a_start_is_checked_again_when_the_parameters_have_changed_since(particle):
    system = particle(
        constraints=[[1.0, 0.5, -0.3]],
        drift=lambda x, p: np.array([p.wind, 0.0, 0.0]),
        parameters={"wind": 0.8},
    )
    start = system.state(BASE, [0.8 + 0.3, 0.0, 1.0])
    with pytest.raises(InputError, match="the start violates the constraints"):
        gni.integrate(system.with_parameters(wind=0.2), start, step=0.1, n_steps=3)


# ---------------------------------------------------------------- values


def test_evaluate_takes_batches_and_gives_zero_for_terms_left_out(knife_edge):
    points = np.linspace(-1.0, 1.0, 12).reshape(2, 2, 3)
    assert knife_edge.evaluate("metric", points).shape == (2, 2, 3, 3)
    assert knife_edge.evaluate("potential", points).shape == (2, 2)
    np.testing.assert_array_equal(knife_edge.evaluate("drift", points), np.zeros((2, 2, 3)))
    assert knife_edge.evaluate("gyroscopic", BASE).shape == (3,)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: s.evaluate("potental", BASE), "unknown term 'potental'; the terms are: metric"),
        (lambda s: s.evaluate("metric", [1.0, 2.0]), r"shape \(\.\.\., 3\), got \(2,\)"),
        (lambda s: s.evaluate("drift", [1.0, 2.0]), r"shape \(\.\.\., 3\), got \(2,\)"),
        (lambda s: s.recorded("potental"), "unknown term 'potental'"),
        (lambda s: s.recorded("drift"), "no drift; it has: metric, constraints, potential"),
        (lambda s: s.compiled(gni.ReferenceFlow()), "gni.GNI.. or a discrete Lagrangian"),
        (lambda s: s.compiled(gni.GNI), "gni.GNI.. or a discrete Lagrangian"),
        (lambda s: s.compiled(gni.GNI(), (0, 1)), r"numbers from 0 to 0, got \(0, 1\)"),
    ],
)
def test_asking_a_system_for_what_it_has_not_names_what_it_has(knife_edge, call, message):
    with pytest.raises(InputError, match=message):
        call(knife_edge)


# ---------------------------------------------------------------- the start: numbers


@pytest.mark.parametrize(
    "convert",
    [
        list,
        tuple,
        lambda v: np.array(v, dtype=np.float32),
        lambda v: np.array(v, dtype=np.int16),
        lambda v: np.array(v, dtype=object),
        lambda v: np.asfortranarray(np.outer(v, [1.0, 2.0]))[:, 0],
        lambda v: np.repeat(v, 3)[::3],
        lambda v: np.broadcast_to(np.array(v), (2, 3))[1],
        lambda v: np.ma.array(v, mask=False),
    ],
    ids=[
        "list",
        "tuple",
        "float32",
        "int16",
        "object array of numbers",
        "column of a Fortran array",
        "strided view",
        "read-only broadcast",
        "masked array without masked entries",
    ],
)
def test_every_sensible_kind_of_vector_gives_the_same_start(particle, convert):
    system = particle(constraints=[[1.0, 2.0, -1.0]])
    base, velocity = [3.0, -2.0, 5.0], [1.0, 2.0, 5.0]
    given = convert(base), convert(velocity)
    copies = [np.array(g, dtype=float) for g in given]
    start = system.state(*given)
    np.testing.assert_array_equal(start.base, base)
    np.testing.assert_allclose(start.velocity, velocity, rtol=1e-15)
    np.testing.assert_allclose(start.momentum, np.multiply(MASSES, velocity), rtol=1e-15)
    for one, copy in zip(given, copies, strict=True):
        np.testing.assert_array_equal(np.array(one, dtype=float), copy)
        assert not np.shares_memory(np.asarray(one), start.base)


def test_a_state_is_read_only_and_compares_by_identity(knife_edge, allowed_velocity):
    first, second = (knife_edge.state(BASE, allowed_velocity) for _ in range(2))
    for part in (first.base, first.velocity, first.momentum):
        with pytest.raises(ValueError, match="read-only"):
            part[0] = np.nan
    assert first != second
    assert first == first
    assert len({first, second}) == 2


@pytest.mark.parametrize(
    ("velocity", "message"),
    [
        (None, "velocity is missing; it needs 3 components"),
        ([0.1, 0.2], r"velocity must have shape \(3,\), got \(2,\); components are ordered base"),
        ([[0.1], [0.2], [0.3]], r"velocity must have shape \(3,\), got \(3, 1\)"),
        (0.4, r"velocity must have shape \(3,\), got \(\)"),
        ([], r"velocity must have shape \(3,\), got \(0,\)"),
        (np.ones((1, 3)), r"velocity must have shape \(3,\), got \(1, 3\)"),
        ([0.1, np.nan, 0.3], r"velocity\[1\] is nan; every component must be finite"),
        ([0.1, 0.2, -np.inf], r"velocity\[2\] is -inf"),
        ([0.1, None, 0.3], r"velocity\[1\] is nan"),
        ([0.1, 0.2j, 0.3], "velocity must hold real numbers, got complex128"),
        (["0.1", "0.2", "0.3"], "velocity must hold real numbers, got <U3"),
        ("fast", "velocity must hold real numbers"),
        ([0.1, object(), 0.3], "velocity must hold real numbers"),
        ([[0.1, 0.2], [0.3]], "velocity must hold real numbers"),
        ([10**400, 0.2, 0.3], "velocity must hold real numbers"),
        (np.ma.array([0.1, 0.2, 0.3], mask=[0, 1, 0]), "velocity has masked entries"),
        (np.array(["2015-02-25"] * 3, dtype="datetime64[D]"), "velocity must hold real numbers"),
        ({"vx": 0.1}, "velocity must hold real numbers"),
    ],
)
def test_a_velocity_that_is_no_finite_real_vector_is_refused(particle, velocity, message):
    with pytest.raises(InputError, match=message):
        particle().state(BASE, velocity)


@pytest.mark.parametrize(
    ("base", "message"),
    [
        (None, r"base is missing: a base point of PairGroupoid has 3 components, for example"),
        ([0.1, 0.2], r"base must have shape \(3,\), got \(2,\)"),
        ([0.1, np.nan, 0.3], r"base\[1\] is nan"),
        ([0.1, 0.2j, 0.3], "base must hold real numbers, got complex128"),
    ],
)
def test_a_base_point_that_is_no_finite_real_vector_is_refused(particle, base, message):
    with pytest.raises(InputError, match=message):
        particle().state(base, [0.1, 0.2, 0.3])


def test_on_a_lie_group_the_base_is_left_out_and_a_lone_vector_is_explained():
    system = gni.MechanicalSystem(gni.SO3(), np.diag(MASSES))
    assert system.state(velocity=[0.3, -0.2, 0.5]).base.shape == (0,)
    assert system.state([], [0.3, -0.2, 0.5]).base.shape == (0,)
    with pytest.raises(InputError, match=r"base of SO3 is a point, so call state\(velocity="):
        system.state([0.3, -0.2, 0.5])


# ---------------------------------------------------------------- the start: off the group


@pytest.fixture
def framed_body():
    space = gni.FramedPairGroupoid(gni.VectorGroup(2), gni.SO3())
    return gni.MechanicalSystem(space, np.diag([1.1, 1.2, 0.5, 0.6, 0.7]))


def pose(matrix):
    return np.concatenate([[0.3, -0.4], np.ravel(matrix)])


SPIN = [0.1, 0.2, 0.3, -0.4, 0.5]


@pytest.mark.parametrize(
    ("matrix", "size"),
    [(1.001 * np.eye(3), "0.003"), (np.diag([1.0, 1.0, -1.0]), "2"), (np.zeros((3, 3)), "1")],
    ids=["not orthogonal", "determinant -1", "zero"],
)
def test_a_base_point_off_the_group_is_refused_with_the_distance(framed_body, matrix, size):
    with pytest.raises(
        InputError, match=rf"off the base manifold of FramedPairGroupoid by {size} .*project_start"
    ):
        framed_body.state(pose(matrix), SPIN)


def test_a_base_point_off_the_group_by_round_off_is_accepted(framed_body):
    assert framed_body.state(pose((1.0 + 1e-11) * np.eye(3)), SPIN).active_rows == ()


def test_project_start_brings_a_slightly_wrong_rotation_back_to_the_group(framed_body):
    rng = np.random.default_rng(7)
    rotation = gni.SO3().exp(np.array([0.4, -0.7, 0.2]))
    wrong = rotation + 0.01 * rng.uniform(-1.0, 1.0, (3, 3))
    start = framed_body.state(pose(wrong), SPIN, project_start=True)
    found = start.base[2:].reshape(3, 3)
    np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-14)
    u, _, vt = np.linalg.svd(wrong)
    np.testing.assert_allclose(found, u @ vt, atol=1e-13)


def test_project_start_does_not_turn_a_reflection_into_a_rotation(framed_body):
    with pytest.raises(InputError, match="determinant -1"):
        framed_body.state(pose(-np.eye(3)), SPIN, project_start=True)


# ---------------------------------------------------------------- the start: metric and terms


@pytest.mark.parametrize(
    ("metric", "message"),
    [
        (
            np.array([[1.3, 0.2, 0.0], [0.21, 0.7, 0.0], [0.0, 0.0, 2.1]]),
            r"metric is not symmetric at the base point .*\[0,1\] is 0.2 but \[1,0\] is 0.21",
        ),
        (np.diag([1.3, -0.7, 2.1]), "metric is not positive definite .*eigenvalue is -0.7"),
        (np.diag([1.3, 0.0, 2.1]), "metric is not positive definite .*eigenvalue is 0"),
        (np.outer([1.3, 0.7, 2.1], [1.3, 0.7, 2.1]), "metric is not positive definite"),
        (lambda x, p: np.diag([1.3, 0.7, 1 / (x[0] - 0.3)]), "metric .*is not finite at the base"),
    ],
    ids=["asymmetric", "indefinite", "massless direction", "rank one", "infinite here"],
)
def test_a_metric_that_is_no_inner_product_at_the_start_is_refused(particle, metric, message):
    with pytest.raises(InputError, match=f"(?s){message}"):
        particle(metric=metric).state(BASE, [0.1, 0.2, 0.3])


def test_a_metric_of_very_different_scales_is_accepted(particle):
    masses = np.array([1e-12, 0.7, 1e9])
    coupling = np.zeros((3, 3))
    coupling[0, 2] = coupling[2, 0] = 0.99 * np.sqrt(masses[0] * masses[2])
    start = particle(metric=np.diag(masses) + coupling).state(BASE, [0.1, 0.2, 0.3])
    assert start.momentum[1] == pytest.approx(0.14)


@pytest.mark.parametrize(
    ("terms", "message"),
    [
        (
            {"potential": lambda x, p: 1.0 / (x[0] - 0.3)},
            r"potential \(.*test_systems.py:\d+\) is not finite at the base point \[ 0.3.*inf",
        ),
        (
            {"potential": lambda x, p: np.sqrt((x - np.array(BASE)) @ (x - np.array(BASE)))},
            "potential .*has no finite derivative.*a norm has none at zero",
        ),
        ({"gyroscopic": lambda x, p: np.log(x)}, "gyroscopic .*is not finite.*nan"),
        (
            {
                "constraints": [[1.0, 0.5, 0.2]],
                "drift": lambda x, p: np.array([0.0, x[0] / (x[1] + 0.2), 0.0]),
            },
            "drift .*is not finite.*inf",
        ),
        (
            {"constraints": lambda x, p: np.array([[1.0, 0.5, np.sqrt(x[1])]])},
            "constraints .*(not|are not) finite",
        ),
    ],
    ids=["potential", "slope of the potential", "gyroscopic", "drift", "constraints"],
)
def test_a_term_that_is_not_finite_at_the_start_is_refused_by_name_and_place(
    particle, terms, message
):
    with pytest.raises(InputError, match=f"(?s){message}"):
        particle(**terms).state(BASE, [0.1, 0.2, 0.3])


def test_a_function_that_draws_random_numbers_is_found_out_at_the_start(particle):
    rng = np.random.default_rng(3)
    system = particle(potential=lambda x, p: rng.uniform() * x[0])
    with pytest.raises(RecordingError, match=r"(?s)potential.*different numbers.*random numbers"):
        system.state(BASE, [0.1, 0.2, 0.3])


def test_a_function_that_reads_a_global_that_changed_is_found_out_at_the_start(particle):
    stiffness = [1.4]
    system = particle(potential=lambda x, p: stiffness[0] * x[0])
    system.state(BASE, [0.1, 0.2, 0.3])
    stiffness[0] = 1.5
    with pytest.raises(RecordingError, match=r"(?s)potential.*a global that changes"):
        system.state(BASE, [0.1, 0.2, 0.3])


def test_checking_a_start_near_the_edge_of_a_domain_gives_no_numpy_warnings(particle):
    system = particle(potential=lambda x, p: np.sqrt(x[0] - 0.2999) + 0.0 * x[1])
    with np.errstate(all="raise"):
        system.state(BASE, [0.1, 0.2, 0.3])


# ---------------------------------------------------------------- the start: constraints


def test_a_start_off_the_constraint_is_refused_with_the_violation_and_the_nearest_velocity(
    particle,
):
    system = particle(constraints=[[1.0, 0.5, -0.3]], drift=[0.2, 0.0, 0.0])
    with pytest.raises(InputError) as caught:
        system.state(BASE, [0.6, 0.0, 0.0])
    message = str(caught.value)
    assert "mu (xi - Y) = [0.4]" in message
    assert "project_start=True" in message
    numbers = re.findall(r"-?\d+\.\d+", message.rsplit("[", 1)[1])
    np.testing.assert_allclose(
        [1.0 * (float(numbers[0]) - 0.2) + 0.5 * float(numbers[1]) - 0.3 * float(numbers[2])],
        0.0,
        atol=1e-7,
    )


def test_a_violation_of_round_off_is_accepted_and_removed(knife_edge, allowed_velocity):
    nearly = np.add(allowed_velocity, [1e-11, 0.0, 0.0])
    start = knife_edge.state(BASE, nearly)
    mu = knife_edge.evaluate("constraints", BASE)
    assert abs(mu @ start.velocity)[0] < 1e-15


def test_a_projected_velocity_is_accepted_again_though_its_row_sees_only_round_off(particle):
    system = particle(space=gni.PairGroupoid(3), constraints=[[2.5, 0.0, 0.0]])
    row_sees = system.state(BASE, [3e-16, -0.7, 0.8]).velocity[0]
    assert abs(row_sees) < 1e-30
    with pytest.raises(InputError, match="violates"):
        system.state(BASE, [3e-7, -0.7, 0.8])


def test_project_start_takes_the_nearest_velocity_in_the_metric(particle):
    rows = np.array([[1.0, 0.5, -0.3], [0.2, -0.4, 1.0]])
    drift, given = np.array([0.2, -0.1, 0.4]), np.array([0.9, -1.2, 0.7])
    system = particle(constraints=rows, drift=drift)
    found = system.state(BASE, given, project_start=True).velocity
    np.testing.assert_allclose(rows @ (found - drift), 0.0, atol=1e-15)
    free = np.cross(rows[0], rows[1])
    assert abs(free @ np.diag(MASSES) @ (found - given)) < 1e-14


def test_project_start_leaves_an_allowed_start_alone(knife_edge, allowed_velocity):
    plain = knife_edge.state(BASE, allowed_velocity)
    projected = knife_edge.state(BASE, allowed_velocity, project_start=True)
    np.testing.assert_allclose(projected.velocity, plain.velocity, rtol=1e-15)


REDUNDANT = {
    "the row again": (lambda a, b: [a, b, a], (0, 1), r"\[2\] depend on the rows \[0, 1\]"),
    "the row scaled": (lambda a, b: [a, -3.7 * a, b], (0, 2), r"\[1\] depend on the rows \[0, 2\]"),
    "the row in tiny units": (lambda a, b: [a, b, 1e-9 * a], (0, 1), r"\[2\] depend"),
    "a combination": (lambda a, b: [a, b, 0.3 * a - 2.0 * b], (0, 1), r"\[2\] depend"),
    "a zero row": (lambda a, b: [0.0 * a, a, b], (1, 2), r"row\(s\) \[0\] are zero"),
    "both kinds": (lambda a, b: [a, a, 0.0 * b, b], (0, 3), r"\[1\] depend .*\[2\] are zero"),
}


@pytest.mark.parametrize("kind", REDUNDANT)
def test_redundant_rows_are_dropped_by_name_and_do_not_change_the_motion(particle, kind):
    arrange, kept, message = REDUNDANT[kind]

    def first(x):
        return np.stack([1.0 + 0.0 * x[0], 0.4 * x[1], -0.3 + 0.0 * x[0], 0.1 * x[0]])

    def second(x):
        return np.stack([0.0 * x[0], 0.2 + x[0] ** 2, 1.0 + 0.0 * x[0], -0.5 + 0.0 * x[0]])

    terms = {
        "space": gni.PairGroupoid(4),
        "metric": np.diag([1.3, 0.7, 2.1, 0.9]),
        "drift": lambda x, p: np.stack([0.2 * x[2], -0.1 + 0.0 * x[0], 0.3 * x[0], 0.0 * x[0]]),
        "potential": lambda x, p: 0.8 * x[0] ** 2 + np.cos(x[1]) + 0.2 * x[3],
    }
    lean = particle(constraints=lambda x, p: np.stack([first(x), second(x)]), **terms)
    fat = particle(constraints=lambda x, p: np.stack(arrange(first(x), second(x))), **terms)
    base = [0.3, -0.2, 0.5, 0.1]
    velocity = lean.state(base, [0.5, 0.6, -0.4, 0.2], project_start=True).velocity
    with pytest.warns(DependentConstraintsWarning, match=message) as caught:
        start = fat.state(base, velocity)
    assert start.active_rows == kept
    assert caught[0].filename == __file__
    expected = motion(lean, base, velocity)
    run = gni.integrate(fat, start, step=0.04, n_steps=25)
    np.testing.assert_allclose(run.base, expected.base, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(run.momenta, expected.momenta, rtol=1e-12, atol=1e-14)
    assert run.multipliers.shape == (26, fat.constraint_count)
    dropped = sorted(set(range(fat.constraint_count)) - set(kept))
    np.testing.assert_array_equal(run.multipliers[:, dropped], 0.0)


def test_a_start_off_a_redundant_row_is_off_the_constraint_too(particle):
    system = particle(constraints=[[1.0, 0.5, -0.3], [2.0, 1.0, -0.6]])
    with pytest.raises(InputError, match="the start violates the constraints"):
        system.state(BASE, [0.9, 0.0, 0.0])


def test_project_start_works_with_redundant_rows(particle):
    rows = np.array([[1.0, 0.5, -0.3], [2.0, 1.0, -0.6]])
    with pytest.warns(DependentConstraintsWarning, match=r"\[1\] depend on the rows \[0\]"):
        start = particle(constraints=rows).state(BASE, [0.9, 0.1, 0.2], project_start=True)
    np.testing.assert_allclose(rows @ start.velocity, 0.0, atol=1e-15)


def test_nearly_dependent_rows_are_kept_with_a_warning(particle):
    system = particle(constraints=[[1.0, 0.5, 0.0], [1.0, 0.5, 1e-7]])
    with pytest.warns(DependentConstraintsWarning, match=r"\[1\] nearly depend on the rows before"):
        start = system.state(BASE, [0.5, -1.0, 0.0])
    assert start.active_rows == (0, 1)


def test_rows_that_are_dependent_to_round_off_only_are_dropped(particle):
    third = 1.0 / 3.0
    rows = [[third, 0.1, 0.7], [3.0 * third, 3.0 * 0.1, 3.0 * 0.7]]
    with pytest.warns(DependentConstraintsWarning, match=r"\[1\] depend"):
        assert particle(constraints=rows).state(BASE, [0, 0, 0]).active_rows == (0,)


def test_as_many_rows_as_directions_leave_only_the_drift(particle):
    system = particle(
        constraints=[[1.0, 0.5, -0.3], [0.2, -0.4, 1.0], [0.0, 0.3, 0.8]],
        drift=lambda x, p: np.array([x[1], -x[0], 0.3]),
    )
    run = motion(system, [0.7, 0.2, 0.0], [0.2, -0.7, 0.3], step=0.01, n_steps=100)
    exact = [0.7 * np.cos(1.0) + 0.2 * np.sin(1.0), 0.2 * np.cos(1.0) - 0.7 * np.sin(1.0), 0.3]
    np.testing.assert_allclose(run.base[-1], exact, atol=1e-4)


def test_more_rows_than_directions_keep_as_many_as_there_are_directions(particle):
    rows = np.array([[1.0, 0.5, -0.3], [0.2, -0.4, 1.0], [0.0, 0.3, 0.8], [1.0, 1.0, 1.0]])
    with pytest.warns(DependentConstraintsWarning, match=r"\[3\] depend on the rows \[0, 1, 2\]"):
        assert particle(constraints=rows).state(BASE, [0, 0, 0]).active_rows == (0, 1, 2)


@pytest.mark.parametrize("method", [gni.GNI(), gni.Rattle()], ids=str)
def test_no_constraints_and_zero_rows_of_constraints_are_the_same_system(particle, method):
    terms = {"potential": lambda x, p: np.cos(x[0]) * x[2]}
    without, empty = particle(**terms), particle(constraints=np.zeros((0, 3)), **terms)
    assert empty.constraint_count == 0
    first, second = (
        motion(system, BASE, [0.3, -0.2, 0.9], method=method) for system in (without, empty)
    )
    assert first.rows.tobytes() == second.rows.tobytes()


# ---------------------------------------------------------------- unusual systems


def test_the_momentum_of_a_start_contains_the_gyroscopic_term(particle):
    system = particle(gyroscopic=lambda x, p: np.array([-p.b * x[1], p.b * x[0], 0.0]),
                      parameters={"b": 1.7})
    start = system.state(BASE, [0.1, 0.2, 0.3])
    expected = np.array(MASSES) * [0.1, 0.2, 0.3] + np.array([1.7 * 0.2, 1.7 * 0.3, 0.0])
    np.testing.assert_allclose(start.momentum, expected, rtol=1e-15)


def test_a_charge_in_a_magnetic_field_runs_on_its_circle():
    system = gni.MechanicalSystem(
        gni.PairGroupoid(2),
        1.3 * np.eye(2),
        gyroscopic=lambda x, p: 0.5 * p.b * np.array([-x[1], x[0]]),
        parameters={"b": 1.7},
    )
    run = motion(system, [0.4, -0.3], [0.6, 0.2], step=0.001, n_steps=1000)
    angle = -1.7 / 1.3
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    np.testing.assert_allclose(run.velocities[-1], turn @ [0.6, 0.2], atol=1e-6)


@pytest.mark.parametrize("method", [gni.ReferenceFlow(), gni.Midpoint()], ids=str)
def test_a_pendulum_of_one_degree_of_freedom_keeps_its_energy(method):
    system = gni.MechanicalSystem(
        gni.PairGroupoid(1),
        lambda x, p: np.array([[p.m + 0.1 * np.cos(x[0])]]),
        potential=lambda x, p: -2.2 * np.cos(x[0]),
        parameters={"m": 1.3},
    )
    run = motion(system, [0.4], [0.9], step=0.01, n_steps=300, method=method)
    assert np.ptp(run.energy()) < 1e-4 * abs(run.energy()[0])


@pytest.mark.parametrize("method", [gni.GNI(), gni.Rattle()], ids=str)
def test_a_spring_of_one_degree_of_freedom_and_constant_mass_runs(method):
    system = gni.MechanicalSystem(
        gni.PairGroupoid(1), [[1.3]], potential=lambda x, p: 0.7 * x[0] ** 2
    )
    run = motion(system, [0.4], [0.9], step=0.01, n_steps=300, method=method)
    assert np.ptp(run.energy()) < 1e-3 * run.energy()[0]


def test_a_system_of_twelve_dimensions_and_four_constraints_keeps_both_records():
    rng = np.random.default_rng(11)
    mixing = rng.uniform(-0.3, 0.3, (12, 12))
    metric = np.diag(np.linspace(0.6, 2.3, 12)) + mixing @ mixing.T
    tilt, rows = rng.uniform(-0.2, 0.2, (4, 12)), rng.uniform(-1.0, 1.0, (4, 12))
    system = gni.MechanicalSystem(
        gni.PairGroupoid(12),
        metric,
        constraints=lambda x, p: rows + tilt * x[0],
        potential=lambda x, p: 0.5 * (x @ x),
    )
    start = system.state(
        rng.uniform(-0.5, 0.5, 12), rng.uniform(-1.0, 1.0, 12), project_start=True
    )
    run = gni.integrate(system, start, step=0.05, n_steps=100)
    assert np.max(np.abs(run.constraint_residuals(relative=True))) < 1e-13
    assert np.ptp(run.energy()) < 5e-3 * run.energy()[0]


def test_making_a_system_and_a_start_leaves_no_trace_in_the_process(particle):
    def process():
        generator = np.random.get_state()  # noqa: NPY002
        return generator[1].tolist(), generator[2:], np.geterr(), list(warnings.filters)

    np.random.seed(20240229)  # noqa: NPY002
    before = process()
    particle(potential=lambda x, p: np.cos(x[0])).state(BASE, [0.1, 0.2, 0.3])
    assert process() == before


def test_a_momentum_that_overflows_is_refused(particle):
    system = particle(metric=np.diag([1e200, 0.7, 2.1]))
    with pytest.raises(InputError, match=r"the momentum G xi \+ A overflows at the base point"):
        system.state(BASE, [1e200, 0.2, 0.3])


def test_the_runner_of_a_method_is_made_once_per_set_of_active_rows(knife_edge):
    assert compiled_step(knife_edge, gni.GNI(), (0,)) is compiled_step(knife_edge, gni.GNI(), (0,))
    assert compiled_step(knife_edge, gni.GNI(), ()) is not compiled_step(
        knife_edge, gni.GNI(), (0,)
    )


def test_a_start_survives_pickling_and_is_checked_again_where_it_arrives(knife_edge):
    start = knife_edge.state([0.3, -0.2, 0.5], [0.4, 0.7, 0.0], project_start=True)
    again = pickle.loads(pickle.dumps(start))
    assert start.checked_by is knife_edge
    assert again.checked_by is None
    np.testing.assert_array_equal(again.momentum, start.momentum)
    checked = knife_edge.checked_again(again)
    assert checked.checked_by is knife_edge
    assert knife_edge.checked_again(checked) is checked


def test_a_start_is_not_checked_again_where_all_parameters_are_equal():
    system = gni.MechanicalSystem(
        gni.SE2(), metric=lambda x, p: np.diag([p.J, p.m, p.m]),
        constraints=[[0.0, 0.0, 1.0]], parameters={"m": 1.3, "J": 0.4},
    )
    start = system.with_parameters(m=2.2).state(velocity=[0.4, 0.7, 0.0])
    assert system.with_parameters(m=2.2).checked_again(start) is start
    other = system.with_parameters(m=2.3).checked_again(start)
    assert other is not start
    np.testing.assert_allclose(other.momentum, [0.16, 1.61, 0.0], rtol=1e-14)
    alike = gni.MechanicalSystem(
        gni.SE2(), metric=lambda x, p: np.diag([p.J, 3 * p.m, p.m]),
        constraints=[[0.0, 0.0, 1.0]], parameters={"m": 2.2, "J": 0.4},
    )
    np.testing.assert_allclose(alike.checked_again(start).momentum[1], 4.62, rtol=1e-14)
