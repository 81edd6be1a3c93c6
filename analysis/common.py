"""What every figure shares: reading a result folder, the look, saving, captions.

An analysis script is run as `python3 analysis/NAME.py results/NAME`. It only reads the folder and
writes PNGs and `NAME.captions.json` into it; all numbers were computed by the experiment.

    result = common.load(sys.argv[1])
    table = result.tables["opacity"]                   # opacity.csv; an empty cell is NaN
    fig, ax = common.subplots()
    ...
    common.save(fig, result.folder, "alpha_over_n", caption="Drawn opacity over ...")
"""
from __future__ import annotations

import io
import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("MPLCONFIGDIR", str(Path(__file__).resolve().parent.parent / "build" / "matplotlib"))
import matplotlib

matplotlib.use("Agg")  # no display is needed, none is opened
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from PIL import Image

# Okabe and Ito's colours without the yellow (too pale on white): told apart with any colour vision.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
THEORY = "#555555"  # lines of theory and guides, always behind the measurements
COLUMN_IN = 5.6     # width of one panel; two panels stand side by side in 2 × this
DPI = 150
SMALL_BYTES = 150_000  # what a committed figure may weigh; from a third of it on, 256 colours have to do

plt.rcParams.update({
    "font.family": "DejaVu Sans", "font.size": 9, "axes.titlesize": 10, "axes.labelsize": 9,
    "legend.fontsize": 8, "xtick.labelsize": 8, "ytick.labelsize": 8, "legend.frameon": False,
    "axes.prop_cycle": matplotlib.cycler(color=COLORS),
    "axes.grid": True, "grid.color": "#dddddd", "grid.linewidth": 0.6, "axes.axisbelow": True,
    "axes.spines.top": False, "axes.spines.right": False,
    "lines.linewidth": 1.4, "lines.markersize": 4, "errorbar.capsize": 2,
    "figure.facecolor": "white", "figure.constrained_layout.use": True, "image.interpolation": "nearest",
})


@dataclass(frozen=True)
class Result:
    """A result folder as read: `summary` is summary.json, `tables` maps stem to CSV, `documents` stem
    to every other JSON (fit.json is documents["fit"])."""
    folder: Path
    summary: dict
    tables: dict[str, pd.DataFrame]
    documents: dict


def fail(message: str) -> None:
    """One line on stderr, exit 2: the folder is not what the figure needs."""
    print(message, file=sys.stderr)
    raise SystemExit(2)


def _json(file: Path):
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        fail(f"{file}: {error}")


def _csv(file: Path) -> pd.DataFrame:
    try:
        return pd.read_csv(file)
    except (OSError, ValueError) as error:  # pandas' parser errors are ValueErrors
        fail(f"{file}: {error}")


def load(result_dir: str | Path) -> Result:
    """Reads summary, tables and documents of a result folder. Exit 2 naming the file where one is damaged."""
    folder = Path(result_dir)
    summary = _json(folder / "summary.json")
    tables = {file.stem: _csv(file) for file in sorted(folder.glob("*.csv"))}
    documents = {file.stem: _json(file) for file in sorted(folder.glob("*.json"))
                 if file.name != "summary.json" and not file.name.endswith(".captions.json")}
    return Result(folder, summary, tables, documents)


def measured(table: pd.DataFrame, *columns: str) -> pd.DataFrame:
    """The rows where all of `columns` were measured (an empty cell is not), every value finite.
    Exit 2 naming column and row where a column is missing, not a number, or infinite: an
    experiment writes an empty cell where there is no answer, never such a thing."""
    for column in columns:
        if column not in table:
            fail(f"no column '{column}' in the table (there are: {', '.join(table.columns)})")
        if not pd.api.types.is_numeric_dtype(table[column]):
            fail(f"column '{column}' is not numeric")
        infinite = np.flatnonzero(np.isinf(table[column].to_numpy(dtype=float)))
        if infinite.size:
            fail(f"column '{column}', row {infinite[0] + 1}: infinite")
    return table.dropna(subset=list(columns))


def subplots(rows: int = 1, columns: int = 1, *, height_in: float = 3.6, **kwargs):
    """plt.subplots in the house size: `height_in` is the height of one row."""
    return plt.subplots(rows, columns, figsize=(COLUMN_IN * columns, height_in * rows), **kwargs)


def _png(fig) -> bytes:
    """The figure as PNG, light enough to be kept in the repository."""
    buffer = io.BytesIO()
    fig.savefig(buffer, format="png", dpi=DPI, metadata={"Software": None})
    if buffer.tell() > SMALL_BYTES / 3:
        image = Image.open(buffer).convert("RGB").quantize(256, dither=Image.Dither.NONE)
        buffer = io.BytesIO()
        image.save(buffer, format="PNG", optimize=True)
    return buffer.getvalue()


def _write_whole(file: Path, content: bytes) -> None:
    aside = file.with_name(f".{file.name}.{os.getpid()}")
    try:
        aside.write_bytes(content)
        os.replace(aside, file)
    finally:
        aside.unlink(missing_ok=True)


def _summary_of(folder: Path) -> dict:
    try:
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return summary if isinstance(summary, dict) else {}


def write_captions(folder: str | Path, captions: dict[str, str]) -> None:
    """Adds {"figure.png": "caption"} to the folder's NAME.captions.json, which the report shows."""
    folder = Path(folder)
    file = folder / f"{_summary_of(folder).get('experiment', folder.resolve().name)}.captions.json"
    try:
        known = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        known = {}
    kept = {name: text for name, text in known.items() if (folder / name).exists()}
    content = json.dumps(kept | captions, indent=1, ensure_ascii=False)
    _write_whole(file, (content + "\n").encode())


def save(fig, folder: str | Path, name: str, caption: str = "") -> Path:
    """Writes `name`.png whole or not at all, notes its caption, closes the figure. A figure of the
    quick preset says so on its face: it proves that the path runs and is not a result."""
    folder = Path(folder)
    file = folder / f"{Path(name).stem if name.endswith('.png') else name}.png"
    if _summary_of(folder).get("preset") == "quick":
        fig.text(0.995, 0.005, "quick preset: not a result", ha="right", va="bottom", fontsize=6, color="#B00000")
    _write_whole(file, _png(fig))
    plt.close(fig)
    if caption:
        write_captions(folder, {file.name: caption})
    return file
