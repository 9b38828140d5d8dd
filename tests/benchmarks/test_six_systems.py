"""The tables of six_systems.py: their orders, and that the script prints them. No times."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest


def _load():
    path = Path(__file__).with_name("six_systems.py")
    spec = importlib.util.spec_from_file_location("six_systems", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["six_systems"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


six_systems = _load()


@pytest.mark.slow
def test_symmetric_methods_are_of_order_two_on_all_six_systems():
    for row in six_systems.rows():
        cells = dict(zip(six_systems.METHODS, six_systems.orders(row), strict=True))
        for name in ("Rattle", "Midpoint", "GNI", "Lagrange-d'Alembert"):
            if (row.name, name) == ("particle, free", "GNI"):
                assert cells[name] == "exact"
            else:
                assert float(cells[name]) == pytest.approx(2.0, abs=0.05), (row.name, name)
        # where nothing depends on the base point, Euler A and B are the symmetric step
        expected = 1.0 if row.scene.system.has("potential") else 2.0
        for name in ("EulerA", "EulerB"):
            assert float(cells[name]) == pytest.approx(expected, abs=0.1), (row.name, name)


@pytest.mark.slow
def test_the_script_prints_three_tables_with_a_row_for_every_scene(capsys):
    six_systems.main(["--quick"])
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    tables = np.split(np.array(lines), [11, 22])
    assert [len(table) for table in tables] == [11, 11, 11]
    for table in tables:
        assert len({line.count("|") for line in table}) == 1
