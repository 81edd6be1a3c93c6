#include "measure/opacity_theory.hpp"

#include <cmath>

namespace pellucid {
namespace {

/// s/(S cosθ), the chance that one particle lands in the pixel; empty where it is no probability below 1.
std::optional<double> landing_probability(const Patch& patch) {
    const bool valid = patch.ratio > 0 && patch.cos_tilt > 0 && patch.cos_tilt <= 1;
    if (!valid || patch.ratio >= patch.cos_tilt) return std::nullopt;
    const double p = patch.ratio / patch.cos_tilt;
    if (p >= 1) return std::nullopt;  // the division rounded up to 1
    return p;
}

bool is_count(double count) { return count >= 0 && std::isfinite(count); }

}  // namespace

std::optional<double> opacity_from_count(double count, const Patch& patch) {
    const auto p = landing_probability(patch);
    if (!p || !is_count(count)) return std::nullopt;
    return -std::expm1(count * std::log1p(-*p));  // PBSR (1)
}

std::optional<double> transmittance_from_count(double count, const Patch& patch) {
    const auto p = landing_probability(patch);
    if (!p || !is_count(count)) return std::nullopt;
    return std::exp(count * std::log1p(-*p));
}

std::optional<double> count_from_opacity(double opacity, const Patch& patch) {
    const auto p = landing_probability(patch);
    if (!p || !(opacity >= 0 && opacity < 1)) return std::nullopt;
    return std::log1p(-opacity) / std::log1p(-*p);
}

std::optional<double> poisson_opacity(double count, const Patch& patch) {
    if (!is_count(count) || !(patch.ratio > 0) || !(patch.cos_tilt > 0 && patch.cos_tilt <= 1)) return std::nullopt;
    return -std::expm1(-count * (patch.ratio / patch.cos_tilt));
}

std::optional<double> oblique_opacity(double opacity, double cos_tilt) {
    if (!(opacity >= 0 && opacity <= 1) || !(cos_tilt > 0 && cos_tilt <= 1)) return std::nullopt;
    return -std::expm1(std::log1p(-opacity) / cos_tilt);  // opacity 1: log1p gives −inf, and so 1
}

}  // namespace pellucid
