"""One figure of many laws on many objects: how far each is from being broken."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from groupoid_gni.array_types import FloatArray
from groupoid_gni.plotting.panels import style

_DECADES = 6.0

Panel = tuple[Sequence[str], Sequence[str], FloatArray]
"""Laws, objects, and residual over tolerance of every pair: (laws, objects), NaN if not tried."""


def plot_laws(panels: Mapping[str, Panel]) -> Any:
    """Residual over tolerance of every law (down) on every object (across), in decades.

    panels : title -> (laws, objects, ratios); a ratio above 1 is a broken law.
    Returns the matplotlib figure; nothing is shown or written.
    """
    with style():
        longest = max(len(laws) for laws, _, _ in panels.values())
        widths = [len(objects) + 11.0 for _, objects, _ in panels.values()]
        figure = Figure(figsize=(0.215 * sum(widths), 2.2 + 0.165 * longest), layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.subplots(1, len(panels), width_ratios=widths, squeeze=False)[0]
        images = [
            _draw(axes, title, panel, longest)
            for axes, (title, panel) in zip(grid, panels.items(), strict=True)
        ]
        bar = figure.colorbar(images[-1], ax=list(grid), location="bottom", shrink=0.35, aspect=40)
        bar.ax.set_xlim(-_DECADES, 1.0)
        bar.set_label("worst residual over allowed residual, powers of ten (grey: does not apply)")
        return figure


def _draw(axes: Any, title: str, panel: Panel, longest: int) -> Any:
    laws, objects, ratios = panel
    axes.set_title(title)
    with np.errstate(divide="ignore"):
        decades = np.clip(np.log10(ratios), -_DECADES, 1.0)
    image = axes.imshow(
        decades, cmap="RdYlGn_r", vmin=-_DECADES, vmax=_DECADES, aspect="auto",
        interpolation="nearest",
    )
    axes.set_facecolor("0.93")
    axes.set_xticks(range(len(objects)), objects, rotation=90, fontsize=7)
    axes.set_yticks(range(len(laws)), [law.replace("_", " ") for law in laws], fontsize=6.5)
    axes.set_ylim(longest - 0.5, -0.5)
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.axhspan(len(laws) - 0.5, longest - 0.5, color="white", zorder=2)
    return image
