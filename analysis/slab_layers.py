"""Figures of slab_layers: error and time over the number of layers, stages, pictures.

    python3 analysis/slab_layers.py results/slab_layers
"""
from __future__ import annotations

import sys

import matplotlib.pyplot as plt

import common

TITLES = {"layers_scientific": "scientific", "layers_stitched": "stitched", "layers_modalities": "head, brain, labels",
          "layers_stroke": "T1, T2, FLAIR"}
WAYS = ("image", "hybrid", "order-free")
CLAIM = 8  # layers that the dissertation recommends (section 6.6.2)


def title_of(scene: str) -> str:
    return TITLES.get(scene, scene)


def layer_axis(ax, layers) -> None:
    ax.set_xscale("log", base=2)
    ax.set_xticks(sorted(layers), [f"{n:g}" for n in sorted(layers)])
    ax.minorticks_off()
    ax.axvline(CLAIM, color=common.THEORY, lw=0.8, ls=":")
    ax.set_xlabel("layers N")


def count(layers: float) -> str:
    return "none" if layers != layers else f"{layers:g}"


def grid(count: int):
    """One panel a scene, two in a row."""
    columns = min(2, count)
    rows = (count + columns - 1) // columns
    fig, axes = plt.subplots(rows, columns, figsize=(columns * common.COLUMN_IN, rows * 0.68 * common.COLUMN_IN), squeeze=False)
    for ax in axes.flat[count:]:
        ax.set_visible(False)
    return fig, list(axes.flat[:count])


def errors(result) -> None:
    table = result.tables["errors"]
    table = table[table.backend == "cpu"]
    enough = result.tables["enough"]
    enough = enough[enough.backend == "cpu"]
    scenes = list(dict.fromkeys(table.scene))
    fig, axes = grid(len(scenes))
    text = []
    for ax, scene in zip(axes, scenes):
        rows = table[table.scene == scene]
        for color, way in zip(common.COLORS, WAYS):
            r = rows[rows.method == way].sort_values("layers")
            if r.empty:
                continue
            ax.plot(r.layers, r.rmse_mdvr, "o-", color=color, label=f"{way}, beside conventional")
            ax.plot(r.layers, r.rmse_truth, "s--", color=color, ms=3, lw=0.9, label=f"{way}, beside the truth")
        floor = rows[rows.method == "mdvr"].rmse_truth.iloc[0]
        ax.axhline(floor, color=common.THEORY, lw=0.9, label="conventional, beside the truth")
        layer_axis(ax, rows.layers.dropna().unique())
        ax.set(yscale="log", ylabel="RMSE", title=title_of(scene))
        first = enough[enough.scene == scene].set_index("intermix")
        text.append(f"{title_of(scene)} " + ", ".join(f"{way} {count(first.truth_layers[way])} ({count(first.mdvr_layers[way])})"
                                                     for way in WAYS if way in first.index))
    axes[0].legend(fontsize=7)
    common.save(fig, result.folder, "error", caption=(
        "Error of zSlabs over the number of layers, beside conventional multi-volume ray-casting (mdvr) with the same step and mixing, and "
        "beside the truth. Claim (section 6.6.2): 8 layers are the most efficient. Finding: beside the truth within a tenth of conventional "
        "ray-casting from so many layers on, in brackets beside conventional ray-casting within a tenth of the most layers: "
        + "; ".join(text) + ". What is left beside conventional ray-casting at many layers is the split of slabs that were "
        "composited before they met (image-level); the truth takes many sub-rays in a pixel, conventional ray-casting one."))


def times(result) -> None:
    table = result.tables["times"]
    scenes = list(dict.fromkeys(table.scene))
    for (backend, side), here in table.groupby(["backend", "side_px"]):
        fig, axes = grid(len(scenes))
        text = []
        for ax, scene in zip(axes, scenes):
            rows = here[here.scene == scene]
            for color, way in zip(common.COLORS, WAYS):
                r = rows[(rows.intermix == way) & rows.skip].sort_values("layers")
                if r.empty:
                    continue
                ax.errorbar(r.layers, r.median_s, yerr=[r.median_s - r.least_s, r.most_s - r.median_s], fmt="o-", color=color,
                            label=f"{way}, skipping")
                off = rows[(rows.intermix == way) & ~rows.skip]
                ax.errorbar(off.layers, off.median_s, yerr=[off.median_s - off.least_s, off.most_s - off.median_s], fmt="x", color=color,
                            label=f"{way}, not skipping")
            for style, skip in (("-", True), ("--", False)):
                r = rows[(rows.method == "mdvr") & (rows.skip == skip)]
                ax.axhline(r.median_s.iloc[0], color=common.THEORY, ls=style, lw=1,
                           label=f"conventional, {'' if skip else 'not '}skipping")
            layer_axis(ax, rows.layers.dropna().unique())
            ax.set(yscale="log", ylabel="seconds a picture", title=title_of(scene))
            text.append(f"{title_of(scene)} " + four_ratios(rows))
        axes[0].legend(fontsize=6, ncol=2)
        common.save(fig, result.folder, f"time_{backend}_{side}", caption=(
            f"Time of a picture of {side}² pixels over the number of layers, backend {backend}; median and range of "
            f"{here.runs.iloc[0]} runs. Claim (figure 6.18): image-level intermixing that skips empty space is faster than conventional "
            "ray-casting that does not, in all cases. Finding, time of conventional over image-level with 8 layers (conventional/image-level "
            "skipping: no/yes as in the dissertation; yes/yes; no/no; yes/no): " + "; ".join(text) + ". Labels are sampled by the nearest: "
            "that takes conventional ray-casting, all volumes of which step together, to the plain caster in double, of slabs the labels' "
            "own array alone."))


def four_ratios(rows) -> str:
    def seconds(method: str, skip: bool) -> float:
        r = rows[(rows.method == method) & (rows.skip == skip)]
        if method == "slabs":
            r = r[(r.intermix == "image") & (r.layers == CLAIM)]
        return r.median_s.iloc[0] if len(r) else float("nan")

    return "; ".join(f"{seconds('mdvr', theirs) / seconds('slabs', ours):.2f}" for theirs, ours in
                     ((False, True), (True, True), (False, False), (True, False))).replace("; ", ", ")


def stages(result) -> None:
    table = result.tables["stages"]
    table = table[(table.intermix == "image") & table.skip.astype(bool)].copy()
    backends = list(dict.fromkeys(table.backend))
    scenes = list(dict.fromkeys(table.scene))
    fig, axes = plt.subplots(len(backends), len(scenes), squeeze=False,
                             figsize=(max(1.1, 0.55 * len(scenes)) * common.COLUMN_IN, 0.6 * len(backends) * common.COLUMN_IN))
    for row, backend in zip(axes, backends):
        rows = table[table.backend == backend]
        rows = rows[rows.side_px == rows.side_px.min()]  # of all numbers of layers
        clock = "wall_s" if rows.device_s.isna().all() else "device_s"
        rows = rows[rows[clock].notna()]
        colors = dict(zip(dict.fromkeys(rows.stage), common.COLORS))
        for ax, scene in zip(row, scenes):
            pivot = rows[rows.scene == scene].pivot_table(index="layers", columns="stage", values=clock, aggfunc="sum")
            bottom = 0
            for stage, color in colors.items():
                ax.bar(range(len(pivot)), pivot[stage], bottom=bottom, color=color, label=stage)
                bottom = bottom + pivot[stage].fillna(0)
            ax.set_xticks(range(len(pivot)), [f"{n:g}" for n in pivot.index])
            ax.set(xlabel="layers N", title=f"{title_of(scene)}, {backend}, {rows.side_px.min()}²")
        row[0].set_ylabel("seconds")
        row[0].legend(fontsize=7)
    common.save(fig, result.folder, "stages", caption=(
        "Where the time of image-level intermixing goes over the number of layers: wall time on the CPU (\"volumes\" casts and collects, "
        "\"intermix\" merges, compresses and stores arrays), timestamps of the device on Vulkan. The dissertation finds the reading of "
        "z-thickness buffers dearer than the kernel."))


def pictures(result) -> None:
    folder = result.folder / "pictures"
    names = ("truth", "mdvr", "image_2", "image_4", "image_8", "hybrid_8", "order-free_8")
    scenes = [s for s in dict.fromkeys(result.tables["errors"].scene) if (folder / f"{s}_truth.png").exists()]
    shown = [n for n in names if all((folder / f"{s}_{n}.png").exists() for s in scenes)]
    if not scenes or not shown:
        return
    fig, axes = plt.subplots(len(scenes), len(shown), figsize=(2.2 * common.COLUMN_IN, 2.2 * common.COLUMN_IN * len(scenes) / len(shown)),
                             squeeze=False)
    for row, scene in zip(axes, scenes):
        for ax, name in zip(row, shown):
            ax.imshow(plt.imread(folder / f"{scene}_{name}.png"))
            ax.set_axis_off()
            if scene == scenes[0]:
                ax.set_title({"mdvr": "conventional"}.get(name, name.replace("_", ", N = ")))
    common.save(fig, result.folder, "pictures", caption=(
        "The scenes (zSlab figures 6.7, 6.8 in kind) by the truth, by conventional ray-casting, by image-level intermixing with 2, 4 and 8 layers, "
        "and by hybrid and order-free intermixing with 8."))


def main() -> None:
    result = common.load(sys.argv[1])
    errors(result)
    times(result)
    stages(result)
    pictures(result)


if __name__ == "__main__":
    main()
