#!/usr/bin/env python3
"""Expected SSIM values for tests/image_metrics_test.cpp, by scikit-image.

    python3 tests/oracles/ssim_oracle.py tests/data/ssim.txt
"""
import sys

import numpy as np
from skimage.metrics import structural_similarity


def main():
    rng = np.random.default_rng(11)
    h, w = 17, 15
    y, x = np.mgrid[0:h, 0:w]
    truth = np.stack((x / w, y / h, 0.5 + 0.4 * np.sin(0.7 * x + 0.3 * y)), 2)
    cases = [
        truth + 0.05 * rng.standard_normal(truth.shape),
        1.0 - truth,
        truth * 0.5 + 0.1,
        3.0 * truth - 1.0,  # beyond [0, 1]: nothing is clamped
    ]
    weights = np.array([0.2126, 0.7152, 0.0722])
    with open(sys.argv[1], "w") as f:
        print("# width height cases; per case its SSIM, then a pixel a line: test RGB, truth RGB. ssim_oracle.py", file=f)
        print(w, h, len(cases), file=f)
        truth3 = np.round(truth, 3)
        for case in cases:
            case3 = np.round(case, 3)
            _, full = structural_similarity(
                case3 @ weights, truth3 @ weights, gaussian_weights=True, sigma=1.5,
                use_sample_covariance=False, data_range=1, full=True,
            )  # truncate = 3.5: 11 weights
            print(repr(float(full[5:-5, 5:-5].mean())), file=f)
            for j in range(h):
                for i in range(w):
                    print(*(f"{v:.3f}" for v in (*case3[j, i], *truth3[j, i])), file=f)


main()
