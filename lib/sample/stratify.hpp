// Particle sets that depend on each other for the better: `particles.sampler = "stratified"`.
//
// G repeats (a *group*) share candidates: a Poisson process of R·G times the density of one independent repeat, R the
// *oversampling*. In every pixel an object's M candidates, nearest first, are worth
//     c(k) − c(k−1) = G q (1−q)^(k−1),    q = 1/(R·G),    c(k) = G (1 − (1−q)^k),
// and they are drawn in that proportion by systematic sampling (one random number a pixel): floor(c(k) + ξ) of the
// nearest k, each in a repeat of its own, which are a random choice of the G. So
//   inside a set       no two particles of an object in one pixel: nothing is drawn to be hidden;
//   between the sets   the number of repeats that a pixel is covered in is c(M), rounded up or down.
// Unbiased, pixel by pixel, whatever the surface, its sheets, opacity and law: with N(<z) the candidates nearer than z,
// Poisson of mean R·G·Λ(z), the expected worth of those at depth z is
//     G q · R G λ(z) dz · E[(1−q)^N] = G λ(z) dz · exp(−q R G Λ) = G λ(z) e^(−Λ(z)) dz,
// which is what G independent repeats show (their nearest particle). Objects stay independent of each other.
//
// The count law: a pixel gets 1 − e^(−Λ) particles a repeat, its opacity, instead of Λ = −ln(1 − α): a flat piece of area S
// that faces the camera needs  n = α S/s  particles in place of  ln(1 − α)/ln(1 − s/S)  of PBSR (1).
// Variance of a pixel's mean over G repeats, one sheet: E[(1−q)^2M] − (E[(1−q)^M])² = e^(−2Λ)(e^(Λ/(R G)) − 1) from the
// candidates, and φ(1 − φ)/G² (φ the fraction of c(M)) from rounding; independent repeats have e^(−Λ)(1 − e^(−Λ))/G.
//
// *Dense objects.* The proof holds for every R >= 1, so each object has its own: where Λ is large, candidates are many and
// the variance e^(−2Λ)(e^(Λ/(R G)) − 1) is next to nothing anyway. R falls as 1/Λ from Λ = kDenseDepth on, to 1: what an
// opaque object costs is at most what its independent particles cost, or R·kDenseDepth candidates a pixel and repeat. Of a
// pixel's candidates no more than the nearest (ln G + 2)·R·G or so can be drawn: these alone are sorted.
//
// *Groups.* Rounding costs φ(1 − φ)/G² a group, so fewer and larger groups have less variance; more of them tell it better,
// by one degree of freedom less than their number. default_group makes 8 groups, and up to 16 while they have 64 repeats
// each: between 7 and 15 degrees of freedom a pixel. With few repeats (8 groups of 8) rounding alone leaves 1/6 to 2/3 of
// the variance of independent ones, at α = 0.5 and 0.05; set `group` to the number of repeats where no variance is wanted.
#pragma once

#include <cstdint>

#include "sample/make_sources.hpp"
#include "sample/particle_set.hpp"
#include "sample/tile_mask.hpp"

namespace pellucid {

struct StratifySettings {
    std::uint32_t group = 64;      // G
    std::uint32_t oversampling = 8;  // R, of objects that are not dense
};

/// −ln(1 − α) from which on an object is dense: α = 0.95.
inline constexpr double kDenseDepth = 3;

/// What an object's candidates come to, from a few thousand trials.
struct CandidatePlan {
    double particles = 0;     // in view, of one independent repeat
    double oversampling = 1;  // the object's own R
};
[[nodiscard]] CandidatePlan plan_candidates(const PreparedScene& scene, const ParticleSource& source,
                                            std::uint32_t oversampling);

/// Most candidates of a group that default_group allows: 16 bytes each, and as many again while they are sorted.
inline constexpr double kMostCandidates = 0x1p25;

/// A group for so many repeats in all: an eighth, a sixteenth while that is 64 or more, within kMostCandidates.
[[nodiscard]] std::uint32_t default_group(const PreparedScene& scene, const SourceRefs& sources, std::uint32_t repeats,
                                          std::uint32_t oversampling);

/// The repeats of the group that begins with repeat `first`, a multiple of G; in `tiles` only, if given.
[[nodiscard]] std::vector<RepeatParticles> stratified_group(const PreparedScene& scene, const SourceRefs& sources,
                                                            const ParticleFrame& frame, Seed seed,
                                                            const StratifySettings& settings, std::uint32_t first,
                                                            const TileMask* tiles = nullptr);

}  // namespace pellucid
