"""Figures of opacity_vs_n: `python3 analysis/opacity_vs_n.py results/opacity_vs_n`.

Deviations are z-scores of the experiment, (drawn − theory)/σ as a standard normal under the exact law
of the drawn total; σ is the theory's own, never estimated from what was drawn.
"""
from __future__ import annotations

import sys

import common
import numpy as np
import pandas as pd
from common import COLORS, THEORY
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter
from scipy import stats

LEVEL = 0.001                                # of everything shown in one panel together, 99.9 %
BARS = stats.norm.isf(LEVEL / 2)             # half length of error bars in σ: 3.29
FEW = 20                                     # covered or clear pixels expected: fewer are far from Gaussian
MARKERS = {"orthographic": "o", "perspective": "D"}
SHAPE_COLORS = {"flat": COLORS[0], "sphere": COLORS[1], "torus": COLORS[2]}
EMPTY = pd.DataFrame(columns=["shape", "projection", "ratio", "count", "tilt_deg", "theta_lo_deg", "theta_hi_deg",
                              "repeats", "pixels_measured", "alpha_drawn", "alpha_theory", "variance_theory",
                              "z_score"], dtype=float)


def rows_measured(result: common.Result) -> pd.DataFrame:
    """Rows that were drawn and tested, with `sigma` of their opacity."""
    table = result.tables.get("opacity", EMPTY)
    if len(table):  # every backend drew the same particles, and equal numbers: the first one's
        table = table[table.backend == table.backend.iloc[0]]
    rows = EMPTY if table.empty else common.measured(table, "ratio", "count", "repeats", "pixels_measured",
                                                     "alpha_drawn", "alpha_theory", "variance_theory", "z_score")
    return rows.assign(sigma=np.sqrt(rows.variance_theory / rows.repeats))


def most_repeats(rows: pd.DataFrame, *keys: str) -> pd.DataFrame:
    """Of rows that differ in repeats alone, the one with most: the smallest error."""
    return rows.sort_values("repeats").drop_duplicates(list(keys), keep="last").sort_values(list(keys))


def spread(values, count: int) -> list:
    """At most `count` of the values, spread evenly, both ends among them."""
    values = sorted(set(values))
    picked = np.unique(np.linspace(0, len(values) - 1, min(count, len(values))).round().astype(int))
    return [values[i] for i in picked]


def theory(ratio: float, count, cos_tilt=1.0):
    """PBSR (1) with its tilt: 1 − (1 − s/(S cosθ))^n; where a pixel is all there is, 1."""
    return -np.expm1(count * np.log1p(-np.minimum(ratio / np.asarray(cos_tilt, dtype=float), 1 - 1e-16)))


def sidak(count: int) -> float:
    """What the largest of `count` independent |z| exceeds with chance LEVEL."""
    return stats.norm.isf(-np.expm1(np.log1p(-LEVEL) / max(count, 1)) / 2)


def plural(count: int, word: str) -> str:
    return f"{count} {word}" if count == 1 else f"{count} {word}s"


def beyond(z, limit: float) -> str:
    """The finding of a residual panel, in words."""
    out = int(np.sum(np.abs(z) > limit))
    worst = np.max(np.abs(z))
    if len(z) == 1:
        return f"It lies {worst:.2f} σ from theory (limit {limit:.2f} σ)."
    verdict = f"{out} of {len(z)} lie" if out else f"none of {len(z)} lies"
    return (f"Finding: {verdict} beyond {limit:.2f} σ, which the largest exceeds with 0.1 % probability; "
            f"the largest is {worst:.2f} σ.")


def signed(value: float, digits: int) -> str:
    return f"{value:.{digits}f}".replace("-", "−")


def with_error(value: float, error: float) -> str:
    """`value ± error`, both to the error's second digit."""
    if not (np.isfinite(error) and error > 0):
        return f"{value:.6g}".replace("-", "−")
    digits = max(0, 1 - int(np.floor(np.log10(error))))
    return f"{signed(value, digits)} ± {error:.{digits}f}"


def power(value: float) -> str:
    """A short number: 10⁻⁴ for powers of ten."""
    exponent = np.log10(value)
    return f"$10^{{{exponent:.0f}}}$" if abs(exponent - round(exponent)) < 1e-9 and abs(exponent) > 2 else f"{value:g}"


def nothing(ax, why: str) -> None:
    """A panel that says why it is empty."""
    ax.set_axis_off()
    ax.text(0.5, 0.5, why, transform=ax.transAxes, ha="center", va="center", color=THEORY, wrap=True)


def save_nothing(result: common.Result, name: str, why: str) -> None:
    fig, ax = common.subplots(height_in=1.6)
    nothing(ax, why)
    common.save(fig, result.folder, name, caption=why)


def residual_axis(ax, z, limit: float) -> None:
    """Limits that hold all z, with guides at 0 and at ±limit."""
    ax.axhline(0, color=THEORY, lw=1, zorder=1)
    for sign in (-1, 1):
        ax.axhline(sign * limit, color=THEORY, lw=0.8, ls=(0, (4, 3)), zorder=1)
    reach = max(limit, np.max(np.abs(z))) * 1.12
    ax.set_ylim(-reach, reach)
    ax.set_ylabel("drawn − theory  [σ]")


def two_storeys(columns: int = 1):
    """Opacity above, what is left of it below."""
    fig, axes = common.subplots(2, columns, height_in=2.7, sharex="col", squeeze=False,
                                gridspec_kw={"height_ratios": (1.5, 1)})
    return fig, axes


def opacity_over_n(result: common.Result, rows: pd.DataFrame) -> None:
    flat = rows[rows["shape"] == "flat"]
    if flat.empty:
        return save_nothing(result, "opacity_over_n", "α over n: no flat patch was measured in this run.")
    tilt = flat.tilt_deg.min()
    flat = flat[(flat.tilt_deg == tilt) & flat.ratio.isin(spread(flat.ratio, len(COLORS)))]
    best = most_repeats(flat, "ratio", "projection", "count")
    fig, axes = two_storeys()
    upper, lower = axes[:, 0]
    n = np.geomspace(max(flat["count"].min() / 2, 0.5), flat["count"].max() * 2, 400)
    ratios = sorted(set(flat.ratio), reverse=True)
    for color, ratio in zip(COLORS, ratios):
        upper.plot(n, theory(ratio, n, np.cos(np.radians(tilt))), color=color, lw=1, zorder=1)
        for projection, side, size in (("orthographic", -1, 3), ("perspective", 1, 7)):
            filled = projection == "orthographic"
            style = {"color": color, "marker": MARKERS[projection], "ls": "", "mew": 0.9, "mfc": color if filled else "none"}
            seen = best[(best.ratio == ratio) & (best.projection == projection)]
            upper.errorbar(seen["count"], seen.alpha_drawn, BARS * seen.sigma, elinewidth=1, ms=size, capsize=size, **style)
            # Side by side about their n, so that none hides the other.
            rest = flat[(flat.ratio == ratio) & (flat.projection == projection)]
            place = side * (0.25 + rest.repeats.rank(method="dense") / flat.repeats.nunique())
            lower.plot(rest["count"] * 1.2**place, rest.z_score, **style | {"ms": 3, "mew": 0.7})
    limit = sidak(len(flat))
    residual_axis(lower, flat.z_score, limit)
    upper.set(xscale="log", ylim=(-0.04, 1.04), ylabel="opacity α")
    upper.set_title(r"Opacity of a patch facing the camera" if tilt == 0 else f"Opacity of a flat patch, tilt {tilt:g}°")
    lower.set_xlabel("particles n")
    spans = (flat.theta_hi_deg - flat.theta_lo_deg).max()
    oblique = (f" In perspective the rays of one patch meet it at angles up to {spans:.0f}° apart, which lifts it a little off "
               "the line; its z-scores are against its own theory.") if spans > 1 else ""
    shown = [projection for projection in MARKERS if projection in set(flat.projection)]
    handles = [Line2D([], [], color=color, lw=2, label=f"s/S = {power(ratio)}") for color, ratio in zip(COLORS, ratios)]
    handles += [Line2D([], [], color=THEORY, marker=MARKERS[p], ls="", mfc=THEORY if p == "orthographic" else "white", label=p)
                for p in shown]
    handles += [Line2D([], [], color=THEORY, lw=1, label=r"$1-(1-s/S)^n$" if tilt == 0 else r"$1-(1-s/(S\cos\theta))^n$")]
    upper.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.0, 1.02))
    common.save(fig, result.folder, "opacity_over_n", caption=(
        f"Drawn opacity α of flat patches (tilt {tilt:g}°) over the number of particles n, for "
        f"{plural(len(ratios), 'area ratio')} s/S. Above: {plural(len(best), 'row')}, each the one with most repeats "
        f"(up to {flat.repeats.max():.0f}), bars ± {BARS:.2f} theoretical standard errors of the mean (99.9 %), mostly "
        f"smaller than the mark; lines: 1 − (1 − s/(S cosθ))^n, nothing fitted.{oblique} Below: z-scores of all "
        f"{plural(len(flat), 'row')}, of every number of repeats, drawn side by side about the same n; dashed: 99.9 % for all of them together. {beyond(flat.z_score, limit)}"))


def cases_over_theta(rows: pd.DataFrame) -> list[tuple[float, float]]:
    """Up to two (s/S, n): most angles first, then a face-on opacity that leaves room to grow (0.2);
    the second with another ratio and another opacity where there is one."""
    cases = most_repeats(rows, "ratio", "count", "shape", "projection", "tilt_deg", "theta_lo_deg")
    cases = cases.groupby(["ratio", "count"]).size().rename("angles").reset_index()
    face_on = theory(cases.ratio, cases["count"])
    cases = cases.assign(face_on=face_on)[(face_on > 0.02) & (face_on < 0.9)]
    cases["worth"] = cases.angles / max(cases.angles.max(), 1) - 0.6 * (cases.face_on - 0.2).abs()
    cases = cases.sort_values("worth", ascending=False)
    if cases.empty:
        return []
    first = cases.iloc[0]
    others = cases[(cases.ratio != first.ratio) & ((cases.face_on - first.face_on).abs() > 0.2)]
    return [(first.ratio, first["count"])] + [(c.ratio, c["count"]) for _, c in others.head(1).iterrows()]


def place_theta(case: pd.DataFrame, ratio: float, count: float) -> np.ndarray:
    """Where a row stands: at its angle, or where it spans many, at that at which the theory has its mean."""
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = ratio / -np.expm1(np.log1p(-case.alpha_theory) / count)
    middle = np.degrees(np.arccos(np.clip(cosine, 0, 1)))
    return np.clip(middle, case.theta_lo_deg, case.theta_hi_deg)


def opacity_over_theta(result: common.Result, rows: pd.DataFrame) -> None:
    cases = cases_over_theta(rows)
    if not cases:
        return save_nothing(result, "opacity_over_theta", "α over θ: nothing was measured at an opacity between 0.02 and 0.9.")
    fig, axes = two_storeys(len(cases))
    texts, shown_kinds = [], set()
    for (upper, lower), (ratio, count) in zip(axes.T, cases):
        rings = most_repeats(rows[(rows.ratio == ratio) & (rows["count"] == count)],
                             "shape", "projection", "tilt_deg", "theta_lo_deg")
        rings = rings.assign(theta=place_theta(rings, ratio, count))
        angle = np.linspace(0, 90, 721)[:-1]
        upper.plot(angle, theory(ratio, count, np.cos(np.radians(angle))), color=THEORY, zorder=1)
        for (shape, projection), seen in rings.groupby(["shape", "projection"]):
            shown_kinds.add((shape, projection))
            color = SHAPE_COLORS.get(shape, COLORS[3])
            style = {"color": color, "marker": MARKERS.get(projection, "s"), "ls": "", "ms": 4.5, "mew": 0.9, "elinewidth": 1,
                     "mfc": color if projection == "orthographic" else "white", "capsize": 0}
            reach = np.clip([seen.theta - seen.theta_lo_deg, seen.theta_hi_deg - seen.theta], 0, None)
            upper.errorbar(seen.theta, seen.alpha_drawn, BARS * seen.sigma, reach, **style)
            lower.errorbar(seen.theta, seen.z_score, None, reach, **style)
        limit = sidak(len(rings))
        residual_axis(lower, rings.z_score, limit)
        least = max(0, min(rings.alpha_drawn.min(), float(theory(ratio, count))) - 0.08)
        upper.set(xlim=(-3, 90), ylim=(least, 1.04), title=f"s/S = {power(ratio)},  n = {count:g}")
        lower.set(xlabel="angle θ between normal and ray  [°]", xticks=range(0, 91, 15))
        texts.append(f"s/S = {ratio:g}, n = {count:.0f}: {plural(len(rings), 'row')} of up to {rings.repeats.max():.0f} repeats. {beyond(rings.z_score, limit)}")
    axes[0, 0].set_ylabel("opacity α")
    for lower in axes[1, 1:]:
        lower.set_ylabel("")
    handles = [Line2D([], [], color=THEORY, label=r"$1-(1-s/(S\cos\theta))^n$")]
    for shape, projection in sorted(shown_kinds):
        color = SHAPE_COLORS.get(shape, COLORS[3])
        handles.append(Line2D([], [], color=color, ls="-", lw=1, marker=MARKERS.get(projection, "s"),
                              mfc=color if projection == "orthographic" else "white", label=f"{shape}, {projection}"))
    axes[0, 0].legend(handles=handles, loc="upper left")
    common.save(fig, result.folder, "opacity_over_theta", caption=(
        "Drawn opacity over the angle θ between surface normal and ray: flat patches, and rings of spheres and tori. "
        "Horizontal bars span all θ of a row (in perspective also flat patches are met at many), its mark stands where the line "
        "has the row's theoretical mean. "
        f"Vertical bars: ± {BARS:.2f} theoretical standard errors (99.9 %). Line: 1 − (1 − s/(S cosθ))^n, nothing fitted. "
        "Below: z-scores, dashed 99.9 % for all of a panel together. " + " ".join(texts)))


def stays_within(low: np.ndarray, high: np.ndarray) -> float:
    """P(low_i <= U_(i) <= high_i for all i), U sorted uniforms, exactly: their count by time t is a
    Poisson process that ends at N; we carry the chance of each count and cut it at every bound."""
    size = len(low)
    times = np.concatenate([low, high])
    is_low = np.arange(2 * size) < size
    order = np.argsort(times, kind="stable")
    chance, first, now = np.ones(1), 0, 0.0  # chance[j]: of first + j points so far
    at_most, at_least = 0, 0
    for k in order:
        mean = size * (times[k] - now)
        now = times[k]
        if mean > 0:
            steps = np.arange(int(mean + 12 * np.sqrt(mean) + 25))
            chance = np.convolve(chance, stats.poisson.pmf(steps, mean))
        # Before low_i at most i − 1 points have come; by high_i at least i.
        chance = chance[:at_most - first + 1]
        at_most, at_least = at_most + is_low[k], at_least + (not is_low[k])
        if at_least > first:
            chance, first = chance[at_least - first:], at_least
        if chance.size == 0 or chance.sum() == 0:
            return 0.0
    chance = np.convolve(chance, stats.poisson.pmf(np.arange(size - first + 1), size * (1 - now)))
    return float(chance[size - first] / stats.poisson.pmf(size, size))


def order_statistic_band(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Band that a sorted sample of `size` standard normals stays in, all of it together, with chance
    1 − LEVEL: beta quantiles of each order statistic at one common level, found by bisection."""
    ranks = np.arange(1, size + 1)
    smallest, largest = np.log(LEVEL / size / 2), np.log(LEVEL)
    def band(level: float):
        return [stats.beta.ppf(p, ranks, size + 1 - ranks) for p in (np.exp(level) / 2, 1 - np.exp(level) / 2)]

    for _ in range(14):
        middle = (smallest + largest) / 2
        smallest, largest = (middle, largest) if stays_within(*band(middle)) >= 1 - LEVEL else (smallest, middle)
    return tuple(stats.norm.ppf(edge) for edge in band(smallest))


def qq_panel(ax, z: np.ndarray) -> str:
    if not z.size:
        nothing(ax, "no opacity was measured")
        return "No opacity was measured."
    z = np.sort(z)
    expected = stats.norm.ppf((np.arange(1, z.size + 1) - 0.5) / z.size)
    low, high = order_statistic_band(z.size)
    ax.fill_between(expected, low, high, color="#cfcfcf", lw=0, label="99.9 % band, all together")
    if z.size == 1:
        ax.errorbar(expected, [0], [[-low[0]], [high[0]]], color="#cfcfcf", lw=4)
    ax.plot(ends := np.array([-1, 1]) * max(expected.max(), 1) * 1.05, ends, color=THEORY, lw=1, label="normal law")
    ax.plot(expected, z, ls="", marker="o", ms=2.5, color=COLORS[0], label=f"{z.size} z-scores")
    ax.set(xlabel="quantile of the standard normal", ylabel="z of drawn opacity", title="Right rendering")
    ax.legend(loc="upper left")
    outside = int(np.sum((z < low) | (z > high)))
    return (f"Left: the sorted z-scores of all {plural(z.size, 'measured row')} against normal quantiles; grey: the band which "
            f"{z.size} independent standard normals leave anywhere with 0.1 % probability (order statistics' beta "
            f"quantiles, simultaneous, exact). Finding: {outside or 'none'} of them {'lie' if outside > 1 else 'lies'} "
            f"outside; mean {with_error(z.mean(), 1 / np.sqrt(z.size))}, standard deviation "
            f"{with_error(z.std(ddof=1), 1 / np.sqrt(2 * z.size)) if z.size > 1 else 'unknown'}, where 0 and 1 are expected.")


def twins_panel(ax, twins: pd.DataFrame) -> str:
    if twins.empty:
        nothing(ax, "no wrong twin was drawn")
        return "No wrong twin was drawn."
    places = np.arange(len(twins))[::-1]
    limit = twins.z_critical.max()
    ax.axvspan(0, limit, color="#cfcfcf", lw=0)
    ax.grid(axis="y", visible=False)
    ax.text(limit / 2, len(twins) - 0.45, "accepted", ha="center", va="center", color=THEORY)
    for place, (_, twin) in zip(places, twins.iterrows()):
        ax.plot(abs(twin.z_score), place, marker="X", ms=7, color=COLORS[1], ls="")
        ax.plot(abs(twin.z_score_without_fault), place, marker="o", ms=5, color=COLORS[0], ls="")
        ax.text(limit * 1.08, place + 0.17, twin.twin, fontsize=8, va="bottom")
        ax.text(abs(twin.z_score), place - 0.16, f"z = {signed(twin.z_score, 1)}\nα {twin.alpha_drawn:.3f}, right: {twin.alpha_theory:.3f}",
                fontsize=7, ha="center", va="top", color=COLORS[1])
    top = max(twins.z_score.abs().max(), limit)
    ax.set_xscale("symlog", linthresh=5, linscale=1)
    ax.set(xlim=(0, top * 6), ylim=(-1.1, len(twins) - 0.3), yticks=[], xlabel="|z|", title="Wrong twins")
    ticks = [t for t in (0, 2, 5, 10, 30, 100, 300, 1000, 3000, 10000) if t <= top * 6]
    ax.set_xticks(ticks, [str(t) for t in ticks])
    ax.minorticks_off()
    ax.legend(handles=[Line2D([], [], color=COLORS[1], marker="X", ms=7, ls="", label="with its fault"),
                       Line2D([], [], color=COLORS[0], marker="o", ms=5, ls="", label="without")],
              loc="lower right", ncol=2)
    said = "; ".join(f"{t.twin}: z = {signed(t.z_score, 1)} (without the fault {signed(t.z_score_without_fault, 2)})" for t in twins.itertuples())
    missed = int((twins.z_score.abs() <= twins.z_critical).sum())
    return (f"Right: renderings made wrong on purpose, far outside the grey range of accepted |z| <= {limit:.2f}: {said}. "
            f"Finding: {'each is rejected' if not missed else f'{missed} of {len(twins)} NOT rejected'}. "
            "Of twins whose fault is in the variance, the largest of 30 draws counts, with and without the fault.")


def z_scores(result: common.Result, rows: pd.DataFrame) -> None:
    fig, (left, right) = common.subplots(1, 2, height_in=4)
    twins = result.tables.get("twins", pd.DataFrame())
    if not twins.empty:
        twins = common.measured(twins, "alpha_drawn", "alpha_theory", "z_score", "z_critical", "z_score_without_fault")
    caption = qq_panel(left, rows.z_score.to_numpy(dtype=float)) + " " + twins_panel(right, twins)
    common.save(fig, result.folder, "z_scores", caption=caption)


def fit_of(result: common.Result, name: str) -> dict[str, dict] | None:
    """The parameters by name of a fit in fit.json, None where it has no answer."""
    fit = (result.documents.get("fit") or {}).get(name) or {}
    return {p["name"]: p for p in fit.get("parameters", [])} if fit.get("converged") else None


def error_over_repeats(result: common.Result) -> None:
    table = result.tables.get("repeats", pd.DataFrame())
    if not table.empty:
        table = common.measured(table, "repeats", "pixels", "error", "error_standard_error")
        table = table[table.error > 0]
    if table.empty:
        return save_nothing(result, "error_over_repeats", "Error over L_R: no pixel with an opacity well within (0, 1) was measured.")
    fig, axes = two_storeys()
    upper, lower = axes[:, 0]
    ends = np.array([table.repeats.min() / 1.5, table.repeats.max() * 1.5])
    upper.plot(ends, ends**-0.5, color=THEORY, label=r"theory: $1/\sqrt{L_R}$, slope −½")
    upper.errorbar(table.repeats, table.error, BARS * table.error_standard_error, ls="", marker="o", color=COLORS[0], label="drawn, 99.9 %")
    relative = table.error * np.sqrt(table.repeats)
    sigma = table.error_standard_error * np.sqrt(table.repeats)
    lower.axhline(1, color=THEORY, lw=1)
    lower.errorbar(table.repeats, relative, BARS * sigma, ls="", marker="o", color=COLORS[0])
    fit = fit_of(result, "error_over_repeats")
    said = "Fewer than two numbers of repeats: no slope."
    if fit and len(table) > 1:
        slope, factor = fit["slope"], fit["log_factor"]
        lower.plot(ends, np.exp(factor["value"]) * ends ** (slope["value"] + 0.5), color=COLORS[1], lw=1, label="fitted power law")
        lower.legend(loc="best")
        level = result.documents["fit"].get("interval_level", np.nan)
        text = f"{with_error(slope['value'], slope['standard_error'])}"
        upper.text(0.04, 0.08, f"fitted slope {text}\n{100 * level:.2f} % interval [{signed(slope['low'], 4)}, {signed(slope['high'], 4)}]", transform=upper.transAxes)
        holds = slope["low"] <= -0.5 <= slope["high"]
        said = (f"Finding: the fitted slope is {text}, its {100 * level:.2f} % interval [{signed(slope['low'], 5)}, {signed(slope['high'], 5)}] "
                f"{'holds' if holds else 'does NOT hold'} −1/2; the error is {with_error(np.exp(factor['value']), np.exp(factor['value']) * factor['standard_error'])} "
                "of the theory's at one repeat.")
    upper.set(xscale="log", yscale="log", ylabel="RMS error of α per pixel  [√(α(1−α))]", title="Error of the ensemble mean over repeats")
    upper.legend(loc="upper right")
    upper.set_xticks(spread(table.repeats, 9), [f"{r:g}" for r in spread(table.repeats, 9)])
    upper.tick_params(axis="x", which="minor", bottom=False)
    lower.tick_params(axis="x", which="minor", bottom=False)
    upper.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    upper.yaxis.set_major_formatter("{x:g}")
    upper.yaxis.set_minor_formatter(NullFormatter())
    reach = max(1.15 * np.max(np.abs(relative - 1) + BARS * sigma), 1e-4)
    lower.set(xlabel="repeats $L_R$", ylabel="drawn / theory", ylim=(1 - reach, 1 + reach))
    common.save(fig, result.folder, "error_over_repeats", caption=(
        "Root mean square error of pixels' ensemble mean opacity, in units of one repeat's standard deviation √(α(1−α)), over "
        f"the number of repeats L_R: {plural(len(table), 'number')} of repeats, {table.pixels.min():.0f} to {table.pixels.max():.0f} pixels each "
        f"(those with α(1−α) > 0.01). Bars: ± {BARS:.2f} theoretical standard errors (99.9 %). Below: drawn over theory. {said}"))


INTERVALS = (("effective_area", "a", r"$s_{\mathrm{eff}}/s$ alone"), ("both", "a", r"$s_{\mathrm{eff}}/s$, joint"),
             ("tilt_exponent", "p", "$p$ alone"), ("both", "p", "$p$, joint"))


def intervals_panel(ax, result: common.Result) -> str:
    found = [(label, fit_of(result, model)[name]) for model, name, label in INTERVALS if fit_of(result, model)]
    if not found:
        nothing(ax, "no fit converged")
        return "No fit of s_eff/s or p converged: too few points carry information."
    ax.axvline(0, color=THEORY, lw=1)
    for place, (label, p) in enumerate(found[::-1]):
        color = COLORS[0] if p["name"] == "a" else COLORS[1]
        ax.plot([1e3 * (p["low"] - 1), 1e3 * (p["high"] - 1)], [place, place], color=color, lw=1.2)
        ax.plot([1e3 * (p["value"] + s * p["standard_error"] - 1) for s in (-1, 1)], [place, place], color=color, lw=4)
        ax.plot(1e3 * (p["value"] - 1), place, marker="o", ms=5, mfc="white", mec=color)
    ax.set_yticks(range(len(found)), [label for label, _ in found[::-1]])
    ax.set(ylim=(-0.6, len(found) - 0.4), xlabel="value − 1  [10⁻³]", title="Fitted parameters (theory: 1)")
    level = result.documents["fit"].get("interval_level", np.nan)
    names = {"a": "s_eff/s", "p": "p"}
    said = "; ".join(f"{names.get(p['name'], p['name'])} {'alone' if 'alone' in label else 'joint'} {with_error(p['value'], p['standard_error'])}"
                     for label, p in found)
    missed = sum(not p["low"] <= 1 <= p["high"] for _, p in found)
    return (f"Top left: fitted values less 1, thick ± 1 σ, thin the {100 * level:.2f} % intervals (99.9 % together): {said}. Finding: "
            f"{'every interval holds 1' if not missed else f'{missed} of {len(found)} intervals do NOT hold 1'}.")


def ellipse_panel(ax, result: common.Result) -> str:
    fit = fit_of(result, "both")
    if not fit:
        nothing(ax, "$s_{\\mathrm{eff}}/s$ and $p$ were not told apart:\nno fit of both converged")
        return "No joint fit converged (without tilts p has no meaning)."
    centre = 1e3 * (np.array([fit["a"]["value"], fit["p"]["value"]]) - 1)
    covariance = 1e6 * np.reshape(result.documents["fit"]["both"]["covariance"], (2, 2))
    values, vectors = np.linalg.eigh(covariance)
    turn = np.linspace(0, 2 * np.pi, 200)
    circle = vectors @ (np.sqrt(np.maximum(values, 0))[:, None] * np.array([np.cos(turn), np.sin(turn)]))
    for level, style in ((0.999, "-"), (0.95, "--")):
        ax.plot(*(centre[:, None] + np.sqrt(stats.chi2.ppf(level, 2)) * circle), color=COLORS[0], ls=style, lw=1.2, label=f"{100 * level:g} %")
    ax.plot(*centre, marker="o", ms=5, mfc="white", mec=COLORS[0], ls="", label="fit")
    ax.plot(0, 0, marker="+", ms=10, mew=1.5, color=THEORY, ls="", label="theory")
    ax.set(xlabel=r"$s_{\mathrm{eff}}/s$ − 1  [10⁻³]", ylabel="$p$ − 1  [10⁻³]", title="Both jointly")
    bottom, top = ax.get_ylim()
    ax.set_ylim(bottom, top + 0.18 * (top - bottom))
    ax.legend(loc="upper center", ncol=4)
    distance = float(centre @ np.linalg.solve(covariance, centre)) if np.linalg.det(covariance) > 0 else np.nan
    correlation = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
    return (f"Top right: joint confidence ellipse; the theory lies at χ² = {distance:.2f} of 2 degrees of freedom "
            f"(p = {stats.chi2.sf(distance, 2):.2g}), correlation {signed(correlation, 2)}.")


def evidence_panel(ax, result: common.Result) -> str:
    laws = (result.documents.get("fit") or {}).get("binomial_against_poisson")
    if not laws:
        nothing(ax, "no point told binomial from Poisson")
        return "No evidence between binomial and Poisson counts."
    bars = (("nothing fitted", laws["log10_bayes_factor"]), ("area fitted", laws["log10_bayes_factor_free_area"]))
    for place, (label, value) in enumerate(bars[::-1]):
        ax.barh(place, value, height=0.5, color=COLORS[2] if value > 0 else COLORS[1])
        ax.annotate(f"{value:.2f}", (max(value, 0), place), xytext=(4, 0), textcoords="offset points", va="center")
    low, high = min(0, *(v for _, v in bars)), max(2.5, *(v for _, v in bars))
    ax.axvline(0, color=THEORY, lw=1)
    ax.axvline(2, color=THEORY, lw=0.8, ls="--")
    ax.text(2, 1.62, "decisive", ha="center", va="center", color=THEORY, fontsize=8, bbox={"facecolor": "white", "lw": 0, "pad": 1})
    ax.set_yticks(range(2), [label for label, _ in bars[::-1]])
    ax.set(xlim=(low * 1.15, high * 1.2), ylim=(-0.6, 1.85), xlabel="log₁₀ Bayes factor, fixed count over Poisson count", title="Binomial against Poisson")
    return (f"Bottom left: evidence for a fixed number of particles against a Poisson number of the same mean, log10 of the Bayes factor "
            f"{bars[0][1]:.2f} with nothing fitted (Δχ² = {laws['delta_chi2']:.1f}), {bars[1][1]:.2f} with the area fitted; 2 is decisive, "
            "negative would speak for Poisson.")


def bias_panel(ax, result: common.Result) -> str:
    fits = result.documents.get("fit") or {}
    found = [(label, fits[model]["smallest_bias_seen"]) for model, label in
             (("effective_area", "$s_{\\mathrm{eff}}/s$"), ("tilt_exponent", "$p$")) if fit_of(result, model) and "smallest_bias_seen" in fits[model]]
    if not found:
        nothing(ax, "no fit converged:\nthe smallest bias seen is not known")
        return ""
    for place, (label, value) in enumerate(found[::-1]):
        ax.barh(place, 100 * value, height=0.5, color=COLORS[0] if "eff" in label else COLORS[1])
        ax.annotate(f"{100 * value:.2g} %", (100 * value, place), xytext=(4, 0), textcoords="offset points", va="center")
    ax.set_yticks(range(len(found)), [label for label, _ in found[::-1]])
    ax.set(xlim=(0, 130 * max(v for _, v in found)), ylim=(-0.6, len(found) - 0.4), xlabel="deviation from 1  [%]", title="Smallest bias that the test sees")
    said = ", ".join(f"{100 * v:.2g} % in {'s_eff/s' if 'eff' in label else 'p'}" for label, v in found)
    return f"Bottom right: the bias which would fail its check with probability one half: {said}."


def scatter_finding(result: common.Result, rows: pd.DataFrame) -> str:
    """χ² of the area's fit; where it is oddly small or large, what makes it so."""
    fit = (result.documents.get("fit") or {}).get("effective_area") or {}
    if not fit.get("converged"):
        return ""
    text = f" {fit['points']} rows enter; χ² = {fit['chi2']:.1f} of {fit['dof']:.0f} (p = {fit['p_value']:.3g})"
    rows = rows[rows.sigma > 0]
    trials = rows.pixels_measured * rows.repeats
    many = rows[np.minimum(rows.alpha_theory, 1 - rows.alpha_theory) * trials >= FEW]
    if not len(many) or len(many) == len(rows) or 0.005 < fit["p_value"] < 0.995:
        return text + "."
    chi2 = float((((many.alpha_drawn - many.alpha_theory) / many.sigma) ** 2).sum())
    return (f"{text}. This p is to be taken with care: {len(rows) - len(many)} rows expect fewer than {FEW} covered or clear pixels, where the squared "
            f"deviation is nearly always close to 0 and seldom large; over the other {len(many)}, against the theory itself, χ² = {chi2:.1f} "
            f"(p = {stats.chi2.sf(chi2, len(many)):.2g}).")


def fits(result: common.Result, rows: pd.DataFrame) -> None:
    fig, axes = common.subplots(2, 2, height_in=2.6)
    panels = (intervals_panel, ellipse_panel, evidence_panel, bias_panel)
    caption = "Least-squares fits of α = 1 − (1 − (s_eff/s)·s/(S cos^p θ))^n." + scatter_finding(result, rows)
    caption = " ".join([caption] + [panel(ax, result) for panel, ax in zip(panels, axes.flat)])
    common.save(fig, result.folder, "fits", caption=caption.strip())


def main() -> int:
    if len(sys.argv) != 2:
        print("usage: opacity_vs_n.py RESULT_DIR", file=sys.stderr)
        return 2
    result = common.load(sys.argv[1])
    rows = rows_measured(result)
    opacity_over_n(result, rows)
    opacity_over_theta(result, rows)
    z_scores(result, rows)
    error_over_repeats(result)
    fits(result, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
