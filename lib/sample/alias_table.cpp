#include "sample/alias_table.hpp"

#include <algorithm>

namespace pellucid {

AliasTable::AliasTable(std::span<const double> weights) : columns_(weights.size(), Column{1, 0}) {
    const std::size_t n = weights.size();
    double sum = 0;
    for (const double w : weights) sum += w;
    std::vector<double> scaled(n);
    std::vector<std::uint32_t> small;
    std::vector<std::uint32_t> large;
    for (std::size_t i = 0; i < n; ++i) {
        scaled[i] = weights[i] * static_cast<double>(n) / sum;
        columns_[i].other = static_cast<std::uint32_t>(i);
        (scaled[i] < 1 ? small : large).push_back(static_cast<std::uint32_t>(i));
    }
    // Every column that lacks something is filled up by one that has too much.
    while (!small.empty() && !large.empty()) {
        const std::uint32_t s = small.back();
        const std::uint32_t l = large.back();
        small.pop_back();
        columns_[s] = {scaled[s], l};
        scaled[l] -= 1 - scaled[s];
        if (scaled[l] < 1) {
            large.pop_back();
            small.push_back(l);
        }
    }
}

AliasTable::Pick AliasTable::pick(double u) const {
    const double place = u * static_cast<double>(columns_.size());
    const auto index = std::min(static_cast<std::size_t>(place), columns_.size() - 1);
    const double side = place - static_cast<double>(index);
    const Column& column = columns_[index];
    if (side < column.share) return {static_cast<std::uint32_t>(index), side / column.share};
    return {column.other, (side - column.share) / (1 - column.share)};
}

}  // namespace pellucid
