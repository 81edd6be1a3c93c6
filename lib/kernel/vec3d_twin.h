// Places in double, where a device is to have the bits of the CPU's rays.
#ifndef PELLUCID_KERNEL_VEC3D_TWIN_H
#define PELLUCID_KERNEL_VEC3D_TWIN_H
#include "kernel/twin.h"
TWIN_BEGIN

struct Vec3d {
    double x;
    double y;
    double z;
};

TWIN_END
#endif
