"""The catalogue as a contact sheet: `python3 analysis/catalogue.py [NAME…]` -> scenes/catalogue.png.

Every surface of `render --list-implicit` with its defaults, ray-traced (method reference) by build/release/bin/render,
the z axis up. NAME…: only these, at build/catalogue.png, to try views.
"""
from __future__ import annotations

import math
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

REPOSITORY = Path(__file__).resolve().parent.parent
RENDER = str(REPOSITORY / "build/release/bin/render")
TILE = 150
LABEL = 22
COLUMNS = 7
MOST_BYTES = 600_000
FONT = "/usr/share/fonts/truetype/dejavu/DejaVuSans.ttf"

# Half-size of what is seen; from where: degrees from −y towards +x, and up; centre; more lines of the surface.
USUAL = (1.5, 28, 22, (0, 0, 0), "")
VIEWS = {
    "sphere": (1.35,), "torus": (1.6, 28, 35), "plane": (1.5,), "cylinder": (1.6,), "cone": (2.4,),
    "ellipsoid": (1.25,), "paraboloid": (1.3, 28, 22, (0, 0, 0.5)), "saddle": (1.6,), "hyperboloid": (1.5,),
    "hyperboloid_two_sheets": (2.5,),
    "barth_sextic": (2.7, 20, 12), "clebsch": (1.5, 100, 10), "cayley": (2.3,), "kummer": (3.4,),
    "steiner": (1.15, 35, 25), "cross_cap": (1.2, 60, 20), "boy": (1.6, 0, -25, (0.1, 0, 0.9)), "klein_bottle": (4.4,),
    "cassini": (1.5, 10, 25), "cassini_oval": (1.55,), "dupin_cyclide": (1.9, 28, 40, (-0.3, 0, 0)), "tangle": (3.2,),
    "goursat": (2.6,), "heart": (1.45, 15, 10), "chmutov": (1.6,), "chair": (1.45,), "bicorn": (1.2, 28, 12, (0, 0, 0.5)),
    "hunt": (3.9,), "miter": (1.25, 70, 20), "whitney_umbrella": (1.3, 40, 25, (0, 0, 0.5)), "bucky_ball": (1.35, 20, 15), "gyroid": (0.85,),
    "schwarz_p": (0.85,), "schwarz_d": (0.85,),
}

SCENE = """
[image]
resolution = [{size}, {size}]
background = [1, 1, 1]
[camera]
projection = "orthographic"
position = [{position}]
target = [{target}]
up = [0, 0, 1]
view_height = {height}
[[light]]
direction = [{light}]
intensity = 0.9
[[light]]
headlight = true
intensity = 0.35
[[surface]]
implicit = "{name}"
color = [{color}]
opacity = 0.6
shading = {{ ambient = 0.1, diffuse = 0.8, specular = 0.25, shininess = 40 }}
{more}
"""
COLORS = ("0.05, 0.30, 0.62", "0.75, 0.20, 0.02", "0.02, 0.42, 0.26", "0.55, 0.20, 0.42", "0.70, 0.40, 0.02")


def names() -> list[str]:
    listed = subprocess.run([RENDER, "--list-implicit"], check=True, capture_output=True, text=True).stdout
    return [line.split()[0] for line in listed.splitlines()[1:] if not line.startswith(" ")]


def scene(name: str, color: str) -> str:
    given = VIEWS.get(name, ())
    half, turn, rise, center, more = given + USUAL[len(given):]
    around, up = math.radians(turn), math.radians(rise)
    way = (math.sin(around) * math.cos(up), -math.cos(around) * math.cos(up), math.sin(up))
    right = (math.cos(around), math.sin(around), 0)
    light = [w - 0.6 * r + (0.9 if axis == 2 else 0) for axis, (w, r) in enumerate(zip(way, right))]  # upper left
    def text(v):
        return ", ".join(f"{c:.6g}" for c in v)
    return SCENE.format(size=TILE, position=text(c + 10 * half * w for c, w in zip(center, way)), target=text(center),
                        height=2 * half, light=text(light), name=name, color=color, more=more)


def tile(name: str, color: str, folder: Path) -> Image.Image:
    file, picture = folder / f"{name}.toml", folder / f"{name}.png"
    file.write_text(scene(name, color))
    subprocess.run([RENDER, str(file), "--method", "reference", "--quiet", "-o", str(picture),
                    "--set", "reference.max_samples=64"], check=True)
    return Image.open(picture).convert("RGB")


def main() -> int:
    chosen = sys.argv[1:] or names()
    target = REPOSITORY / ("build/catalogue.png" if sys.argv[1:] else "scenes/catalogue.png")
    rows = -(-len(chosen) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * TILE, rows * (TILE + LABEL)), "white")
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.truetype(FONT, 12)
    with tempfile.TemporaryDirectory() as folder:
        for i, name in enumerate(chosen):
            x, y = i % COLUMNS * TILE, i // COLUMNS * (TILE + LABEL)
            try:
                sheet.paste(tile(name, COLORS[i % len(COLORS)], Path(folder)), (x, y))
            except subprocess.CalledProcessError as error:
                print(f"{name}: render stopped with exit code {error.returncode}", file=sys.stderr)
                return error.returncode
            draw.text((x + TILE // 2, y + TILE + LABEL // 2), name, fill="black", font=font, anchor="mm")
    sheet = sheet.quantize(256, dither=Image.Dither.NONE)
    sheet.save(target, optimize=True)
    if target.stat().st_size > MOST_BYTES:
        print(f"{target}: {target.stat().st_size} bytes, expected at most {MOST_BYTES}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
