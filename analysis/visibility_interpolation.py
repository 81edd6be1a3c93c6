"""Figures of visibility_interpolation: opacity inside of a slab, bands and the eye, error and bands of pictures.

    python3 analysis/visibility_interpolation.py results/visibility_interpolation
"""
from __future__ import annotations

import sys

import matplotlib.pyplot as plt

import common

LABELS = {"modified": "modified (linear)", "original": "original (a medium's)", "original-textbook": "original, as the formula stands",
          "mdvr": "conventional ray-casting (mdvr)", "depth-peeling": "depth peeling", "z-test": "z-test", "truth": "truth"}
STYLE = dict(zip(("modified", "original", "original-textbook", "mdvr", "depth-peeling", "z-test"), common.COLORS))


def profiles(result) -> None:
    rows, digits = result.tables["profile"], result.tables["digits"]
    fig, axes = common.subplots(1, 2)
    ax = axes[0]
    cmap = plt.get_cmap("viridis")
    for opacity, r in rows.groupby("opacity"):
        color = cmap(0.9 * opacity)
        for name, line in (("original", "-"), ("modified", "--")):
            part = r[r.interpolation == name]
            ax.plot(part.t_over_d, part.front_opacity, line, color=color, lw=1)
        ax.annotate(f"{opacity:g}", (1.01, r.front_opacity.max()), color=color, fontsize=7, va="center", annotation_clip=False)
    ax.plot([], [], "-", color="k", label="original = homogeneous medium")
    ax.plot([], [], "--", color="k", label="modified")
    ax.set(xlabel="t / d", ylabel="opacity of the front part", title="opacity inside of a slab", xlim=(0, 1), ylim=(0, 1.25))
    ax.legend(loc="upper left")
    ax = axes[1]
    for name in ("original", "original-textbook"):
        part = digits[digits.interpolation == name].groupby("opacity").relative_error.max().reset_index()
        small = part[part.opacity <= 0.5]
        ax.plot(small.opacity, small.relative_error.clip(lower=1e-9), "o-", color=STYLE[name], label=LABELS[name])
    ax.axhline(2.0 ** -23, color=common.THEORY, lw=0.8, ls=":", label="one unit in the last place")
    ax.set(xscale="log", yscale="log", xlabel="opacity of the slab", ylabel="largest relative error of the front part",
           title="what is model and what is numerics")
    ax.legend(loc="center left")
    common.save(fig, result.folder, "profile", caption=(
        "Opacity of the front part of a slab that is cut at t (zSlab figure 3.1): original (3.2) is that of a homogeneous medium, modified "
        "(3.4) is linear, so the front half of a slab of 0.9 has 0.45 of it where the medium has 0.684. Right: (3.2) by expm1 and log1p is right to "
        f"{digits[digits.interpolation == 'original'].relative_error.max():.1e}; as the formula stands, in float32, thin slabs lose all their "
        f"digits. The pictures of both differ in RMSE by at most {same_pictures(result):.1e}: lost digits are not what makes bands here (divisions by "
        "zero, to which the dissertation ascribes them, section 6.4, count as 0 in both), and the jump at opacity 1 is the model's."))


def same_pictures(result) -> float:
    """Largest difference of error between the evaluations of (3.2), over all pictures."""
    table = result.tables["pictures"]
    keys = ["scene", "opacity", "thickness_px", "step_voxels"]
    stable, textbook = (table[table.method == m].fillna({k: -1 for k in keys}).set_index(keys).rmse for m in ("original", "original-textbook"))
    return float((stable - textbook).abs().max())


def bands(result) -> None:
    rows = result.tables["bands"]
    rows = rows[rows.period_px.notna()]
    fig, ax = common.subplots()
    for color, (key, label) in zip(common.COLORS, (("banding", "banding"), ("flip", "FLIP"), ("sensitivity", "contrast sensitivity of the eye"))):
        ax.plot(rows.period_px, rows[key] / rows[key].max(), "o-", color=color, label=label)
    ax.axhline(1, color=common.THEORY, lw=0.8, ls=":", label="RMSE")
    ax.set(xscale="log", xlabel="period of the bands, pixels (67 a degree)", ylabel="over its largest", title="bands of one RMSE")
    ax.set_xticks([2, 4, 8, 16, 32, 64], ["2", "4", "8", "16", "32", "64"])
    ax.minorticks_off()
    ax.legend(loc="lower center")
    eye = result.tables["eye"]
    seen = "Over all pictures FLIP ranks by error rather than by banding, rank correlation with banding and with RMSE: " + "; ".join(
        f"{r.scene} {r.rank_correlation_banding_flip:.2f} and {r.rank_correlation_rmse_flip:.2f}" for r in eye.itertuples())
    common.save(fig, result.folder, "bands", caption=(
        "What different numbers say of bands that all have the same RMSE: banding, the gradient beyond the truth's of the picture as the eye "
        "has it, beside the contrast sensitivity by Mannos and Sakrison, and FLIP, which is as large for a shift of the whole picture "
        "(banding: 0) as for bands. " + seen + "."))


def banding_by_thickness(crossing) -> str:
    by = {m: crossing[crossing.method == m].set_index("thickness_px").banding for m in ("modified", "original")}
    return ", ".join(f"{t:g} px {by['modified'][t] / by['original'][t]:.2f}" for t in sorted(by["modified"].index))


def errors(result) -> None:
    table = result.tables["pictures"]
    fig, axes = common.subplots(2, 2, height_in=3.3)
    crossing = table[(table.scene == "crossing") & (table.opacity == 1)]
    clipped = table[(table.scene == "clipped")]
    most = clipped.opacity.max()
    for row, (key, label) in zip(axes, (("rmse", "RMSE"), ("banding", "banding"))):
        ax = row[0]
        for name in ("modified", "original"):
            r = crossing[crossing.method == name].sort_values("thickness_px")
            ax.plot(r.thickness_px, r[key], "o-", color=STYLE[name], label=LABELS[name])
        ax.set(xlabel="virtual thickness, pixels", ylabel=label, title="two opaque surfaces that cross", ylim=(0, None))
        ax.legend(loc="best")
        ax = row[1]
        for name in ("modified", "original", "mdvr"):
            for opacity, line in ((most, "-"), (clipped.opacity.min(), ":")):
                r = clipped[(clipped.method == name) & (clipped.opacity == opacity)].sort_values("step_voxels")
                ax.plot(r.step_voxels, r[key], "o" + line, color=STYLE[name], label=f"{LABELS[name]}, opacity {opacity:g}")
        ax.set(xlabel="step, voxels", ylabel=label, title="surfaces in a clipped volume", xscale="log", ylim=(0, None))
        ax.set_xticks(sorted(clipped.step_voxels.unique()), [f"{v:g}" for v in sorted(clipped.step_voxels.unique())])
        ax.minorticks_off()
        ax.legend(loc="lower left", fontsize=6.5)
    means = clipped[clipped.opacity == most].groupby("method")[["rmse", "banding"]].mean()
    wins = "; ".join(f"{LABELS[m]} {means.rmse[m]:.4f} and {means.banding[m]:.4f}" for m in ("modified", "original", "mdvr"))
    common.save(fig, result.folder, "errors", caption=(
        "Error and banding of pictures beside the ray-traced truth. Left: two opaque surfaces, virtual slabs of one thickness: under the "
        "original interpolation thickness does nothing (the front takes all); under the modified one, banding over original's by thickness: "
        f"{banding_by_thickness(crossing)}. "
        f"Right: a volume whose opacity accrues over a voxel; means over steps at opacity {most:g}, RMSE and banding: {wins}."))


def rows_and_pictures(result) -> None:
    rows = result.tables["rows"]
    fig, axes = common.subplots(1, 2)
    for ax, scene in zip(axes, ("crossing", "clipped")):
        for name, r in rows[rows.scene == scene].groupby("method", sort=False):
            if name == "original-textbook":
                continue
            color = "k" if name == "truth" else STYLE[name]
            ax.plot(r.x_px, r.r, color=color, lw=2.2 if name == "truth" else 1, alpha=0.5 if name == "truth" else 1, label=LABELS[name])
        ax.set(xlabel="column, pixels", ylabel="red", title=f"{scene}: middle row", ylim=(0, 1.3))
        ax.legend(loc="upper left", ncols=2)
    common.save(fig, result.folder, "rows", caption="The middle row of the pictures: what becomes of a crossing in each model.")
    folder = result.folder / "pictures"
    shown = [(scene, name) for scene, names in (("crossing", ("truth", "z-test", "original", "modified")),
                                                ("clipped", ("truth", "mdvr", "original", "modified"))) for name in names]
    if not all((folder / f"{s}_{n}.png").exists() for s, n in shown):
        return
    fig, axes = plt.subplots(2, 4, figsize=(2 * common.COLUMN_IN, common.COLUMN_IN))
    for ax, (scene, name) in zip(axes.flat, shown):
        ax.imshow(plt.imread(folder / f"{scene}_{name}.png"))
        ax.set_axis_off()
        ax.set_title(LABELS[name], fontsize=9)
    common.save(fig, result.folder, "pictures", caption=(
        "Two surfaces that cross, thick virtual slabs; a clipped dense volume with a surface in the clip plane and one through all, steps of a "
        "voxel, both at opacity 1 (zSlab figures 6.9, 6.10 in kind)."))


def main() -> None:
    result = common.load(sys.argv[1])
    profiles(result)
    bands(result)
    errors(result)
    rows_and_pictures(result)


if __name__ == "__main__":
    main()
