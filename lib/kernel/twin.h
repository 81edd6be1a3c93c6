// What twin headers share: they compile as C++ (g++) and as GLSL (glslc). Scalars, small structs and
// pure functions only; the C++ side brings the few GLSL built-ins that they use, which have the same bits
// everywhere: roots and powers are in math_twin.h.
#ifndef PELLUCID_KERNEL_TWIN_H
#define PELLUCID_KERNEL_TWIN_H

#ifdef __cplusplus
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#define TWIN_BEGIN namespace pellucid::twin { using uint = std::uint32_t;
#define TWIN_END   }
#define TWIN_FN    [[nodiscard]] inline
#define TWIN_PRECISE
namespace pellucid::twin {
using std::abs;
using std::floor;
using std::int64_t;
using std::uint64_t;
using std::max;
using std::min;
[[nodiscard]] inline std::uint32_t floatBitsToUint(float v) { return std::bit_cast<std::uint32_t>(v); }
[[nodiscard]] inline float uintBitsToFloat(std::uint32_t bits) { return std::bit_cast<float>(bits); }
}  // namespace pellucid::twin
#else
#extension GL_EXT_shader_explicit_arithmetic_types_int64 : require
#define TWIN_BEGIN
#define TWIN_END
#define TWIN_FN
#define TWIN_PRECISE precise
#endif

#endif
