"""The contract of analysis/report.py and analysis/common.py. A method's name is the claim."""
import html.parser
import json
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "analysis"))
import common
import numpy as np
import report
from PIL import Image

CHECK = {"name": "z", "value": 1.5, "relation": "<=", "limit": 2, "passed": True}


class Page(html.parser.HTMLParser):
    """What a browser would load from, link to and show of a page; fails on tags that do not close."""
    def __init__(self, text):
        super().__init__()
        self.loads, self.links, self.ids, self.open, self.text = [], [], [], [], ""
        self.feed(text)
        assert not self.open, self.open

    def handle_starttag(self, tag, attributes):
        found = dict(attributes)
        self.loads += [found[key] for key in ("src",) if key in found] + ([found["href"]] if tag == "link" else [])
        self.links += [found["href"]] if tag == "a" else []
        self.ids += [found["id"]] if "id" in found else []
        if tag not in ("meta", "img", "link", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag, tag

    def handle_data(self, data):
        self.text += data


class Folder(unittest.TestCase):
    def setUp(self):
        holder = tempfile.TemporaryDirectory()
        self.addCleanup(holder.cleanup)
        self.results = Path(holder.name)

    def experiment(self, name, checks=(CHECK,), **more):
        folder = self.results / name
        folder.mkdir()
        summary = {"experiment": name, "preset": "default", "seed": 1, "commit": "abc", "checks": list(checks)}
        (folder / "summary.json").write_text(json.dumps(summary | more))
        return folder

    def page(self):
        return Page(report.write_report(self.results).read_text(encoding="utf-8"))


class KeptResults(unittest.TestCase):
    """Of the index, not of the working tree: there lies what its user ran last."""
    # From before this was asked; each is to leave this list when it is made again.
    DIRTY = {"backend_parity", "reference_trust"}

    def git(self, *arguments):
        root = Path(__file__).resolve().parent.parent
        try:
            return subprocess.run(["git", "-C", root, *arguments], check=True, capture_output=True, text=True).stdout
        except (OSError, subprocess.CalledProcessError) as error:
            self.skipTest(f"skipped: no repository here ({error})")

    def test_kept_summaries_name_a_commit_that_made_them(self):
        files = [f for f in self.git("ls-files", "results").split() if f.endswith("/summary.json")]
        commits = {Path(f).parent.name: json.loads(self.git("show", f":{f}"))["commit"] for f in files}
        dirty = {name for name, commit in commits.items() if not commit or commit.endswith("-dirty")}
        self.assertEqual(dirty - self.DIRTY, set(), "made with uncommitted changes: commit them and run again")
        self.assertEqual(self.DIRTY - dirty, set(), "clean or gone: take out of DIRTY")


class Report(Folder):
    def test_figures_are_copied_and_linked_within_the_folder(self):
        folder = self.experiment("one")
        (folder / "a b#.png").write_bytes(b"picture")
        (folder / "one.captions.json").write_text(json.dumps({"a b#.png": "What it shows", "gone.png": "x"}))
        page = self.page()
        self.assertEqual(page.loads, ["one.a%20b%23.png"])
        self.assertEqual((self.results / "report" / "one.a b#.png").read_bytes(), b"picture")
        self.assertIn("What it shows", page.text)

    def test_failed_checks_stand_before_everything_else(self):
        self.experiment("alpha")
        self.experiment("omega", [CHECK, CHECK | {"name": "slope", "value": 3, "passed": False}])
        text = self.page().text
        self.assertIn("slope: 3, expected <= 2", text[:text.index("verdict")])
        self.assertIn("1 of 2 checks failed", text)

    def test_a_check_without_verdict_counts_as_failed(self):
        self.experiment("one", [{"name": "silent"}])
        self.assertIn("1 of 1 checks failed", self.page().text)

    def test_damaged_summaries_are_named_and_the_others_still_shown(self):
        self.experiment("good")
        for name, content in {"empty": "", "cut": '{"checks": [', "list": "[]", "nochecks": "{}", "number": '{"checks": 3}',
                              "deep": "[" * 100000, "binary": "\udcff"}.items():
            (self.results / name).mkdir()
            (self.results / name / "summary.json").write_bytes(content.encode("utf-8", "surrogateescape"))
        (self.results / "unfinished").mkdir()
        page = self.page()
        self.assertEqual(page.text.count("no result:"), 8 * 2)  # in the overview and in the section
        self.assertIn("the one check holds", page.text)

    def test_figures_without_a_run_are_no_failure(self):
        (self.results / "kept").mkdir()
        (self.results / "kept" / "figure.png").write_bytes(b"")
        text = self.page().text
        self.assertIn("not run here", text)
        self.assertNotIn("Failed", text)

    def test_a_run_without_summary_is_a_failure(self):
        (self.results / "cut").mkdir()
        for name in ("figure.png", "table.csv"):
            (self.results / "cut" / name).write_bytes(b"")
        self.assertIn("Failed", self.page().text)

    def test_strange_values_do_not_stop_the_page(self):
        self.experiment("one", [CHECK | {"value": None, "limit": [1, 2]}, CHECK | {"value": float("nan")}],
                        host={"cpu": "x", "flags": ["a", "b"]}, devices=None, wall_s="long", peak_rss_bytes=True, config={"a": 1})
        self.assertIn("cpu: x; flags: a, b", self.page().text)

    def test_everything_is_escaped(self):
        evil = '<script>alert("1")</script>&'
        folder = self.experiment("evil", [CHECK | {"name": evil, "relation": evil}], host={evil: evil}, config=evil, commit=evil)
        (folder / "f.png").write_bytes(b"")
        (folder / "evil.captions.json").write_text(json.dumps({"f.png": '"><script>'}))
        html = report.write_report(self.results).read_text(encoding="utf-8")
        self.assertNotIn("<script", html)
        Page(html)

    def test_links_have_their_target(self):
        self.experiment("a b", [CHECK | {"passed": False}])
        page = self.page()
        self.assertTrue(page.links)
        self.assertLessEqual({link.removeprefix("#") for link in page.links}, set(page.ids))

    def test_nothing_comes_from_outside(self):
        self.experiment("one")
        html = report.write_report(self.results).read_text(encoding="utf-8")
        for word in ("http:", "https:", "@import", "url(", "<script"):
            self.assertNotIn(word, html)

    def test_a_new_report_replaces_the_old_and_leaves_nothing_beside(self):
        folder = self.experiment("one")
        (folder / "old.png").write_bytes(b"")
        self.page()
        (folder / "old.png").unlink()
        self.page()
        self.assertEqual([file.name for file in (self.results / "report").iterdir()], ["index.html"])
        self.assertEqual(sorted(file.name for file in self.results.iterdir()), ["one", "report"])

    def test_a_report_that_fails_leaves_the_old_one(self):
        folder = self.experiment("one")
        self.page()
        (folder / "picture.png").mkdir()  # cannot be copied
        with self.assertRaises(OSError):
            report.write_report(self.results)
        self.assertTrue((self.results / "report" / "index.html").exists())
        self.assertEqual(sorted(file.name for file in self.results.iterdir()), ["one", "report"])

    def test_the_quick_preset_is_never_sold_as_a_result(self):
        self.experiment("one", preset="quick")
        self.assertIn("its numbers are no result", self.page().text)


class Common(Folder):
    def test_an_empty_cell_is_dropped_and_infinity_refused(self):
        folder = self.experiment("one")
        (folder / "t.csv").write_text("a,b\n1,2\n,3\n4,inf\n")
        table = common.load(folder).tables["t"]
        self.assertEqual(list(common.measured(table, "a")["a"]), [1, 4])
        for column in ("b", "missing"):
            with self.assertRaises(SystemExit) as stopped:
                common.measured(table, column)
            self.assertEqual(stopped.exception.code, 2)

    def test_damaged_input_is_exit_2(self):
        folder = self.experiment("one")
        (folder / "fit.json").write_text("{")
        with self.assertRaises(SystemExit) as stopped:
            common.load(folder)
        self.assertEqual(stopped.exception.code, 2)

    def test_other_json_is_a_document_and_captions_are_not(self):
        folder = self.experiment("one")
        (folder / "fit.json").write_text('{"p": 1}')
        common.write_captions(folder, {"x.png": "y"})
        self.assertEqual(common.load(folder).documents, {"fit": {"p": 1}})

    def test_a_saved_figure_is_small_and_has_its_caption_in_the_report(self):
        folder = self.experiment("one")
        fig, ax = common.subplots()
        ax.imshow(np.random.default_rng(1).random((400, 400)), cmap="viridis")
        file = common.save(fig, folder, "noise", caption="Noise.")
        self.assertLess(file.stat().st_size, 2 * common.SMALL_BYTES)
        fig, ax = common.subplots(1, 2)
        for color in common.COLORS:
            ax[0].plot([0, 1], color=color)
        file = common.save(fig, folder, "lines.png", caption="Lines.")
        self.assertLess(file.stat().st_size, common.SMALL_BYTES)
        with Image.open(file) as image:
            self.assertEqual(image.size, (round(2 * common.COLUMN_IN * common.DPI), round(3.6 * common.DPI)))
        text = self.page().text
        self.assertLess(text.index("Noise."), text.index("Lines."))


if __name__ == "__main__":
    unittest.main()
