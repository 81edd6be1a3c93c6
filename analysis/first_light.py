"""The picture of the README: `python3 analysis/first_light.py [SCENE]` -> results/first_light.png.

One scene by particles (left) and ray-traced truth (right), by build/release/bin/render.
"""
from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

REPOSITORY = Path(__file__).resolve().parent.parent
SIZE = (640, 360)
HALVES = (("particles", "particles.repeats=500"), ("reference", 'reference.filter="particle"'))


def main() -> int:
    scene = sys.argv[1] if len(sys.argv) > 1 else str(REPOSITORY / "scenes/readme.toml")
    picture = Image.new("RGB", (2 * SIZE[0] + 4, SIZE[1]), "white")
    with tempfile.TemporaryDirectory() as folder:
        for side, (method, setting) in enumerate(HALVES):
            half = Path(folder) / f"{method}.png"
            run = subprocess.run([str(REPOSITORY / "build/release/bin/render"), scene, "--method", method, "--quiet",
                                  "-o", str(half), "--set", f"image.resolution={list(SIZE)}", "--set", setting])
            if run.returncode:
                return run.returncode
            picture.paste(Image.open(half).convert("RGB"), (side * (SIZE[0] + 4), 0))
    target = REPOSITORY / "results/first_light.png"
    target.parent.mkdir(exist_ok=True)
    picture.save(target, optimize=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
