"""Figure of opacity_control: `python3 analysis/opacity_control.py results/opacity_control`.

Achieved opacity of counting spheres beside what was wished, over what makes a sphere's great circle a wrong area.
"""
from __future__ import annotations

import sys

import common
import numpy as np
import pandas as pd
from common import COLORS, THEORY

LABELS = {"curvature": "$(\\kappa_1-\\kappa_2)^2 r^2$", "edge": "distance from an open edge / r",
          "second sheet": "distance of a second sheet / r"}
COLUMNS = ["case", "value", "alpha_wished", "alpha_counted", "alpha_counted_theory"]


def achieved(result: common.Result) -> None:
    rows = result.tables.get("opacity_control", pd.DataFrame(columns=COLUMNS))
    figure, axes = common.subplots(1, 3)
    for axis, (case, label) in zip(np.ravel(axes), LABELS.items()):
        some = rows[rows.case == case]
        for color, (alpha, group) in zip(COLORS, some.groupby("alpha_wished")):
            by_value = group.groupby("value")
            means = by_value[["alpha_counted", "alpha_counted_theory"]].mean()
            axis.plot(means.index, means.alpha_counted_theory, color=THEORY, lw=1)
            axis.errorbar(means.index, means.alpha_counted, by_value.alpha_counted.std(), fmt="o", ms=3, color=color,
                          label=f"wished {alpha:g}")
            axis.axhline(alpha, color=color, lw=0.5, alpha=0.5)
        axis.set(xlabel=label, ylabel="achieved opacity", title=case)
    np.ravel(axes)[-1].legend(fontsize="x-small")
    caption = ("Opacity that sampling achieves which stops by counting spheres; thin lines: what was wished, and what the exact "
               "way gives. Grey: (1) with the area that is really inside a sphere.")
    common.save(figure, result.folder, "opacity_control", caption=caption)


def main() -> int:
    if len(sys.argv) != 2:
        print("usage: opacity_control.py RESULT_DIR", file=sys.stderr)
        return 2
    achieved(common.load(sys.argv[1]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
