// What a user chooses about zSlabs: shared by the stages, by method `slabs` and by the command slabs-merge.
#pragma once

#include <cstdint>

namespace pellucid {

/// How opacity is spread inside of a slab that is split. zSlab (3.2) to (3.6).
enum class SlabInterpolation : std::uint8_t {
    modified,           // linear (3.4, 3.5), the rest by (3.6)
    original,           // homogeneous (3.2, 3.3), by expm1 and log1p: no digits are lost
    original_textbook,  // the same as the formulas stand, with a power and a division: to show what is numerics
};
/// How slabs that share an interval mix.
enum class SlabMixing : std::uint8_t {
    average,     // (4.4)
    normalised,  // (4.3)
    extinction,  // Σσ_i c_i / Σσ_i: the physics of two media in one place
};
/// Who meets whom. zSlab, section 5.5.
enum class SlabIntermix : std::uint8_t {
    image,       // every object makes its own array, then arrays are merged one by one
    hybrid,      // the last volume is cast against the array so far, sample by sample
    order_free,  // all objects at once over shared intervals: no order matters
};
/// What happens to slabs that do not fit.
enum class SlabCompression : std::uint8_t {
    tail,           // all that follow go into the last
    slope,          // successive ones merge while the slope of opacity changes little: (2.6, 2.7), then tail
    transmittance,  // the boundary whose removal changes the transmittance curve least goes first
};

struct SlabSettings {
    int layers = 8;  // N, with the image as layer 0: N − 1 slabs
    SlabInterpolation interpolation = SlabInterpolation::modified;
    SlabMixing mixing = SlabMixing::average;
    SlabIntermix intermix = SlabIntermix::image;
    SlabCompression compression = SlabCompression::transmittance;
    /// Accumulated opacity at which a ray ends (early ray termination); 1: only where nothing passes.
    float opaque_at = 0.999F;
    /// M: surfaces of a pixel that a device finds in one pass over the triangles, 1 to 64. No result depends on it.
    int targets = 4;
};

/// How a volume or an isosurface is cast.
struct CastSettings {
    double step = 0;  // world length along the ray, > 0
    bool skip = true;  // what surely shows nothing
};

}  // namespace pellucid
