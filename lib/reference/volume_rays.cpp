#include "reference/volume_rays.hpp"

#include <algorithm>
#include <cmath>

#include "scene/shading.hpp"

namespace pellucid {
namespace {

/// Kronrod's extension of Gauss' two points on [−1, 1]: A. S. Kronrod, Nodes and weights of quadrature
/// formulas, 1965.
constexpr std::size_t kNodes = 5;
constexpr std::array<double, kNodes> kNode{-0.92582009977255146157, -0.57735026918962576451, 0,
                                           0.57735026918962576451, 0.92582009977255146157};
constexpr std::array<double, kNodes> kWeight{98.0 / 495, 27.0 / 55, 28.0 / 45, 27.0 / 55, 98.0 / 495};
/// Gauss' three points, and ∫ from −1 to node i of the polynomial that is 1 at node j and 0 at the others.
constexpr double kGauss3 = 0.77459666924148337704;
constexpr std::array<double, 3> kGaussNode{-kGauss3, 0, kGauss3};
constexpr std::array<double, 3> kGaussWeight{5.0 / 9, 8.0 / 9, 5.0 / 9};
/// A piece is halved at most so often in a row; what is left of a jump is then 2^-30 of a cell.
constexpr int kMostLevels = 30;
/// Parts of a ray below this share of its way through volumes are rounding: at the end of a hull a value may
/// pass that of opacity 1 by its last bit.
constexpr double kSliver = 1e-12;
/// Shading is done in float32: differences of colours below this are its rounding, and no halving takes them
/// away.
constexpr double kShadingNoise = 2e-6;
/// Pooled layers of one ray become one up to this optical depth; and where in a layer it lies is known to this.
constexpr double kMergedDepth = 0.02;
/// A layer of one colour in place of one that runs by Δc errs by Δc·τ/12 of its weight, one way where colour rises and the
/// other where it falls: of single layers four times the tolerance of the whole ray.
constexpr double kUneven = 12 * 4;
/// Where a Catmull-Rom value is looked at to find the pieces of the transfer function.
constexpr int kLooks = 24;

/// ∫ from −1 to node i of the polynomial that is 1 at node j and 0 at the others.
[[nodiscard]] std::array<std::array<double, kNodes>, kNodes> make_partial_weights() {
    std::array<std::array<double, kNodes>, kNodes> sums{};
    for (std::size_t j = 0; j < kNodes; ++j) {
        std::array<double, kNodes> c{1};
        std::size_t degree = 0;
        for (std::size_t m = 0; m < kNodes; ++m) {
            if (m == j) continue;
            const double scale = 1 / (kNode[j] - kNode[m]);
            std::array<double, kNodes> next{};
            for (std::size_t k = 0; k <= degree; ++k) {
                next[k + 1] += c[k] * scale;
                next[k] -= c[k] * kNode[m] * scale;
            }
            c = next;
            ++degree;
        }
        const auto primitive = [&](double u) {
            double sum = 0;
            for (std::size_t k = kNodes; k-- > 0;) sum = sum * u + c[k] / static_cast<double>(k + 1);
            return sum * u;
        };
        for (std::size_t i = 0; i < kNodes; ++i) sums[i][j] = primitive(kNode[i]) - primitive(-1);
    }
    return sums;
}
const std::array<std::array<double, kNodes>, kNodes> kPartialWeight = make_partial_weights();

const std::array<std::array<double, 3>, 3> kGaussPartial = [] {
    std::array<std::array<double, 3>, 3> sums{};
    for (std::size_t i = 0; i < 3; ++i) {
        const double u = kGaussNode[i], r = kGauss3;
        const auto between = [&](auto&& primitive) { return primitive(u) - primitive(-1.0); };
        sums[i][0] = between([&](double x) { return (x * x * x / 3 - r * x * x / 2) / (2 * r * r); });
        sums[i][1] = between([&](double x) { return x - x * x * x / (3 * r * r); });
        sums[i][2] = between([&](double x) { return (x * x * x / 3 + r * x * x / 2) / (2 * r * r); });
    }
    return sums;
}();

/// −ln(1 − α), as log1p but for thin media.
[[nodiscard]] double optical(double opacity) {
    if (opacity > 0.03) return -std::log1p(-opacity);
    return opacity *
           (1 + opacity * (1.0 / 2 +
                           opacity * (1.0 / 3 + opacity * (1.0 / 4 + opacity * (1.0 / 5 + opacity * (1.0 / 6))))));
}
/// e^−x, x >= 0.
[[nodiscard]] double passing(double x) {
    if (x > 0.01) return std::exp(-x);
    return 1 - x * (1 - x * (1.0 / 2) * (1 - x * (1.0 / 3) * (1 - x * (1.0 / 4) * (1 - x * (1.0 / 5)))));
}

[[nodiscard]] double largest(const Vec3& v) {
    return std::max({v.x, v.y, v.z});
}

/// Cubics in u of the four Catmull-Rom weights at p + u·d.
[[nodiscard]] std::array<std::array<double, 4>, 4> weights_along(double p, double d) {
    // Of powers of t, samples −1 … 2.
    constexpr double kPower[4][4] = {{0, -0.5, 1, -0.5}, {1, 0, -2.5, 1.5}, {0, 0.5, 2, -1.5}, {0, 0, -0.5, 0.5}};
    std::array<std::array<double, 4>, 4> w{};
    for (std::size_t i = 0; i < 4; ++i) {
        const double* k = kPower[i];
        w[i] = {k[0] + p * (k[1] + p * (k[2] + p * k[3])), d * (k[1] + p * (2 * k[2] + p * 3 * k[3])),
                d * d * (k[2] + p * 3 * k[3]), d * d * d * k[3]};
    }
    return w;
}

/// The Catmull-Rom value less `less` at p + u·d as a polynomial in u: along x, then y, then z.
[[nodiscard]] std::array<double, 10> catmull_rom_along(const VolumeField::Samples& samples, double less, const Vec3& p,
                                                       const Vec3& d) {
    const auto x = weights_along(p.x, d.x), y = weights_along(p.y, d.y), z = weights_along(p.z, d.z);
    std::array<double, 10> out{};
    for (std::size_t k = 0; k < 4; ++k) {
        std::array<double, 7> slice{};
        for (std::size_t j = 0; j < 4; ++j) {
            std::array<double, 4> row{};
            for (std::size_t i = 0; i < 4; ++i) {
                const double v = static_cast<double>(samples[i + 4 * j + 16 * k]) - less;
                for (std::size_t m = 0; m < 4; ++m) row[m] += v * x[i][m];
            }
            for (std::size_t n = 0; n < 4; ++n)
                for (std::size_t m = 0; m < 4; ++m) slice[n + m] += y[j][n] * row[m];
        }
        for (std::size_t n = 0; n < 4; ++n)
            for (std::size_t m = 0; m < 7; ++m) out[n + m] += z[k][n] * slice[m];
    }
    return out;
}

}  // namespace

VolumeRay::VolumeRay(const PreparedScene& scene, const VolumeRaySettings& settings)
    : scene_(&scene), settings_(settings) {
    for (std::size_t i = 0; i < scene.volumes.size(); ++i) {
        const VolumeObject& volume = scene.volumes[i];
        if (volume.bounds().empty()) continue;
        Walk walk{};
        walk.volume = &volume;
        walk.index = static_cast<std::uint32_t>(i);
        walk.cells = volume.cells();
        walk.lit =
            !volume.settings().shading.flat && volume.settings().interpolation != Interpolation::nearest;
        walks_.push_back(std::move(walk));
    }
    if (!walks_.empty()) unit_ = std::max(1.0, brightest_color(scene));
}

void VolumeRay::start(const Ray& ray, double share) {
    ray_ = ray;
    share_ = share;
    clear_ = 1;
    halvings_left_ = kMostHalvings;
    t_ = scene_->camera.near();
    reach_ = 0;
    met_ = 0;
    for (Walk& walk : walks_) {
        const VolumeObject& volume = *walk.volume;
        const Vec3 from = volume.to_index().point(ray.origin);
        walk.along = volume.to_index().vector(ray.direction);
        double lo = scene_->camera.near();
        double hi = scene_->camera.far();
        const auto cut = [&](double value, double slope) {  // keeps value + slope·t >= 0
            if (slope > 0) lo = std::max(lo, -value / slope);
            if (slope < 0) hi = std::min(hi, -value / slope);
            if (slope == 0 && value < 0) hi = lo;
        };
        const Vec3 last = volume.field().hull().hi;
        for (int axis = 0; axis < 3; ++axis) {
            cut(from[axis], walk.along[axis]);
            cut(last[axis] - from[axis], -walk.along[axis]);
        }
        for (const ClipPlane& plane : volume.settings().clip)
            cut(plane.offset - dot(plane.normal, ray.origin), -dot(plane.normal, ray.direction));
        walk.from = from + Vec3(volume.cell_shift());
        walk.t_in = lo;
        walk.t_out = std::max(lo, hi);
        walk.inside = false;
        reach_ += walk.t_out - walk.t_in;
        if (walk.t_out > walk.t_in) enter(walk, lo);
    }
}

/// Finds the cell at depth t.
void VolumeRay::enter(Walk& walk, double t) const {
    const std::array<int, 3>& cells = walk.cells;
    const Vec3 p = walk.from + t * walk.along;
    for (int axis = 0; axis < 3; ++axis) {
        const auto a = static_cast<std::size_t>(axis);
        walk.cell[a] = std::clamp(static_cast<int>(std::floor(p[axis])), 0, cells[a] - 1);
        // On a face, the cell that the ray goes into.
        if (walk.along[axis] < 0 && p[axis] == walk.cell[a] && walk.cell[a] > 0) --walk.cell[a];
        walk.step[a] = walk.along[axis] > 0 ? 1 : walk.along[axis] < 0 ? -1 : 0;
        walk.t_next[a] = walk.step[a] == 0 ? kInfinity
                                           : (walk.cell[a] + (walk.step[a] > 0 ? 1 : 0) - walk.from[axis]) /
                                                 walk.along[axis];
    }
    walk.inside = true;
    walk.cell_begin = t;
    open_cell(walk);
}

/// One cell on; false where the volume ends.
bool VolumeRay::next_cell(Walk& walk) const {
    std::size_t axis = 0;
    for (std::size_t a = 1; a < 3; ++a)
        if (walk.t_next[a] < walk.t_next[axis]) axis = a;
    const int next = walk.cell[axis] + walk.step[axis];
    if (!(walk.t_next[axis] < walk.t_out) || next < 0 || next >= walk.cells[axis]) return false;
    walk.cell_begin = std::max(walk.cell_begin, walk.t_next[axis]);
    walk.cell[axis] = next;
    const int face = next + (walk.step[axis] > 0 ? 1 : 0);
    walk.t_next[axis] = (face - walk.from[static_cast<int>(axis)]) / walk.along[static_cast<int>(axis)];
    open_cell(walk);
    return true;
}

/// Stretches the current cell's end to that of its block, which is empty.
void VolumeRay::skip_block(Walk& walk) const {
    const std::array<int, 3>& cells = walk.cells;
    constexpr int kSide = VolumeObject::kBlock;
    double end = walk.t_out;
    std::array<int, 3> face{};
    for (std::size_t a = 0; a < 3; ++a) {
        if (walk.step[a] == 0) continue;
        const int block = walk.cell[a] / kSide;
        face[a] = walk.step[a] > 0 ? std::min(kSide * (block + 1), cells[a]) : kSide * block;
        const int axis = static_cast<int>(a);
        end = std::min(end, (face[a] - walk.from[axis]) / walk.along[axis]);
    }
    // The last cell before the end, along every axis.
    const Vec3 p = walk.from + end * walk.along;
    for (std::size_t a = 0; a < 3; ++a) {
        if (walk.step[a] == 0) continue;
        const int axis = static_cast<int>(a);
        const int block = walk.cell[a] / kSide;
        const int lo = kSide * block;
        const int hi = std::min(lo + kSide, cells[a]) - 1;
        const int at = std::clamp(static_cast<int>(std::floor(p[axis])), lo, hi);
        walk.cell[a] = walk.step[a] > 0 ? std::max(walk.cell[a], at) : std::min(walk.cell[a], at);
        walk.t_next[a] = (walk.cell[a] + (walk.step[a] > 0 ? 1 : 0) - walk.from[axis]) / walk.along[axis];
        // The face through which the block is left is the end, whatever rounding says of the others.
        if (walk.t_next[a] < end) walk.t_next[a] = end;
    }
    walk.cell_end = std::max(end, walk.cell_begin);
}

bool VolumeRay::one_piece(Walk& walk, double least, double most) {
    const TransferFunction& transfer = walk.volume->transfer();
    const std::span<const double> kinks = transfer.kinks();
    const auto holds = [&](double v) {
        return (walk.known_piece == 0 || kinks[walk.known_piece - 1] <= v) &&
               (walk.known_piece == kinks.size() || v < kinks[walk.known_piece]);
    };
    if (!holds(least)) walk.known_piece = transfer.piece_of(least);
    return holds(most);
}

/// The value along the ray in the current cell, and where its pieces end.
void VolumeRay::open_cell(Walk& walk) const {
    const VolumeObject& volume = *walk.volume;
    const TransferFunction& transfer = volume.transfer();
    walk.cell_end = std::min({walk.t_next[0], walk.t_next[1], walk.t_next[2], walk.t_out});
    walk.cell_end = std::max(walk.cell_end, walk.cell_begin);
    walk.ends.clear();
    walk.piece = 0;
    walk.empty = true;
    if (volume.block_opacity(volume.block_of(walk.cell)) == 0) {
        skip_block(walk);
        walk.ends.push_back(walk.cell_end);
        return;
    }
    const auto give_up = [&] { walk.ends.push_back(walk.cell_end); };
    const double half = 0.5 * (walk.cell_end - walk.cell_begin);
    const double middle = 0.5 * (walk.cell_end + walk.cell_begin);
    walk.middle = middle;
    walk.per_half = half > 0 ? 1 / half : 0;
    const auto enter_piece = [&](const TransferFunction::Piece& piece) {
        walk.ends.push_back(walk.cell_end);
        walk.transfer = &piece;
        walk.empty = false;
    };
    const Vec3 base(walk.cell[0], walk.cell[1], walk.cell[2]);
    const Vec3 p = walk.from + middle * walk.along - base;
    const Vec3 d = half * walk.along;
    std::array<double, kLooks + 1> stop{-1, 1};  // between which the value is monotone
    std::size_t stops = 2;
    Along& value = walk.value;
    switch (volume.settings().interpolation) {
        case Interpolation::nearest: {
            value.degree = 0;
            value.c[0] =
                static_cast<double>(volume.field().grid().at(walk.cell[0], walk.cell[1], walk.cell[2]));
            if (!(transfer.opacity(value.c[0]) > 0)) return give_up();
            break;
        }
        case Interpolation::trilinear: {
            const std::array<float, 8> corner = volume.corners(walk.cell);
            float least = corner[0], most = corner[0];
            for (const float v : corner) {
                least = std::min(least, v);
                most = std::max(most, v);
            }
            const bool one = one_piece(walk, static_cast<double>(least), static_cast<double>(most));
            if (one) {
                const TransferFunction::Piece& piece = transfer.pieces()[walk.known_piece];
                if (!(piece.opacity_at(static_cast<double>(least)) > 0 ||
                      piece.opacity_at(static_cast<double>(most)) > 0))
                    return give_up();
            } else if (!(transfer.most_opacity(static_cast<double>(least), static_cast<double>(most)) > 0)) {
                return give_up();
            }
            const TrilinearDifferences f(corner);
            walk.cell_values = f;
            value.degree = 3;
            value.c[0] = f.value(p);
            value.c[1] = dot(f.gradient(p), d);
            value.c[2] = d.x * d.y * (f.xy + p.z * f.xyz) + d.x * d.z * (f.xz + p.y * f.xyz) +
                         d.y * d.z * (f.yz + p.x * f.xyz);
            value.c[3] = d.x * d.y * d.z * f.xyz;
            if (!std::isfinite(value.c[0]) || !std::isfinite(value.c[3])) return give_up();
            if (one) return enter_piece(transfer.pieces()[walk.known_piece]);
            // Roots of c1 + 2 c2 u + 3 c3 u².
            const double a = 3 * value.c[3], b = value.c[2], c = value.c[1];
            std::array<double, 2> turn{2, 2};
            const double root = b * b - a * c;
            if (root >= 0) {
                const double q = -(b + std::copysign(std::sqrt(root), b));
                if (a != 0) turn[0] = q / a;
                if (q != 0) turn[1] = c / q;
            }
            if (turn[0] > turn[1]) std::swap(turn[0], turn[1]);
            stops = 1;
            for (const double u : turn)
                if (u > -1 && u < 1) stop[stops++] = u;
            stop[stops++] = 1;
            break;
        }
        case Interpolation::catmull_rom: {
            walk.around = volume.field().samples_around(walk.cell);
            float least = walk.around[0], most = walk.around[0], sum = 0;
            for (const float v : walk.around) {
                least = std::min(least, v);
                most = std::max(most, v);
                sum += v * 0;
            }
            if (sum != 0) return give_up();  // not all are numbers
            // The absolute values of the weights have a sum of at most 5/4 along each axis.
            constexpr double kBeyond = 0.5 * (1.25 * 1.25 * 1.25 - 1) + 1e-6;
            const double beyond = kBeyond * (static_cast<double>(most) - static_cast<double>(least));
            const double lo = static_cast<double>(least) - beyond, hi = static_cast<double>(most) + beyond;
            const bool one = one_piece(walk, lo, hi);
            if (!(transfer.most_opacity(lo, hi) > 0)) return give_up();
            const auto first = static_cast<double>(walk.around[0]);
            value.degree = 9;
            value.c = catmull_rom_along(walk.around, first, p, d);
            value.c[0] += first;
            if (!std::isfinite(value.c[0])) return give_up();
            if (one) return enter_piece(transfer.pieces()[walk.known_piece]);
            for (int i = 0; i <= kLooks; ++i) stop[static_cast<std::size_t>(i)] = -1 + 2.0 * i / kLooks;
            stops = kLooks + 1;
            break;
        }
    }
    // Where the value passes an end of a piece of the transfer function.
    const std::span<const double> kinks = transfer.kinks();
    double left = value(stop[0]);
    for (std::size_t s = 0; value.degree > 0 && s + 1 < stops; ++s) {
        const double right = value(stop[s + 1]);
        const double least = std::min(left, right);
        const double most = std::max(left, right);
        const std::size_t first = walk.ends.size();
        for (auto k = std::upper_bound(kinks.begin(), kinks.end(), least); k != kinks.end() && *k < most;
             ++k) {
            // One root, as the value is monotone: Newton's steps, halving where they leave the bracket.
            double lo = stop[s], hi = stop[s + 1];
            const bool rising = right > left;
            double u = lo + (hi - lo) * (*k - left) / (right - left);
            for (int i = 0; i < 60 && hi - lo > 1e-15; ++i) {
                const double off = value(u) - *k;
                ((off < 0) == rising ? lo : hi) = u;
                double next = u - off / value.slope(u);
                if (!(next > lo && next < hi)) next = off != 0 ? 0.5 * (lo + hi) : u;
                const double step = std::abs(next - u);
                u = next;
                if (step <= 1e-15) break;
            }
            walk.ends.push_back(middle + u * half);
        }
        if (right < left)
            std::reverse(walk.ends.begin() + static_cast<std::ptrdiff_t>(first), walk.ends.end());
        left = right;
    }
    walk.ends.push_back(walk.cell_end);
    open_piece(walk);
}

/// What the transfer function is on the current piece.
void VolumeRay::open_piece(Walk& walk) const {
    const double begin = walk.piece == 0 ? walk.cell_begin : walk.ends[walk.piece - 1];
    const double end = walk.ends[walk.piece];
    const double u = (0.5 * (begin + end) - walk.middle) * walk.per_half;
    const TransferFunction& transfer = walk.volume->transfer();
    const TransferFunction::Piece& piece = transfer.pieces()[transfer.piece_of(walk.value(u))];
    // Between looks a Catmull-Rom value may go anywhere.
    walk.transfer = walk.value.degree > 3 ? nullptr : &piece;
    walk.empty = walk.transfer != nullptr && piece.opacity == 0 && piece.opacity_slope == 0;
}

void VolumeRay::next_piece(Walk& walk) const {
    if (++walk.piece < walk.ends.size()) {
        open_piece(walk);
    } else {
        walk.inside = next_cell(walk);
    }
}

void VolumeRay::advance(double t, double clear, double least_clear, std::vector<VolumeLayer>& out) {
    if (!settings_.pooled) clear_ = clear;
    least_clear_ = least_clear;
    merge_from_ = out.size();
    t = std::min(t, scene_->camera.far());
    while (t_ < t && clear_ >= least_clear_) {
        double end = t;
        here_.clear();
        bool any = false;
        for (Walk& walk : walks_) {
            while (walk.inside && walk.ends[walk.piece] <= t_) next_piece(walk);
            if (!walk.inside) continue;
            any = true;
            if (walk.cell_begin > t_) {  // not there yet
                end = std::min(end, walk.cell_begin);
                continue;
            }
            end = std::min(end, walk.ends[walk.piece]);
            if (!walk.empty) here_.push_back(&walk);
        }
        if (!any) {
            t_ = t;
            return;
        }
        if (!here_.empty()) integrate(t_, end, 0, out);
        t_ = end;
    }
}

Vec3 VolumeRay::lit_color(const Walk& walk, double t, const Vec3& color) const {
    const VolumeObject& volume = *walk.volume;
    const Vec3 at = walk.from + t * walk.along - Vec3(walk.cell[0], walk.cell[1], walk.cell[2]);
    const Vec3 gradient = volume.settings().interpolation == Interpolation::trilinear
                              ? walk.cell_values.gradient(at)
                              : catmull_rom_gradient(walk.around, 0, glm::clamp(at, Vec3(0.0), Vec3(1.0)));
    return shade(*scene_, volume, ray_.origin + t * ray_.direction, color, gradient);
}

VolumeRay::Sample VolumeRay::at(double t) const {
    Sample sum;
    int infinite = 0;
    Vec3 solid(0.0);
    for (const Walk* walk : here_) {
        const double value =
            walk->value.degree == 0 ? walk->value.c[0] : walk->value((t - walk->middle) * walk->per_half);
        const VolumeObject& volume = *walk->volume;
        const TransferFunction& transfer = volume.transfer();
        const TransferFunction::Piece& piece =
            walk->transfer != nullptr ? *walk->transfer : transfer.pieces()[transfer.piece_of(value)];
        const double opacity = std::min(piece.opacity_at(value), settings_.most_opacity);
        if (!(opacity > 0)) continue;
        Vec3 color = piece.color_at(value);
        if (walk->lit) color = lit_color(*walk, t, color);
        if (opacity >= 1) {
            ++infinite;
            solid += color;
            continue;
        }
        const double extinction = optical(opacity) / volume.opacity_step();
        sum.extinction += extinction;
        sum.emission += extinction * color;
    }
    if (infinite > 0) return {kInfinity, solid / static_cast<double>(infinite)};
    return sum;
}

void VolumeRay::put(double a, double b, double optical_depth, const Vec3& color,
                    std::vector<VolumeLayer>& out) {
    if (!(optical_depth > 0)) return;
    for (const Walk* walk : here_) met_ |= std::uint64_t{1} << (walk->index & 63U);
    if (!settings_.pooled) {
        out.push_back({0.5 * (a + b), optical_depth, color, 0.5 * (b - a)});
        clear_ *= passing(optical_depth);
        return;
    }
    clear_ *= passing(optical_depth * share_);
    if (out.size() > merge_from_) {
        // With the last one, where it ends here and neither order nor place of what is thin matters.
        VolumeLayer& last = out.back();
        const double begin = last.t - last.half_length;
        const double sum = last.optical_depth + optical_depth;
        if (sum <= kMergedDepth && std::abs(last.t + last.half_length - a) <= kSliver * reach_ &&
            sum * largest(glm::abs(color - last.color)) / 4 <= settings_.tolerance * unit_) {
            last.color += (color - last.color) * (optical_depth / sum);
            last.optical_depth = sum;
            last.t = 0.5 * (begin + b);
            last.half_length = 0.5 * (b - begin);
            return;
        }
    }
    out.push_back({0.5 * (a + b), optical_depth, color, 0.5 * (b - a)});
}

/// One volume whose value is a cubic in u and α linear in it, by Gauss' three points: true where their error is
/// below what is allowed.
///
/// With α in an interval of width Δα, g = 1/(1 − α) at most and L the length in opacity steps: −ln(1 − α) is the
/// quadratic through three points within Δα³g³/62, and so is its sum; what the rule misses of the quadratic is the
/// u⁶ of α², 0.023 of its coefficient. The same with a colour that is linear in the value and changes by Δc: third
/// derivative 3g²Δα²Δc + g³Δα³Δc.
bool VolumeRay::integrate_smooth(const Walk& walk, double a, double b, std::vector<VolumeLayer>& out) {
    const TransferFunction::Piece& piece = *walk.transfer;
    const double u_middle = (0.5 * (a + b) - walk.middle) * walk.per_half;
    const double u_half = 0.5 * (b - a) * walk.per_half;
    const std::array<double, 10>& c = walk.value.c;
    const auto value = [&](double u) { return c[0] + u * (c[1] + u * (c[2] + u * c[3])); };
    const double middle_value = value(u_middle);
    const double change = 2 * u_half * (std::abs(c[1]) + 2 * std::abs(c[2]) + 3 * std::abs(c[3]));
    const double off = std::abs(piece.opacity_slope) * change;
    const double most = piece.opacity + (middle_value - piece.from) * piece.opacity_slope + 0.5 * off;
    if (!(most > 0)) return !std::isnan(most);
    if (most > 0.5 || most > settings_.most_opacity) return false;
    const double length_in_steps = (b - a) * length(ray_.direction) / walk.volume->opacity_step();
    const double allowed = settings_.tolerance * (b - a) / reach_;
    const double g = 1 / (1 - most);
    const double cubic = piece.opacity_slope * c[3] * u_half * u_half * u_half;
    const double deep = length_in_steps * g * most;  // at most so deep
    const double g_off = g * off;
    const double depth_error =
        length_in_steps * (g_off * g_off * g_off / 31 + 0.0115 * g * g * cubic * cubic);
    if (!(clear_ * depth_error <= allowed)) return false;
    double color_change = largest(glm::abs(piece.color_slope)) * change / unit_;
    if (!walk.lit) {
        double color_error = length_in_steps * color_change * g_off * (g_off * (3 + g_off) / 62 + 8e-4);
        if (!settings_.pooled) color_error += 0.05 * color_change * deep * deep * std::min(1.0, deep + off / most);
        if (!(clear_ * color_error <= allowed)) return false;
    }
    if (settings_.pooled && (clear_ * deep * color_change > kUneven * settings_.tolerance ||
                             length_in_steps * g_off > 2 * kMergedDepth))
        return false;

    std::array<double, 3> extinction;
    std::array<Vec3, 3> colors;
    double depth = 0;
    for (std::size_t i = 0; i < 3; ++i) {
        const double v = value(u_middle + u_half * kGaussNode[i]);
        extinction[i] = optical(std::max(0.0, piece.opacity + (v - piece.from) * piece.opacity_slope));
        colors[i] = piece.color_at(v);
        depth += kGaussWeight[i] * extinction[i];
    }
    const double scale = 0.5 * length_in_steps;
    depth *= scale;
    if (!(depth > 0)) return true;
    if (walk.lit) {
        for (std::size_t i = 0; i < 3; ++i)
            colors[i] = lit_color(walk, a + 0.5 * (b - a) * (1 + kGaussNode[i]), colors[i]);
        // Colours bend by their second difference, of which the rule keeps nothing to first order.
        const double bend = largest(glm::abs(colors[0] - 2.0 * colors[1] + colors[2])) / unit_;
        color_change = 1.3 * std::max(largest(glm::abs(colors[0] - colors[2])), largest(glm::abs(colors[0] - colors[1]))) / unit_;
        const double bend_error = bend > kShadingNoise ? depth * bend * std::min(0.5, bend) * 0.25 : 0;
        const double order_error = settings_.pooled ? 0 : 0.05 * color_change * deep * deep * std::min(1.0, deep + off / most);
        if (!(clear_ * (bend_error + order_error) <= allowed)) return false;
        if (settings_.pooled && clear_ * depth * color_change > kUneven * settings_.tolerance) return false;
    }
    Vec3 color(0.0);
    double weight = 0;
    for (std::size_t i = 0; i < 3; ++i) {
        double w = kGaussWeight[i] * extinction[i];
        if (!settings_.pooled && color_change > 0) {
            double inner = 0;
            for (std::size_t j = 0; j < 3; ++j) inner += kGaussPartial[i][j] * extinction[j];
            w *= passing(std::max(0.0, scale * inner));
        }
        weight += w;
        color += w * colors[i];
    }
    put(a, b, depth, color / weight, out);
    return true;
}

/// On [a, b] all values are polynomials, and all transfer functions linear.
void VolumeRay::integrate(double a, double b, int level, std::vector<VolumeLayer>& out) {
    if (!(b - a > kSliver * reach_) || clear_ < least_clear_) return;
    if (here_.size() == 1 && here_[0]->transfer != nullptr && here_[0]->value.degree == 3 &&
        integrate_smooth(*here_[0], a, b, out))
        return;
    const double ray_length = length(ray_.direction);
    const double half = 0.5 * (b - a);
    std::array<Sample, kNodes> sample;
    bool blocks = false;
    bool blocks_all = true;
    for (std::size_t i = 0; i < kNodes; ++i) {
        sample[i] = at(a + half * (1 + kNode[i]));
        const bool infinite = sample[i].extinction == kInfinity;
        blocks = blocks || infinite;
        blocks_all = blocks_all && infinite;
    }
    // Whether a piece may be halved; work for one ray has a bound.
    const auto halve = [&] {
        if (level >= kMostLevels || halvings_left_ < 0) return false;
        if (halvings_left_-- == 0) {
            ++cut_short_;
            return false;
        }
        const double m = a + half;
        integrate(a, m, level + 1, out);
        integrate(m, b, level + 1, out);
        return true;
    };
    if (blocks) {
        // The colour is that of the place where the ray ends. What is left of halving is thin, and its
        // neighbour blocks.
        if (!blocks_all) return void(halve());
        const Sample entry = at(a + 1e-9 * (b - a));
        return put(a, a, kInfinity, entry.extinction == kInfinity ? entry.emission : sample[0].emission, out);
    }
    const double scale = half * ray_length;
    double depth = 0;
    for (std::size_t i = 0; i < kNodes; ++i) depth += kWeight[i] * sample[i].extinction;
    const double gauss_depth = scale * (sample[1].extinction + sample[3].extinction);
    depth *= scale;
    if (!(depth > 0)) return;

    // Colour by extinction and the transmittance inside of the piece; to be pooled: by extinction.
    Vec3 color(0.0), gauss_color(0.0);
    double weight = 0, gauss_weight = 0;
    for (std::size_t i = 0; i < kNodes; ++i) {
        double inner = 0;
        if (!settings_.pooled && depth > 1e-9) {
            for (std::size_t j = 0; j < kNodes; ++j) inner += kPartialWeight[i][j] * sample[j].extinction;
            inner *= scale;
        }
        const double passes = inner < 1e-4 ? 1 - inner : std::exp(-inner);
        color += kWeight[i] * passes * sample[i].emission;
        weight += kWeight[i] * passes * sample[i].extinction;
        if (i == 1 || i == 3) {
            gauss_color += passes * sample[i].emission;
            gauss_weight += passes * sample[i].extinction;
        }
    }
    // So thick that nothing of it passes the first point.
    if (!(weight > 0)) {
        if (!halve()) put(a, b, depth, sample[0].emission / sample[0].extinction, out);
        return;
    }
    color /= weight;
    if (gauss_weight > 0) gauss_color /= gauss_weight;

    // The better rule errs by less than they differ: where nothing is lit, whose colours have kinks, all is smooth, and
    // that by their square.
    const bool lit = std::ranges::any_of(here_, [](const Walk* walk) { return walk->lit; });
    const auto sharper = [&](double difference, double whole) {
        return lit ? difference : difference * std::min(1.0, 0.1 + 10 * difference / whole);
    };
    const double alpha = -std::expm1(-depth);
    const double depth_off = sharper(std::abs(depth - gauss_depth), depth);
    const double depth_error =
        depth_off * (settings_.pooled ? 1 / (1 + depth) : std::exp(-std::min(depth, gauss_depth)));
    const double color_off = largest(glm::abs(color - gauss_color)) / unit_;
    const double color_error = color_off > kShadingNoise ? alpha * sharper(color_off, 1) : 0;
    const double allowed = settings_.tolerance * (b - a) / reach_;
    // A pooled layer is one of one colour, evenly: what is in it must not vary where order matters.
    const auto uneven = [&] {
        const double off_middle = kWeight[0] * std::abs(sample[0].extinction - sample[4].extinction) +
                                  kWeight[1] * std::abs(sample[1].extinction - sample[3].extinction);
        if (scale * off_middle > 4 * kMergedDepth && clear_ * alpha > settings_.tolerance) return true;
        Vec3 least(kInfinity), most(-kInfinity);
        for (const Sample& s : sample) {
            if (!(s.extinction > 0)) continue;
            least = glm::min(least, s.emission / s.extinction);
            most = glm::max(most, s.emission / s.extinction);
        }
        return clear_ * largest(most - least) * std::min(depth, 8.0) > kUneven * settings_.tolerance * unit_;
    };
    if ((clear_ * std::max(depth_error, color_error) > allowed || (settings_.pooled && uneven())) && halve())
        return;
    put(a, b, depth, color, out);
}

}  // namespace pellucid
