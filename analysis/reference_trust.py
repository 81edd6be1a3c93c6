"""Figure of reference_trust: six ways in which the ray-traced truth might be wrong, and what was found."""
from __future__ import annotations

import sys

import common
import numpy as np
from common import COLORS, THEORY
from scipy import stats

LEVEL = 0.05  # error bars of counts: 95 %
BARS = stats.norm.isf(0.0005)  # half length of other error bars in their standard error: 99.9 %
DEPTH_LIMIT = 32  # kDepthUnits, lib/study/trust_closed_form.hpp
MARKERS = "os^Dv"


def garwood(events):
    """Exact bounds of a Poisson mean."""
    events = np.asarray(events, dtype=float)
    return np.where(events > 0, stats.gamma.ppf(LEVEL / 2, np.maximum(events, 1e-9)), 0), stats.gamma.isf(LEVEL / 2, events + 1)


def panel_letter(ax, letter: str, title: str) -> None:
    ax.set_title(f"{letter}  {title}", loc="left")


def draw_parity(ax, table) -> str:
    random = table[table.aim == "random"]
    by_mesh = random.groupby("mesh", sort=False)[["rays", "hits", "odd_rays"]].sum()
    expected = (random.odd_per_1e9_expected * random.rays).groupby(random.mesh, sort=False).sum() / by_mesh.rays
    aimed = table[table.aim != "random"].groupby("aim", sort=False)[["rays", "odd_rays"]].sum()
    words = {"vertex": "at vertices", "edge middle": "at edges' middles", "along edge": "along edges",
             "vertex, along axis": "at vertices, along axes"}
    names = [*by_mesh.index, *(words.get(name, name) for name in aimed.index)]
    rays = np.concatenate([by_mesh.rays, aimed.rays])
    odd = np.concatenate([by_mesh.odd_rays, aimed.odd_rays])
    lo, hi = garwood(odd)
    y = np.arange(len(names))
    color = [COLORS[0]] * len(by_mesh) + [COLORS[1]] * len(aimed)
    least = 0.5 * 1e9 / by_mesh.rays.max()
    for i in y:
        ax.plot(np.maximum(np.array([lo[i], hi[i]]) * 1e9 / rays[i], least), [i, i], color=color[i], lw=2.2, solid_capstyle="butt")
        if odd[i]:
            ax.plot(odd[i] * 1e9 / rays[i], i, "o", color=color[i])
    ax.plot(expected, y[: len(expected)], "|", color=THEORY, ms=11, mew=1.5, label="6 · 2⁻²³ a hit: Embree's edge tolerance, nothing mended")
    ax.set(xscale="log", xlim=(least, 2e9), ylim=(len(names) - 0.4, -1.6), xlabel="rays with an odd number of hits, per 10⁹")
    ax.set_yticks(y, [name.replace("_", " ") for name in names])
    ax.grid(axis="y", visible=False)
    ax.legend(loc="upper right")
    total = by_mesh.sum()
    panel_letter(ax, "a", f"closed meshes: {total.odd_rays:.0f} odd of {total.rays:.3g} random rays")
    lo, hi = garwood(total.odd_rays)
    tolerated = (random.odd_per_1e9_expected * random.rays).sum() / total.rays
    return (f"a: {total.odd_rays:.0f} of {total.rays:.4g} random rays through closed meshes had an odd number of hits, "
            f"{1e9 * total.odd_rays / total.rays:.0f} per 10⁹ (95 %: {1e9 * lo / total.rays:.0f} to {1e9 * hi / total.rays:.0f}); "
            f"Embree's tolerance at edges would make {tolerated:.0f}, were hits not dropped that repeat a neighbour's. "
            f"{random.odd_with_too_few.sum():.0f} of them lacked a hit. Rays aimed at vertices and edges meet that tolerance every "
            f"time, many at outlines, where neighbours do not tell: {100 * aimed.odd_rays.sum() / aimed.rays.sum():.0f} % are odd")


def draw_depth(ax, table) -> str:
    table = table.assign(far=np.maximum(table.offset_sizes, table.distance_sizes))
    for k, (shape, rows) in enumerate(table.groupby("shape", sort=False)):
        shift = 1.35 ** (k - 1.5)
        ax.plot(rows.far * shift, rows.worst_units, MARKERS[k], ms=3, alpha=0.45, mew=0, color=COLORS[k])
        worst = rows.groupby("far").worst_units.max()
        ax.plot(worst.index * shift, worst, "-", marker=MARKERS[k], color=COLORS[k], label=shape)
    ax.axhline(DEPTH_LIMIT, color=THEORY, ls="--")
    ax.text(table.far.max() * 2, DEPTH_LIMIT * 0.85, f"limit, {DEPTH_LIMIT}: roundings on the way", ha="right", va="top", color=THEORY, fontsize=8)
    ax.set(xscale="log", yscale="log", ylim=(0.02, 60), ylabel="largest depth error, in units of\n2⁻⁵³ · coordinates / |cosθ|",
           xlabel="distance of camera or of the world's origin, in sizes of the surface")
    ax.legend(ncols=4, loc="lower left")
    panel_letter(ax, "b", f"closed forms: {table.wrong_rays.sum():.0f} of {table.rays.sum():.0f} rays with a wrong count")
    scales = table.scale
    return (f"b: {table.rays.sum():.0f} camera rays at spheres, ellipsoids, tori and slabs of size {scales.min():g} to "
            f"{scales.max():g} against closed forms in fifty digits: {table.wrong_rays.sum():.0f} wrong counts "
            f"({table.borderline_rays.sum():.0f} too close to a tangent to tell), depths within {table.worst_units.max():.2g} "
            "roundings of the coordinates that take part")


def draw_grazing(ax, table) -> str:
    offsets = sorted(table.offset_radii.unique())
    for k, offset in enumerate(offsets):
        for side, style in (("inside", "-"), ("outside", "--")):
            rows = table[(table.offset_radii == offset) & (table.side == side)].sort_values("delta")
            ax.plot(rows.delta, rows.found_two / rows.rays, style, color=COLORS[k], marker="o" if side == "inside" else "s", ms=3,
                    label=f"{offset:g} radii from the origin" if side == "inside" else None)
            ax.plot(rows.delta, rows.exact_two / rows.rays, "x", color=THEORY, ms=6, mew=0.8, zorder=1,
                    label="exact, of the rays as rounded" if k == len(offsets) - 1 and side == "inside" else None)
        ax.axvline(table[table.offset_radii == offset].resolution.iloc[0], color=COLORS[k], lw=0.8, ls=":")
    ax.text(0.03, 0.90, "made to pass inside", transform=ax.transAxes, fontsize=8, color=THEORY, va="top")
    ax.text(0.03, 0.10, "made to pass outside (dashed)", transform=ax.transAxes, fontsize=8, color=THEORY)
    ax.set(xscale="log", ylim=(-0.08, 1.08), xlabel="δ: rays pass at (1 ± δ) radii from a sphere's centre", ylabel="share with two hits")
    ax.invert_xaxis()
    ax.legend(loc="center left")
    panel_letter(ax, "c", "grazing rays")
    above = table[table.delta >= table.resolution]
    wrong = table[table.wrong_rays > 0]
    text = (f"c: {above.wrong_rays.sum():.0f} of {above.rays.sum():.0f} grazing rays told wrongly above the rounding of the ray "
            "itself (dotted)")
    return text + (f"; the largest δ with any error is {wrong.delta.max():.0e}" if len(wrong) else "")


def draw_roots(ax, table) -> str:
    rows = table[(table.finder == "certified") & (table.lines_kind == "random")]
    names = list(rows.surface)
    colors = ["#e6e6e6", COLORS[5], COLORS[0], COLORS[2], COLORS[4], COLORS[3], COLORS[1]]
    for y, row in enumerate(rows.itertuples()):
        left = 0.0
        for count in range(7):
            share = getattr(row, f"lines_with_{count}") / row.lines
            ax.barh(y, share, left=left, color=colors[count], height=0.65, label=f"{count}" if y == 0 else None, edgecolor="white", lw=0.5)
            if share > 0.035:
                ax.text(left + share / 2, y, f"{100 * share:.0f} %", ha="center", va="center", fontsize=7)
            left += share
    ax.set_yticks(range(len(names)), names)
    ax.set(xlim=(0, 1), ylim=(len(names) - 0.4, -1.25), xlabel="share of random lines with so many roots")
    ax.grid(axis="y", visible=False)
    ax.legend(ncols=7, loc="upper center", title=None, handlelength=1, columnspacing=1)
    certified = table[table.finder == "certified"]
    traced = table[(table.finder == "traced") & (table.lines_kind == "random")]
    centre = table[(table.finder == "traced") & (table.lines_kind == "centre")]
    twin = table[table.finder == "16 samples"]
    panel_letter(ax, "d", f"root counts: {certified.mismatched_lines.sum():.0f} of {certified.checked_lines.sum():.0f} differ from Sturm's theorem")
    return (f"d: certified roots of {certified.lines.sum():.3g} lines: {certified.mismatched_lines.sum():.0f} of "
            f"{certified.checked_lines.sum():.0f} counts differ from Sturm's theorem, {certified.undecided.sum():.0f} undecided; "
            f"traced as surfaces of a scene {traced.mismatched_lines.sum():.0f} of {traced.checked_lines.sum():.0f}, and "
            f"{centre.mismatched_lines.sum():.0f} of {centre.checked_lines.sum():.0f} lines aimed at a corner of cells; sampling at 16 points instead is wrong on {twin.mismatched_lines.sum():.0f} of {twin.checked_lines.sum():.0f}")


def draw_stated(ax, table) -> str:
    errors = sorted(table.max_error.dropna().unique(), reverse=True)
    places = {**{error: i + 1 for i, error in enumerate(errors)}}
    scenes = list(dict.fromkeys(table.scene))
    for k, scene in enumerate(scenes):
        for filter_name, filled in (("box", True), ("particle", False)):
            rows = table[(table.scene == scene) & (table["filter"] == filter_name)]
            x = np.array([0 if np.isnan(e) else places[e] for e in rows.max_error]) + (k - 2.5) * 0.11 + (0.03 if filled else -0.03)
            ax.errorbar(x, rows.ratio, yerr=BARS * rows.ratio_error, fmt=MARKERS[k % 5] if k < 5 else "P", ms=4, color=COLORS[k], capsize=0, lw=0.9,
                        mfc=COLORS[k] if filled else "white", label=scene if filled else None)
    ax.axhline(1, color=THEORY, lw=1)
    ax.axvline(0.5, color=THEORY, lw=0.6, ls=":")
    ax.set(yscale="log", ylim=(0.08, 3), ylabel="stated / true variance")
    ax.set_yticks([0.1, 0.2, 0.5, 1, 2], ["0.1", "0.2", "0.5", "1", "2"])
    ax.set_yticks([], minor=True)
    ax.set_xticks([0, *places.values()], ["64 sub-rays,\nnothing chosen", *(f"error asked\n{e:g}" for e in errors)])
    ax.grid(axis="x", visible=False)
    ax.legend(ncols=2, loc="lower left")
    panel_letter(ax, "e", "stated error: box (full) and particle filter (open)")
    fixed = table[table.max_error.isna() & (table.scene != "oblique rim")]
    chosen = table[table.max_error.notna() & (table.scene != "oblique rim")]
    largest = np.sqrt(chosen.true_variance / chosen.allowed_variance).max()
    least = chosen.groupby("filter").ratio.min()
    return (f"e: with a fixed number of sub-rays the stated variance is the true one ({fixed.ratio.min():.2f} to "
            f"{fixed.ratio.max():.2f}); where a small error is asked for it may be too small (box filter, 48 degrees of freedom or "
            f"more: down to {least['box']:.2f}; particle filter, 3: {least['particle']:.2f}), because estimates that admit much more "
            "than the error asked are traced anew, and those that are wrong without saying so stay; "
            "the true RMS error is below the larger of stated and asked all the same "
            f"(at most {largest:.2f} of it). Oblique rims have no finite variance under the particle filter and are shown only")


def draw_restart(ax, table) -> str:
    twin = table[table.collects == "restarts"]
    truth = table[table.collects == "truth"]
    share = lambda rows: (rows.lost_rays + rows.doubled_rays) / rows.rays
    for k, (mesh, rows) in enumerate(twin.groupby("mesh", sort=False)):
        rows = rows.sort_values("epsilon_radii")
        ax.plot(rows.epsilon_radii, np.maximum(share(rows), 1e-5), "-", marker=MARKERS[k], color=COLORS[k], label=f"restarts: {mesh}")
    least = stats.gamma.isf(LEVEL / 2, truth.lost_rays.sum() + truth.doubled_rays.sum() + 1) / truth.rays.sum()
    ax.axhline(least, color=THEORY, ls="--")
    found = truth.lost_rays.sum() + truth.doubled_rays.sum()
    ax.text(3e-5, least * 0.85, f"the truth, same rays: {found:.0f} of {truth.rays.sum():.0f} (line: 95 % bound)", ha="center",
            va="top", color=THEORY, fontsize=8)
    ax.set(xscale="log", yscale="log", ylim=(7e-6, 3), xlabel="restart by ε, in radii of the mesh", ylabel="share of rays with lost or doubled hits")
    ax.set_yticks([1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1], ["0", "$10^{-4}$", "$10^{-3}$", "0.01", "0.1", "1"])
    ax.legend(loc="center right", bbox_to_anchor=(1, 0.55))
    panel_letter(ax, "f", "wrong twin: nearest hit, then restart behind it")
    worst = share(twin).groupby(twin.epsilon_radii).max()
    return ("f: the wrong twin, which asks for the nearest hit again and again, loses or doubles hits at every ε on some mesh "
            f"(on the worst of them {100 * worst.min():.0f} % of the rays or more); the truth on the same rays: {found:.0f} of "
            f"{truth.rays.sum():.0f}")


def main() -> None:
    result = common.load(sys.argv[1])
    fig, axes = common.subplots(3, 2, height_in=4.0)
    panels = (("parity", draw_parity), ("closed_form", draw_depth), ("grazing", draw_grazing), ("roots", draw_roots),
              ("stated_error", draw_stated), ("restart", draw_restart))
    captions = []
    for ax, (name, draw) in zip(axes.flat, panels):
        if name in result.tables:
            captions.append(draw(ax, result.tables[name]))
        else:
            ax.set_axis_off()
    particles = result.tables["particle_filter"]
    right = particles[particles.truth == "particle filter"]
    coincident = result.tables["coincident"]
    captions.append(f"Not drawn: brute-force particles ({right.repeats.max():.0f} repeats) agree with the particle filter in "
                    f"{right.pixels_tested.sum():.0f} pixels (largest |z| {right.worst_z.max():.2f}, limit "
                    f"{right.worst_z_limit.min():.2f}); coincident surfaces give the same picture in every order of the file "
                    f"(largest difference {coincident.worst_ulps.max():g} ulp)")
    common.save(fig, result.folder, "trust", caption="Is the ray-traced truth right? " + ". ".join(captions) + ".")


if __name__ == "__main__":
    main()
