"""Figures of repeat_level: error and time over the repeats, gain of stratified sets, bias.

    python3 analysis/repeat_level.py results/repeat_level
"""
from __future__ import annotations

import sys

import common

LABELS = {"lines": "random lines, exact", "fast": "random lines, fast", "stratified": "stratified", "brownian": "Brownian motion",
          "mesh": "triangles", "octree": "octree"}


def main() -> None:
    result = common.load(sys.argv[1])
    errors = result.tables["errors"]
    slopes = result.tables["slopes"].set_index("sampler")
    bias = result.tables["bias"].set_index("sampler")
    fig, axes = common.subplots(1, 3, height_in=3.9)
    fig.set_size_inches(14.5, 4.1)

    ax = axes[0]
    floor = errors.drop_duplicates("repeats").sort_values("repeats")
    ax.plot(floor.repeats, floor.floor, color=common.THEORY, lw=0.9, label="theory of independent repeats")
    for color, (name, rows) in zip(common.COLORS, errors.groupby("sampler", sort=False)):
        slope = slopes.loc[name]
        ax.errorbar(rows.repeats, rows.rmse, yerr=rows.rmse_error, fmt="o-", color=color, lw=1,
                    label=f"{LABELS.get(name, name)}: slope {slope.slope:.3f} ± {slope.slope_error:.3f}")
    ax.set(xscale="log", yscale="log", xlabel="repeats $L_R$", ylabel="RMSE beside the truth", title="error")
    ax.legend(loc="lower left")

    ax = axes[1]
    for color, (name, rows) in zip(common.COLORS, errors.groupby("sampler", sort=False)):
        ax.plot(rows.sampling_s + rows.draw_s, rows.rmse, "o-", color=color, lw=1, label=LABELS.get(name, name))
    ax.set(xscale="log", yscale="log", xlabel="sampling and drawing, s", ylabel="RMSE beside the truth", title="error for time")
    ax.legend(loc="lower left")

    ax = axes[2]
    gain = result.tables.get("gain")
    text = ""
    if gain is not None:
        ax.axhline(1, color=common.THEORY, lw=0.8)
        ax.axhline(0.25, color=common.THEORY, lw=0.8, ls=":", label="goal: a quarter")
        ax.errorbar(gain.repeats, gain.variance_ratio, yerr=gain.variance_ratio_error, fmt="o-", color=common.COLORS[2],
                    label="stratified over independent")
        ax.set(xscale="log", xlabel="repeats $L_R$", ylabel="variance ratio at equal particles", ylim=(0, None), title="gain")
        ax.legend(loc="upper right", bbox_to_anchor=(1, 0.93))
        last = gain.iloc[-1]
        text = f" At {last.repeats:.0f} repeats stratified sets have {last.variance_ratio:.3f} of the variance at equal particles."
    biases = "; ".join(f"{LABELS.get(n, n)} {1e5 * b.bias:+.1f} ± {1e5 * b.bias_error:.1f}" for n, b in bias.iterrows())
    common.save(fig, result.folder, "repeat_level", caption=(
        "A ring through a ball, up to six sheets of two objects: error beside the ray-traced truth (particle filter) over the number of "
        "repeats, bars one standard error over seeds; the same over time on "
        f"{result.summary['host']['cpu']}, {result.summary['host']['threads']} threads.{text} Repeats of stratified sets "
        f"are cut into {result.summary['config']['groups']} groups, so that few repeats have little to share. Mean colour beside the truth, in 1e-5: {biases}."))


if __name__ == "__main__":
    main()
