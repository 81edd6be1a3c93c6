#include "cpu/packed_volume.hpp"

#include <algorithm>
#include <atomic>
#include <cassert>
#include <cmath>
#include <cstring>
#include <limits>

#include "core/parallel.hpp"

namespace pellucid {
namespace {

constexpr int kBrick = EmptySpace::kBlock;
constexpr int kSide = kBrick + 1;
/// Vectors are at most this long.
constexpr std::size_t kMostLanes = 16;
/// Values are computed in float32: by what share of its size one may leave the range of its block.
constexpr double kRoom = 4e-6;

[[nodiscard]] std::size_t wide(int n) {
    return static_cast<std::size_t>(n);
}

/// The least float that is not below.
[[nodiscard]] float up(double value) {
    const auto f = static_cast<float>(value);
    return static_cast<double>(f) < value ? std::nextafter(f, std::numeric_limits<float>::infinity()) : f;
}

struct Integers {
    float least, most;  // least > most: not all of them are whole, or they are too large
};
[[nodiscard]] Integers find_integers(const VoxelGrid& grid) {
    constexpr float kExact = 0x1p23F;
    std::atomic<bool> whole{true};
    std::atomic<float> least{kExact}, most{-kExact};
    parallel_for(grid.values.size(), std::size_t{1} << 18U, [&](std::size_t begin, std::size_t end) {
        float lo = kExact, hi = -kExact;
        int broken = 0;
        for (std::size_t i = begin; i < end; ++i) {
            const float v = grid.values[i];
            const float sure = std::abs(v) < kExact ? v : 0.5F;  // what is not a number counts as broken
            broken |= static_cast<float>(static_cast<std::int32_t>(sure)) == sure ? 0 : 1;
            lo = std::min(lo, v);
            hi = std::max(hi, v);
        }
        if (broken != 0) whole = false;
        for (float seen = least; lo < seen && !least.compare_exchange_weak(seen, lo);) {
        }
        for (float seen = most; hi > seen && !most.compare_exchange_weak(seen, hi);) {
        }
    });
    return whole ? Integers{least, most} : Integers{1, 0};
}

template <class Sample>
void fill_bricks(const VoxelGrid& grid, float least, const std::array<int, 3>& count, std::size_t brick_bytes,
                 std::vector<std::uint8_t>& out) {
    parallel_for(wide(count[0]) * wide(count[1]) * wide(count[2]), 16,
                 [&](std::size_t begin, std::size_t end) {
                     for (std::size_t b = begin; b < end; ++b) {
                         const std::array<int, 3> first{
                             kBrick * static_cast<int>(b % wide(count[0])),
                             kBrick * static_cast<int>(b / wide(count[0]) % wide(count[1])),
                             kBrick * static_cast<int>(b / wide(count[0]) / wide(count[1]))};
                         std::uint8_t* to = out.data() + b * brick_bytes;
                         for (int k = 0; k < kSide; ++k)
                             for (int j = 0; j < kSide; ++j) {
                                 const int y = std::min(first[1] + j, grid.size[1] - 1);
                                 const int z = std::min(first[2] + k, grid.size[2] - 1);
                                 const float* from = grid.values.data() + grid.index(first[0], y, z);
                                 const auto last = wide(std::min(kSide, grid.size[0] - first[0])) - 1;
                                 std::array<Sample, kSide> row;
                                 for (std::size_t i = 0; i <= last; ++i)
                                     row[i] = static_cast<Sample>(static_cast<std::int32_t>(from[i] - least));
                                 for (std::size_t i = last + 1; i < row.size(); ++i) row[i] = row[last];
                                 std::memcpy(to, row.data(), sizeof(row));
                                 to += sizeof(row);
                             }
                     }
                 });
}

[[nodiscard]] PackedTransfer pack(const TransferFunction& f, double offset) {
    PackedTransfer t;
    const auto pieces = f.pieces();
    const auto kinks = f.kinks();
    t.count = static_cast<std::uint32_t>(pieces.size());
    const std::size_t room = std::max(pieces.size(), kMostLanes) + kMostLanes;
    for (auto* column : {&t.begin, &t.end, &t.base, &t.opacity, &t.opacity_slope, &t.color[0], &t.color[1],
                         &t.color[2], &t.color_slope[0], &t.color_slope[1], &t.color_slope[2]})
        column->resize(room, 0.0F);
    constexpr float kFar = std::numeric_limits<float>::infinity();
    for (std::size_t k = 0; k < pieces.size(); ++k) {
        const TransferFunction::Piece& p = pieces[k];
        t.begin[k] = k == 0 ? -kFar : up(kinks[k - 1] - offset);
        t.end[k] = k < kinks.size() ? up(kinks[k] - offset) : kFar;
        t.base[k] = static_cast<float>(p.from - offset);
        t.opacity[k] = static_cast<float>(p.opacity);
        t.opacity_slope[k] = static_cast<float>(p.opacity_slope);
        for (int c = 0; c < 3; ++c) {
            t.color[static_cast<std::size_t>(c)][k] = static_cast<float>(p.color[c]);
            t.color_slope[static_cast<std::size_t>(c)][k] = static_cast<float>(p.color_slope[c]);
        }
        t.ever_opaque =
            t.ever_opaque || p.opacity >= 1 || (k < kinks.size() && p.opacity_at(kinks[k]) >= 1 - 1e-7);
    }
    return t;
}

}  // namespace

bool PackedVolume::takes(const VolumeObject& volume) {
    constexpr double kMostBytes = 2.0e9;
    double samples = 1;
    for (const int n : volume.field().grid().size) samples *= n + kBrick;
    // Numbers that float32 has, with room for their products.
    constexpr double kLargest = 1e15, kSteepest = 1e15, kGentlest = 1e-25;
    const auto fits = [&](double slope) {
        return slope == 0 || (std::abs(slope) < kSteepest && std::abs(slope) > kGentlest);
    };
    bool tame = std::ranges::all_of(volume.transfer().kinks(), [&](double k) { return std::abs(k) < kLargest; });
    for (const TransferFunction::Piece& piece : volume.transfer().pieces()) {
        tame = tame && fits(piece.opacity_slope);
        for (int c = 0; c < 3; ++c) tame = tame && fits(piece.color_slope[c]);
    }
    return tame && volume.settings().interpolation == Interpolation::trilinear && !volume.bounds().empty() &&
           4 * samples < kMostBytes;
}

PackedVolume::PackedVolume(const VolumeObject& volume, bool skip, bool with_bricks)
    : object(&volume), kind(Kind::floats), data(nullptr) {
    assert(takes(volume));
    const VoxelGrid& grid = volume.field().grid();
    for (std::size_t a = 0; a < 3; ++a) {
        last[a] = static_cast<float>(grid.size[a] - 1);
        last_cell[a] = grid.size[a] - 2;
    }
    const Integers whole = find_integers(grid);
    const float span = whole.most - whole.least;
    if (span >= 0 && span <= 65535) {
        kind = span <= 255 ? Kind::bytes : Kind::words;
        offset = static_cast<double>(whole.least);
    }
    if (kind != Kind::floats && with_bricks) {
        const int size = kind == Kind::bytes ? 1 : 2;
        std::array<int, 3> count{};
        for (std::size_t a = 0; a < 3; ++a) count[a] = (volume.cells()[a] + kBrick - 1) / kBrick;
        // A multiple of 16 with room for reading four bytes at the last sample.
        const int brick_bytes = (size * kSide * kSide * kSide + 4 + 15) / 16 * 16;
        step = {size, size * kSide, size * kSide * kSide};
        std::int32_t stride = brick_bytes;
        for (std::size_t a = 0; a < 3; ++a) {
            jump[a] = stride - kBrick * step[a];
            stride *= count[a];
        }
        bricks.resize(static_cast<std::size_t>(stride));
        if (kind == Kind::bytes)
            fill_bricks<std::uint8_t>(grid, whole.least, count, static_cast<std::size_t>(brick_bytes),
                                      bricks);
        else
            fill_bricks<std::uint16_t>(grid, whole.least, count, static_cast<std::size_t>(brick_bytes),
                                       bricks);
        data = bricks.data();
    } else if (kind == Kind::floats) {
        step = {4, 4 * grid.size[0], 4 * grid.size[0] * grid.size[1]};
        data = reinterpret_cast<const std::uint8_t*>(grid.values.data());
    }
    transfer = pack(volume.transfer(), offset);
    if (skip) space = find_empty_space(volume, kRoom);
}

}  // namespace pellucid
