// zSlabs: pieces of one pixel's ray, each filled with one homogeneous medium (zSlab dissertation, chapters 2 to 4).
#ifndef PELLUCID_KERNEL_SLAB_TWIN_H
#define PELLUCID_KERNEL_SLAB_TWIN_H
#include "kernel/math_twin.h"
TWIN_BEGIN

// From depth z − d to z. Depths are measured along the view axis. Colour is associated.
struct Slab {
    float z;  // of the back
    float d;  // thickness, >= 0
    float r;
    float g;
    float b;
    float a;  // opacity, [0, 1]
};

TWIN_END
#ifdef __cplusplus
#include <cstddef>
static_assert(sizeof(pellucid::twin::Slab) == 24 && offsetof(pellucid::twin::Slab, r) == 8);
#endif
#endif
