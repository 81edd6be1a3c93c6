"""Figures of virtual_thickness: the shape of a transition, error, jags and blur over thickness, pictures.

    python3 analysis/virtual_thickness.py results/virtual_thickness
"""
from __future__ import annotations

import sys

import matplotlib.pyplot as plt

import common

UNITS = {"polygons": "pixels", "volume": "voxels"}
TITLES = {"polygons": "ball in a cube", "volume": "surfaces in a dense volume"}


def transitions(result) -> None:
    rows, fits = result.tables["transitions"], result.tables["fits"]
    fig, axes = common.subplots(1, 2)
    ax = axes[0]
    opacity = fits.opacity.max()
    for color, (thickness, r) in zip(common.COLORS, rows[rows.opacity == opacity].groupby("thickness_px")):
        fit = fits[(fits.opacity == opacity) & (fits.thickness_px == thickness)].iloc[0]
        middle = fit.center_px
        near = r[(r.x_px - middle).abs() <= 1.5 * fit.overlap_px]
        ax.plot((near.x_px - middle) / fit.overlap_px, near.share, "o", color=color, ms=3, label=f"thickness {thickness:g} pixels")
        ax.plot((near.x_px - middle) / fit.overlap_px, near.fitted_share, color=color, lw=0.9)
    ax.set(xlabel="distance from the crossing / where slabs cease to overlap", ylabel="share of one surface",
           title=f"opacity {opacity:g}: points drawn, lines fitted", xlim=(-1.5, 1.5))
    ax.legend(loc="upper left")
    ax = axes[1]
    for color, (opacity, r) in zip(common.COLORS, fits.groupby("opacity")):
        ax.errorbar(r.thickness_px, r.exponent, yerr=r.exponent_error, fmt="o-", color=color, label=f"opacity {opacity:g}: exponent")
        ax.plot(r.thickness_px, r.width_px / r.overlap_px, "s--", color=color, label=f"opacity {opacity:g}: width / overlap")
    ax.set(xscale="log", xlabel="thickness, pixels", title="fits by Ceres", ylim=(0, 2.4))
    ax.set_xticks(sorted(fits.thickness_px.unique()), [f"{t:g}" for t in sorted(fits.thickness_px.unique())])
    ax.minorticks_off()
    ax.legend(loc="center", bbox_to_anchor=(0.5, 0.66), fontsize=7)
    opaque = fits
    common.save(fig, result.folder, "transition", caption=(
        "Two surfaces that cross, each a virtual slab under the modified interpolation: the share that one of them has of a pixel's "
        "colour. With the mixture (4.4) two slabs, opaque or not, give way to one another as a triangle, share = 1/2 + u - u²/2, u the distance "
        "over that at which they cease to overlap; fitted with width and exponent free the exponent is "
        f"{opaque.exponent.min():.4f} to {opaque.exponent.max():.4f} (theory 2) and the width {((opaque.width_px / opaque.overlap_px)).min():.4f} "
        f"to {((opaque.width_px / opaque.overlap_px)).max():.4f} of the overlap (theory 1)."))


def errors(result) -> None:
    table = result.tables["thickness"]
    best = result.tables["best"].set_index("scene")
    fig, axes = common.subplots(1, 2)
    text = []
    for ax, (scene, rows) in zip(axes, table.groupby("scene", sort=False)):
        auto = rows[rows.thickness.isna()].iloc[0]
        swept = rows[rows.thickness.notna()].sort_values("thickness")
        for color, (key, label) in zip(common.COLORS, (("rmse", "RMSE"), ("jag", "jags"), ("blur", "blur"))):
            ax.plot(swept.thickness, swept[key], "o-", color=color, label=label)
            ax.axhline(auto[key], color=color, lw=0.8, ls=":")
        ax.set(xlabel=f"virtual thickness, {UNITS[scene]}", ylabel="beside the truth", title=TITLES[scene], yscale="log")
        ax.set_xscale("symlog", linthresh=0.125)
        ax.set_xlim(-0.02, None)
        ax.minorticks_off()
        ax.set_xticks([0, 0.125, 0.5, 1, 3, 10, 50], ["0", "1/8", "1/2", "1", "3", "10", "50"])
        ax.legend(loc="upper left", title="dotted: auto")
        b = best.loc[scene]
        text.append(f"{TITLES[scene]}: least error at {b.least_error_at:g} {UNITS[scene]} ({b.least_rmse:.4f}; {b.rmse_at_0:.4f} without "
                    f"thickness), auto {b.rmse_auto:.4f}")
    common.save(fig, result.folder, "thickness", caption=(
        "Error over the thickness of virtual slabs (zSlab figures 5.3, 6.14 in kind), away from outlines, beside the supersampled truth; "
        "jags are gradients that the truth does not have, blur gradients that it has. " + "; ".join(text) + ". Auto is half a pixel's size on the "
        "surface where there is no volume. With one it is the smallest voxel pitch, as the dissertation has it: "
        f"{best.loc['volume'].rmse_auto / best.loc['volume'].least_rmse:.1f} times the least error, "
        f"{best.loc['volume'].rmse_auto / best.loc['volume'].rmse_at_0:.2f} times that without thickness, and "
        f"{best.loc['volume'].jag_auto / best.loc['volume'].jag_at_0:.2f} times its jags: a surface blurs over a voxel where the volume's own "
        "boundary is sharper."))


def pictures(result) -> None:
    names = ("truth", "0", "auto", "50")
    folder = result.folder / "pictures"
    if not all((folder / f"{scene}_{name}.png").exists() for scene in UNITS for name in names):
        return
    fig, axes = plt.subplots(2, 4, figsize=(2 * common.COLUMN_IN, common.COLUMN_IN))
    for row, scene in zip(axes, UNITS):
        for ax, name in zip(row, names):
            ax.imshow(plt.imread(folder / f"{scene}_{name}.png"))
            ax.set_axis_off()
            ax.set_title({"truth": "truth", "auto": "auto"}.get(name, f"{name} {UNITS[scene]}"))
    common.save(fig, result.folder, "pictures", caption=(
        "A ball that looks out of a cube, and surfaces in a dense volume: the truth, no thickness, auto, and far too thick: what lies "
        "behind shows through."))


def main() -> None:
    result = common.load(sys.argv[1])
    transitions(result)
    errors(result)
    pictures(result)


if __name__ == "__main__":
    main()
