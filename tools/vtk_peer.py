#!/usr/bin/python3
"""How fast is Pellucid beside VTK on this machine? Draws the same scenes by both, in turns, and prints a table.

    /usr/bin/python3 tools/vtk_peer.py RENDER FOLDER [--repetitions N] [--only NAME]...

RENDER is Pellucid's binary; FOLDER gets vtk.csv (every measurement) and vtk.md (the table). Needs Debian's
python3-vtk9, and xvfb where there is no display. Exit 0 all goals met, 1 one missed, 2 bad usage, 3 no VTK or no display,
4 a program failed.

Same scene, resolution and step: volumes at 512² with steps of one voxel, spheres at 1024². VTK's time is that of a frame
after the first, up to glFinish: its data are in place, shaders compiled. Pellucid's is that of all stages that another view
needs as well; what does not depend on the view (packing of volumes) stands beside it, and is done for every picture. The
RMSE, of linear colours on 0 to 255, says how much alike both pictures are; lit by VTK, what faces away is dark.
"""
from __future__ import annotations

import argparse
import csv
import json
import math
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

import numpy as np

VOLUME_SIDE = 256
VOLUME_PIXELS = 512
SPHERE_PIXELS = 1024
# Value, r, g, b, opacity of a voxel's length: something everywhere, and nothing hides what is behind.
TRANSFER = ((0, 1, 0, 0, 0), (1, 1, 0, 0, 0.001), (90, 1, 0.8, 0.6, 0.004), (255, 1, 1, 1, 0.01))
OFFSETS = ((0, 0, 0), (20, -10, 5), (40, -20, 10))
VOLUME_CAMERA = {"position": (484.5, 357, 535.5), "target": (127.5, 127.5, 127.5), "fov_degrees": 34}
SPHERE_CAMERA = {"position": (0, 0, 4), "target": (0, 0, 0), "fov_degrees": 30}
SPHERE_COLOR = (0.8, 0.8, 0.8)
SPHERE_OPACITY = 0.3
AMBIENT, DIFFUSE = 0.2, 0.8  # by a light at the eye


def stop(code: int, message: str) -> None:
    print(f"vtk_peer: {message}", file=sys.stderr)
    raise SystemExit(code)


# ---- What is drawn

def cube_values() -> np.ndarray:
    """[z, y, x], smooth, with nothing empty; as bench/workloads.cpp has it."""
    k, j, i = np.meshgrid(*3 * [np.arange(VOLUME_SIDE)], indexing="ij")
    waves = 60 * np.sin(0.1 * i) * np.cos(0.07 * j + 0.05 * k) + 40 * np.sin(0.031 * k + 0.02 * i)
    return (128 + waves).astype(np.uint8)


def wavy_sphere(radius: float, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a cube of n × n squares a side, blown up to a sphere that goes up and down."""
    points, triangles = [], []
    corner = np.arange(n + 1)
    j, i = (grid.ravel() for grid in np.meshgrid(corner, corner, indexing="ij"))
    first = np.array([row * (n + 1) + column for row in range(n) for column in range(n)])
    for face in range(6):
        side = 1 if face & 1 else -1
        p = np.empty((len(i), 3))
        p[:, face // 2] = side
        p[:, (face // 2 + 1) % 3] = 2 * i / n - 1
        p[:, (face // 2 + 2) % 3] = side * (2 * j / n - 1)
        p /= np.linalg.norm(p, axis=1)[:, None]
        wave = np.sin(9 * p[:, 0]) * np.sin(8 * p[:, 1]) * np.sin(7 * p[:, 2])
        a = first + face * len(i)
        points.append(radius * (1 + 0.05 * wave)[:, None] * p)
        triangles += [np.stack([a, a + 1, a + n + 2], axis=1), np.stack([a, a + n + 2, a + n + 1], axis=1)]
    return np.concatenate(points), np.concatenate(triangles)


def sphere_centers() -> list[tuple[float, float, float]]:
    """Eight along a spiral: they overlap and cross each other."""
    radius = [0.15 * math.sqrt(i + 0.5) for i in range(8)]
    return [(r * math.cos(2.4 * i), r * math.sin(2.4 * i), 0.1 * (i % 3) - 0.1) for i, r in enumerate(radius)]


def write_ply(path: Path, points: np.ndarray, triangles: np.ndarray) -> None:
    faces = np.empty(len(triangles), dtype=[("count", "u1"), ("corner", "<u4", 3)])
    faces["count"] = 3
    faces["corner"] = triangles
    header = (f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\n"
              f"property float z\nelement face {len(triangles)}\nproperty list uchar uint vertex_indices\nend_header\n")
    path.write_bytes(header.encode() + points.astype("<f4").tobytes() + faces.tobytes())


def write_nrrd(path: Path, values: np.ndarray) -> None:
    sizes = " ".join(str(n) for n in reversed(values.shape))
    path.write_bytes(f"NRRD0004\ntype: uint8\ndimension: 3\nsizes: {sizes}\nencoding: raw\n\n".encode() + values.tobytes())


def toml_head(pixels: int, camera: dict) -> str:
    return (f"[image]\nresolution = [{pixels}, {pixels}]\n[camera]\nposition = {list(camera['position'])}\n"
            f"target = {list(camera['target'])}\nfov_degrees = {camera['fov_degrees']}\n")


def volumes_toml(count: int, lit: bool) -> str:
    shading = f"{{ ambient = {AMBIENT}, diffuse = {DIFFUSE} }}" if lit else '"flat"'
    return toml_head(VOLUME_PIXELS, VOLUME_CAMERA) + "".join(
        f'[[volume]]\nname = "cube {i}"\nfile = "cube.nrrd"\ntransfer = {[list(point) for point in TRANSFER]}\n'
        f"shading = {shading}\ntranslate = {list(OFFSETS[i])}\n" for i in range(count))


def spheres_toml() -> str:
    return toml_head(SPHERE_PIXELS, SPHERE_CAMERA) + "".join(
        f'[[surface]]\nname = "sphere {i}"\nmesh = "sphere.ply"\ntranslate = {list(center)}\n'
        f"color = {list(SPHERE_COLOR)}\nopacity = {SPHERE_OPACITY}\nshading = {{ ambient = {AMBIENT}, diffuse = {DIFFUSE} }}\n"
        for i, center in enumerate(sphere_centers()))


# ---- VTK

class VtkScene:
    """A window that is not shown, with one scene. Its first frame is drawn at once and not timed."""

    def __init__(self, vtk, pixels: int, camera: dict, fill: Callable) -> None:
        self.vtk = vtk
        self.renderer = vtk.vtkRenderer()
        self.window = vtk.vtkRenderWindow()
        self.window.SetOffScreenRendering(1)
        self.window.SetMultiSamples(0)
        self.window.SetAlphaBitPlanes(1)
        self.window.SetSize(pixels, pixels)
        self.window.AddRenderer(self.renderer)
        self.renderer.SetBackground(0, 0, 0)
        fill(vtk, self.renderer)
        eye = self.renderer.GetActiveCamera()
        eye.SetPosition(*camera["position"])
        eye.SetFocalPoint(*camera["target"])
        eye.SetViewUp(0, 1, 0)
        eye.SetViewAngle(camera["fov_degrees"])
        self.renderer.ResetCameraClippingRange()
        self.draw()

    def draw(self) -> float:
        """Seconds for a frame."""
        self.renderer.GetActiveCamera().Modified()
        start = time.perf_counter()
        self.window.Render()
        self.window.WaitForCompletion()
        return time.perf_counter() - start

    def picture(self) -> np.ndarray:
        """[row from the top, column, channel], linear, 0 to 1."""
        from vtk.util.numpy_support import vtk_to_numpy
        grab = self.vtk.vtkWindowToImageFilter()
        grab.SetInput(self.window)
        grab.ReadFrontBufferOff()
        grab.Update()
        width, height, _ = grab.GetOutput().GetDimensions()
        pixels = vtk_to_numpy(grab.GetOutput().GetPointData().GetScalars())
        return pixels.reshape(height, width, -1)[::-1, :, :3] / 255.0


def vtk_image(vtk, values: np.ndarray):
    from vtk.util.numpy_support import numpy_to_vtk
    image = vtk.vtkImageData()
    image.SetDimensions(*reversed(values.shape))
    image.GetPointData().SetScalars(numpy_to_vtk(values.ravel(), deep=True, array_type=vtk.VTK_UNSIGNED_CHAR))
    return image


def volume_property(vtk, lit: bool):
    color, opacity = vtk.vtkColorTransferFunction(), vtk.vtkPiecewiseFunction()
    for value, r, g, b, a in TRANSFER:
        color.AddRGBPoint(value, r, g, b)
        opacity.AddPoint(value, a)
    look = vtk.vtkVolumeProperty()
    look.SetColor(color)
    look.SetScalarOpacity(opacity)
    look.SetScalarOpacityUnitDistance(1)
    look.SetInterpolationTypeToLinear()
    look.SetShade(lit)
    look.SetAmbient(AMBIENT)
    look.SetDiffuse(DIFFUSE)
    look.SetSpecular(0)
    return look


def fill_cpu_volume(values: np.ndarray, lit: bool) -> Callable:
    def fill(vtk, renderer) -> None:
        mapper = vtk.vtkFixedPointVolumeRayCastMapper()
        mapper.SetInputData(vtk_image(vtk, values))
        mapper.AutoAdjustSampleDistancesOff()
        mapper.SetSampleDistance(1)
        mapper.SetImageSampleDistance(1)
        volume = vtk.vtkVolume()
        volume.SetMapper(mapper)
        volume.SetProperty(volume_property(vtk, lit))
        renderer.AddVolume(volume)
    return fill


def fill_many_volumes(values: np.ndarray) -> Callable:
    def fill(vtk, renderer) -> None:
        mapper = vtk.vtkGPUVolumeRayCastMapper()
        mapper.AutoAdjustSampleDistancesOff()
        mapper.SetSampleDistance(1)
        mapper.SetImageSampleDistance(1)
        mapper.UseJitteringOff()
        together = vtk.vtkMultiVolume()
        together.SetMapper(mapper)
        for port, offset in enumerate(OFFSETS):
            mapper.SetInputDataObject(port, vtk_image(vtk, values))
            volume = vtk.vtkVolume()
            volume.SetProperty(volume_property(vtk, False))
            volume.SetPosition(*offset)
            together.SetVolume(volume, port)
        renderer.AddVolume(together)
    return fill


def fill_spheres(path: Path) -> Callable:
    def fill(vtk, renderer) -> None:
        reader = vtk.vtkPLYReader()
        reader.SetFileName(str(path))
        for center in sphere_centers():
            mapper = vtk.vtkPolyDataMapper()
            mapper.SetInputConnection(reader.GetOutputPort())
            actor = vtk.vtkActor()
            actor.SetMapper(mapper)
            actor.SetPosition(*center)
            look = actor.GetProperty()
            look.SetColor(*SPHERE_COLOR)
            look.SetOpacity(SPHERE_OPACITY)
            look.SetInterpolationToFlat()
            look.SetAmbient(AMBIENT)
            look.SetDiffuse(DIFFUSE)
            look.SetSpecular(0)
            renderer.AddActor(actor)
        renderer.SetUseDepthPeeling(1)
        renderer.SetMaximumNumberOfPeels(1000)
        renderer.SetOcclusionRatio(0)
    return fill


# ---- Pellucid

def draw_pellucid(render: Path, scene: Path, method: str, settings: tuple[str, ...]) -> tuple[float, float, np.ndarray]:
    """Seconds of the stages that depend on the view, of those that do not, and the picture."""
    from PIL import Image
    picture, stats = scene.with_suffix(".png"), scene.with_suffix(".json")
    command = [str(render), str(scene), "--method", method, "-o", str(picture), "--stats", str(stats), "--quiet"]
    for setting in settings:
        command += ["--set", setting]
    done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)
    if done.returncode != 0:
        stop(4, f"{' '.join(command)}: exit {done.returncode}: {done.stderr.strip()}")
    stages = json.loads(stats.read_text(encoding="utf-8"))["stages"]
    encoded = np.asarray(Image.open(picture).convert("RGB")) / 255.0
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    frame_s = sum(stage["wall_s"] for stage in stages if stage["name"] not in ("read scene", "pack volumes"))
    pack_s = sum(stage["wall_s"] for stage in stages if stage["name"] == "pack volumes")
    return frame_s, pack_s, linear


# ---- The comparison

@dataclass
class Case:
    name: str
    what: str
    scene: str  # file
    method: str
    vtk_scene: str  # of VTK_SCENES
    goal: float | None = None  # VTK's time over Pellucid's, at least
    settings: tuple[str, ...] = ()
    pellucid_s: list[float] = field(default_factory=list)
    pack_s: list[float] = field(default_factory=list)
    vtk_s: list[float] = field(default_factory=list)
    rmse: float = math.nan


def all_cases() -> list[Case]:
    return [
        Case("volume_flat", "a volume of 256³, flat; VTK: fixed-point CPU caster", "flat.toml", "mdvr", "cpu_flat", 2),
        Case("volume_lit", "the same, lit", "lit.toml", "mdvr", "cpu_lit", 2),
        Case("three_volumes", "three volumes of 256³ across one another; VTK: multi-volume mapper", "three.toml", "mdvr",
             "gpu_three", 5),
        Case("eight_spheres", "8 spheres of 99 372 triangles; VTK: exact dual depth peeling", "spheres.toml", "depth-peeling",
             "spheres", 2),
        Case("volume_slabs", "a volume of 256³, flat, as slabs of 8 layers; VTK: fixed-point CPU caster", "flat.toml", "slabs",
             "cpu_flat"),
        Case("three_slabs", "three volumes as slabs of 8 layers; VTK: multi-volume mapper", "three.toml", "slabs", "gpu_three"),
        Case("spheres_slabs", "8 spheres as slabs of 8 layers; VTK: exact dual depth peeling", "spheres.toml", "slabs",
             "spheres"),
    ]


def vtk_scene(vtk, name: str, folder: Path, values: np.ndarray) -> VtkScene:
    fills = {
        "cpu_flat": (VOLUME_PIXELS, VOLUME_CAMERA, fill_cpu_volume(values, False)),
        "cpu_lit": (VOLUME_PIXELS, VOLUME_CAMERA, fill_cpu_volume(values, True)),
        "gpu_three": (VOLUME_PIXELS, VOLUME_CAMERA, fill_many_volumes(values)),
        "spheres": (SPHERE_PIXELS, SPHERE_CAMERA, fill_spheres(folder / "sphere.ply")),
    }
    return VtkScene(vtk, *fills[name])


def measure(vtk, render: Path, cases: list[Case], repetitions: int, folder: Path) -> list[tuple]:
    """Both sides of all cases in turns, in another order each time; rows of the table."""
    values = cube_values()
    write_nrrd(folder / "cube.nrrd", values)
    write_ply(folder / "sphere.ply", *wavy_sphere(0.55, 91))
    (folder / "flat.toml").write_text(volumes_toml(1, False), encoding="utf-8")
    (folder / "lit.toml").write_text(volumes_toml(1, True), encoding="utf-8")
    (folder / "three.toml").write_text(volumes_toml(3, False), encoding="utf-8")
    (folder / "spheres.toml").write_text(spheres_toml(), encoding="utf-8")
    windows = {name: vtk_scene(vtk, name, folder, values) for name in dict.fromkeys(case.vtk_scene for case in cases)}

    rows = []
    order = random.Random(1)
    for repetition in range(repetitions):
        turns = [(case, side) for case in cases for side in ("pellucid", "vtk")]
        order.shuffle(turns)
        for case, side in turns:
            if side == "vtk":
                seconds, pack_s = windows[case.vtk_scene].draw(), 0.0
                case.vtk_s.append(seconds)
            else:
                seconds, pack_s, picture = draw_pellucid(render, folder / case.scene, case.method, case.settings)
                case.pellucid_s.append(seconds)
                case.pack_s.append(pack_s)
                if repetition == 0:
                    difference = 255 * (picture - windows[case.vtk_scene].picture())
                    case.rmse = float(np.sqrt(np.mean(difference**2)))
            rows.append((case.name, case.method, side, repetition, f"{seconds:.6f}", f"{pack_s:.6f}"))
    return rows


def table(cases: list[Case], version: str) -> tuple[str, bool]:
    lines = [f"Pellucid beside VTK {version}, {os.cpu_count()} threads, medians of {len(cases[0].vtk_s)} runs in turns, "
             f"load {os.getloadavg()[0]:.1f}.", "",
             "| scene | method | Pellucid, s (least … most) | packing, s | VTK, s (least … most) | ratio | goal | "
             "| ratio with packing | RMSE, 0 to 255 |",
             "|---|---|---|---|---|---|---|---|---|---|"]
    met = True
    for case in cases:
        def spread(seconds: list[float]) -> str:
            return f"{median(seconds):.3f} ({min(seconds):.3f} … {max(seconds):.3f})"
        ratio = median(case.vtk_s) / median(case.pellucid_s)
        verdict = ""
        if case.goal is not None:
            verdict = "met" if ratio >= case.goal else "**missed**"
            met = met and ratio >= case.goal
        all_s = median(case.pellucid_s) + median(case.pack_s)
        lines.append(f"| {case.what} | {case.method} | {spread(case.pellucid_s)} | {median(case.pack_s):.3f} "
                     f"| {spread(case.vtk_s)} | {ratio:.2f} | {'' if case.goal is None else f'>= {case.goal:g}'} | {verdict} "
                     f"| {median(case.vtk_s) / all_s:.2f} | {case.rmse:.1f} |")
    return "\n".join(lines) + "\n", met


def import_vtk():
    """Debian's VTK needs a display: one is made where there is none."""
    try:
        import vtk
    except ImportError as missing:
        stop(3, f"no VTK ({missing}): install python3-vtk9, or use the python3 that has it ({sys.executable} has not)")
    if not os.environ.get("DISPLAY"):
        if shutil.which("xvfb-run") is None:
            stop(3, "no display for VTK: set DISPLAY or install xvfb")
        os.execvp("xvfb-run", ["xvfb-run", "-a", sys.executable, "-B", *sys.argv])
    return vtk


def main() -> int:
    cases = all_cases()
    arguments = argparse.ArgumentParser(prog="vtk_peer", description=__doc__.splitlines()[0])
    arguments.add_argument("render", type=Path, help="Pellucid's binary")
    arguments.add_argument("folder", type=Path, help="where vtk.csv and vtk.md go")
    arguments.add_argument("--repetitions", type=int, default=7, help="at least 5 (default 7)")
    arguments.add_argument("--only", action="append", choices=[case.name for case in cases], help="these cases alone")
    options = arguments.parse_args()
    if options.repetitions < 5:
        stop(2, f"--repetitions = {options.repetitions}, expected 5 or more")
    if not os.access(options.render, os.X_OK):
        stop(2, f"{options.render}: no program; build it by ./reproduce --build-only")
    vtk = import_vtk()
    cases = [case for case in cases if not options.only or case.name in options.only]
    with tempfile.TemporaryDirectory() as scratch:
        rows = measure(vtk, options.render.resolve(), cases, options.repetitions, Path(scratch))
    text, met = table(cases, vtk.vtkVersion.GetVTKVersion())
    options.folder.mkdir(parents=True, exist_ok=True)
    with open(options.folder / "vtk.csv.part", "w", encoding="utf-8", newline="") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(("case", "method", "renderer", "repetition", "frame_s", "pack_s"))
        writer.writerows(rows)
    os.replace(options.folder / "vtk.csv.part", options.folder / "vtk.csv")
    (options.folder / "vtk.md").write_text(text, encoding="utf-8")
    print(text, end="")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
