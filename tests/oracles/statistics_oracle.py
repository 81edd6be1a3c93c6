#!/usr/bin/env python3
"""Expected values for tests/statistics_test.cpp, by SciPy.

    python3 tests/oracles/statistics_oracle.py tests/data/statistics.txt
"""
import sys

import numpy as np
from scipy import stats


def main():
    with open(sys.argv[1], "w") as f:
        print("# kind arguments… value. Made by statistics_oracle.py", file=f)
        for p in (1e-300, 1e-12, 0.001, 0.3, 0.5, 0.9, 1 - 1e-12):
            print("normal_quantile", repr(p), repr(float(stats.norm.ppf(p))), file=f)
        for k, n, p in ((0, 10, 0.3), (3, 10, 0.3), (7, 10, 0.3), (2, 3, 0.5), (12, 500, 0.01), (260, 500, 0.5),
                        (0, 500, 0.01), (500, 500, 0.99), (1000, 100000, 0.0105), (4, 10, 0.5)):
            print("binomial_pmf", k, n, p, repr(float(stats.binom.pmf(k, n, p))), file=f)
            print("binomial_cdf", k, n, p, repr(float(stats.binom.cdf(k, n, p))), file=f)
            print("binomial_survival", k, n, p, repr(float(stats.binom.sf(k, n, p))), file=f)
            print("binomial_two_sided", k, n, p, repr(float(stats.binomtest(k, n, p).pvalue)), file=f)
        for n, p in ((500, 0.01), (500, 0.5), (500, 0.001), (20, 0.3), (16, 0.5)):
            k = np.arange(n + 1)
            out = np.abs(k - n * p) > 3 * np.sqrt(n * p * (1 - p))
            print("share_outside", n, p, repr(float(stats.binom.pmf(k, n, p)[out].sum())), file=f)
        for x, dof in ((0.3, 1), (10, 4), (1100, 1000), (300, 20)):
            print("chi2_survival", x, dof, repr(float(stats.chi2.sf(x, dof))), file=f)
        rng = np.random.default_rng(3)
        for n, power in ((20, 1.0), (200, 1.0), (200, 1.3)):
            values = np.round(rng.random(n) ** power, 6)
            test = stats.kstest(values, "uniform", method="exact")
            print("ks", n, *values, repr(float(test.statistic)), repr(float(test.pvalue)), file=f)
        values = np.round(rng.normal(size=25), 6)
        print("moments", 25, *values, repr(float(values.mean())), repr(float(values.var(ddof=1))),
              repr(float(np.median(values))), repr(float(np.quantile(values, 0.9))), file=f)


main()
