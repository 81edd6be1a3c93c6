// Casting in double, as cpu/volume_caster.cpp does it: what its shaders read, and the two elementary
// functions that GLSL has for float alone.
#ifndef PELLUCID_KERNEL_PLAIN_CAST_TWIN_H
#define PELLUCID_KERNEL_PLAIN_CAST_TWIN_H
#include "kernel/cast_rays_twin.h"
#ifdef __cplusplus
namespace pellucid::twin {
[[nodiscard]] inline std::int64_t doubleBitsToInt64(double v) { return std::bit_cast<std::int64_t>(v); }
[[nodiscard]] inline double int64BitsToDouble(std::int64_t bits) { return std::bit_cast<double>(bits); }
}  // namespace pellucid::twin
#endif
TWIN_BEGIN

// ln(1 + x) to 3e-16 of it, for x > -1. 1 + x = 2^k·m with m in [√½, √2); with s = (m − 1)/(m + 1) the series
// of 2·atanh s, |s| < 0.172, whose first term left out is below 2e-18; what 1 + x lost by rounding is added
// as its share.
TWIN_FN double log1p_d(double x) {
    TWIN_PRECISE double sum = double(1) + x;
    TWIN_PRECISE double lost = (x - (sum - double(1))) / sum;
    int64_t bits = doubleBitsToInt64(sum);
    int64_t k = (bits - int64_t(0x3fe6a09e667f3bcdL)) >> 52;  // √½
    TWIN_PRECISE double f = int64BitsToDouble(bits - (k << 52)) - double(1);
    TWIN_PRECISE double s = f / (double(2) + f);
    TWIN_PRECISE double z = s * s;
    TWIN_PRECISE double p = double(1) / double(19) + z / double(21);
    p = double(1) / double(17) + z * p;
    p = double(1) / double(15) + z * p;
    p = double(1) / double(13) + z * p;
    p = double(1) / double(11) + z * p;
    p = double(1) / double(9) + z * p;
    p = double(1) / double(7) + z * p;
    p = double(1) / double(5) + z * p;
    p = double(1) / double(3) + z * p;
    TWIN_PRECISE double r = double(2) * s + (double(2) * s * (z * p) + lost);
    TWIN_PRECISE double ln2 = int64BitsToDouble(int64_t(0x3fe62e42fefa39efL));
    TWIN_PRECISE double all = double(k) * ln2 + r;
    return all;
}

// e^x − 1 to 4e-16 of it, for x in [-60, 60]; beyond, as there. x = n·ln 2 + r: Taylor's series, |r| < 0.35.
TWIN_FN double expm1_d(double x) {
    x = min(max(x, double(-60)), double(60));
    TWIN_PRECISE double over_ln2 = int64BitsToDouble(int64_t(0x3ff71547652b82feL));
    TWIN_PRECISE double ln2_head = int64BitsToDouble(int64_t(0x3fe62e42fee00000L));
    TWIN_PRECISE double ln2_tail = int64BitsToDouble(int64_t(0x3dea39ef35793c76L));
    TWIN_PRECISE double n = floor(x * over_ln2 + double(0.5f));
    TWIN_PRECISE double r = (x - n * ln2_head) - n * ln2_tail;
    TWIN_PRECISE double p = double(1) + r / double(15);
    p = double(1) + r / double(14) * p;
    p = double(1) + r / double(13) * p;
    p = double(1) + r / double(12) * p;
    p = double(1) + r / double(11) * p;
    p = double(1) + r / double(10) * p;
    p = double(1) + r / double(9) * p;
    p = double(1) + r / double(8) * p;
    p = double(1) + r / double(7) * p;
    p = double(1) + r / double(6) * p;
    p = double(1) + r / double(5) * p;
    p = double(1) + r / double(4) * p;
    p = double(1) + r / double(3) * p;
    p = r + r * (r / double(2) * p);
    TWIN_PRECISE double power = int64BitsToDouble((int64_t(n) + int64_t(1023)) << 52);
    TWIN_PRECISE double result = power * p + (power - double(1));
    return result;
}

// TransferFunction::Piece, and the value at which the next one begins.
struct PlainPiece {
    double from;
    double opacity;
    double opacity_slope;
    Vec3d color;
    Vec3d color_slope;
    double end;
};

// A grid of samples (float), x fastest: a volume's, or an isosurface's. For Catmull-Rom one sample more on
// every side, the continuation beyond the border.
struct PlainGrid {
    CastPlace place;
    Vec3d cofactor0;  // columns of what carries a gradient into the world, as a normal
    Vec3d cofactor1;
    Vec3d cofactor2;
    int size_x;  // without what is continued
    int size_y;
    int size_z;
    int blocks_x;  // 0: everything is visited
    int blocks_y;
    int blocks_z;
    uint anything;
    uint plane_count;
    uint lit;
    uint interpolation;  // as enum class Interpolation
    float ambient;
    float diffuse;
    float specular;
    float shininess;
    uint64_t samples;
    uint64_t distance;  // bytes
    uint64_t planes;    // CastPlane
};

struct PlainVolume {
    PlainGrid grid;
    double opacity_step;
    uint64_t pieces;  // PlainPiece
    uint piece_count;
    uint unused;
};

// Keeps what is within bounds, where there are any, in object space.
struct PlainSurface {
    PlainGrid grid;
    double isovalue;
    double opacity;
    double thickness;
    Vec3d color;
    CastPlace to_object;
    Vec3d bounds_lo;
    Vec3d bounds_hi;
    uint has_bounds;
    uint oblique;
};

TWIN_END
#endif
