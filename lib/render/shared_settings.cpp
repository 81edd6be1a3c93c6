#include "render/shared_settings.hpp"

namespace pellucid {

TessellationSettings read_tessellation(const RenderInput& input) {
    TessellationSettings s;
    if (input.tessellate) s.error_px = input.tessellate->number("error_px", s.error_px, above(0));
    return s;
}

SlabMixing read_mixing(const ConfigTable& table, SlabMixing otherwise) {
    return table.choice<SlabMixing>("mixing", otherwise,
                                    {{"average", SlabMixing::average},
                                     {"normalised", SlabMixing::normalised},
                                     {"extinction", SlabMixing::extinction}});
}

}  // namespace pellucid
