"""Every example runs, compares itself with a known answer and writes its figure."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import groupoid_gni as gni

EXAMPLES = Path(__file__).parent.parent / "examples"


def load(name):
    specification = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def test_every_example_is_tested_here():
    assert {p.stem for p in EXAMPLES.glob("*.py")} == {
        "chaplygin_sleigh", "figures_of_the_paper", "hopf_gauge_groupoid", "rolling_sphere",
        "six_systems", "steer_the_robot",
    }  # fmt: skip


def test_chaplygin_sleigh_settles_with_gni_and_is_reversed_with_rattle(tmp_path, capsys):
    errors = load("chaplygin_sleigh").main(tmp_path / "sleigh.png")
    assert errors["GNI"] < 2e-3
    assert errors["Rattle"] > 3.0
    assert (tmp_path / "sleigh.png").stat().st_size > 20_000
    assert "left its O(h^2) level" in capsys.readouterr().out


def test_rolling_sphere_has_order_two_and_the_known_error(tmp_path, capsys):
    numbers = load("rolling_sphere").main(tmp_path / "new folder" / "sphere.png")
    assert numbers["slope"] == pytest.approx(2.0, abs=0.03)
    assert numbers["error"] == pytest.approx(3.8e-3, rel=0.03)
    assert numbers["difference"] < 5e-3
    assert (tmp_path / "new folder" / "sphere.png").stat().st_size > 20_000
    assert "moving energy" in capsys.readouterr().out


def test_hopf_gauge_groupoid_gives_the_motion_of_the_action_groupoid(tmp_path, capsys):
    numbers = load("hopf_gauge_groupoid").main(tmp_path / "hopf.png")
    assert numbers["difference"] < 2e-11
    assert numbers["off sphere"] < 2e-15
    assert numbers["moving energy"] < 2e-4
    assert numbers["crossings"] == 31
    assert (tmp_path / "hopf.png").stat().st_size > 20_000
    assert "HopfGaugeGroupoid" in capsys.readouterr().out


def test_six_systems_follow_their_exact_or_reference_motions(tmp_path, capsys):
    errors = load("six_systems").main(tmp_path / "six.png")
    assert len(errors) == 6
    assert max(errors.values()) < 1e-3
    assert (tmp_path / "six.png").stat().st_size > 100_000
    assert "heading left out" in capsys.readouterr().out


def test_figures_of_the_paper_have_their_slopes_and_files(tmp_path, capsys):
    numbers = load("figures_of_the_paper").main(tmp_path / "new folder", quick=True)
    assert len(numbers) == 5
    slope = numbers["paper_figure_1"]["GNI: slope of (x, y)"]
    assert slope == pytest.approx(2.0, abs=0.02)
    for name in numbers:
        assert (tmp_path / "new folder" / f"{name}.png").stat().st_size > 10_000
        assert (tmp_path / "new folder" / f"{name}.npz").stat().st_size > 1_000
    assert "order-one consistent" in capsys.readouterr().out


def test_steer_the_robot_parks_and_its_torques_do_so_in_integrate(tmp_path, capsys):
    numbers = load("steer_the_robot").main(tmp_path / "robot.png")
    for order, miss in (("order 2", 3.1e-2), ("order 4", 4.2e-6)):
        found = numbers[order]
        assert found["replay"] < 1e-9
        assert found["pose"] < 1e-9
        assert found["constraint"] < 1e-14
        assert found["end energy"] < 1e-18
        assert found["effort"] == pytest.approx(10.81, abs=0.02)
        assert found["true miss"] == pytest.approx(miss, rel=0.05)
    assert (tmp_path / "robot.png").stat().st_size > 30_000
    assert "IPOPT" in capsys.readouterr().out


def test_the_robot_without_wheel_angles_moves_as_the_one_with_them():
    small, scene = load("steer_the_robot").robot(), gni.scenes.two_wheeled_robot()
    whole = gni.MechanicalSystem(
        scene.system.space, scene.system.plain["metric"],
        constraints=scene.system.plain["constraints"],
        force=lambda x, xi, p, u: np.array([u[0], u[1], 0.0, 0.0, 0.0]), controls=2,
        parameters=small.parameters,
    )  # fmt: skip
    torques = np.stack([np.sin(0.9 * np.arange(8)), np.cos(1.3 * np.arange(8))], axis=1)
    options = {"step": 0.25, "n_steps": 8, "controls": torques}
    options["method"] = gni.ReferenceFlow(rtol=1e-12)
    start = whole.state(velocity=scene.start.velocity)
    expected = gni.integrate(whole, start, reconstruct=True, **options)
    run = gni.integrate(small, small.state(np.eye(3).ravel(), start.velocity[2:]), **options)
    np.testing.assert_allclose(run.velocities, expected.velocities[:, 2:], atol=1e-10)
    poses = expected.reconstruct()[:, -9:]
    np.testing.assert_allclose(run.base, poses, atol=1e-8)
