// A particle's own colour in 32 bits: shares of its object's brightest colour, 11 bits red, 11 green, 10 blue.
#ifndef PELLUCID_KERNEL_PAINT_TWIN_H
#define PELLUCID_KERNEL_PAINT_TWIN_H
#include "kernel/normal_twin.h"
TWIN_BEGIN

const float kRedSteps = 2047.0f;
const float kGreenSteps = 2047.0f;
const float kBlueSteps = 1023.0f;

// 32 bits that follow from the bits of three floats (finalisers of C. Wellons' search for low-bias hashes, 2018).
TWIN_FN uint place_hash(float x, float y, float z) {
    uint h = floatBitsToUint(x) * 0x9e3779b1u ^ floatBitsToUint(y) * 0x85ebca77u ^ floatBitsToUint(z) * 0xc2b2ae3du;
    h = (h ^ (h >> 16u)) * 0x7feb352du;
    h = (h ^ (h >> 15u)) * 0x846ca68bu;
    return h ^ (h >> 16u);
}

// value · steps, rounded up with a chance that is what is cut off; `chance` has 10 bits.
TWIN_FN uint dithered(float value, float steps, uint chance) {
    TWIN_PRECISE float at = min(max(value, 0.0f), 1.0f) * steps + (float(chance & 1023u) + 0.5f) * 0.0009765625f;
    return min(uint(at), uint(steps));
}

TWIN_FN uint pack_paint(Vec3f share, uint hash) {
    uint red = dithered(share.x, kRedSteps, hash);
    uint green = dithered(share.y, kGreenSteps, hash >> 10u);
    uint blue = dithered(share.z, kBlueSteps, hash >> 20u);
    return red | (green << 11u) | (blue << 22u);
}

TWIN_FN Vec3f unpack_paint(uint paint) {
    Vec3f share;
    share.x = float(paint & 2047u) * (1.0f / 2047.0f);
    share.y = float((paint >> 11u) & 2047u) * (1.0f / 2047.0f);
    share.z = float(paint >> 22u) * (1.0f / 1023.0f);
    return share;
}

TWIN_END
#endif
