// Formulas that tests of cells and of the sampler share: what is hard for one is hard for the other.
#pragma once

#include <ostream>
#include <vector>

#include "core/vec.hpp"

namespace pellucid::testing_scenes {

struct FieldCase {
    const char* name;
    const char* text;
    Box bounds;
    bool continuous = true;
};

inline void PrintTo(const FieldCase& c, std::ostream* out) { *out << c.name; }

inline constexpr const char* kBarthSextic =
    "4*(2.618033988749895*x^2-y^2)*(2.618033988749895*y^2-z^2)*(2.618033988749895*z^2-x^2)"
    "-4.23606797749979*(x^2+y^2+z^2-1)^2";
inline constexpr const char* kClebschCubic =
    "81*(x^3+y^3+z^3)-189*(x^2*y+x^2*z+y^2*x+y^2*z+z^2*x+z^2*y)+54*x*y*z+126*(x*y+x*z+y*z)-9*(x^2+y^2+z^2)-9*(x+y+z)+1";
inline constexpr const char* kTorusQuartic = "(x^2+y^2+z^2+0.84)^2-4*(x^2+y^2)";
inline constexpr const char* kGyroid = "sin(x)*cos(y)+sin(y)*cos(z)+sin(z)*cos(x)";

inline Box cube(double half) { return {Vec3(-half), Vec3(half)}; }

inline const std::vector<FieldCase>& field_cases() {
    static const std::vector<FieldCase> all{
        {"sphere", "x^2+y^2+z^2-1", cube(1.1)},
        {"sphere that touches its bounds", "x^2+y^2+z^2-1", cube(1)},
        {"torus", kTorusQuartic, {{-1.5, -1.5, -0.5}, {1.5, 1.5, 0.5}}},
        {"Barth", kBarthSextic, cube(1.7)},
        {"Clebsch", kClebschCubic, cube(1.3)},
        {"gyroid", kGyroid, cube(3.5)},
        {"three planes", "x*y*z", cube(1)},
        {"three planes off the middle", "(x-0.1)*(y+0.2)*(z-0.3)", cube(1)},
        {"sphere touched", "(x^2+y^2+z^2-1)^2", cube(1.1)},
        {"cubed", "(x+0.1*y)^3", cube(1)},
        {"box of abs", "max(abs(x),abs(y),abs(z))-0.7", cube(1)},
        {"union", "min(x^2+y^2+z^2-0.49,(x-0.6)^2+y^2+z^2-0.25,abs(z)+abs(x)-0.4)", cube(1.2)},
        {"domain edge", "sqrt(x)-y", cube(1), false},
        {"log edge", "log(x+0.3)+z^2+y", cube(1), false},
        {"pole", "1/x-2*y+z", cube(1), false},
        {"tangents", "tan(2*x)+y-z", cube(1.3), false},
        {"speck", "x^2+y^2+z^2-1e-6", {{-1, -2, -1.5}, {1.3, 1, 1}}},
        {"plane in a face", "z", {{-1, -1, 0}, {1, 1, 1}}},
        {"plane in the other face", "z-1", {{-1, -1, 0}, {1, 1, 1}}},
        {"plane in the middle", "x", cube(1)},
        {"plane an ulp beside the middle", "x-0.3", {{-0.1, -1, -1}, {0.7, 1, 1}}},
        {"plane through edges", "x+y", cube(1)},
        {"plane through corners", "x+y+z", cube(1)},
        {"cone", "sqrt(x^2+y^2)-z", cube(1)},
        {"exponents", "exp(3*x)+exp(-3*y)-4+z", cube(1)},
        {"far from the origin", "(x-1000)^2+(y+2000)^2+(z-500)^2-1", {{998.9, -2001.1, 498.9}, {1001.1, -1998.9, 501.1}}},
    };
    return all;
}

}  // namespace pellucid::testing_scenes
