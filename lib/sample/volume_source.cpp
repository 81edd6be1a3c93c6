#include "sample/volume_source.hpp"

#include <algorithm>
#include <cmath>
#include <memory>

#include <fmt/format.h>

#include "core/box_corners.hpp"
#include "core/parallel.hpp"
#include "sample/edge_lines.hpp"
#include "scene/shading.hpp"

namespace pellucid {
namespace {

/// A box of cells is cut where its parts need less than this share of its trials: smaller boxes take memory
/// and leave the near cache earlier.
constexpr double kWorthACut = 0.6;
/// A piece is cut while the area that a pixel sees varies on it by more than this.
constexpr double kMostAreaRatio = 4;
/// Below this ratio, parts of a box need no bound of their own.
constexpr double kEvenAreaRatio = 1.1;
/// A piece that reaches out of view is cut while it spans more virtual pixels than this.
constexpr double kMostPixelsOutside = 1024;
constexpr int kMostCuts = 40;
/// Pieces and cells a block: with their samples they fit into a level-2 cache.
constexpr std::size_t kBlockPieces = 4096;
constexpr double kBlockCells = 0x1p17;
/// More trials a repeat than this are refused, more particles in view cannot be: cut into pieces, they would not end.
constexpr double kMostTrials = 0x1p32;
constexpr double kHopeless = 0x1p40;
/// −ln(1 − kMostParticleOpacity).
const double kMostDepth = -std::log1p(-kMostParticleOpacity);

[[nodiscard]] double smallest_voxel(const VolumeObject& volume) {
    const Mat3& m = volume.to_world().linear;
    return std::min({length(m[0]), length(m[1]), length(m[2])});
}

}  // namespace

/// Cuts one block of cells after the other.
class VolumeSource::Cutter {
public:
    explicit Cutter(const VolumeSource& source)
        : source_(source), volume_(*source.volume_), cells_(volume_.cells()) {}

    void cut(const std::array<int, 3>& block) {
        for (std::size_t a = 0; a < 3; ++a) first_[a] = kSide * block[a];
        find_bounds();
        add(kLevels, {0, 0, 0}, {});
    }

    std::vector<Piece> pieces;

private:
    static constexpr int kSide = VolumeObject::kBlock;
    static constexpr int kLevels = 3;
    static_assert(1 << kLevels == kSide);

    /// Bounds that hold for a box and all its parts, where they need no look.
    struct Node {
        double least_area = 0;
        bool even = false;  // wholly in view, not clipped, and least_area is good for the parts
    };

    /// Extinctions of cells, and of boxes of 2³, 4³ and 8³ of them, with their sums.
    void find_bounds() {
        for (int k = 0; k < kSide; ++k)
            for (int j = 0; j < kSide; ++j)
                for (int i = 0; i < kSide; ++i) {
                    const std::array<int, 3> cell{first_[0] + i, first_[1] + j, first_[2] + k};
                    Bound& bound = level_[0][at(0, {i, j, k})];
                    bound = {};
                    if (cell[0] >= cells_[0] || cell[1] >= cells_[1] || cell[2] >= cells_[2]) continue;
                    const ValueRange range = volume_.range(cell, {cell[0] + 1, cell[1] + 1, cell[2] + 1});
                    bound.most = source_.density_of(volume_.transfer().most_opacity(range.lo, range.hi));
                    bound.sum = bound.most;
                }
        for (int level = 1; level <= kLevels; ++level) {
            const int side = kSide >> level;
            for (int k = 0; k < side; ++k)
                for (int j = 0; j < side; ++j)
                    for (int i = 0; i < side; ++i) {
                        Bound& bound = level_[static_cast<std::size_t>(level)][at(level, {i, j, k})];
                        bound = {};
                        for (int part = 0; part < 8; ++part) {
                            const Bound& small = level_[static_cast<std::size_t>(level - 1)][at(
                                level - 1,
                                {2 * i + (part & 1), 2 * j + (part >> 1 & 1), 2 * k + (part >> 2)})];
                            bound.most = std::max(bound.most, small.most);
                            bound.sum += small.sum;
                        }
                    }
        }
    }

    [[nodiscard]] static std::size_t at(int level, const std::array<int, 3>& node) {
        const int side = kSide >> level;
        return static_cast<std::size_t>(node[0] + side * (node[1] + side * node[2]));
    }

    /// The part of index space that a box of cells fills.
    [[nodiscard]] Box box_of(int level, const std::array<int, 3>& node) const {
        const Vec3 last = volume_.field().hull().hi;
        Box box;
        for (std::size_t a = 0; a < 3; ++a) {
            const int axis = static_cast<int>(a);
            const int from = first_[a] + (node[a] << level);
            const int to = std::min(from + (1 << level), cells_[a]);
            box.lo[axis] = std::max(0.0, from - volume_.cell_shift());
            box.hi[axis] = std::min(last[axis], to - volume_.cell_shift());
        }
        return box;
    }

    /// Whether all, none or some of the corners are kept by the clip planes: 1, −1, 0.
    [[nodiscard]] int clipped(const std::array<Vec3, 8>& corner) const {
        bool whole = true;
        for (const ClipPlane& plane : volume_.settings().clip) {
            int kept = 0;
            for (const Vec3& p : corner) kept += dot(plane.normal, p) > plane.offset ? 0 : 1;
            if (kept == 0) return -1;
            whole = whole && kept == 8;
        }
        return whole ? 1 : 0;
    }

    /// Adds a box of cells, whole or in parts; returns its virtual pixels.
    double add(int level, const std::array<int, 3>& node, const Node& above) {
        const Bound& bound = level_[static_cast<std::size_t>(level)][at(level, node)];
        if (!(bound.most > 0)) return 0;
        const Box box = box_of(level, node);
        if (level == 0) return add_box(box, bound.most, above, 0);
        Node own = above;
        bool must = false;
        if (!above.even) {
            const std::array<Vec3, 8> corner = corners_of(volume_.to_world(), box);
            const auto area = source_.scene_->camera.pixel_area_range(corner.data(), 8);
            const int kept = clipped(corner);
            if (!area || kept < 0) return 0;
            own.least_area = area->least;
            const bool inside = kept > 0 && source_.scene_->camera.wholly_in_view(corner.data(), 8);
            own.even = inside && area->most <= kEvenAreaRatio * area->least;
            const double pixels = source_.pixels_of(source_.piece_of(box, bound.most, own.least_area));
            must = (!inside && pixels > kMostPixelsOutside) ||
                   (area->most > kMostAreaRatio * area->least && pixels > 1);
        }
        const Piece piece = source_.piece_of(box, bound.most, own.least_area);
        const double whole = source_.pixels_of(piece);
        const Vec3 size = box.size();
        const bool uneven = bound.sum < kWorthACut * bound.most * (size.x * size.y * size.z);
        if (must || uneven) {
            const std::size_t before = pieces.size();
            double sum = 0;
            for (int part = 0; part < 8; ++part)
                sum +=
                    add(level - 1,
                        {2 * node[0] + (part & 1), 2 * node[1] + (part >> 1 & 1), 2 * node[2] + (part >> 2)},
                        own);
            if (sum < (must ? 1 : kWorthACut) * whole) return sum;
            pieces.resize(before);
        }
        pieces.push_back(piece);
        return whole;
    }

    /// Adds a box within a cell.
    double add_box(const Box& box, double most, const Node& above, int depth) {
        if (above.even) {
            pieces.push_back(source_.piece_of(box, most, above.least_area));
            return source_.pixels_of(pieces.back());
        }
        const std::array<Vec3, 8> corner = corners_of(volume_.to_world(), box);
        const Camera& camera = source_.scene_->camera;
        const auto area = camera.pixel_area_range(corner.data(), 8);
        if (!area || clipped(corner) < 0) return 0;
        const Piece piece = source_.piece_of(box, most, area->least);
        const double whole = source_.pixels_of(piece);
        if (!(whole > 0)) return 0;
        const bool inside = camera.wholly_in_view(corner.data(), 8);
        if (depth < kMostCuts && ((!inside && whole > kMostPixelsOutside) ||
                                  (area->most > kMostAreaRatio * area->least && whole > 1))) {
            const std::size_t before = pieces.size();
            const Vec3 middle = box.center();
            double sum = 0;
            for (int part = 0; part < 8; ++part) {
                Box half = box;
                for (int axis = 0; axis < 3; ++axis)
                    ((part >> axis & 1) != 0 ? half.lo : half.hi)[axis] = middle[axis];
                sum += add_box(half, most, {}, depth + 1);
            }
            if (sum < whole) return sum;
            pieces.resize(before);
        }
        pieces.push_back(piece);
        return whole;
    }

    struct Bound {
        double most = 0;
        double sum = 0;  // over cells, so that cutting can be judged before it is done
    };
    const VolumeSource& source_;
    const VolumeObject& volume_;
    std::array<int, 3> cells_;
    std::array<int, 3> first_{};  // cell of the block
    std::array<std::array<Bound, kSide * kSide * kSide>, kLevels + 1> level_;
};

VolumeSource::VolumeSource(const PreparedScene& scene, std::size_t index, Density density)
    : scene_(&scene),
      volume_(&scene.volumes[index]),
      density_(density),
      object_id_(static_cast<std::uint32_t>(scene.objects.size() + index)),
      brightest_(brightest_color(scene.settings.lights, *volume_)),
      scale_(std::abs(volume_->to_world().determinant())),
      voxel_(smallest_voxel(*volume_)) {
    const VolumeObject& volume = *volume_;
    if (volume.bounds().empty()) return;
    const Camera& camera = scene.camera;
    for (int axis = 0; axis < 3; ++axis)
        to_view_.linear[axis] = camera.view_vector(volume.to_world().linear[axis]);
    to_view_.offset = camera.to_view(volume.to_world().offset);
    mean_area_ = camera.pixel_area(camera.to_view(volume.bounds().center()));

    const double diagonal = length(volume.bounds().size());
    capped_ = density_of(volume.most_opacity()) * diagonal * camera.width() * camera.height() > kHopeless;
    find_pieces();
    if (!capped_ && virtual_pixels_ > kMostTrials) {
        capped_ = true;
        find_pieces();
    }
}

/// Rows of blocks of cells in parallel, put together in order.
void VolumeSource::find_pieces() {
    const VolumeObject& volume = *volume_;
    pieces_.clear();
    blocks_.clear();
    virtual_pixels_ = 0;
    const std::array<int, 3>& blocks = volume.blocks();
    const std::size_t rows = static_cast<std::size_t>(blocks[1]) * static_cast<std::size_t>(blocks[2]);
    std::vector<std::vector<Piece>> found(rows);
    parallel_for(rows, 1, [&](std::size_t begin, std::size_t end) {
        const auto cutter = std::make_unique<Cutter>(*this);
        for (std::size_t row = begin; row < end; ++row) {
            cutter->pieces.clear();
            for (int i = 0; i < blocks[0]; ++i) {
                const std::array<int, 3> block{i, static_cast<int>(row % static_cast<std::size_t>(blocks[1])),
                                               static_cast<int>(row / static_cast<std::size_t>(blocks[1]))};
                if (volume.block_opacity(volume.block_index(block)) > 0) cutter->cut(block);
            }
            found[row] = cutter->pieces;
        }
    });
    std::size_t count = 0;
    for (const auto& row : found) count += row.size();
    pieces_.reserve(count);
    for (auto& row : found) {
        pieces_.insert(pieces_.end(), row.begin(), row.end());
        row = {};
    }

    std::vector<double> weights, sums;
    for (std::size_t first = 0; first < pieces_.size();) {
        weights.clear();
        double sum = 0;
        double cells = 0;
        std::size_t end = first;
        for (; end < pieces_.size() && end - first < kBlockPieces && cells < kBlockCells; ++end) {
            const Piece& piece = pieces_[end];
            weights.push_back(pixels_of(piece));
            sum += weights.back();
            cells += std::max(1.0, piece.size.x * piece.size.y * piece.size.z);
        }
        if (sum > 0) {
            blocks_.push_back({first, end - first, sum, AliasTable(weights)});
            sums.push_back(sum);
            virtual_pixels_ += sum;
        }
        first = end;
    }
    if (virtual_pixels_ > 0) block_table_ = AliasTable(sums);
}

std::string VolumeSource::label() const {
    return fmt::format("volume \"{}\"", volume_->settings().name);
}

double VolumeSource::density_of(double opacity) const {
    const double most = std::min(opacity, kMostParticleOpacity);
    return density_ == Density::without_log ? most / volume_->opacity_step() : volume_->extinction_of(most);
}

double VolumeSource::most_density(double area) const {
    return capped_ ? kMostDepth / std::min(std::sqrt(area), voxel_) : kInfinity;
}

VolumeSource::Piece VolumeSource::piece_of(const Box& box, double most, double least_area) const {
    return {box.lo, box.size(), std::min(most, most_density(least_area)), least_area};
}

std::string VolumeSource::complaint() const {
    if (!capped_) return {};
    return fmt::format("{}: opacity_step = {} would be more than 2^32 particles a repeat: no place is drawn denser than gives a "
                       "voxel, or a pixel's width if that is less, an opacity of 1 - 2^-20",
                       label(), volume_->opacity_step());
}

double VolumeSource::pixels_of(const Piece& piece) const {
    const double area = density_ == Density::without_area ? mean_area_ : piece.least_area;
    return scale_ * (piece.size.x * piece.size.y * piece.size.z) * piece.most / area;
}

std::optional<VolumeSource::Point> VolumeSource::trial_in(const Piece& piece, const Words& words) const {
    const Vec3 index = piece.lo + Vec3(words.u, words.v, words.w) * piece.size;
    const Vec3 view = to_view_.point(index);
    const Camera& camera = scene_->camera;
    if (!(view.z >= camera.near() && view.z <= camera.far())) return std::nullopt;
    const double value = volume_->value(index);
    const TransferFunction& transfer = volume_->transfer();
    const TransferFunction::Piece& look = transfer.pieces()[transfer.piece_of(value)];
    const double opacity = look.opacity_at(value);
    if (!(opacity > 0)) return std::nullopt;
    const double area = density_ == Density::without_area ? piece.least_area : camera.pixel_area(view);
    const double density = std::min(density_of(opacity), most_density(area));
    if (!(words.chance * piece.most * area < density * piece.least_area)) return std::nullopt;
    const Vec2 pixel = camera.project(view);
    if (!(pixel.x >= 0 && pixel.x < camera.width() && pixel.y >= 0 && pixel.y < camera.height()))
        return std::nullopt;
    const bool lit = !volume_->settings().shading.flat;
    Vec3 color = look.color_at(value);
    if (lit || !volume_->settings().clip.empty()) {
        const Vec3 world = volume_->to_world().point(index);
        if (!volume_->keeps(world)) return std::nullopt;
        if (lit) color = shade(*scene_, *volume_, world, color, volume_->gradient(index));
    }
    return Point{view, share_of(color, brightest_)};
}

void VolumeSource::trials_in_block(std::size_t block, Seed seed, std::uint32_t repeat, std::uint32_t first,
                                   std::uint32_t count, std::vector<Point>& out) const {
    const Block& b = blocks_[block];
    const LineKeys keys{seed.value, object_id_, repeat, static_cast<std::uint32_t>(block)};
    LineWords words;
    for (std::uint32_t done = 0; done < count;) {
        const std::uint32_t n = std::min(kLineChunk, count - done);
        draw_words(keys, &b.table, first + done, n, words);
        for (std::uint32_t i = 0; i < n; ++i) {
            const Words own{words.u[i], words.v[i],
                            unit_interval(static_cast<std::uint32_t>(words.choice[i])), words.chance[i]};
            if (const auto point = trial_in(pieces_[b.first + words.piece[i]], own)) out.push_back(*point);
        }
        done += n;
    }
}

std::optional<VolumeSource::Point> VolumeSource::trial(Seed seed, std::uint32_t repeat,
                                                       std::uint64_t index) const {
    const auto bits = [&](std::uint32_t block) {
        return random_bits(seed, {.object = object_id_, .repeat = repeat, .index = index, .block = block});
    };
    const auto first = bits(0), second = bits(1), third = bits(2);
    const Block& block = blocks_[block_table_.pick(third[0], third[1])];
    const Words words{unit_interval(first[0]), unit_interval(first[1]), unit_interval(first[2]),
                      unit_interval(first[3])};
    return trial_in(pieces_[block.first + block.table.pick(second[0], second[1])], words);
}

std::optional<Box> VolumeSource::block_bounds(std::size_t block) const {
    Box box;
    for (std::size_t i = blocks_[block].first; i < blocks_[block].first + blocks_[block].count; ++i) {
        box.include(pieces_[i].lo);
        box.include(pieces_[i].lo + pieces_[i].size);
    }
    return bounds_of(volume_->to_world(), box);
}

std::size_t VolumeSource::bytes() const {
    std::size_t sum =
        pieces_.capacity() * sizeof(Piece) + blocks_.capacity() * sizeof(Block) + block_table_.bytes();
    for (const Block& block : blocks_) sum += block.table.bytes();
    return sum;
}

}  // namespace pellucid
