#include "sample/alias_table.hpp"

#include <algorithm>
#include <bit>

namespace pellucid {

AliasTable::AliasTable(std::span<const double> weights)
    : columns_(std::bit_ceil(weights.size()), Column{0xffffffffU, 0}),
      shift_(32 - std::countr_zero(columns_.size())) {
    // Up to the next power of two columns stand for nothing, so that bits choose one without rounding.
    const std::size_t n = columns_.size();
    double sum = 0;
    for (const double w : weights) sum += w;
    std::vector<double> scaled(n, 0);
    std::vector<std::uint32_t> small;
    std::vector<std::uint32_t> large;
    for (std::size_t i = 0; i < n; ++i) {
        if (i < weights.size()) scaled[i] = weights[i] * static_cast<double>(n) / sum;
        columns_[i].other = static_cast<std::uint32_t>(i);
        (scaled[i] < 1 ? small : large).push_back(static_cast<std::uint32_t>(i));
    }
    // Every column that lacks something is filled up by one that has too much.
    while (!small.empty() && !large.empty()) {
        const std::uint32_t s = small.back();
        const std::uint32_t l = large.back();
        small.pop_back();
        columns_[s] = {static_cast<std::uint32_t>(std::min(scaled[s] * 0x1p32 + 0.5, 0x1p32 - 1)), l};
        scaled[l] -= 1 - scaled[s];
        if (scaled[l] < 1) {
            large.pop_back();
            small.push_back(l);
        }
    }
}

}  // namespace pellucid
