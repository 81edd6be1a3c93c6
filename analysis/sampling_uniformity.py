"""Figures of sampling_uniformity: uniformity, neighbours and rates of every sampler; Brownian motion over its settings.

    python3 analysis/sampling_uniformity.py results/sampling_uniformity
"""
from __future__ import annotations

import sys

import numpy as np
from scipy import stats

import common

NAMES = {"lines": "random lines", "fast": "lines, fast", "stratified": "stratified", "mesh": "triangles", "octree": "octree",
         "twin: all hits of a line in one repeat": "wrong twin:\nall hits of a line"}


def colors(surfaces) -> dict[str, str]:
    return dict(zip(surfaces, common.COLORS))


def draw_samplers(result: common.Result) -> None:
    table = result.tables["uniformity"]
    surfaces = list(dict.fromkeys(table.surface))
    samplers = list(dict.fromkeys(table.sampler))
    place = {name: i for i, name in enumerate(samplers)}
    fig, axes = common.subplots(1, 4, height_in=4.0)
    fig.set_size_inches(17, 4.2)
    for k, surface in enumerate(surfaces):
        rows = table[table.surface == surface]
        at = np.array([place[s] for s in rows.sampler]) + 0.12 * (k - (len(surfaces) - 1) / 2)
        style = dict(fmt="o", color=colors(surfaces)[surface], label=surface.replace("_", " "))
        axes[0].errorbar(rows.chi2 / rows.dof, at, **style)
        axes[1].errorbar(rows.count_dispersion, at, **style)
        axes[2].errorbar(rows.neighbour / rows.neighbour_expected, at,
                         xerr=np.abs((rows.neighbour - rows.neighbour_expected) / rows.neighbour_z.replace(0, np.nan)), **style)
        axes[3].errorbar(rows.particles_per_s / 1e6, at, **style)
    dof = table.dof.iloc[0]
    lo, hi = stats.chi2.ppf([0.0005, 0.9995], dof) / dof
    axes[0].axvspan(lo, hi, color="#cccccc", alpha=0.6, lw=0, label="99.9 % of uniform samples")
    for ax, title, label in ((axes[0], "uniform in area", "χ²/dof over equal-area cells"),
                             (axes[1], "Poisson numbers", "variance over mean of a repeat's number"),
                             (axes[2], "neighbours", "mean of πρd² over that of independent points"), (axes[3], "rate", "million particles a second")):
        ax.set_yticks(range(len(samplers)), [NAMES.get(s, s) for s in samplers] if ax is axes[0] else [""] * len(samplers))
        ax.set(title=title, xlabel=label, ylim=(-0.6, len(samplers) - 0.4))
        ax.invert_yaxis()
        if ax is not axes[3]:
            ax.axvline(1, color=common.THEORY, lw=0.8)
    # Beside the wrong twin, which alone is far from 1, the second panel is empty.
    axes[1].legend(*axes[0].get_legend_handles_labels(), loc="upper right", bbox_to_anchor=(1, 0.98))
    axes[3].set_xscale("log")
    if table.chi2.div(table.dof).max() > 4:
        axes[0].set_xscale("log")
    lines, fast = (table[table.sampler == s].set_index("surface") for s in ("lines", "fast"))
    same = [s.replace("_", " ") for s in lines.index.intersection(fast.index, sort=False)
            if lines.chi2[s] == fast.chi2[s] and lines.neighbour[s] == fast.neighbour[s]]
    right = table[~table.sampler.str.contains("twin")]
    beyond = right[(right.chi2 / right.dof < lo) | (right.chi2 / right.dof > hi)]
    outside = "; ".join(f"{NAMES.get(r.sampler, r.sampler)} on the {r.surface.replace('_', ' ')} ({r.chi2 / r.dof:.2f})".replace("\n", " ")
                        for r in beyond.itertuples())
    common.save(fig, result.folder, "samplers", caption=(
        f"Every sampler judged against random lines that the truth traces: {int(dof) + 1} cells of equal area, "
        f"{table.points.iloc[0]:.3g} particles a row; bars one standard error. All hits of a line in one repeat are as uniform as "
        "any, but come in bunches: their numbers give them away. Stratified particles are seen through pixels so small that "
        "hardly any holds two, where they are Poisson like the others. "
        + (f"Outside of the band: {outside}; triangles and leaves are flat, which shows near nodes. " if outside else "")
        + (f"Fast lines differ from exact ones only where a line may cross a block more than once: their particles are the same on the "
           f"{' and the '.join(same)}. " if same else "") + "Rates: "
        f"{result.summary['host']['cpu']}, {result.summary['host']['threads']} threads."))


def draw_walks(result: common.Result) -> None:
    table = result.tables["walks"]
    surfaces = list(dict.fromkeys(table.surface))
    base = table[table.walk == "brownian"]
    fig, axes = common.subplots(1, 4, height_in=4.0)
    fig.set_size_inches(17, 4.2)

    def series(ax, rows, x, y, surface, **style):
        rows = rows.sort_values(x)
        ax.plot(rows[x], rows[y], "o" + style.pop("line", "-"), color=colors(surfaces)[surface], lw=1, **style)

    thin = table[table.walk.str.startswith("thinned")]
    # What is left when noise is taken off is known to within noise² √(2/cells), squared: less is drawn there.
    floor = (thin.density_noise.median() * (2 / (thin.dof.iloc[0] + 1)) ** 0.25)
    for surface in surfaces:
        own = table[table.surface == surface]
        name = surface.replace("_", " ")
        with_drift = own[own.walk.isin(["brownian", "step"])]
        for walk, style in (("thinned", dict(label=name)), ("thinned, no drift", dict(line="--", mfc="none"))):
            rows = thin[(thin.surface == surface) & (thin.walk == walk)]
            if len(rows):
                series(axes[0], rows.assign(density_deviation=rows.density_deviation.clip(lower=floor)), "step", "density_deviation",
                       surface, **style)
        series(axes[1], with_drift, "step", "dispersion", surface, label=name)
        walkers = own[own.walk.isin(["brownian", "walkers"])]
        series(axes[2], walkers, "walkers", "dispersion", surface, label=name)
        series(axes[3], with_drift, "step", "independent_per_s", surface, label=name)
    for ax in axes:
        ax.set(xscale="log", yscale="log")
    axes[0].axhspan(axes[0].get_ylim()[0], floor, color="#cccccc", alpha=0.6, lw=0, label="not seen")
    axes[0].set(xlabel="√(2Δt) over the surface's width", ylabel="RMS deviation of density over cells",
                title="bias of thinned walks: full with dx$^{(S)}$, dashed without")
    axes[1].set(xlabel="√(2Δt) over the surface's width", ylabel="particles for one independent one", title="correlation over the step")
    axes[2].set(xlabel="walkers of a repeat", ylabel="particles for one independent one", title="correlation over walkers")
    axes[3].set(xlabel="√(2Δt) over the surface's width", ylabel="independent particles a second", title="what it is worth")
    axes[0].legend(loc="best")
    axes[1].legend(loc="best")
    twins = table[table.walk.str.startswith("twin") & (table.surface == "sphere")]
    said = "; ".join(f"{w.walk.removeprefix('twin: ')}: |z| = {abs(w.cosine_z):.0f}" for w in twins.itertuples())
    row = base.iloc[0]
    biases = "; ".join(
        f"{w.surface.replace('_', ' ')}, step {w.step:g}: {w.density_deviation:.3f}, χ²/dof {w.chi2 / w.dof:.2f}, without "
        f"{wo.density_deviation:.3f}, {wo.chi2 / wo.dof:.2f}"
        for w in thin[thin.walk == "thinned"].itertuples()
        for wo in thin[(thin.walk == "thinned, no drift") & (thin.surface == w.surface) & (thin.step == w.step)].itertuples()
        if w.step <= 0.1)
    common.save(fig, result.folder, "walks", caption=(
        f"Brownian motion, {row.walkers:.0f} walkers a repeat of {row.points:.3g} particles in all, step {row.step:g} of the width and no "
        "thinning where nothing else is said. Left: one position in 20, another walker for every particle, so that bias stands out "
        "from noise; dx$^{(S)}$ matters at every step where it is seen. RMS deviation of density with it and without it: "
        f"{biases}. Small steps without thinning mix slowly: a particle is worth a fraction of an independent one. Mean cosine "
        f"between successive positions on the sphere, wrong twins beside exact theory: {said}."))


def main() -> None:
    result = common.load(sys.argv[1])
    draw_samplers(result)
    draw_walks(result)


if __name__ == "__main__":
    main()
