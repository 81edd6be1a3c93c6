"""Figures of fused_scenes: particles beside their truth, scene by scene; the paper's table and ours.

    python3 analysis/fused_scenes.py results/fused_scenes
"""
from __future__ import annotations

import sys

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

import common

TITLES = {"cell": "five isosurfaces of one trilinear cell", "head": "Catmull-Rom isosurfaces of a head",
          "organs": "overlapping MPU organs", "scan_and_wave": "a scan and a cosine wave", "dose": "dose isosurfaces in a volume",
          "slice": "slice, volume and polygons"}


def picture(result: common.Result, name: str) -> np.ndarray | None:
    file = result.folder / "pictures" / f"{name}.png"
    return np.asarray(Image.open(file).convert("RGB")) if file.exists() else None


def draw_pictures(result: common.Result) -> None:
    errors = result.tables["errors"]
    scenes = list(dict.fromkeys(errors.scene))
    fig, axes = plt.subplots(3, len(scenes), figsize=(2.5 * len(scenes), 7.9), squeeze=False)
    for column, scene in enumerate(scenes):
        for ax, (kind, label) in zip(axes[:, column], (("particles", "particles"), ("truth", "truth"), ("flip", "FLIP error"))):
            image = picture(result, f"{scene}_{kind}")
            if image is not None:
                ax.imshow(image)
            ax.set_xticks([])
            ax.set_yticks([])
            ax.grid(False)
            if column == 0:
                ax.set_ylabel(label)
        axes[0, column].set_title(TITLES.get(scene, scene), fontsize=8)
    lines = errors[errors.sampler == "lines"]
    stratified = errors[errors.sampler == "stratified"].set_index("scene")
    said = "; ".join(f"{TITLES.get(r.scene, r.scene)}: {r.ratio:.3f} ± {r.ratio_error:.3f}, stratified {stratified.ratio[r.scene]:.2f}"
                     for r in lines.itertuples())
    common.save(fig, result.folder, "pictures", caption=(
        f"Figures 3 to 6 of the 2012 paper in kind, {lines.repeats.iloc[0]} repeats, each beside its ray-traced truth (particle filter). "
        f"RMSE over what theory says the noise must be: {said}."))


def draw_table(result: common.Result) -> None:
    table = result.tables["table"]

    def number(value, form: str) -> str:
        return "" if np.isnan(value) else format(value, form)

    cells = [[r.source, TITLES.get(r.scene, r.scene), f"{r.resolution_px}²", r.repeats, number(r.particles, ".3g"),
              number(r.preparing_s, ".1f"), number(r.sampling_s, ".1f"), number(r.draw_s, ".2f"), number(r.frames_per_s, ".3g"),
              number(r.sampled_per_s / 1e6, ".3g"), number(r.sampling_gain, ".0f"), number(r.drawing_gain, ".2g")] for r in table.itertuples()]
    fig, ax = plt.subplots(figsize=(13, 0.5 + 0.3 * len(cells)))
    ax.set_axis_off()
    labels = ["source", "scene", "pixels", "$L_R$", "particles", "preparing, s", "sampling, s", "drawing, s", "frames/s", "M sampled/s", "gain", "gain, drawn"]
    drawn = ax.table(cells, colLabels=labels, loc="center", cellLoc="right",
                     colWidths=[0.1, 0.24, 0.06, 0.05, 0.08, 0.09, 0.09, 0.08, 0.07, 0.09, 0.06, 0.09], edges="horizontal")
    drawn.scale(1, 1.35)
    for (_, column), cell in drawn.get_celld().items():
        if column < 2:
            cell.get_text().set_horizontalalignment("left")
    common.save(fig, result.folder, "table", caption=(
        "The table of the 2012 paper (sampled on an i7-980, drawn on a GTX 580) and ours: the "
        f"{result.summary['host']['cpu']}, {result.summary['host']['threads']} threads. Preparing reads files and finds the surface "
        "(fits of points, cells of volumes); drawing projects, shades and averages all repeats. Gains are in particles a second, sampled and drawn, over the published "
        "ones of the scene in kind."))


def main() -> None:
    result = common.load(sys.argv[1])
    draw_pictures(result)
    draw_table(result)


if __name__ == "__main__":
    main()
