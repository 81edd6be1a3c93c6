#include "sample/stratify.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "sample/pack_points.hpp"
#include "sample/poisson_number.hpp"

namespace pellucid {
namespace {

/// Trials of one block that a thread takes at a time.
constexpr std::uint32_t kTaskTrials = 1U << 16U;
/// Groups of so many repeats are large enough: more groups tell the variance better.
constexpr std::uint32_t kWorthMoreGroups = 64;

struct Task {
    std::size_t block;
    std::uint32_t first, count;
};

/// A particle that was drawn, and its repeat within the group.
struct Drawn {
    std::uint32_t repeat;
    Particle particle;
};

/// Candidates of one tile, sorted by pixel: those of pixel p are begin[p] … begin[p + 1] − 1.
struct TileCandidates {
    std::vector<Particle> particles;
    std::vector<std::uint32_t> begin;
};

class GroupSampler {
public:
    GroupSampler(const PreparedScene& scene, const ParticleFrame& frame, Seed seed, const StratifySettings& settings,
                 std::uint32_t first)
        : frame_(frame),
          projection_(frame.projection(scene.camera)),
          grid_(projection_.width, projection_.height),
          scene_(scene),
          seed_(seed),
          oversampling_(settings.oversampling),
          first_(first),
          count_(settings.group) {}

    /// Appends the object's particles to those of each repeat.
    void add(const ParticleSource& source, std::span<std::vector<Particle>> repeats) const {
        const double oversampling = plan_candidates(scene_, source, oversampling_).oversampling;
        const auto tiles = by_tile(candidates(source, oversampling));
        std::vector<std::vector<Drawn>> drawn(tiles.size());
        parallel_for(tiles.size(), 1, [&](std::size_t begin, std::size_t end) {
            for (std::size_t tile = begin; tile < end; ++tile) drawn[tile] = draw_tile(source, oversampling, tile, tiles[tile]);
        });
        for (const auto& tile : drawn)
            for (const Drawn& each : tile) repeats[each.repeat].push_back(each.particle);
    }

    [[nodiscard]] const twin::Projection& projection() const { return projection_; }

private:
    [[nodiscard]] std::vector<std::vector<Particle>> candidates(const ParticleSource& source, double oversampling) const {
        RandomStream counts(seed_, {.object = static_cast<std::uint32_t>(Purpose::particle_count),
                                    .repeat = first_,
                                    .index = static_cast<std::uint64_t>(source.object_id()) << 24U | 1U << 22U});
        std::vector<Task> tasks;
        const double times = double{source.optical_depth()} * oversampling * count_;
        for (std::size_t block = 0; block < source.block_count(); ++block) {
            const std::uint32_t trials = poisson_number(times * source.block_virtual_pixels(block), counts);
            for (std::uint32_t done = 0; done < trials; done += std::min(kTaskTrials, trials - done))
                tasks.push_back({block, done, std::min(kTaskTrials, trials - done)});
        }
        std::vector<std::vector<Particle>> found(tasks.size());
        parallel_for(tasks.size(), 1, [&](std::size_t begin, std::size_t end) {
            std::vector<SourcePoint> points;
            for (std::size_t i = begin; i < end; ++i) {
                points.clear();
                source.trials_in_block(tasks[i].block, seed_, first_, tasks[i].first, tasks[i].count, points);
                found[i].resize(points.size());
                pack_points(frame_, points, source.painted(), found[i]);
            }
        });
        return found;
    }

    /// Those in view, in the order of their tasks.
    [[nodiscard]] std::vector<TileCandidates> by_tile(std::vector<std::vector<Particle>> parts) const {
        struct Place {
            std::uint32_t tile, pixel;
        };
        std::vector<std::vector<Place>> places(parts.size());
        parallel_for(parts.size(), 1, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) {
                places[i].resize(parts[i].size());
                for (std::size_t k = 0; k < parts[i].size(); ++k) {
                    const twin::PixelDepth at = twin::project_quickly(projection_, parts[i][k]);
                    constexpr int kMask = twin::kTileSide - 1;
                    places[i][k] = at.column < 0 ? Place{~0U, 0}
                                                 : Place{static_cast<std::uint32_t>(grid_.tile(at.column, at.row)),
                                                         static_cast<std::uint32_t>((at.row & kMask) << twin::kTileShift |
                                                                                    (at.column & kMask))};
                }
            }
        });
        std::vector<TileCandidates> tiles(grid_.count());
        for (TileCandidates& tile : tiles) tile.begin.assign(twin::kTilePixels + 1, 0);
        for (const auto& part : places)
            for (const Place& at : part)
                if (at.tile != ~0U) ++tiles[at.tile].begin[at.pixel + 1];
        for (TileCandidates& tile : tiles) {
            std::partial_sum(tile.begin.begin(), tile.begin.end(), tile.begin.begin());
            tile.particles.resize(tile.begin.back());
        }
        // begin[p] counts up to begin[p + 1] while pixels are filled; what it was is one place behind.
        for (std::size_t i = 0; i < parts.size(); ++i) {
            for (std::size_t k = 0; k < parts[i].size(); ++k) {
                const Place& at = places[i][k];
                if (at.tile != ~0U) tiles[at.tile].particles[tiles[at.tile].begin[at.pixel]++] = parts[i][k];
            }
            std::vector<Particle>().swap(parts[i]);
        }
        for (TileCandidates& tile : tiles) {
            std::shift_right(tile.begin.begin(), tile.begin.end(), 1);
            tile.begin[0] = 0;
        }
        return tiles;
    }

    /// Systematic sampling of every pixel's candidates, and their repeats.
    [[nodiscard]] std::vector<Drawn> draw_tile(const ParticleSource& source, double oversampling, std::size_t tile,
                                               const TileCandidates& candidates) const {
        std::vector<Drawn> drawn;
        std::vector<std::uint32_t> order;
        std::vector<std::uint32_t> shuffled(count_);
        std::iota(shuffled.begin(), shuffled.end(), 0U);
        for (std::size_t pixel = 0; pixel + 1 < candidates.begin.size(); ++pixel) {
            const std::uint32_t begin = candidates.begin[pixel];
            const std::uint32_t size = candidates.begin[pixel + 1] - begin;
            if (size == 0) continue;
            const Particle* particles = candidates.particles.data() + begin;
            const std::size_t place = grid_.row_of(tile, pixel) * static_cast<std::size_t>(projection_.width) +
                                      grid_.column_of(tile, pixel);
            draw_pixel(source, oversampling, place, {particles, size}, order, shuffled, drawn);
        }
        return drawn;
    }

    void draw_pixel(const ParticleSource& source, double oversampling, std::size_t place, std::span<const Particle> particles,
                    std::vector<std::uint32_t>& order, std::vector<std::uint32_t>& shuffled,
                    std::vector<Drawn>& drawn) const {
        RandomStream random(seed_, {.object = static_cast<std::uint32_t>(Purpose::stratify),
                                    .repeat = first_,
                                    .index = static_cast<std::uint64_t>(source.object_id()) << 32U | place});
        const auto group = static_cast<double>(count_);
        const double log_miss = std::log1p(-1 / (group * oversampling));
        const double start = unit_interval(random());
        // The group's last particle is the k-th nearest, or there is none: what is behind is never asked for, which is all
        // but a few of a dense object's candidates.
        const double last = std::ceil(std::log1p(-(group - start) / group) / log_miss);
        const auto size = static_cast<std::uint32_t>(particles.size());
        const std::uint32_t nearest = last + count_ < size ? static_cast<std::uint32_t>(last) + count_ : size;
        order.resize(size);
        std::iota(order.begin(), order.end(), 0U);
        const auto depth = [&](std::uint32_t i) { return twin::floatBitsToUint(particles[i].above_near); };
        const auto nearer = [&](std::uint32_t a, std::uint32_t b) {
            return depth(a) != depth(b) ? depth(a) < depth(b) : a < b;
        };
        if (nearest < size) std::nth_element(order.begin(), order.begin() + nearest, order.end(), nearer);
        order.resize(nearest);
        std::sort(order.begin(), order.end(), nearer);
        // Drawn are those at which the sum passes a whole number: from k on to the k that passes the next.
        std::uint32_t number = 0;
        for (std::uint32_t next = 0; number < count_;) {
            // Least k with group·(1 − (1−q)^k) >= number + 1 − start.
            const double share = (number + 1 - start) / group;
            if (!(share < 1)) break;
            const double k = std::ceil(std::log1p(-share) / log_miss);
            if (!(k <= static_cast<double>(order.size()))) break;
            next = std::max(static_cast<std::uint32_t>(k), next + 1);
            if (next > order.size()) break;
            // A random choice of the repeats: the first steps of a Fisher-Yates shuffle, of any order.
            const auto left = static_cast<std::uint64_t>(count_ - number);
            const auto pick = number + static_cast<std::uint32_t>(std::uint64_t{random()} * left >> 32U);
            std::swap(shuffled[number], shuffled[pick]);
            drawn.push_back({shuffled[number], particles[order[next - 1]]});
            ++number;
        }
    }

    const ParticleFrame& frame_;
    twin::Projection projection_;
    TileGrid grid_;
    const PreparedScene& scene_;
    Seed seed_;
    std::uint32_t oversampling_, first_, count_;
};

}  // namespace

/// Λ as a particle sees it on the mean, Λ̄ = Σ Λ²/Σ Λ over the pixels: n trials that are kept fall into one cell of the
/// image by pairs, a pair with the chance Σ p², p the cells' shares, and Λ̄ = particles·Σ p²/(pixels of a cell).
CandidatePlan plan_candidates(const PreparedScene& scene, const ParticleSource& source, std::uint32_t oversampling) {
    constexpr std::uint64_t kProbes = 4096;
    constexpr int kCells = 32;  // along an edge of the image
    CandidatePlan plan{0, static_cast<double>(oversampling)};
    if (!(source.virtual_pixels() > 0) || !source.has_single_trials()) return plan;
    const Camera& camera = scene.camera;
    const int width = (camera.width() + kCells - 1) / kCells;
    const int height = (camera.height() + kCells - 1) / kCells;
    std::array<double, kCells * kCells> counts{};
    double kept = 0;
    for (std::uint64_t i = 0; i < kProbes; ++i) {
        const auto point = source.trial({0}, ~0U, i);
        if (!point) continue;
        const Vec2 pixel = camera.project(point->view);
        const int column = std::clamp(static_cast<int>(pixel.x) / width, 0, kCells - 1);
        const int row = std::clamp(static_cast<int>(pixel.y) / height, 0, kCells - 1);
        ++counts[static_cast<std::size_t>(row * kCells + column)];
        ++kept;
    }
    plan.particles = source.optical_depth() * source.virtual_pixels() * kept / static_cast<double>(kProbes);
    if (kept < 2) return plan;
    double pairs = 0;
    for (const double count : counts) pairs += count * (count - 1);
    const double depth = plan.particles * pairs / (kept * (kept - 1)) / (width * height);
    plan.oversampling = std::clamp(oversampling * kDenseDepth / std::max(depth, kDenseDepth), 1.0, plan.oversampling);
    return plan;
}

std::uint32_t default_group(const PreparedScene& scene, const SourceRefs& sources, std::uint32_t repeats,
                            std::uint32_t oversampling) {
    double candidates = 1;  // of one repeat, of the object that has most
    for (const ParticleSource* source : sources.all()) {
        const CandidatePlan plan = plan_candidates(scene, *source, oversampling);
        candidates = std::max(candidates, plan.particles * plan.oversampling);
    }
    const std::uint32_t group = std::max((repeats + 15) / 16, std::min(kWorthMoreGroups, (repeats + 7) / 8));
    return static_cast<std::uint32_t>(std::clamp(std::floor(kMostCandidates / candidates), 1.0, static_cast<double>(group)));
}

std::vector<RepeatParticles> stratified_group(const PreparedScene& scene, const SourceRefs& sources,
                                              const ParticleFrame& frame, Seed seed, const StratifySettings& settings,
                                              std::uint32_t first, const TileMask* tiles) {
    const std::uint32_t count = settings.group;
    const GroupSampler sampler(scene, frame, seed, settings, first);
    std::vector<std::vector<Particle>> particles(count);
    std::vector<std::vector<std::uint32_t>> ends(count);
    for (const ParticleSource* source : sources.all()) {
        sampler.add(*source, particles);
        for (std::size_t i = 0; i < count; ++i) ends[i].push_back(static_cast<std::uint32_t>(particles[i].size()));
    }
    std::vector<RepeatParticles> repeats(count);
    parallel_for(count, 1, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            if (tiles != nullptr) tiles->drop_others(particles[i], ends[i], sampler.projection());
            repeats[i] = sort_by_tile(particles[i], ends[i], sampler.projection());
        }
    });
    return repeats;
}

}  // namespace pellucid
