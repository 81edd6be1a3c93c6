#include "reference/volume_rays.hpp"

#include <algorithm>
#include <cmath>

#include "scene/shading.hpp"

namespace pellucid {
namespace {

/// Kronrod's extension of Gauss' two points on [−1, 1]: A. S. Kronrod, Nodes and weights of quadrature formulas, 1965.
constexpr std::size_t kNodes = 5;
constexpr std::array<double, kNodes> kNode{-0.92582009977255146157, -0.57735026918962576451, 0, 0.57735026918962576451,
                                           0.92582009977255146157};
constexpr std::array<double, kNodes> kWeight{98.0 / 495, 27.0 / 55, 28.0 / 45, 27.0 / 55, 98.0 / 495};
/// The difference of the rules is the error of the lesser one; that of the better is far below.
constexpr double kRuleGain = 1;
/// Pieces are halved at most so often; what is left of a jump is then 2^-30 of a cell.
constexpr int kMostHalvings = 30;
/// Parts of a ray below this share of its way through volumes are rounding: at the end of a hull a value may pass that of
/// opacity 1 by its last bit.
constexpr double kSliver = 1e-12;
/// Shading is done in float32: differences of colours below this are its rounding, and no halving takes them away.
constexpr double kShadingNoise = 2e-6;
/// Colours of a layer that differ by less count as one.
constexpr double kEvenColor = 1e-3;
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

/// Chebyshev points and the inverse Vandermonde matrix of a polynomial of degree 9 through them.
struct Interpolation9 {
    std::array<double, 10> node{};
    std::array<std::array<double, 10>, 10> to_coefficients{};

    Interpolation9() {
        for (std::size_t i = 0; i < 10; ++i)
            node[i] = -std::cos(3.14159265358979323846 * (static_cast<double>(i) + 0.5) / 10);
        for (std::size_t j = 0; j < 10; ++j) {
            std::array<double, 11> c{1};
            std::size_t degree = 0;
            for (std::size_t m = 0; m < 10; ++m) {
                if (m == j) continue;
                const double scale = 1 / (node[j] - node[m]);
                std::array<double, 11> next{};
                for (std::size_t k = 0; k <= degree; ++k) {
                    next[k + 1] += c[k] * scale;
                    next[k] -= c[k] * node[m] * scale;
                }
                c = next;
                ++degree;
            }
            for (std::size_t k = 0; k < 10; ++k) to_coefficients[k][j] = c[k];
        }
    }
};
const Interpolation9 kInterpolation;

}  // namespace

VolumeRay::VolumeRay(const PreparedScene& scene, const VolumeRaySettings& settings) : scene_(&scene), settings_(settings) {
    for (std::size_t i = 0; i < scene.volumes.size(); ++i) {
        const VolumeObject& volume = scene.volumes[i];
        if (volume.bounds().empty()) continue;
        Walk walk{};
        walk.volume = &volume;
        walk.index = static_cast<std::uint32_t>(i);
        walk.lit = !volume.settings().shading.flat && volume.settings().interpolation != Interpolation::nearest;
        walks_.push_back(std::move(walk));
    }
    if (!walks_.empty()) unit_ = std::max(1.0, brightest_color(scene));
}

void VolumeRay::start(const Ray& ray) {
    ray_ = ray;
    t_ = scene_->camera.near();
    reach_ = 0;
    depth_ = 0;
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
    const std::array<int, 3> cells = walk.volume->cells();
    const Vec3 p = walk.from + t * walk.along;
    for (int axis = 0; axis < 3; ++axis) {
        const auto a = static_cast<std::size_t>(axis);
        walk.cell[a] = std::clamp(static_cast<int>(std::floor(p[axis])), 0, cells[a] - 1);
        // On a face, the cell that the ray goes into.
        if (walk.along[axis] < 0 && p[axis] == walk.cell[a] && walk.cell[a] > 0) --walk.cell[a];
        walk.step[a] = walk.along[axis] > 0 ? 1 : walk.along[axis] < 0 ? -1 : 0;
        walk.t_next[a] = walk.step[a] == 0 ? kInfinity
                                           : (walk.cell[a] + (walk.step[a] > 0 ? 1 : 0) - walk.from[axis]) / walk.along[axis];
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
    if (!(walk.t_next[axis] < walk.t_out) || next < 0 || next >= walk.volume->cells()[axis]) return false;
    walk.cell_begin = std::max(walk.cell_begin, walk.t_next[axis]);
    walk.cell[axis] = next;
    const int face = next + (walk.step[axis] > 0 ? 1 : 0);
    walk.t_next[axis] = (face - walk.from[static_cast<int>(axis)]) / walk.along[static_cast<int>(axis)];
    open_cell(walk);
    return true;
}

/// Stretches the current cell's end to that of its block, which is empty.
void VolumeRay::skip_block(Walk& walk) const {
    const std::array<int, 3> cells = walk.volume->cells();
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
    const Vec3 base(walk.cell[0], walk.cell[1], walk.cell[2]);
    const Vec3 p = walk.from + middle * walk.along - base;
    const Vec3 d = half * walk.along;
    std::array<double, kLooks + 1> stop{-1, 1};  // between which the value is monotone
    std::size_t stops = 2;
    Along& value = walk.value;
    switch (volume.settings().interpolation) {
        case Interpolation::nearest: {
            value.degree = 0;
            value.c[0] = static_cast<double>(volume.field().grid().at(walk.cell[0], walk.cell[1], walk.cell[2]));
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
            if (!(transfer.most_opacity(static_cast<double>(least), static_cast<double>(most)) > 0)) return give_up();
            const TrilinearDifferences f(corner);
            walk.cell_values = f;
            value.degree = 3;
            value.c[0] = f.value(p);
            value.c[1] = dot(f.gradient(p), d);
            value.c[2] = d.x * d.y * (f.xy + p.z * f.xyz) + d.x * d.z * (f.xz + p.y * f.xyz) + d.y * d.z * (f.yz + p.x * f.xyz);
            value.c[3] = d.x * d.y * d.z * f.xyz;
            if (!std::isfinite(value.c[0]) || !std::isfinite(value.c[3])) return give_up();
            if (transfer.piece_of(static_cast<double>(least)) == transfer.piece_of(static_cast<double>(most))) {
                walk.ends.push_back(walk.cell_end);
                return open_piece(walk);
            }
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
            const VolumeField::Samples around = volume.field().samples_around(walk.cell);
            const auto first = static_cast<double>(around[0]);
            std::array<double, 10> at{};
            for (std::size_t i = 0; i < 10; ++i)
                at[i] = catmull_rom_value(around, first, glm::clamp(p + kInterpolation.node[i] * d, Vec3(0.0), Vec3(1.0)));
            value.degree = 9;
            for (std::size_t k = 0; k < 10; ++k) {
                value.c[k] = 0;
                for (std::size_t i = 0; i < 10; ++i) value.c[k] += kInterpolation.to_coefficients[k][i] * at[i];
            }
            value.c[0] += first;
            if (!std::isfinite(value.c[0])) return give_up();
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
        for (auto k = std::upper_bound(kinks.begin(), kinks.end(), least); k != kinks.end() && *k < most; ++k) {
            double lo = stop[s], hi = stop[s + 1];
            const bool rising = right > left;
            for (int i = 0; i < 60 && hi - lo > 1e-15; ++i) {  // one root: the value is monotone
                const double u = 0.5 * (lo + hi);
                ((value(u) < *k) == rising ? lo : hi) = u;
            }
            walk.ends.push_back(middle + 0.5 * (lo + hi) * half);
        }
        if (right < left) std::reverse(walk.ends.begin() + static_cast<std::ptrdiff_t>(first), walk.ends.end());
        left = right;
    }
    walk.ends.push_back(walk.cell_end);
    open_piece(walk);
}

/// What the transfer function is on the current piece.
void VolumeRay::open_piece(Walk& walk) const {
    const double begin = walk.piece == 0 ? walk.cell_begin : walk.ends[walk.piece - 1];
    const double end = walk.ends[walk.piece];
    const double half = 0.5 * (walk.cell_end - walk.cell_begin);
    const double middle = 0.5 * (walk.cell_end + walk.cell_begin);
    const double u = half > 0 ? (0.5 * (begin + end) - middle) / half : 0;
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
    clear_ = clear;
    least_clear_ = least_clear;
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

VolumeRay::Sample VolumeRay::at(double t) const {
    Sample sum;
    int infinite = 0;
    Vec3 solid(0.0);
    for (const Walk* walk : here_) {
        const double half = 0.5 * (walk->cell_end - walk->cell_begin);
        const double middle = 0.5 * (walk->cell_end + walk->cell_begin);
        const double value = walk->value.degree == 0 ? walk->value.c[0] : walk->value(half > 0 ? (t - middle) / half : 0);
        const VolumeObject& volume = *walk->volume;
        const TransferFunction& transfer = volume.transfer();
        const TransferFunction::Piece& piece = walk->transfer != nullptr ? *walk->transfer : transfer.pieces()[transfer.piece_of(value)];
        const double opacity = std::min(piece.opacity_at(value), settings_.most_opacity);
        if (!(opacity > 0)) continue;
        Vec3 color = piece.color_at(value);
        if (walk->lit) {
            const Vec3 index = walk->from + t * walk->along;
            const Vec3 gradient = volume.settings().interpolation == Interpolation::trilinear
                                      ? walk->cell_values.gradient(index - Vec3(walk->cell[0], walk->cell[1], walk->cell[2]))
                                      : volume.gradient(glm::clamp(index, Vec3(0.0), volume.field().hull().hi));
            color = shade(*scene_, volume, ray_.origin + t * ray_.direction, color, gradient);
        }
        if (opacity >= 1) {
            ++infinite;
            solid += color;
            continue;
        }
        const double extinction = volume.extinction_of(opacity);
        sum.extinction += extinction;
        sum.emission += extinction * color;
    }
    if (infinite > 0) return {kInfinity, solid / static_cast<double>(infinite)};
    return sum;
}

void VolumeRay::put(double a, double b, double optical_depth, const Vec3& color, std::vector<VolumeLayer>& out) {
    if (!(optical_depth > 0)) return;
    for (const Walk* walk : here_) met_ |= std::uint64_t{1} << (walk->index & 63U);
    const double parts = optical_depth <= settings_.most_optical_depth || depth_ > VolumeRaySettings::kThinUntil
                             ? 1
                             : std::ceil(optical_depth / settings_.most_optical_depth);
    for (int i = 0; i < parts; ++i)
        out.push_back({a + (b - a) * ((i + 0.5) / parts), optical_depth / parts, color});
    depth_ += optical_depth;
    if (!pooled()) clear_ *= std::exp(-optical_depth);
}

/// On [a, b] all values are polynomials, and all transfer functions linear.
void VolumeRay::integrate(double a, double b, int halvings, std::vector<VolumeLayer>& out) {
    if (!(b - a > kSliver * reach_) || clear_ < least_clear_) return;
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
    const auto halve = [&] {
        const double m = a + half;
        integrate(a, m, halvings + 1, out);
        integrate(m, b, halvings + 1, out);
    };
    if (blocks) {
        // The colour is that of the place where the ray ends. What is left of halving is thin, and its neighbour blocks.
        if (!blocks_all) return halvings < kMostHalvings ? halve() : void();
        const Sample entry = at(a + 1e-9 * (b - a));
        return put(a, a, kInfinity, entry.extinction == kInfinity ? entry.emission : sample[0].emission, out);
    }
    const double scale = half * ray_length;
    double depth = 0;
    for (std::size_t i = 0; i < kNodes; ++i) depth += kWeight[i] * sample[i].extinction;
    const double gauss_depth = scale * (sample[1].extinction + sample[3].extinction);
    depth *= scale;
    if (!(depth > 0)) return;

    // Colour by extinction and the transmittance inside of the piece; thin layers for pooling: by extinction.
    Vec3 color(0.0), gauss_color(0.0);
    double weight = 0, gauss_weight = 0;
    for (std::size_t i = 0; i < kNodes; ++i) {
        double inner = 0;
        if (!pooled() && depth > 1e-9) {
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
    if (!(weight > 0)) return halvings < kMostHalvings ? halve() : put(a, b, depth, sample[0].emission / sample[0].extinction, out);
    color /= weight;
    if (gauss_weight > 0) gauss_color /= gauss_weight;

    const double alpha = -std::expm1(-depth);
    const Vec3 off = glm::abs(color - gauss_color);
    const double depth_error = std::abs(depth - gauss_depth) * (pooled() ? 1 / (1 + depth) : std::exp(-std::min(depth, gauss_depth)));
    const double color_off = std::max({off.x, off.y, off.z}) / unit_;
    const double color_error = color_off > kShadingNoise ? alpha * color_off : 0;
    const double allowed = kRuleGain * settings_.tolerance * (b - a) / reach_;
    // A thick layer is put as thin ones of one colour, so colour must not vary in it.
    const auto differs = [&](const Sample& x, const Sample& y) {
        const Vec3 d = glm::abs(x.emission * y.extinction - y.emission * x.extinction);
        return std::max({d.x, d.y, d.z}) > kEvenColor * unit_ * x.extinction * y.extinction;
    };
    const bool thick = pooled() && depth > settings_.most_optical_depth && depth_ <= VolumeRaySettings::kThinUntil &&
                       (differs(sample[0], sample[2]) || differs(sample[2], sample[4]));
    if (halvings < kMostHalvings && ((clear_ * std::max(depth_error, color_error) > allowed) || thick)) return halve();
    put(a, b, depth, color, out);
}

}  // namespace pellucid
