"""The README is executed: its code, its two commands, its figure."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def block(language, number=0):
    parts = README.split(f"```{language}\n")[1:]
    return parts[number].split("```")[0]


def test_the_fourteen_lines_run_as_printed(capsys):
    names = {}
    exec(compile(block("python"), "README.md", "exec"), names)
    run = names["run"]
    assert run.success
    assert len(run) == 10001
    exact_rate = (2 / 3) / (2 / 3 + 1.0)
    speed = run.velocities[:, :2]
    assert speed @ [1.0, 1.0] == pytest.approx(speed[0] @ [1.0, 1.0], abs=10.0)
    assert abs(float((speed**2).sum(axis=1).max()) - 2.0) < 0.05, exact_rate
    assert "success" in capsys.readouterr().out


def test_the_fourteen_lines_are_about_fourteen():
    assert len(block("python").strip().splitlines()) <= 17


def test_ci_calls_exactly_the_second_command():
    command = block("bash", 1).strip().splitlines()[-1]
    assert command in (ROOT / ".ci" / "run").read_text(encoding="utf-8").splitlines()


def test_every_file_the_readme_points_to_exists():
    targets = [part.split(")")[0] for part in README.split("](")[1:]]
    assert targets
    for target in targets:
        assert (ROOT / target).exists(), target
