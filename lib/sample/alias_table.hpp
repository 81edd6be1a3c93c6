// Draws an index with given weights in constant time (Walker 1977, Vose 1991).
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace pellucid {

class AliasTable {
public:
    /// One of 2^k columns: the first part of it is its own, the rest is `other`.
    struct Column {
        std::uint32_t own;  // in 2^-32 of the column
        std::uint32_t other;
    };

    AliasTable() = default;
    /// weights >= 0, not all 0; at most 2^31 of them.
    explicit AliasTable(std::span<const double> weights);

    /// From 64 random bits: the top bits of `column` choose one, `side` its part. Precondition: not empty.
    [[nodiscard]] std::uint32_t pick(std::uint32_t column, std::uint32_t side) const {
        const auto index = static_cast<std::uint32_t>(std::uint64_t{column} >> shift_);
        return side < columns_[index].own ? index : columns_[index].other;
    }
    [[nodiscard]] std::span<const Column> columns() const { return columns_; }
    /// How far the column's word is shifted, 1 … 32.
    [[nodiscard]] int shift() const { return shift_; }
    [[nodiscard]] std::size_t bytes() const { return columns_.capacity() * sizeof(Column); }

private:
    std::vector<Column> columns_;
    int shift_ = 32;
};

}  // namespace pellucid
