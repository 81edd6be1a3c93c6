"""Google Benchmark's output and the memory line -> speed.csv, speed.json, speed.md; prints the table.

    python3 tools/bench_report.py BENCHMARK.json MEMORY.json FOLDER

Absolute times mean little on a shared machine: goals are ratios of medians over interleaved repetitions,
with a 95 % bootstrap interval. Wall time decides; beside it stands the same ratio in processor time of the
whole process, which other programs on the machine disturb less. Exit 0 all goals met, 1 one missed.
"""
from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

WORK = ("particles", "trials", "steps", "points", "hits", "rays", "samples", "blocks", "merges", "triangles")  # the benchmarks' counters, per second
SECONDS = ("s", "s/block")
BOOTSTRAPS = 4000


@dataclass
class Ratio:
    """median(top)/median(bottom) of one quantity: "s" a run, or a rate per second."""
    name: str
    quantity: str
    top: str
    bottom: str
    at_least: float | None = None
    at_most: float | None = None


RATIOS = (
    Ratio("whole drawing of 5e7 (fast CPU), of bare splat", "particles", "draw/fast_5e7", "draw/probe", at_least=0.5),
    Ratio("drawing 5e6 particles costs, of 5e7", "s", "draw/fast_5e6", "draw/fast_5e7", at_most=0.2),
    Ratio("winners of 5e7 particles (plain CPU), of bare splat", "particles", "draw/winners_5e7", "draw/probe"),
    Ratio("whole drawing of 5e7 (plain CPU), of bare splat", "particles", "draw/plain_5e7", "draw/probe"),
    Ratio("Vulkan: clear, project, resolve, of bare compute splat", "particles", "vulkan/winners_5e7", "vulkan/probe",
          at_least=0.6),
    Ratio("Vulkan: the same, shaded and summed, of bare compute splat", "particles", "vulkan/ensemble_5e7", "vulkan/probe",
          at_least=0.6),
    Ratio("Vulkan: the same with all copies", "particles", "vulkan/ensemble_5e7_with_copies", "vulkan/probe"),
    Ratio("Vulkan: a pass of depth peeling, of bare raster", "triangles", "vulkan/peel_pass_1", "vulkan/raster_probe", at_least=0.5),
    Ratio("Vulkan: a pass that keeps eight surfaces, of bare raster", "triangles", "vulkan/peel_pass_8", "vulkan/raster_probe"),
    Ratio("Vulkan: casting a volume, flat, of bare march", "samples", "vulkan/cast_flat", "vulkan/march_probe", at_least=0.5),
    Ratio("Vulkan: casting a volume, flat, of bare march through packed samples", "samples", "vulkan/cast_flat",
          "vulkan/packed_march_probe"),
    Ratio("Vulkan: casting a volume, lit, of bare march", "samples", "vulkan/cast_lit", "vulkan/march_probe"),
    Ratio("Vulkan: casting into slabs of 8 layers takes, of casting", "s", "vulkan/slabs_8_layers", "vulkan/cast_flat"),
    Ratio("sampling a torus, of bare lines", "particles", "sample/torus", "sample/probe", at_least=0.3),
    Ratio("sampling a torus in fast mode, of bare lines", "particles", "sample/torus_fast_mode", "sample/probe"),
    Ratio("Brownian steps on a torus, of bare steps", "steps", "walk/torus_thinned", "walk/probe", at_least=0.25),
    Ratio("Brownian steps and a particle of each, of bare steps", "steps", "walk/torus", "walk/probe"),
    Ratio("sampling a torus by triangles, of copying", "particles", "sample/torus_mesh", "sample/copy", at_least=0.25),
    Ratio("sampling a torus by triangles, of bare lines", "particles", "sample/torus_mesh", "sample/probe"),
    Ratio("sampling a torus by octree leaves, of bare lines", "particles", "sample/torus_octree", "sample/probe"),
    Ratio("sampling points (MPU), of bare lines", "particles", "sample/points", "sample/probe", at_least=0.02),
    Ratio("sampling a sextic formula, of bare lines through a torus", "particles", "sample/sextic", "sample/probe",
          at_least=0.25),
    Ratio("sampling a sextic formula, of bare lines through it", "particles", "sample/sextic", "sample/sextic_probe"),
    Ratio("sampling a mesh, of bare lines", "particles", "sample/mesh", "sample/probe"),
    Ratio("sampling an isosurface, of bare lines", "particles", "sample/isosurface", "sample/probe"),
    # 3 M particles/s where a probe gives 46 M/s.
    Ratio("sampling the head, of bare lines", "particles", "sample/head", "sample/probe", at_least=3 / 46),
    Ratio("sampling a Catmull-Rom isosurface, of bare lines", "particles", "sample/catmull_rom", "sample/probe",
          at_least=0.05),
    Ratio("sampling the head by Catmull-Rom, of bare lines", "particles", "sample/head_catmull_rom", "sample/probe",
          at_least=0.05),
    Ratio("truth's all hits, of bare Embree", "hits", "truth/gather", "truth/probe", at_least=0.5),
    Ratio("truth of a sextic formula, 16 rays a pixel, of bare lines through it", "rays", "truth/sextic_512",
          "sample/sextic_probe"),
    # 256³ uint8 at 512², one-voxel steps, nothing skipped.
    Ratio("casting a volume, flat, of bare trilinear", "samples", "cast/flat", "cast/probe", at_least=0.4),
    Ratio("casting a volume, lit, of bare trilinear", "samples", "cast/lit", "cast/probe", at_least=0.2),
    Ratio("casting into slabs of 8 layers takes, of casting", "s", "cast/slabs_8_layers", "cast/flat", at_most=1.3),
    Ratio("the same one by one", "s", "cast/slabs_8_layers_one_by_one", "cast/flat"),
    Ratio("a non-empty block where half are empty takes, of where none is", "s/block", "cast/filled_50", "cast/flat"),
    Ratio("where 80 % are empty", "s/block", "cast/filled_20", "cast/flat"),
    Ratio("where 95 % are empty", "s/block", "cast/filled_5", "cast/flat"),
    Ratio("whole truth (box), of bare Embree", "hits", "truth/whole_box", "truth/probe"),
    Ratio("whole truth (particle), of bare Embree", "hits", "truth/whole_particle", "truth/probe"),
)


@dataclass
class Level:
    """A median by itself: a goal in seconds, or a second, which a slower machine may miss."""
    name: str
    quantity: str
    benchmark: str
    at_least: float | None = None
    at_most: float | None = None


LEVELS = (
    Level("points fitted a second (30 µs each)", "points", "points/fit", at_least=1 / 30e-6),
    Level("merges of slabs a second", "merges", "slabs/merge", at_least=1e8),
    # Half of what VTK 9.1 took for the exact dual depth peeling of eight spheres of 100 k triangles at 1024².
    Level("peeling eight spheres, s", "s", "surfaces/peel_eight_spheres", at_most=2.1 / 2),
)


def long_table(raw: dict) -> pd.DataFrame:
    """One row a measurement. A rate in processor time is the work over the processor seconds spent on it."""
    unit_s = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0}
    rows = []
    for run in raw["benchmarks"]:
        if run["run_type"] != "iteration":
            continue
        if run.get("error_occurred"):
            raise SystemExit(f"bench_report: {run['name']}: {run.get('error_message')}")
        name = "/".join(run["name"].split("/")[:2])
        scale = unit_s[run["time_unit"]]
        wall_s, cpu_s = run["real_time"] * scale, run["cpu_time"] * scale
        whole_process = "process_time" in run["name"]
        values = [("s", "wall", wall_s)]
        values += [(work, "wall", run[work]) for work in WORK if work in run]
        if whole_process:
            values += [("s", "processor", cpu_s)]
            values += [(work, "processor", run[work] * wall_s / cpu_s) for work in WORK if work in run]
        if "blocks" in run:
            values.append(("s/block", "wall", 1 / run["blocks"]))
        for quantity, clock, value in values:
            unit = quantity if quantity in SECONDS else f"{quantity}/s"
            rows.append((name, run["repetition_index"], clock, quantity, value, unit))
    return pd.DataFrame(rows, columns=["benchmark", "repetition", "clock", "quantity", "value", "unit"])


def values_of(table: pd.DataFrame, benchmark: str, quantity: str, clock: str) -> np.ndarray:
    chosen = (table.benchmark == benchmark) & (table.quantity == quantity) & (table.clock == clock)
    return table.value[chosen].to_numpy()


def judge(ratio: Ratio, table: pd.DataFrame) -> dict | None:
    """None where one of the two was not measured."""
    verdict = {"ratio": ratio.name, "quantity": ratio.quantity, "top": ratio.top, "bottom": ratio.bottom}
    for clock in ("wall", "processor"):
        top = values_of(table, ratio.top, ratio.quantity, clock)
        bottom = values_of(table, ratio.bottom, ratio.quantity, clock)
        if not len(top) or not len(bottom):
            if clock == "wall":
                return None
            continue
        random = np.random.default_rng(1)
        resampled = (np.median(random.choice(top, (BOOTSTRAPS, len(top))), axis=1)
                     / np.median(random.choice(bottom, (BOOTSTRAPS, len(bottom))), axis=1))
        low, high = np.percentile(resampled, [2.5, 97.5])
        verdict[clock] = {"value": np.median(top) / np.median(bottom), "low": low, "high": high}
    goal = ratio.at_least if ratio.at_least is not None else ratio.at_most
    if goal is not None:
        value = verdict["wall"]["value"]
        verdict["goal"] = f"{'>=' if ratio.at_least is not None else '<='} {goal:.3g}"
        verdict["met"] = bool(value >= goal if ratio.at_least is not None else value <= goal)
    return verdict


def judge_level(level: Level, table: pd.DataFrame) -> dict | None:
    """None where it was not measured."""
    measured = values_of(table, level.benchmark, level.quantity, "wall")
    if not len(measured):
        return None
    value = float(np.median(measured))
    met = value >= level.at_least if level.at_least is not None else value <= level.at_most
    goal = f">= {level.at_least:.3g}" if level.at_least is not None else f"<= {level.at_most:.3g}"
    return {"ratio": level.name, "value": value, "goal": goal, "met": bool(met)}


def judge_memory(memory: dict) -> list[dict]:
    per_particle = memory["particle_set_bytes"] / memory["particles"]
    peak = memory["rss_drawn_bytes"] - memory["rss_before_bytes"]
    share = peak / memory["budget_bytes"]
    return [
        {"ratio": "bytes a particle resident", "value": per_particle, "goal": "<= 16.1",
         "met": per_particle <= 16.1},
        {"ratio": "peak memory, of 16 B a particle + a tile a thread + result", "value": share,
         "goal": "<= 1.02", "met": share <= 1.02},
    ]


def summary_of(table: pd.DataFrame) -> list[dict]:
    groups = table.groupby(["benchmark", "clock", "quantity", "unit"], sort=False).value
    return [{"benchmark": b, "clock": c, "quantity": q, "unit": u, "repetitions": len(v),
             "median": v.median(), "least": v.min(), "most": v.max(),
             "quartile_1": v.quantile(0.25), "quartile_3": v.quantile(0.75)}
            for (b, c, q, u), v in groups]


def markdown(summary: list[dict], ratios: list[dict], memory: dict, context: dict) -> str:
    def million(row: dict, key: str) -> str:
        return f"{row[key] / 1e6:.3g}"

    lines = [f"{context['cpu']}, {context['threads']} threads, load {context['load_avg'][0]:.1f}, "
             f"{context['date']}, commit {context['commit']}, {context['compiler']}.", "",
             "| stage | work | median (least … most), M/s | M a processor-second |", "|---|---|---|---|"]
    by_processor = {(r["benchmark"], r["quantity"]): r for r in summary if r["clock"] == "processor"}
    for row in summary:
        if row["clock"] != "wall" or row["quantity"] in SECONDS:
            continue
        cpu = by_processor.get((row["benchmark"], row["quantity"]))
        lines.append(f"| {row['benchmark']} | {row['quantity']} | {million(row, 'median')} "
                     f"({million(row, 'least')} … {million(row, 'most')}) "
                     f"| {million(cpu, 'median') if cpu else ''} |")
    lines += ["", "| ratio of medians | wall (95 %) | processor time (95 %) | goal | |",
              "|---|---|---|---|---|"]
    for r in ratios:
        def interval(clock: str) -> str:
            if clock not in r:
                return ""
            return f"{r[clock]['value']:.3g} ({r[clock]['low']:.3g} … {r[clock]['high']:.3g})"
        wall = f"{r['value']:.4g}" if "value" in r else interval("wall")
        met = {True: "met", False: "**missed**", None: ""}[r.get("met")]
        lines.append(f"| {r['ratio']} | {wall} | {interval('processor')} | {r.get('goal', '')} | {met} |")
    mib = {key.removesuffix("_bytes"): memory[key] / 2**20 for key in memory if key.endswith("_bytes")}
    lines += ["", f"Memory, 5e7 particles at 1024² (MiB): particle set {mib['particle_set']:.1f}; a thread's "
              f"frames {mib['frame']:.2f}, image of sums {mib['sums']:.0f}; "
              f"peak resident {mib['rss_drawn'] - mib['rss_before']:.0f} above {mib['rss_before']:.0f} "
              f"before sampling; budget {mib['budget']:.0f}."]
    return "\n".join(lines) + "\n"


def main() -> int:
    if len(sys.argv) != 4:
        print(f"usage: {sys.argv[0]} BENCHMARK.json MEMORY.json FOLDER", file=sys.stderr)
        return 2
    raw = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    memory = json.loads(Path(sys.argv[2]).read_text(encoding="utf-8"))
    folder = Path(sys.argv[3])
    folder.mkdir(parents=True, exist_ok=True)

    table = long_table(raw)
    summary = summary_of(table)
    judged = [judge(r, table) for r in RATIOS] + [judge_level(level, table) for level in LEVELS]
    ratios = [v for v in judged if v is not None] + judge_memory(memory)
    text = markdown(summary, ratios, memory, raw["context"])
    table.to_csv(folder / "speed.csv", index=False)
    whole = {"context": raw["context"], "memory": memory, "medians": summary, "ratios": ratios}
    (folder / "speed.json").write_text(json.dumps(whole, indent=2) + "\n", encoding="utf-8")
    (folder / "speed.md").write_text(text, encoding="utf-8")
    print(text, end="")
    return 0 if all(r.get("met", True) for r in ratios) else 1


if __name__ == "__main__":
    sys.exit(main())
