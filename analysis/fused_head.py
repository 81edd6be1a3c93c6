"""Figures of fused_head: pictures beside their truth, the tests of A, the model's bias at edges."""
from __future__ import annotations

import sys

import common
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.cm import ScalarMappable
from PIL import Image
from scipy import stats


def picture(result: common.Result, name: str) -> np.ndarray:
    file = result.folder / "pictures" / f"{name}.png"
    try:
        return np.asarray(Image.open(file).convert("RGB"))
    except OSError as error:
        common.fail(f"{file}: {error}")


def show(ax, image, title: str, **kwargs):
    ax.set_title(title)
    ax.set_axis_off()
    return ax.imshow(image, **kwargs)


def draw_pictures(result: common.Result, n) -> None:
    fig, axes = plt.subplots(1, 3, figsize=(12.6, 4.4))
    show(axes[0], picture(result, "particles"), f"particles, $L_R$ = {n.repeats:.0f}")
    show(axes[1], picture(result, "truth"), "ray-traced truth, particle filter")
    show(axes[2], picture(result, "flip"), f"ꟻLIP, mean {n.flip:.3f}".replace("ꟻ", "F"))
    fig.colorbar(ScalarMappable(plt.Normalize(0, 1), "magma"), ax=axes[2], shrink=0.8, label="FLIP error")
    t = result.tables["table"]
    ours = t[t.source == "Pellucid"].iloc[0]
    common.save(fig, result.folder, "pictures", caption=(
        f"Skin and brain of a T1 head, two isosurfaces fused: {ours.particles:.3g} opaque particles in "
        f"{n.repeats:.0f} repeats, beside their ray-traced truth. The volume ends below the eyes, so the head has no mouth. "
        f"PSNR {n.psnr:.1f} dB, SSIM {n.ssim:.3f}, mean FLIP {n.flip:.4f}: all of it noise, as the next figure shows."))


def draw_tests(result: common.Result, n) -> None:
    cases = result.tables["coverage"].set_index("case")
    ours = cases.loc["particles"]
    fig, axes = common.subplots(1, 3, height_in=3.7)
    fig.set_size_inches(14, 3.9)

    # Randomised p-values: flat within the band that holds all bins in 99.9 % of all drawings
    p = result.tables["p_values"].query("case == 'particles'")
    pixels = p.pixels.sum()
    level = 1 - (1 - 0.001) ** (1 / len(p))
    lo, hi = stats.binom.ppf([level / 2, 1 - level / 2], pixels, 1 / len(p))
    ax = axes[0]
    ax.axhspan(lo, hi, color="#cccccc", alpha=0.6, lw=0, label="99.9 % of all drawings, all bins")
    ax.stairs(p.pixels, np.append(p.p_lo, p.p_hi.iloc[-1]), color=common.COLORS[0], label="particles")
    ax.axhline(pixels / len(p), color=common.THEORY, lw=0.8)
    half = max(hi - pixels / len(p), np.abs(p.pixels - pixels / len(p)).max()) * 1.8
    ax.set(xlabel="randomised p-value of covered repeats", ylabel="pixels in bin", xlim=(0, 1),
           ylim=(max(0, pixels / len(p) - half), pixels / len(p) + half),
           title=f"{pixels:,} pixels: KS p = {ours.ks_p:.2g}, χ² p = {ours.chi2_p:.2g}".replace(",", " "))
    ax.legend(loc="upper right")

    # z, log scale, so that the tails are seen
    ax = axes[1]
    for case, label, color in (("particles", "particles", common.COLORS[0]),
                               ("twin: box filter", "wrong twin: box-filtered truth", common.COLORS[1])):
        z = result.tables["z_scores"].query("case == @case")
        ax.stairs(z.pixels / z.pixels.sum(), np.append(z.z_lo, z.z_hi.iloc[-1]), color=color, label=label)
    z = result.tables["z_scores"].query("case == 'particles'")
    ax.plot((z.z_lo + z.z_hi) / 2, z.expected / z.expected.sum(), color=common.THEORY, lw=0.9, label="normal law")
    ax.set(yscale="log", xlabel="z of covered repeats (outer bins: all beyond)", ylabel="share of pixels",
           ylim=(0.3 / pixels, 1),
           title=f"outside 3σ: {ours.outside:.0f} pixels, binomial's own {ours.outside_expected:.1f} "
                 f"(z = {ours.outside_z:.2f})")
    ax.legend(loc="upper right")

    # Outside 3σ by class, in standard deviations of the law; and the colour
    ax = axes[2]
    groups = result.tables["outside"].query("case == 'particles' and outside_expected >= 1")
    labels = [f"{g.surfaces}, {g.place}\n({g.outside:.0f} of {g.outside_expected:.1f})" for g in groups.itertuples()]
    values = (groups.outside - groups.outside_expected) / groups.outside_sd
    ax.errorbar([*values, (n.color_ratio - 1) / n.color_ratio_error], range(len(values) + 1), fmt="o", xerr=1,
                color=common.COLORS[0])
    limit = stats.norm.isf(n.level / 2)
    ax.axvspan(-limit, limit, color="#cccccc", alpha=0.6, lw=0)
    ax.axvline(0, color=common.THEORY, lw=0.8)
    ax.set_yticks(range(len(values) + 1), [*labels, f"colour: RMSE / floor\n= {n.color_ratio:.4f} ± {n.color_ratio_error:.4f}"])
    ax.set(xlabel="standard deviations off theory", xlim=(-5, 5), ylim=(-0.6, len(values) + 0.6),
           title="outside 3σ by surfaces; colour noise")
    twins = cases[cases.index.str.startswith("twin")]
    rules = cases[cases.index.str.startswith("rule")]
    common.save(fig, result.folder, "tests", caption=(
        f"Covered repeats of every pixel against the exact binomial of the truth's A. Tested are pixels where the truth's standard "
        f"error is below {ours.largest_error_share:g} of the binomial's: {pixels} pixels, {ours.left_out:.0f} are left out (worst ratio "
        f"{ours.worst_error_share:.3f}, mean square {ours.mean_noise_share:.1e}). With "
        + ", ".join(f"{r.largest_error_share:g}: KS p = {r.ks_p:.2g}" for r in rules.itertuples())
        + ". Bars and grey band: one standard deviation, 99.9 % of all drawings. The test sees optical depths off by "
        f"{100 * n.smallest_optical_depth_error:.2f} %. Wrong twins, smallest p: "
        + "; ".join(f"{name.removeprefix('twin: ')} {min(r.outside_p, r.ks_p, r.chi2_p):.1g}" for name, r in twins.iterrows())
        + f". Colour: RMSE {n.color_rmse:.5f}, layered noise floor {n.color_floor:.5f}, truth's own error {n.color_truth_error:.5f}."
        f" Beside the silhouette {n.rim_drawn:.0f} of {n.rim_pixels:.0f} pixels were drawn where the truth's rays met nothing: slivers"
        " of surface; elsewhere none."))


def draw_bias(result: common.Result, n) -> None:
    grey = picture(result, "edge_bias")[..., 0].astype(float)
    fig, ax = plt.subplots(figsize=(6.2, 5))
    shown = show(ax, (grey - 128) / 127 * n.bias_range, "particle filter − box filter", cmap="RdBu_r", vmin=-n.bias_range,
                 vmax=n.bias_range)
    fig.colorbar(shown, ax=ax, label="luminance, linear", shrink=0.9, extend="both")
    common.save(fig, result.folder, "edge_bias", caption=(
        f"The model's own bias, which no number of particles removes: a particle covers its whole pixel, so optical depth is averaged over "
        f"the pixel and not opacity. RMSE {n.bias_rmse:.4f} (the truths' error {n.bias_truth_error:.4f} taken off) beside a noise floor of "
        f"{n.color_floor:.4f}; in {100 * n.bias_share_above_noise:.1f} % of the covered pixels it is above the noise of {n.repeats:.0f} repeats."))


def draw_table(result: common.Result) -> None:
    table = result.tables["table"]
    ours = table[table.source == "Pellucid"]

    def seconds(value: float) -> str:
        return "" if np.isnan(value) else f"{value:.2f}"

    cells = [[f"{r.source}, {r.backend}" if r.source == "Pellucid" else r.source, r.scene, f"{r.resolution_px}²", r.repeats,
              f"{r.particles:.3g}", f"{r.sampling_s:.0f}", seconds(r.draw_s), seconds(r.device_s), f"{r.frames_per_s:.3g}"]
             for r in table.itertuples()]
    fig, ax = plt.subplots(figsize=(9.6, 0.5 + 0.3 * len(cells)))
    ax.set_axis_off()
    labels = ["source", "scene", "pixels", "$L_R$", "particles", "sampling, s", "drawing, s", "on device, s", "frames/s"]
    drawn = ax.table(cells, colLabels=labels, loc="center", cellLoc="right",
                     colWidths=[0.15, 0.25, 0.08, 0.06, 0.1, 0.11, 0.1, 0.11, 0.08], edges="horizontal")
    drawn.scale(1, 1.35)
    for (_, column), cell in drawn.get_celld().items():
        if column < 2:
            cell.get_text().set_horizontalalignment("left")
    devices = "; ".join(f"{r.backend} on {r.device}" for r in ours.dropna(subset="device").itertuples())
    equal = "".join(f"; {check['name']}: {check['value']:.0f}" for check in result.summary["checks"]
                    if "pixels that differ" in check["name"])
    common.save(fig, result.folder, "table", caption=(
        "The table of the 2012 paper and ours. Theirs: sampled on an i7-980, drawn on a GTX 580, all L_R repeats in a frame. Ours: the "
        f"{result.summary['host']['cpu']}, {result.summary['host']['threads']} threads"
        f"{'; ' + devices if devices else ''}{equal}. Drawing projects, shades and averages all repeats, transfers included."))


def main() -> None:
    result = common.load(sys.argv[1])
    numbers = result.tables["numbers"].set_index("name").value
    draw_pictures(result, numbers)
    draw_tests(result, numbers)
    draw_bias(result, numbers)
    draw_table(result)


if __name__ == "__main__":
    main()
