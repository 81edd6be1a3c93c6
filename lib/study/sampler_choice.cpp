#include "study/sampler_choice.hpp"

#include "core/error.hpp"

namespace pellucid {

SamplerChoice sampler_choice(const std::string& name) {
    if (name == "fast") return {SamplerKind::lines, LineMode::fast};
    for (const auto& [known, kind] : sampler_names())
        if (name == known) return {kind, LineMode::exact};
    std::string all = "fast";
    for (const auto& [known, kind] : sampler_names()) all += fmt::format(", {}", known);
    throw input_error("sampler \"{}\", expected one of {}", name, all);
}

}  // namespace pellucid
