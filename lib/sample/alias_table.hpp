// Draws an index with given weights in constant time (Walker 1977, Vose 1991).
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace pellucid {

class AliasTable {
public:
    AliasTable() = default;
    /// weights >= 0, not all 0; at most 2^32 of them.
    explicit AliasTable(std::span<const double> weights);

    struct Pick {
        std::uint32_t index;
        double rest;  // what is left of the random number, in [0, 1): may choose something else
    };
    /// u in [0, 1). Precondition: not empty.
    [[nodiscard]] Pick pick(double u) const;
    [[nodiscard]] std::size_t bytes() const { return columns_.capacity() * sizeof(Column); }

private:
    struct Column {
        double share;  // of the column that is its own; the rest is `other`
        std::uint32_t other;
    };
    std::vector<Column> columns_;
};

}  // namespace pellucid
