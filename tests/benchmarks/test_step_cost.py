"""The hand-written C of the benchmark and the library end at the same state. No times."""

import importlib.util
import sys
from pathlib import Path

import pytest


def _load():
    path = Path(__file__).with_name("step_cost.py")
    spec = importlib.util.spec_from_file_location("step_cost", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["step_cost"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


step_cost = _load()


@pytest.mark.skipif(step_cost.c_compiler() is None, reason="no C compiler (cc) on this machine")
@pytest.mark.parametrize("scheme", step_cost.METHODS)
@pytest.mark.parametrize("case", step_cost.CASES)
def test_c_and_library_end_at_the_same_state(case, scheme, tmp_path):
    problem = step_cost.Problem(case(), scheme)
    reached = step_cost.agreement(problem, step_cost.c_contenders(problem, tmp_path))
    _, iterations = reached["library"]
    for name, (difference, own) in reached.items():
        assert difference < 1e-10, name
        # round-off may decide about an iteration in a thousand, not more
        assert abs(own - iterations) <= 0.001 * iterations, name


@pytest.mark.parametrize("scheme", step_cost.METHODS)
@pytest.mark.parametrize("case", step_cost.CASES)
def test_derived_path_ends_at_the_same_state(case, scheme):
    problem = step_cost.Problem(case(), scheme)
    derived = problem.library("derived", problem.derived)
    difference, _ = step_cost.agreement(problem, [derived])["derived"]
    assert difference < 1e-10
