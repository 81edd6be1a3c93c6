#include "study/uniformity.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <boost/geometry.hpp>
#include <boost/geometry/geometries/point.hpp>
#include <boost/geometry/index/rtree.hpp>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "scene/scene_file.hpp"
#include "study/trust_meshes.hpp"
#include "study/trust_rays.hpp"

namespace pellucid {
namespace {

namespace bg = boost::geometry;
using TreePoint = bg::model::point<double, 3, bg::cs::cartesian>;
using Tree = bg::index::rtree<TreePoint, bg::index::quadratic<16>>;

[[nodiscard]] TreePoint tree_point(const Vec3& p) { return {p.x, p.y, p.z}; }

/// π ρ d² of some points of one repeat.
void add_neighbours(const std::vector<Vec3>& points, double density, std::size_t queries,
                    std::vector<double>& found) {
    if (points.size() < 2) return;
    std::vector<TreePoint> packed;
    for (const Vec3& p : points) packed.push_back(tree_point(p));
    const Tree tree(packed.begin(), packed.end());
    const std::size_t step = std::max<std::size_t>(1, points.size() / queries);
    for (std::size_t i = 0; i < points.size(); i += step) {
        std::vector<TreePoint> nearest;
        tree.query(bg::index::nearest(packed[i], 2), std::back_inserter(nearest));
        double square = 0;  // the nearest is the point itself
        for (const TreePoint& p : nearest) square = std::max(square, bg::comparable_distance(p, packed[i]));
        found.push_back(std::numbers::pi * density * square);
    }
}

}  // namespace

Scene uniformity_scene(const std::string& body, const std::filesystem::path& folder, int resolution) {
    const auto read = [&](const std::string& camera) {
        const Config config = Config::parse(fmt::format("image.resolution = [{0}, {0}]\n", resolution) + "[camera]\nprojection = \"orthographic\"\n" + camera +
                                                "\n[[surface]]\nopacity_law = \"oblique\"\nopacity = 0.5\nshading = \"flat\"\n" + body,
                                            "uniformity", folder);
        Scene scene = scene_from_config(config);
        config.finish();
        return scene;
    };
    const Box box = prepare(read("position = [0, 0, 1]\n")).objects[0].geometry->bounds();
    const Vec3 middle = box.center();
    const double size = length(box.size());
    if (!(size > 0)) throw input_error("uniformity: the surface \"{}\" is empty", body);
    const Vec3 eye = middle + size * Vec3(0.36, 0.48, 0.8);
    return read(fmt::format("position = [{}, {}, {}]\ntarget = [{}, {}, {}]\nview_height = {}", eye.x, eye.y, eye.z,
                            middle.x, middle.y, middle.z, 1.01 * size));
}

AreaCells::AreaCells(const PreparedScene& scene, std::size_t points, int depth, Seed seed) {
    const PreparedScene lines = scene_for_lines(scene.settings.surfaces);
    const LineShooter shooter(lines);
    constexpr std::size_t kBatch = 1 << 14;
    std::vector<Vec3> found;
    std::vector<Ray> rays(kBatch);
    std::vector<std::vector<RayHit>> hits;
    MeanVariance crossings;
    std::size_t most = 1;
    std::uint64_t number = 0;
    std::vector<std::vector<Vec3>> batch(kBatch);
    while (found.size() < points) {
        if (number > 1000 * points + 1000 * kBatch) throw run_error("uniformity: lines miss the surface");
        for (std::size_t i = 0; i < kBatch; ++i) {
            const Vec3 direction = random_direction(seed, number + i);
            const auto [u, v, choice] = random_numbers(seed, number + i, 1);
            const Frame frame = frame_around(direction);
            const double r = shooter.radius() * std::sqrt(u);
            const double angle = 2 * std::numbers::pi * v;
            rays[i] = shooter.through(shooter.center() + r * (std::cos(angle) * frame.aside + std::sin(angle) * frame.up),
                                      direction);
        }
        shooter.gather(rays, hits);
        for (std::size_t i = 0; i < kBatch; ++i) {
            crossings.add(static_cast<double>(hits[i].size()));
            if (hits[i].size() > most) {
                // One in K of each: those of before are thinned to the new K.
                const double keep = static_cast<double>(most) / static_cast<double>(hits[i].size());
                std::uint64_t k = 0;
                std::erase_if(found, [&](const Vec3&) { return random_numbers(seed, k++, 2 + static_cast<std::uint32_t>(most))[0] >= keep; });
                most = hits[i].size();
            }
            const double choice = random_numbers(seed, number + i, 1)[2];
            const auto pick = static_cast<std::size_t>(choice * static_cast<double>(most));
            if (pick < hits[i].size()) found.push_back(rays[i].origin + hits[i][pick].t * rays[i].direction);
        }
        number += kBatch;
    }
    // A line through the disc of radius R across a random direction crosses area A so many times: A/(2πR²) on average.
    const double unit = 2 * std::numbers::pi * shooter.radius() * shooter.radius();
    area_ = unit * crossings.mean();
    area_error_ = unit * crossings.standard_error();

    sample_.assign(found.begin(), found.begin() + static_cast<std::ptrdiff_t>(std::min(found.size(), kMostSample)));
    const std::size_t leaves = std::size_t{1} << static_cast<unsigned>(depth);
    cuts_.resize(leaves - 1);
    std::vector<std::span<Vec3>> parts{found};
    for (std::size_t node = 0; node < cuts_.size(); ++node) {
        const std::span<Vec3> part = parts[node];
        Box box;
        for (const Vec3& p : part) box.include(p);
        const Vec3 size = box.size();
        const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
        const std::size_t half = part.size() / 2;
        std::nth_element(part.begin(), part.begin() + static_cast<std::ptrdiff_t>(half), part.end(),
                         [axis](const Vec3& a, const Vec3& b) { return a[axis] < b[axis]; });
        cuts_[node] = {axis, part[half][axis]};
        parts.push_back(part.first(half));
        parts.push_back(part.subspan(half));
    }
    counts_.assign(leaves, 0);
    for (const Vec3& p : found) ++counts_[cell_of(p)];
    total_ = static_cast<double>(found.size());
}

std::size_t AreaCells::cell_of(const Vec3& point) const {
    std::size_t node = 0;
    while (node < cuts_.size()) node = 2 * node + (point[cuts_[node].axis] < cuts_[node].at ? 1 : 2);
    return node - cuts_.size();
}

PointSets world_points(const PreparedScene& scene, const ParticleSet& set) {
    PointSets sets(set.repeats.size());
    for (std::size_t i = 0; i < sets.size(); ++i)
        for (const Particle& q : set.repeats[i].particles) sets[i].push_back(scene.camera.to_world(set.frame.view_position(q)));
    return sets;
}

namespace {

/// Over all repeats, in their order.
[[nodiscard]] MeanVariance all_neighbours(const AreaCells& cells, const PointSets& sets, std::size_t queries) {
    std::vector<std::vector<double>> found(sets.size());
    parallel_for(sets.size(), 1, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i)
            add_neighbours(sets[i], static_cast<double>(sets[i].size()) / cells.area(), queries, found[i]);
    });
    MeanVariance sum;
    for (const auto& each : found)
        for (const double value : each) sum.add(value);
    return sum;
}

}  // namespace

NeighbourBaseline neighbour_baseline(const AreaCells& cells, double points_a_set, std::size_t queries) {
    const auto size = std::max<std::size_t>(2, static_cast<std::size_t>(points_a_set));
    PointSets sets;
    for (std::size_t first = 0; first + size <= cells.sample().size(); first += size) {
        const auto part = cells.sample().subspan(first, size);
        sets.emplace_back(part.begin(), part.end());
    }
    const MeanVariance mean = all_neighbours(cells, sets, queries);
    return {mean.mean(), mean.standard_error()};
}

UniformityReport judge_uniformity(const AreaCells& cells, const PointSets& sets, std::size_t queries,
                                  const NeighbourBaseline& baseline) {
    UniformityReport report;
    const std::size_t n = cells.count();
    std::vector<MeanVariance> of_cell(n);
    std::vector<double> total(n, 0);
    MeanVariance numbers;
    for (const auto& points : sets) {
        std::vector<double> count(n, 0);
        for (const Vec3& p : points) count[cells.cell_of(p)] += 1;
        for (std::size_t i = 0; i < n; ++i) {
            of_cell[i].add(count[i]);
            total[i] += count[i];
        }
        numbers.add(static_cast<double>(points.size()));
        report.points += static_cast<double>(points.size());
    }
    if (!(report.points > 0)) return report;
    double deviation = 0;
    double noise = 0;
    for (std::size_t i = 0; i < n; ++i) {
        const double share = static_cast<double>(cells.counts()[i]) / cells.total();
        const double expected = report.points * share;
        const double off = total[i] - expected;
        report.chi2 += off * off / (expected * (1 + report.points / cells.total()));
        // Repeats are independent of each other, points of one need not be: the variance of all that a cell got is the repeats'
        // number times that of what it gets in one.
        const double variance = sets.size() > 1 ? of_cell[i].variance() * static_cast<double>(sets.size()) : expected;
        noise += (variance / (expected * expected) + 1 / (share * cells.total())) / static_cast<double>(n);
        deviation += off * off / (expected * expected) / static_cast<double>(n);
        if (of_cell[i].mean() > 0) report.dispersion += of_cell[i].variance() / of_cell[i].mean() / static_cast<double>(n);
    }
    report.dof = static_cast<double>(n - 1);
    report.p_value = chi2_survival(report.chi2, report.dof);
    report.density_deviation = std::sqrt(std::max(0.0, deviation - noise));
    report.density_noise = std::sqrt(noise);
    if (sets.size() > 1) {
        report.count_dispersion = numbers.variance() / numbers.mean();
        const double dof = static_cast<double>(sets.size() - 1);
        const double upper = chi2_survival(report.count_dispersion * dof, dof);
        report.count_p = 2 * std::min(upper, 1 - upper);
    }
    const MeanVariance neighbours = all_neighbours(cells, sets, queries);
    report.neighbour = neighbours.mean();
    report.neighbour_expected = baseline.mean;
    report.neighbour_z = (report.neighbour - baseline.mean) / std::hypot(neighbours.standard_error(), baseline.error);
    return report;
}

}  // namespace pellucid
