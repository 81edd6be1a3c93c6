"""Figures of opacity_control: wished against achieved opacity, and what a counting sphere counts beside its great circle.

    python3 analysis/opacity_control.py results/opacity_control
"""
from __future__ import annotations

import math
import sys

import numpy as np

import common


def main() -> None:
    result = common.load(sys.argv[1])
    control = result.tables["control"]
    bias = result.tables["bias"]
    drawn = result.tables["drawn"]
    exact = drawn[drawn.way == "exact"]
    fig, axes = common.subplots(1, 4, height_in=3.9)
    fig.set_size_inches(17, 4.1)

    ax = axes[0]
    for color, (name, rows) in zip(common.COLORS, control.groupby("surface", sort=False)):
        ax.errorbar(rows.wished, 100 * (rows.counted - rows.wished), yerr=100 * rows.counted_error, fmt="o-", lw=1, color=color,
                    label=name.replace("_", " "))
    for marker, (name, rows) in zip("sdv", exact.groupby("surface", sort=False)):
        ax.errorbar(rows.wished, 100 * (rows.drawn - rows.predicted), yerr=100 * rows.error, fmt=marker, ms=4, mfc="none", lw=1,
                    color=common.THEORY, label=f"exact count, drawn: {name.replace('_', ' ')}")
    ax.axhline(0, color=common.THEORY, lw=0.8)
    ax.set(xlabel="wished opacity", ylabel="achieved − wished, in 1/100", title="opacity by counting spheres")
    ax.legend(loc="best")

    titles = (("curvature", "(κ₁ − κ₂)² r²", "curvature: a cylinder"), ("edge", "distance to an open edge, in radii", "open edge"),
              ("second sheet", "distance to a second sheet, in radii", "second sheet"))
    for ax, (case, label, title) in zip(axes[1:], titles):
        rows = bias[bias["case"] == case]
        ax.errorbar(rows.x, rows.ratio, yerr=rows.ratio_error, fmt="o", color=common.COLORS[0], label="counted")
        ax.plot(rows.x, rows.exact, color=common.THEORY, lw=0.9, label="geometry")
        if case == "curvature":
            ax.plot(rows.x, rows.series, color=common.COLORS[1], ls="--", lw=0.9, label="1 + (κ₁ − κ₂)² r²/32")
        ax.set(xlabel=label, ylabel="area inside over the great circle's", title=title)
        # The density is off by the inverse of the ratio, and (1) says what opacity that gives.
        other = ax.secondary_yaxis("right", functions=(lambda ratio: 1 - 0.5 ** (1 / np.maximum(ratio, 0.05)),
                                                       lambda opacity: math.log(0.5) / np.log1p(-np.clip(opacity, 0.05, 1 - 1e-6))))
        other.set_ylabel("achieved for a wished 0.5")
        ax.legend(loc="best")

    worst = control.loc[(control.counted - control.wished).abs().idxmax()]
    common.save(fig, result.folder, "opacity_control", caption=(
        "The paper's opacity control beside the exact count. Left: 100 spheres at random places of whole surfaces, bars one standard "
        f"error of a run; largest deviation {worst.counted - worst.wished:+.3f} at {worst.wished:g} on the {worst.surface.replace('_', ' ')}. "
        f"Images with the exact count differ from the opacity of their sheets by at most {(exact.drawn - exact.predicted).abs().max():.4f} "
        f"(largest |z| of {len(exact)}: {((exact.drawn - exact.predicted) / exact.error).abs().max():.1f}). Right: what one kind of place does. Where the principal curvatures differ a sphere holds "
        "more than its great circle (no bias on a sphere), at an open edge half of it, beside a second sheet up to twice: the density "
        "then is off by the inverse."))


if __name__ == "__main__":
    main()
