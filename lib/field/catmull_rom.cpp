#include "field/catmull_rom.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "field/safeguarded_newton.hpp"

namespace pellucid {
namespace {

constexpr std::uint64_t kWholeCell = 1;
constexpr int kMostCuts = 2;
/// Cells stay whole where lines along one axis are at most so many times the surface's shadow along it.
constexpr double kFlat = 3;
/// They are cut where the octants' lines are so many times as many as theirs, or fewer: every cell costs
/// memory, and lines that do not find theirs in a cache. Tuned on the skin of a head, 1 mm.
constexpr double kWorthACut = 0.6;
/// A line that may have several roots costs so many of those along the one axis that suits.
constexpr double kDear = 6;
/// Bisections of a line in a cell; what is left then is a cluster.
constexpr int kMostHalvings = 40;
/// Of the largest sample: values below are rounding.
constexpr double kNoise = 0x1p-47;

/// The part of the surface in one place, in shares of its cell of the grid.
struct Look {
    Box tight;  // empty: nothing there
    std::array<Interval, 3> gradient;
    std::array<int, 3> most_roots{};
    double lines = 0;  // what the sampler has to throw, in areas of the grid's cells
    bool flat = false;
};

[[nodiscard]] bool sure(const Interval& g) {
    return !g.has_zero() && !g.empty();
}

[[nodiscard]] double square(double x) {
    return x * x;
}

/// Lines are counted by what they must be for the oblique law: area across times the largest |∇f|/|∂f/∂axis|.
void count_lines(Look& look) {
    const Vec3 size = look.tight.size();
    double all = 0;
    double least = kInfinity;
    for (std::size_t a = 0; a < 3; ++a) {
        const auto b = (a + 1) % 3;
        const auto c = (a + 2) % 3;
        const double across = size[static_cast<int>(b)] * size[static_cast<int>(c)];
        all += kDear * look.most_roots[a] * across;
        const Interval& g = look.gradient[a];
        if (!sure(g)) continue;
        const double smallest = std::min(std::abs(g.lo), std::abs(g.hi));
        const double steepest =
            std::sqrt(square(look.gradient[b].reach()) + square(look.gradient[c].reach()));
        const double most = std::sqrt(1 + square(steepest / smallest));
        const double lines = across * most;
        if (lines >= least) continue;
        least = lines;
        const auto middle = [&](std::size_t axis) { return look.gradient[axis].lo + look.gradient[axis].hi; };
        const double typical = std::sqrt(1 + (square(middle(b)) + square(middle(c))) / square(middle(a)));
        look.flat = most <= kFlat * typical;
    }
    look.lines = std::min(least, all);
}

/// f is that of the cell of the grid.
[[nodiscard]] Look look_at(const Tricubic& f, const Vec3& lo, const Vec3& hi) {
    Look look;
    Box box{lo, hi};
    Tricubic part = f.part(lo, hi);
    // A second look, where the box has shrunk, sees more.
    for (int pass = 0; pass < 2; ++pass) {
        const Box zeros = part.zeros();
        if (zeros.empty()) return look;
        const Vec3 size = box.size();
        const Vec3 first = box.lo;
        for (int axis = 0; axis < 3; ++axis) {
            box.lo[axis] = first[axis] + zeros.lo[axis] * size[axis];
            // A face stays where it is to the last bit.
            if (zeros.hi[axis] < 1) box.hi[axis] = first[axis] + zeros.hi[axis] * size[axis];
        }
        part = part.part(zeros.lo, zeros.hi);
        const Vec3 left = zeros.size();
        if (left.x * left.y * left.z > 0.7) break;
    }
    look.tight = box;
    const Vec3 size = box.size();
    for (int axis = 0; axis < 3; ++axis) {
        const auto a = static_cast<std::size_t>(axis);
        const Interval slope = part.slope(axis);
        look.gradient[a] = Interval(slope.lo / size[axis], slope.hi / size[axis]);
        look.most_roots[a] = sure(slope) ? 1 : sure(part.bend(axis)) ? 2 : 3;
    }
    count_lines(look);
    return look;
}

/// The octants of a cell of the grid that are worth their lines.
struct Cutter {
    const Tricubic& f;
    std::uint64_t base;  // the code of a place but for its path
    std::vector<std::uint64_t>& out;

    /// Adds a place or its parts; the lines that they cost.
    double add(const Look& look, const Vec3& lo, double width, std::uint64_t path, int depth) {
        if (!look.flat && depth < kMostCuts) {
            const std::size_t before = out.size();
            const double half = 0.5 * width;
            double sum = 0;
            for (unsigned octant = 0; octant < 8; ++octant) {
                const Vec3 at = lo + half * Vec3(octant & 1U, octant >> 1U & 1U, octant >> 2U);
                const Look part = look_at(f, at, at + Vec3(half));
                if (!part.tight.empty()) sum += add(part, at, half, path << 3U | octant, depth + 1);
            }
            if (sum <= kWorthACut * look.lines) return sum;
            out.resize(before);
        }
        out.push_back(base | path);
        return look.lines;
    }
};

// ---- along a line

constexpr int kDegree = 9;
using Coefficients = std::array<double, kDegree + 1>;

[[nodiscard]] bool positive(double value) {
    return value >= 0;
}

/// The weights of an axis along a line, from place a to b: each as a cubic, its Bernstein coefficients times
/// binomials.
[[nodiscard]] std::array<std::array<double, 4>, 4> weights_along(double a, double b) {
    // w(t) = c0 + c1 t + c2 t² + c3 t³; the blossom of t^k is the k-th elementary symmetric mean.
    constexpr std::array<std::array<double, 4>, 4> kPowers{
        {{0, -0.5, 1, -0.5}, {1, 0, -2.5, 1.5}, {0, 0.5, 2, -1.5}, {0, 0, -0.5, 0.5}}};
    std::array<std::array<double, 4>, 4> out{};
    for (std::size_t m = 0; m < 4; ++m) {
        const double u = m > 2 ? b : a, v = m > 1 ? b : a, w = m > 0 ? b : a;
        const double one = (u + v + w) / 3;
        const double two = (u * v + v * w + w * u) / 3;
        const double binomial = m == 1 || m == 2 ? 3 : 1;
        for (std::size_t i = 0; i < 4; ++i)
            out[i][m] = binomial * (kPowers[i][0] + kPowers[i][1] * one + kPowers[i][2] * two +
                                    kPowers[i][3] * (u * v * w));
    }
    return out;
}

/// f on the segment from a to b, Bernstein form.
[[nodiscard]] Coefficients along(const VolumeField::Samples& samples, double isovalue, const Vec3& a,
                                 const Vec3& b) {
    const auto x = weights_along(a.x, b.x);
    const auto y = weights_along(a.y, b.y);
    const auto z = weights_along(a.z, b.z);
    Coefficients sum{};
    for (std::size_t k = 0; k < 4; ++k) {
        std::array<double, 7> slice{};
        for (std::size_t j = 0; j < 4; ++j) {
            std::array<double, 4> row{};
            for (std::size_t i = 0; i < 4; ++i) {
                const double sample = static_cast<double>(samples[i + 4 * j + 16 * k]) - isovalue;
                for (std::size_t m = 0; m < 4; ++m) row[m] += sample * x[i][m];
            }
            for (std::size_t m = 0; m < 4; ++m)
                for (std::size_t n = 0; n < 4; ++n) slice[m + n] += y[j][m] * row[n];
        }
        for (std::size_t m = 0; m < 4; ++m)
            for (std::size_t n = 0; n < 7; ++n) sum[m + n] += z[k][m] * slice[n];
    }
    constexpr Coefficients kBinomials{1, 9, 36, 84, 126, 126, 84, 36, 9, 1};
    for (std::size_t i = 0; i < sum.size(); ++i) sum[i] /= kBinomials[i];
    return sum;
}

/// Value and slope at t, by de Casteljau.
[[nodiscard]] std::pair<double, double> value_and_slope(Coefficients b, double t) {
    for (std::size_t n = kDegree; n > 1; --n)
        for (std::size_t i = 0; i < n; ++i) b[i] += t * (b[i + 1] - b[i]);
    return {b[0] + t * (b[1] - b[0]), kDegree * (b[1] - b[0])};
}

/// All changes of sign in [lo, hi] of [0, 1], by Descartes' rule; `part` are the coefficients there.
struct LineRoots {
    const Coefficients& whole;
    double noise;
    IsolationStats& stats;
    std::array<double, kDegree> root{};
    std::size_t count = 0;

    void isolate(const Coefficients& part, double lo, double hi, int depth) {
        int changes = 0;
        double largest = 0;
        for (std::size_t i = 0; i < kDegree; ++i)
            changes += positive(part[i]) != positive(part[i + 1]) ? 1 : 0;
        if (changes == 0) return;
        const bool differ = positive(part.front()) != positive(part.back());
        if (changes == 1) {
            const double guess = lo + (hi - lo) * (part.front() / (part.front() - part.back()));
            push(safeguarded_newton(lo, hi, guess, !positive(part.front()),
                                    [&](double t) { return value_and_slope(whole, t); }));
            return;
        }
        for (const double value : part) largest = std::max(largest, std::abs(value));
        if (depth == kMostHalvings || largest <= noise) {
            ++stats.undecided;
            if (differ) push(0.5 * (lo + hi));
            return;
        }
        Coefficients left{};
        Coefficients right = part;
        for (std::size_t n = 0; n <= kDegree; ++n) {
            left[n] = right[0];
            for (std::size_t i = 0; i < kDegree - n; ++i) right[i] = 0.5 * (right[i] + right[i + 1]);
        }
        const double middle = 0.5 * (lo + hi);
        isolate(left, lo, middle, depth + 1);
        isolate(right, middle, hi, depth + 1);
    }
    void push(double t) {
        if (count < root.size()) root[count++] = t;
    }
};

}  // namespace

CatmullRomCells::CatmullRomCells(std::shared_ptr<const VolumeField> volume, double isovalue)
    : field_(std::move(volume), isovalue) {
    const VolumeField& grid = field_.volume();
    for (const int samples : grid.grid().size) {
        if (samples > 1 << kAxisBits)
            throw input_error("an axis of the volume has {} samples, expected at most {}", samples,
                              1 << kAxisBits);
        if (samples < 2) return;  // no cell
    }
    std::vector<std::vector<std::uint64_t>> found(field_.brick_count());
    std::atomic<std::size_t> lost = 0;
    parallel_for(found.size(), 4, [&](std::size_t begin, std::size_t end) {
        for (std::size_t brick = begin; brick < end; ++brick) {
            if (!field_.brick_may_hold(brick)) continue;
            const IsoField::CellRange range = field_.cells_of_brick(brick);
            std::size_t unknown = 0;
            for (int k = range.first[2]; k < range.last[2]; ++k)
                for (int j = range.first[1]; j < range.last[1]; ++j)
                    for (int i = range.first[0]; i < range.last[0]; ++i) {
                        const Tricubic f = Tricubic::in_cell(grid.samples_around({i, j, k}), isovalue);
                        if (!std::isfinite(f.rounding)) {
                            ++unknown;
                            continue;
                        }
                        const Look look = look_at(f, Vec3(0.0), Vec3(1.0));
                        if (look.tight.empty()) continue;
                        const auto wide = [](int n) { return static_cast<std::uint64_t>(n); };
                        const std::uint64_t base = ((wide(k) << kAxisBits | wide(j)) << kAxisBits | wide(i))
                                                   << kPathBits;
                        Cutter{f, base, found[brick]}.add(look, Vec3(0.0), 1, kWholeCell, 0);
                    }
            lost += unknown;
        }
    });
    lost_ = lost;
    std::size_t count = 0;
    for (const auto& each : found) count += each.size();
    cells_.reserve(count);
    for (const auto& each : found) cells_.insert(cells_.end(), each.begin(), each.end());
}

CatmullRomCells::Place CatmullRomCells::place_of(std::uint64_t code) {
    Place place{base_of(code), Vec3(0.0), Vec3(0.0)};
    const std::uint64_t path = code & ((1U << kPathBits) - 1);
    double width = 1;
    for (unsigned shift = 0; path >> shift != kWholeCell; shift += 3) {
        // From the last octant outwards.
        const std::uint64_t octant = path >> shift & 7U;
        for (int axis = 0; axis < 3; ++axis)
            place.lo[axis] = 0.5 * (place.lo[axis] + static_cast<double>(octant >> axis & 1U));
        width *= 0.5;
    }
    place.hi = place.lo + Vec3(width);
    return place;
}

SurfaceCell CatmullRomCells::cell(std::size_t index) const {
    const Place at = place(index);
    const Tricubic f = Tricubic::in_cell(field_.volume().samples_around(at.base), field_.isovalue());
    const Look look = look_at(f, at.lo, at.hi);
    const Vec3 base(at.base[0], at.base[1], at.base[2]);
    return {true, look.gradient, {base + look.tight.lo, base + look.tight.hi}};
}

Box CatmullRomCells::box(std::size_t index) const {
    const Place at = place(index);
    const Vec3 base(at.base[0], at.base[1], at.base[2]);
    return {base + at.lo, base + at.hi};
}

int CatmullRomCells::most_roots(std::size_t index, int axis) const {
    const Place at = place(index);
    const Tricubic f = Tricubic::in_cell(field_.volume().samples_around(at.base), field_.isovalue());
    return look_at(f, at.lo, at.hi).most_roots[static_cast<std::size_t>(axis)];
}

void CatmullRomCells::cross(std::size_t index, const Vec3& origin, const Vec3& direction, double t_lo,
                            double t_hi, std::vector<FieldRoot>& roots, IsolationStats& stats) const {
    const Place at = place(index);
    const Vec3 base(at.base[0], at.base[1], at.base[2]);
    // Where the line enters and leaves; half-open along axes across which it does not move, but at the
    // volume's end.
    double lo = t_lo;
    double hi = t_hi;
    Vec3 enters(-kInfinity), leaves(kInfinity);
    for (int axis = 0; axis < 3; ++axis) {
        const double first = base[axis] + at.lo[axis];
        const double last = base[axis] + at.hi[axis];
        if (direction[axis] == 0) {
            const bool end = last == field_.volume().grid().size[static_cast<std::size_t>(axis)] - 1;
            if (!(origin[axis] >= first && (origin[axis] < last || (end && origin[axis] == last)))) return;
            continue;
        }
        const double a = (first - origin[axis]) / direction[axis];
        const double b = (last - origin[axis]) / direction[axis];
        enters[axis] = std::min(a, b);
        leaves[axis] = std::max(a, b);
        lo = std::max(lo, enters[axis]);
        hi = std::min(hi, leaves[axis]);
    }
    if (!(lo < hi)) return;
    Vec3 from = origin + lo * direction - base;
    Vec3 to = origin + hi * direction - base;
    for (int axis = 0; axis < 3; ++axis) {
        const bool up = direction[axis] > 0;
        if (enters[axis] == lo) from[axis] = up ? at.lo[axis] : at.hi[axis];
        if (leaves[axis] == hi) to[axis] = up ? at.hi[axis] : at.lo[axis];
    }

    const double isovalue = field_.isovalue();
    const VolumeField::Samples samples = field_.volume().samples_around(at.base);
    Coefficients f = along(samples, isovalue, from, to);
    f.front() = catmull_rom_value(samples, isovalue, from);
    f.back() = catmull_rom_value(samples, isovalue, to);
    double largest = 0;
    for (const float sample : samples)
        largest = std::max(largest, std::abs(static_cast<double>(sample) - isovalue));
    LineRoots found{f, kNoise * largest, stats};
    found.isolate(f, 0, 1, 0);
    for (std::size_t i = 0; i < found.count; ++i) {
        const double share = found.root[i];
        Vec3 gradient = catmull_rom_gradient(samples, isovalue, from + share * (to - from));
        if (!(length(gradient) > 1e-12 * largest)) {
            // Of a root of several multiplicities: the direction beside it.
            const double beside = share < 0.5 ? share + 1e-3 : share - 1e-3;
            gradient = catmull_rom_gradient(samples, isovalue, from + beside * (to - from));
        }
        roots.push_back({lo + share * (hi - lo), gradient});
    }
}

}  // namespace pellucid
