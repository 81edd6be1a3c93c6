#ifndef PELLUCID_KERNEL_MATH_TWIN_H
#define PELLUCID_KERNEL_MATH_TWIN_H
#include "kernel/twin.h"
TWIN_BEGIN
TWIN_FN float twin_reciprocal(float x) { return 1.0f / x; }
TWIN_FN float twin_rsqrt(float x) { return 1.0f / sqrt(x); }
TWIN_FN float twin_power(float x, float y) { return x*x*y; }
TWIN_END
#endif
