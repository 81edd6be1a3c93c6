"""Figures of backend_parity: which implementation equals the specification on which scene, and how fast each is."""
from __future__ import annotations

import sys

import common
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from common import COLORS, THEORY

EQUAL, DIFFERENT = "#d9efe4", "#f6d5c3"
STAGE_WORDS = {"winners": "particles with the same pixel", "colours": "pixels with the same sums"}


def label(row) -> str:
    threads = "" if row.implementation.startswith(("wrong twin", "Vulkan")) else f", {row.threads} thread{'s' * (row.threads > 1)}"
    return f"{row.implementation}{threads}"


def labelled(result: common.Result) -> pd.DataFrame:
    table = result.tables["parity"].copy()
    several = table[table.implementation == "Vulkan"].device.nunique() > 1
    table["label"] = [label(r) + (f"\n{r.device}" if several and r.implementation == "Vulkan" else "") for r in table.itertuples()]
    return table


def cell(row) -> tuple[str, bool]:
    """What stands in a cell, and whether all is equal."""
    if row.different == 0:
        return "equal", True
    if np.isfinite(row.winners_equal_share):
        return f"{row.different:,} differ\nof {row.hits:,} hits".replace(",", " "), False
    return f"{row.different:,} pixels differ\nmean by ≤ {row.largest_mean_difference_units:.3g}/65535".replace(",", " "), False


def draw_parity(result: common.Result, table: pd.DataFrame) -> None:
    scenes = list(dict.fromkeys(table.scene))
    stages = list(dict.fromkeys(table.stage))
    rows = {stage: list(dict.fromkeys(table[table.stage == stage].label)) for stage in stages}
    height = sum(len(r) for r in rows.values())
    fig, axes = plt.subplots(len(stages), 1, figsize=(2.6 + 1.35 * len(scenes), 1.1 + 0.36 * height), squeeze=False,
                             height_ratios=[len(rows[stage]) for stage in stages])
    for ax, stage in zip(axes[:, 0], stages):
        ax.grid(False)
        ax.set_xlim(-0.5, len(scenes) - 0.5)
        ax.set_ylim(len(rows[stage]) - 0.5, -0.5)
        for row in table[table.stage == stage].itertuples():
            x, y = scenes.index(row.scene), rows[stage].index(row.label)
            text, equal = cell(row)
            ax.add_patch(plt.Rectangle((x - 0.48, y - 0.46), 0.96, 0.92, color=EQUAL if equal else DIFFERENT, lw=0))
            ax.text(x, y, text, ha="center", va="center", fontsize=7, linespacing=1.0)
        ax.set_yticks(range(len(rows[stage])), rows[stage])
        ax.set_xticks(range(len(scenes)), [name.replace(", ", ",\n").replace("_", " ") for name in scenes])
        ax.tick_params(length=0, labeltop=ax is axes[0, 0], labelbottom=False)
        ax.spines[:].set_visible(False)
        ax.set_title(f"{stage}: {STAGE_WORDS.get(stage, 'output')} as by the specification", loc="left",
                     pad=28 if ax is axes[0, 0] else 6)
    right = table[~table.implementation.str.startswith("wrong twin")]
    per_scene = right.drop_duplicates("scene")
    worst = right.largest_mean_difference_units.max()
    common.save(fig, result.folder, "parity", caption=(
        f"Every implementation beside the specification, the plain CPU version on one thread (whose own row repeats it): {len(per_scene)} "
        f"particle sets, {per_scene.particles.sum():.3g} particles, {per_scene.hits.sum():.3g} hits of pixels. Least share of equal winners "
        f"{right.winners_equal_share.min():.10g}, largest difference of a pixel's mean colour {worst:g} of 1/65535, over all timed runs. The "
        "sets called borders are thrown on and beside the borders of pixels and tiles, half of them at one depth: there the wrong twins "
        "(float32 without the deciding integers; ties by the plain index) show."
        + ("" if (table.implementation == "Vulkan").any() else " No Vulkan device took part.")))


def draw_speed(result: common.Result, table: pd.DataFrame) -> None:
    table = common.measured(table, "time_s", "particles_per_s")
    table = table[~table.scene.str.startswith("borders")].assign(rate=lambda t: t.particles_per_s / 1e6)
    stages = list(dict.fromkeys(table.stage))
    labels = list(dict.fromkeys(table.label))
    fig, axes = plt.subplots(1, len(stages), figsize=(3.2 + 3.6 * len(stages), 1.2 + 0.34 * len(labels)), sharey=True, squeeze=False)
    least = table.rate.min()
    most = table.rate.max()
    for ax, stage, color in zip(axes[0], stages, COLORS):
        for y, name in enumerate(labels):
            rates = table[(table.stage == stage) & (table.label == name)].rate
            if rates.empty:
                continue
            middle = rates.median()
            ax.barh(y, middle, height=0.62, color=color, alpha=0.85)
            ax.plot([rates.min(), rates.max()], [y, y], color=THEORY, lw=1.2)
            ax.plot(rates, [y] * len(rates), "|", color=THEORY, ms=6)
            ax.annotate(f"{middle:.3g}", (rates.max(), y), xytext=(5, 0), textcoords="offset points", va="center", fontsize=8)
        ax.set(xscale="log", xlim=(least / 2, most * 2.5), title=stage, xlabel="million particles a second")
        ax.grid(axis="y", visible=False)
    axes[0, 0].set_yticks(range(len(labels)), labels)
    axes[0, 0].invert_yaxis()
    host = result.summary["host"]
    devices = ", ".join(sorted({str(d) for d in table[table.implementation == "Vulkan"].device}))
    common.save(fig, result.folder, "speed", caption=(
        "Particles a second by stage and implementation: bars and numbers are the median over the scenes, marks the scenes, each the median of "
        f"{result.summary['config']['runs']} interleaved runs; output and transfers to and from the device are in it. {host['cpu']}, "
        f"{host['threads']} threads{'; Vulkan: ' + devices if devices else ''}."))


def main() -> None:
    result = common.load(sys.argv[1])
    table = labelled(result)
    draw_parity(result, table)
    draw_speed(result, table)


if __name__ == "__main__":
    main()
