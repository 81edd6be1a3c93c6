"""One plain page over all results: `python3 analysis/report.py results` -> results/report/index.html.

Per experiment: the question (first comment line of experiments/NAME.cpp), the verdict, its checks,
its figures with captions, where the numbers come from. What failed stands on top. Needs no network,
no script and nothing but Python's own library; the page and its images can be moved as one folder.
The folder `report` is replaced as a whole or left as it was.
"""
from __future__ import annotations

import json
import math
import os
import shutil
import sys
import tempfile
from dataclasses import dataclass, field
from datetime import datetime, timezone
from html import escape
from pathlib import Path
from urllib.parse import quote

REPOSITORY = Path(__file__).resolve().parent.parent

STYLE = """
:root { color-scheme: light dark; --line: #8884; --soft: #8882; --bad: #c0261c; --good: #16794a; --dim: #6b6b6b; }
@media (prefers-color-scheme: dark) { :root { --bad: #ff8a80; --good: #6fd6a2; --dim: #a5a5a5; } }
body { font: 16px/1.5 system-ui, "DejaVu Sans", sans-serif; max-width: 62rem; margin: 0 auto; padding: 1rem; overflow-wrap: break-word; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.25rem; margin-top: 3rem; border-top: 1px solid var(--line); padding-top: 1rem; }
.question { font-size: 1.1rem; margin: 0 0 .5rem; }
.failed, .passed { font-weight: 600; } .failed { color: var(--bad); } .passed { color: var(--good); } .dim { color: var(--dim); }
.scroll { overflow-x: auto; } table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .25rem .75rem .25rem 0; border-bottom: 1px solid var(--line); vertical-align: top; }
td.number { text-align: right; white-space: nowrap; }
figure { margin: 1.5rem 0; } img { max-width: 100%; height: auto; background: white; } figcaption { color: var(--dim); }
pre { background: var(--soft); padding: .75rem; overflow-x: auto; font-size: .85rem; } summary { cursor: pointer; }
.box { border: 1px solid var(--bad); padding: .5rem 1rem; border-radius: .4rem; }
"""


@dataclass
class Experiment:
    """A result folder as the page shows it. `problem`: why there is nothing to judge, else empty.
    `kept`: only figures lie here, as the repository keeps them; nothing was run, nothing failed."""
    name: str
    folder: Path
    question: str = ""
    summary: dict = field(default_factory=dict)
    checks: list[dict] = field(default_factory=list)
    problem: str = ""
    kept: bool = False
    notes: list[str] = field(default_factory=list)
    figures: list[tuple[Path, str]] = field(default_factory=list)
    date: str = ""

    @property
    def failed(self) -> list[dict]:
        return [check for check in self.checks if check.get("passed") is not True]


def first_comment(source: Path) -> str:
    """The text of the first `//` line: the question the experiment asks. Empty where there is none."""
    try:
        for line in source.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("//"):
                return line.lstrip("/").strip()
    except OSError:
        pass
    return ""


#: Folders of results that other commands write: this page itself, and tools/speed.sh.
NO_EXPERIMENTS = ("report", "speed")


def read_summary(folder: Path) -> tuple[dict, list[dict], str]:
    """summary.json, its checks, and what is wrong with it: one line, or empty."""
    file = folder / "summary.json"
    try:
        summary = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}, [], "summary.json is not there: the run did not finish"
    except (OSError, ValueError, RecursionError) as error:
        return {}, [], f"summary.json cannot be read: {error}"
    if not isinstance(summary, dict):
        return {}, [], "summary.json is not an object"
    checks = summary.get("checks")
    if not isinstance(checks, list) or not all(isinstance(check, dict) for check in checks):
        return summary, [], "summary.json: 'checks' is missing or no list of objects"
    return summary, checks, ""


def read_captions(folder: Path, name: str, notes: list[str]) -> dict[str, str]:
    file = folder / f"{name}.captions.json"
    if not file.exists():
        return {}
    try:
        captions = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        notes.append(f"{file.name} cannot be read: {error}")
        return {}
    if not isinstance(captions, dict):
        notes.append(f"{file.name} is not an object")
        return {}
    return {key: str(text) for key, text in captions.items()}


def read_experiment(folder: Path) -> Experiment:
    summary, checks, problem = read_summary(folder)
    experiment = Experiment(folder.name, folder, first_comment(REPOSITORY / "experiments" / f"{folder.name}.cpp"),
                            summary, checks, problem)
    captions = read_captions(folder, folder.name, experiment.notes)
    pictures = {file.name: file for file in sorted(folder.glob("*.png")) if not file.name.startswith(".")}
    order = [name for name in captions if name in pictures] + [name for name in pictures if name not in captions]
    experiment.figures = [(pictures[name], captions.get(name, "")) for name in order]
    names = {file.name for file in folder.iterdir()}
    if pictures and names <= set(pictures) | {f"{folder.name}.captions.json"}:
        experiment.kept, experiment.problem = True, ""
    if isinstance(summary.get("date"), str):
        experiment.date = summary["date"]
    elif summary:
        written = datetime.fromtimestamp((folder / "summary.json").stat().st_mtime, timezone.utc)
        experiment.date = written.strftime("%Y-%m-%d %H:%M UTC")
    return experiment


def number(value) -> str:
    if isinstance(value, bool) or value is None:
        return "" if value is None else str(value).lower()
    if isinstance(value, (int, float)):
        return f"{value:.6g}" if math.isfinite(value) else str(value)
    return str(value)


def words(value) -> str:
    """A JSON value in one line: objects as `key value`, lists by commas."""
    if isinstance(value, dict):
        return "; ".join(f"{key}: {words(inner)}" for key, inner in value.items())
    if isinstance(value, list):
        return ", ".join(words(inner) for inner in value) or "none"
    return number(value)


def verdict(experiment: Experiment) -> str:
    if experiment.kept:
        return '<span class="dim">not run here; figures as kept in the repository</span>'
    if experiment.problem:
        return f'<span class="failed">no result: {escape(experiment.problem)}</span>'
    if experiment.failed:
        return f'<span class="failed">{len(experiment.failed)} of {len(experiment.checks)} checks failed</span>'
    if not experiment.checks:
        return '<span class="dim">no checks</span>'
    count = len(experiment.checks)
    return f'<span class="passed">{"the one check holds" if count == 1 else f"all {count} checks hold"}</span>'


def anchor(experiment: Experiment) -> str:
    return quote(experiment.name)


def limit(check: dict) -> str:
    return f"[{words(check['limit'])}]" if isinstance(check.get("limit"), list) else words(check.get("limit"))


def check_rows(checks: list[dict]) -> str:
    rows = []
    for check in checks:
        passed = check.get("passed") is True
        rows.append(f'<tr><td class="{"passed" if passed else "failed"}">{"pass" if passed else "FAIL"}</td>'
                    f'<td>{escape(str(check.get("name", "(unnamed)")))}</td>'
                    f'<td class="number">{escape(number(check.get("value")))}</td>'
                    f'<td>{escape(str(check.get("relation", "")))}</td>'
                    f'<td class="number">{escape(limit(check))}</td></tr>')
    return "\n".join(rows)


def provenance_rows(experiment: Experiment) -> str:
    summary = experiment.summary
    facts = {"preset": summary.get("preset"), "seed": summary.get("seed"), "commit": summary.get("commit"),
             "date": experiment.date, "host": summary.get("host"), "devices": summary.get("devices")}
    if isinstance(summary.get("wall_s"), (int, float)):
        facts["time"] = f"{summary['wall_s']:.1f} s"
    if isinstance(summary.get("peak_rss_bytes"), (int, float)):
        facts["peak memory"] = f"{summary['peak_rss_bytes'] / 2**20:.0f} MiB"
    if summary.get("files"):
        facts["files"] = summary["files"]
    return "\n".join(f"<tr><th>{escape(key)}</th><td>{escape(words(value))}</td></tr>"
                     for key, value in facts.items() if value not in (None, ""))


def section(experiment: Experiment, pictures: dict[Path, str]) -> str:
    parts = [f'<h2 id="{escape(anchor(experiment))}">{escape(experiment.name)}</h2>']
    if experiment.question:
        parts.append(f'<p class="question">{escape(experiment.question)}</p>')
    parts.append(f"<p>{verdict(experiment)}</p>")
    if experiment.summary.get("preset") == "quick":
        parts.append('<p class="failed">quick preset: it proves that the path runs; its numbers are no result.</p>')
    parts += [f'<p class="failed">{escape(note)}</p>' for note in experiment.notes]
    if experiment.checks:
        ordered = experiment.failed + [check for check in experiment.checks if check.get("passed") is True]
        parts.append('<div class="scroll"><table><tr><th></th><th>check</th><th>value</th><th></th><th>limit</th></tr>\n'
                     f"{check_rows(ordered)}\n</table></div>")
    for file, caption in experiment.figures:
        text = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
        parts.append(f'<figure><img src="{escape(quote(pictures[file]))}" alt="{escape(caption or file.stem)}" '
                     f'loading="lazy">{text}</figure>')
    if experiment.summary:
        parts.append(f'<div class="scroll"><table>\n{provenance_rows(experiment)}\n</table></div>')
    if "config" in experiment.summary:
        config = experiment.summary["config"]
        text = config if isinstance(config, str) else json.dumps(config, indent=1, ensure_ascii=False)
        parts.append(f"<details><summary>config, with all defaults</summary><pre>{escape(text)}</pre></details>")
    return "\n".join(parts)


def overview(experiments: list[Experiment]) -> str:
    """Failures first, then one line per experiment."""
    parts = []
    bad = [experiment for experiment in experiments if experiment.problem or experiment.failed]
    if bad:
        lines = []
        for experiment in bad:
            link = f'<a href="#{escape(anchor(experiment))}">{escape(experiment.name)}</a>'
            reasons = [experiment.problem] if experiment.problem else [
                f"{check.get('name', '(unnamed)')}: {number(check.get('value'))}, expected "
                f"{check.get('relation', '')} {limit(check)}" for check in experiment.failed]
            lines += [f"<li>{link}: {escape(reason)}</li>" for reason in reasons]
        parts.append(f'<div class="box"><p class="failed">Failed</p><ul>{"".join(lines)}</ul></div>')
    rows = "\n".join(f'<tr><td><a href="#{escape(anchor(experiment))}">{escape(experiment.name)}</a></td>'
                     f"<td>{escape(experiment.question)}</td><td>{verdict(experiment)}</td></tr>"
                     for experiment in experiments)
    parts.append(f'<div class="scroll"><table><tr><th>experiment</th><th>question</th><th>verdict</th></tr>\n{rows}\n</table></div>'
                 if experiments else "<p>No results yet: run ./reproduce.</p>")
    return "\n".join(parts)


def page(experiments: list[Experiment], pictures: dict[Path, str]) -> str:
    sections = "\n".join(section(experiment, pictures) for experiment in experiments)
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>Pellucid: results</title><style>{STYLE}</style></head><body>
<h1>Pellucid: results</h1>
<p>Each experiment asks one question and judges itself by checks whose limits were set beforehand. A failed check is
a finding and stays on this page. The tables behind the figures lie in <code>results/NAME/</code>.</p>
{overview(experiments)}
{sections}
</body></html>
"""


def write_report(results: Path) -> Path:
    """Makes results/report anew beside the old one, then swaps them."""
    folders = [folder for folder in sorted(results.iterdir())
               if folder.is_dir() and folder.name not in NO_EXPERIMENTS and not folder.name.startswith(".")]
    experiments = [read_experiment(folder) for folder in folders]
    target = results / "report"
    aside = Path(tempfile.mkdtemp(prefix=".report-", dir=results))
    try:
        os.chmod(aside, 0o755)
        fresh, old = aside / "fresh", aside / "old"
        fresh.mkdir()
        pictures: dict[Path, str] = {}
        for experiment in experiments:
            for file, _ in experiment.figures:
                pictures[file] = f"{experiment.name}.{file.name}"
                shutil.copyfile(file, fresh / pictures[file])
        (fresh / "index.html").write_text(page(experiments, pictures), encoding="utf-8")
        if target.exists():
            target.rename(old)
        try:
            fresh.rename(target)
        except OSError:
            if old.exists():
                old.rename(target)
            raise
    finally:
        shutil.rmtree(aside, ignore_errors=True)
    return target / "index.html"


def main() -> int:
    if len(sys.argv) != 2:
        print("usage: report.py RESULTS", file=sys.stderr)
        return 2
    results = Path(sys.argv[1])
    if not results.exists():
        results.mkdir(parents=True)
    try:
        print(write_report(results))
    except OSError as error:
        print(f"report: {error}", file=sys.stderr)
        return 4
    return 0


if __name__ == "__main__":
    sys.exit(main())
