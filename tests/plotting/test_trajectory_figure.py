"""Figures: what they hold, and that global matplotlib settings survive."""

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

import groupoid_gni as gni
from groupoid_gni.plotting import plot_path, style


@pytest.fixture(scope="module")
def runs():
    ball = gni.scenes.inhomogeneous_ball(mass=1.7, table=0.6)
    sleigh = gni.scenes.chaplygin_sleigh(mass=1.3, inertia=0.8)
    free = gni.MechanicalSystem(gni.PairGroupoid(1), metric=[[2.3]], potential=lambda x, p: x[0]**2)
    start = free.state([0.4], [0.7])
    return {
        "ball": gni.integrate(ball.system, ball.start, step=0.03, n_steps=50),
        "sleigh": gni.integrate(sleigh.system, sleigh.start, step=0.03, n_steps=50),
        "free": gni.integrate(free, start, step=0.1, n_steps=50),
    }


@pytest.mark.parametrize("name", ["ball", "sleigh", "free"])
def test_plot_draws_four_panels_for_every_kind_of_base(runs, name, tmp_path):
    figure = runs[name].plot()
    assert len(figure.axes) == 4
    assert figure.axes[2].get_title(loc="left") == "relative energy change"
    figure.savefig(tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000


def test_plot_draws_into_given_axes_and_returns_their_figure(runs):
    figure = Figure()
    assert runs["ball"].plot(axes=figure.subplots(4)) is figure


def test_style_leaves_the_global_settings_alone(runs):
    before = dict(mpl.rcParams)
    runs["ball"].plot()
    with style():
        assert mpl.rcParams["axes.grid"]
    assert dict(mpl.rcParams) == before


def test_the_path_is_the_base_path(runs):
    axes = Figure().subplots()
    plot_path(axes, runs["ball"].base[:, :2])
    assert np.array_equal(axes.lines[0].get_xydata(), runs["ball"].base[:, :2])
