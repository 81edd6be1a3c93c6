#!/usr/bin/env python3
"""Expected LDR-FLIP maps for tests/flip_test.cpp, written from the paper's equations.

Andersson et al. 2020, "FLIP: A difference evaluator for alternating images". Plain and slow: every
filter is one kernel in two dimensions, every convolution a sum over shifted images. Needs NumPy.

    python3 tests/oracles/flip_oracle.py tests/data
"""
import sys
from pathlib import Path

import numpy as np


def correlate(image, kernel):
    ry, rx = kernel.shape[0] // 2, kernel.shape[1] // 2
    padded = np.pad(image, ((ry, ry), (rx, rx)), mode="edge")
    out = np.zeros_like(image)
    for j in range(kernel.shape[0]):
        for i in range(kernel.shape[1]):
            out += kernel[j, i] * padded[j : j + image.shape[0], i : i + image.shape[1]]
    return out


M = np.array(
    [
        [10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
        [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897],
        [1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382],
    ]
)
WHITE = M @ np.ones(3)


def xyz(rgb):
    return np.einsum("ij,hwj->hwi", M, rgb)


def opponent(rgb):
    x, y, z = np.moveaxis(xyz(rgb) / WHITE, 2, 0)
    return np.stack((116 * y - 16, 500 * (x - y), 200 * (y - z)), 2)


def opponent_to_rgb(ycc):
    y = (ycc[..., 0] + 16) / 116
    v = np.stack((y + ycc[..., 1] / 500, y, y - ycc[..., 2] / 200), 2) * WHITE
    return np.einsum("ij,hwj->hwi", np.linalg.inv(M), v)


def hunt_lab(rgb):
    t = xyz(rgb) / WHITE
    d = 6 / 29
    f = np.where(t > d**3, np.cbrt(t), t / (3 * d * d) + 4 / 29)
    lightness = 116 * f[..., 1] - 16
    a = 500 * (f[..., 0] - f[..., 1])
    b = 200 * (f[..., 1] - f[..., 2])
    return np.stack((lightness, 0.01 * lightness * a, 0.01 * lightness * b), 2)


def hyab(p, q):
    d = p - q
    return np.abs(d[..., 0]) + np.sqrt(d[..., 1] ** 2 + d[..., 2] ** 2)


def sensitivity_kernel(ppd, a1, b1, a2, b2):
    r = int(np.ceil(3 * np.sqrt(0.04 / (2 * np.pi**2)) * ppd))
    x, y = np.meshgrid(np.arange(-r, r + 1) / ppd, np.arange(-r, r + 1) / ppd)
    d2 = x * x + y * y
    k = a1 * np.sqrt(np.pi / b1) * np.exp(-np.pi**2 * d2 / b1)
    k = k + a2 * np.sqrt(np.pi / b2) * np.exp(-np.pi**2 * d2 / b2)
    return k / k.sum()


def feature_kernels(ppd):
    sd = 0.5 * 0.082 * ppd
    r = int(np.ceil(3 * sd))
    x, y = np.meshgrid(np.arange(-r, r + 1.0), np.arange(-r, r + 1.0))
    g = np.exp(-(x * x + y * y) / (2 * sd * sd))
    for k in (-x * g, (x * x / sd**2 - 1) * g):
        yield np.where(k > 0, k / k[k > 0].sum(), k / -k[k < 0].sum())


def flip(test, truth, ppd):
    test, truth = np.clip(test, 0, 1), np.clip(truth, 0, 1)
    constants = ((1, 0.0047, 0, 1e-5), (1, 0.0053, 0, 1e-5), (34.1, 0.04, 13.5, 0.025))
    colors, features = [], []
    for image in (test, truth):
        ycc = opponent(image)
        blurred = np.stack([correlate(ycc[..., c], sensitivity_kernel(ppd, *constants[c])) for c in range(3)], 2)
        colors.append(hunt_lab(np.clip(opponent_to_rgb(blurred), 0, 1)))
        y = (ycc[..., 0] + 16) / 116
        features.append([np.hypot(correlate(y, k), correlate(y, k.T)) for k in feature_kernels(ppd)])
    green = hunt_lab(np.array([[[0.0, 1, 0]]]))
    blue = hunt_lab(np.array([[[0.0, 0, 1]]]))
    largest = hyab(green, blue)[0, 0] ** 0.7
    e = hyab(colors[0], colors[1]) ** 0.7
    knee = 0.4 * largest
    color = np.where(e < knee, 0.95 / knee * e, 0.95 + (e - knee) / (largest - knee) * 0.05)
    feature = np.maximum(np.abs(features[0][0] - features[1][0]), np.abs(features[0][1] - features[1][1]))
    return color ** (1 - (feature / np.sqrt(2)) ** 0.5)


def pairs():
    """name, test, truth, pixels per degree"""
    h, w = 12, 17
    y, x = np.mgrid[0:h, 0:w]
    grey = np.full((h, w, 3), 0.2)

    edge = grey.copy()
    edge[:, 9:] = 0.8
    shifted = grey.copy()
    shifted[:, 8:] = 0.8
    yield "edge", shifted, edge, 67.02

    points = grey.copy()
    points[3, 4] = (1, 0.5, 0)
    points[11, 16] = 1.0
    points[0, 0] = 0.0
    yield "points", points, grey, 67.02

    ramp = np.stack((x / (w - 1), y / (h - 1), 0.5 + 0 * x), 2)
    turned = ramp[..., [2, 0, 1]]
    yield "colors", turned, ramp, 67.02

    rng = np.random.default_rng(7)
    noise = np.round(rng.random((h, w, 3)) * 1.4 - 0.2, 3)  # also beyond [0, 1]
    yield "noise_ppd20", noise, ramp, 20.0
    yield "noise_ppd3", noise, ramp, 3.0
    yield "edge_ppd150", shifted, edge, 150.0
    yield "row", noise[:1], ramp[:1], 67.02
    yield "green_blue", np.broadcast_to([0.0, 1, 0], (2, 3, 3)), np.broadcast_to([0.0, 0, 1], (2, 3, 3)), 67.02


def main():
    folder = Path(sys.argv[1])
    for name, test, truth, ppd in pairs():
        with open(folder / f"flip_{name}.txt", "w") as f:
            print("# width height ppd, then a pixel a line: test RGB, truth RGB, FLIP. Made by flip_oracle.py", file=f)
            print(test.shape[1], test.shape[0], ppd, file=f)
            error = flip(np.array(test, float), np.array(truth, float), ppd)
            for j in range(test.shape[0]):
                for i in range(test.shape[1]):
                    print(*(f"{v:.9g}" for v in (*test[j, i], *truth[j, i], error[j, i])), file=f)


main()
