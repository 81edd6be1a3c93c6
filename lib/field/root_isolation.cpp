#include "field/root_isolation.hpp"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <limits>
#include <optional>
#include <type_traits>
#include <utility>

#include "core/interval.hpp"
#include "core/real.hpp"
#include "field/dual.hpp"
#include "field/line_polynomial.hpp"

namespace pellucid {
namespace {

/// A stretch of the line, and f at its ends.
struct Stretch {
    double a, b;
    Interval at_a, at_b;
};

/// Neighbouring pieces of which nothing could be said.
struct Cluster {
    double a, b;
    bool continuous;  // f is, on all of them
    bool cut_short;   // not subdivided to the end
};

enum class Sign : signed char { negative, positive, undefined };

struct Scratch {
    std::vector<Interval> intervals;
    std::vector<Dual<Interval>> boxes;
    std::vector<Real> numbers;
    std::vector<Dual<Real>> points;
    std::vector<Stretch> stack;
};

/// f along one line.
class Line {
public:
    Line(const Program& f, const Vec3& origin, const Vec3& direction, Scratch& scratch)
        : f_(f), origin_(origin), direction_(direction), scratch_(scratch) {}

    [[nodiscard]] int steps() const { return static_cast<int>(f_.steps.size()); }

    [[nodiscard]] Interval at(double t) const {
        const auto x = [t](double o, double d) { return Interval(o) + Interval(d) * Interval(t); };
        std::array<Interval, 1> out;
        run_program<Interval>(f_, along(x), scratch_.intervals, out);
        return out[0];
    }

    /// Range of f and of its slope.
    [[nodiscard]] Dual<Interval> over(double a, double b) const {
        const auto x = [a, b](double o, double d) {
            const Interval slope(d);
            return Dual<Interval>(Interval(o) + slope * Interval(a, b), slope);
        };
        std::array<Dual<Interval>, 1> out;
        run_program<Dual<Interval>>(f_, along(x), scratch_.boxes, out);
        if (out[0].slope.empty()) out[0].slope = Interval::everything(false);
        return out[0];
    }

    [[nodiscard]] double value(double t) const {
        const auto x = [t](double o, double d) { return Real(o + d * t); };
        std::array<Real, 1> out;
        run_program<Real>(f_, along(x), scratch_.numbers, out);
        return out[0].value;
    }

    [[nodiscard]] Dual<Real> value_and_slope(double t) const {
        const auto x = [t](double o, double d) { return Dual<Real>(Real(o + d * t), Real(d)); };
        std::array<Dual<Real>, 1> out;
        run_program<Dual<Real>>(f_, along(x), scratch_.points, out);
        return out[0];
    }

    /// Surely the sign of f where the interval tells it, else that of f in doubles: a function of t alone.
    [[nodiscard]] Sign sign(double t, const Interval& at_t) const {
        if (at_t.lo >= 0 && !at_t.empty()) return Sign::positive;
        if (at_t.hi < 0 && !at_t.empty()) return Sign::negative;
        const double v = value(t);
        if (std::isnan(v)) return Sign::undefined;
        return v >= 0 ? Sign::positive : Sign::negative;
    }
    [[nodiscard]] Sign sign(double t) const { return sign(t, at(t)); }

private:
    /// The three coordinates, each made by coordinate(origin, direction).
    template <class Coordinate>
    [[nodiscard]] std::array<std::invoke_result_t<Coordinate, double, double>, 3> along(
        const Coordinate& coordinate) const {
        return {coordinate(origin_.x, direction_.x), coordinate(origin_.y, direction_.y),
                coordinate(origin_.z, direction_.z)};
    }

    const Program& f_;
    Vec3 origin_, direction_;
    Scratch& scratch_;
};

[[nodiscard]] double middle(double a, double b) {
    return std::isfinite(b - a) ? a + 0.5 * (b - a) : 0.5 * a + 0.5 * b;
}
[[nodiscard]] bool neighbours(double a, double b) { return !(std::nextafter(a, b) < b); }
/// The interval at a point tells the sign.
[[nodiscard]] bool sure(const Interval& at) { return at.lo > 0 || at.hi < 0; }

/// The one change of sign in [a, b], where f is monotone: Newton, halving where a step leaves the bracket or
/// does not shrink, to the spacing of doubles.
[[nodiscard]] double refine(const Line& f, double a, double b, bool rising) {
    double lo = a, hi = b;
    double t = middle(a, b);
    double last_step = b - a;
    const double spacing = 0x1p-53 * std::max(std::abs(a), std::abs(b));
    for (int iteration = 0; iteration < 200; ++iteration) {
        const Dual<Real> v = f.value_and_slope(t);
        ((v.value.value >= 0) == rising ? hi : lo) = t;
        double next = t - v.value.value / v.slope.value;
        const bool halve = !(next >= lo && next <= hi) || std::abs(next - t) > 0.5 * last_step;
        if (halve) next = middle(lo, hi);
        last_step = std::abs(next - t);
        t = next;
        if (last_step <= spacing || neighbours(lo, hi)) break;
    }
    return t;
}

/// Neighbouring doubles with different signs, from different signs at a and b; f is defined at both.
[[nodiscard]] std::pair<double, double> follow_signs(const Line& f, double a, double b, Sign at_b) {
    while (!neighbours(a, b)) {
        const double m = middle(a, b);
        (f.sign(m) == at_b ? b : a) = m;
    }
    return {a, b};
}

/// Where |f| is least in [a, b], by golden section: f does not change its sign there.
[[nodiscard]] double least_magnitude(const Line& f, double a, double b) {
    constexpr double kGolden = 0.38196601125010515;
    const auto size = [&](double t) {
        const double v = std::abs(f.value(t));
        return std::isnan(v) ? std::numeric_limits<double>::infinity() : v;
    };
    // From a dense look, so that the pieces' own extremum is between neighbours.
    constexpr int kLooks = 32;
    const auto look = [&](int i) {
        const double share = static_cast<double>(std::clamp(i, 0, kLooks)) / kLooks;
        return std::clamp(a * (1 - share) + b * share, a, b);
    };
    int best = 0;
    double least = std::numeric_limits<double>::infinity();
    for (int i = 0; i <= kLooks; ++i) {
        const double v = size(look(i));
        if (v < least) least = v, best = i;
    }
    double lo = look(best - 1), hi = look(best + 1);
    double p = lo + kGolden * (hi - lo), q = hi - kGolden * (hi - lo);
    double at_p = size(p), at_q = size(q);
    for (int iteration = 0; iteration < 100 && p < q; ++iteration) {
        if (at_p <= at_q) {
            hi = q, q = p, at_q = at_p;
            p = lo + kGolden * (hi - lo);
            at_p = size(p);
        } else {
            lo = p, p = q, at_p = at_q;
            q = hi - kGolden * (hi - lo);
            at_q = size(q);
        }
    }
    const double found = at_p <= at_q ? p : q;
    const double looked = look(best);
    return size(found) < size(looked) ? found : looked;
}

class Subdivision {
public:
    Subdivision(const Line& f, double lo, double hi, std::vector<Root>& roots, IsolationStats& stats)
        : f_(f),
          lo_(lo),
          hi_(hi),
          least_(kLeastShare * hi - kLeastShare * lo),
          roots_(roots),
          stats_(stats) {}

    void run_all(std::vector<Stretch>& stack) {
        stack.clear();
        stack.push_back({lo_, hi_, f_.at(lo_), f_.at(hi_)});
        const int most = std::clamp(kMostSteps / std::max(1, f_.steps()), kFewestPieces, kMostPieces);
        for (int pieces = 0; !stack.empty(); ++pieces) {
            const Stretch piece = stack.back();
            stack.pop_back();
            if (pieces < most) look(piece, stack);
            else leave({piece.a, piece.b, false, true});
        }
        close();
    }

private:
    void look(const Stretch& s, std::vector<Stretch>& stack) {
        const Dual<Interval> range = f_.over(s.a, s.b);
        const Interval& value = range.value;
        const Interval& slope = range.slope;
        if (value.empty() || !value.has_zero()) return;
        const bool tiny = s.b - s.a <= least_ || neighbours(s.a, s.b);

        if (value.continuous) {
            const bool told_a = s.a == lo_ || sure(s.at_a);
            const bool told_b = s.b == hi_ || sure(s.at_b);
            if ((slope.lo >= 0 || slope.hi <= 0) && told_a && told_b) {
                // Monotone: the signs at the ends say all.
                const Sign at_a = f_.sign(s.a, s.at_a);
                const Sign at_b = f_.sign(s.b, s.at_b);
                if (at_a != at_b) add(refine(f_, s.a, s.b, at_b == Sign::positive));
                return;
            }
            if (!tiny && narrow(s, slope, stack)) return;
        }
        if (tiny) return leave({s.a, s.b, value.continuous, false});
        halve(s, value, stack);
    }

    /// From both ends f can fall no faster than its slope: cuts off what has no root.
    /// True where the piece is dealt with: no root, or one much smaller piece.
    bool narrow(const Stretch& s, const Interval& slope, std::vector<Stretch>& stack) const {
        if (!sure(s.at_a) || !sure(s.at_b)) return false;
        // Signs as if f were positive at a; then f >= near − fall·(t − a).
        const auto reach = [](const Interval& at, double fall) {
            const double near = at.lo > 0 ? at.lo : -at.hi;
            // Rounded down, with what is lost in the difference below.
            return fall > 0 ? near / fall * (1 - 0x1p-50) : std::numeric_limits<double>::infinity();
        };
        const double from_a = reach(s.at_a, s.at_a.lo > 0 ? -slope.lo : slope.hi);
        const double from_b = reach(s.at_b, s.at_b.lo > 0 ? slope.hi : -slope.lo);
        const double width = s.b - s.a;
        if (!(from_a < width && from_b < width)) return true;
        const double a = std::max(s.a, round_down(round_down(s.a + from_a)));
        const double b = std::min(s.b, round_up(round_up(s.b - from_b)));
        if (!(a <= b)) return true;
        if (!(b - a < 0.5 * width)) return false;
        const Interval at_a = a > s.a ? f_.at(a) : s.at_a;
        const Interval at_b = b < s.b ? f_.at(b) : s.at_b;
        // So that the sign is sure wherever a cluster can end.
        if (!sure(at_a) || !sure(at_b)) return false;
        stack.push_back({a, b, at_a, at_b});
        return true;
    }

    void halve(const Stretch& s, const Interval& value, std::vector<Stretch>& stack) {
        // Not where the sign is unsure, if that can be had.
        double m = middle(s.a, s.b);
        Interval at_m = f_.at(m);
        if (!sure(at_m) && !at_m.empty()) {
            const double other = s.a + 0.4140625 * (s.b - s.a);
            if (other > s.a && other < s.b) {
                m = other;
                at_m = f_.at(m);
            }
        }
        // All noise of rounding: smaller pieces say no more.
        if (value.continuous && s.at_a.has_zero() && at_m.has_zero() && s.at_b.has_zero() &&
            value.width() <= 4 * (s.at_a.width() + s.at_b.width()))
            return leave({s.a, s.b, true, false});
        stack.push_back({m, s.b, at_m, s.at_b});
        stack.push_back({s.a, m, s.at_a, at_m});
    }

    void add(double t) {
        close();
        append(t, false);
    }

    void append(double t, bool touching) {
        if (!roots_.empty() && roots_.size() > first_) t = std::max(t, roots_.back().t);
        roots_.push_back({t, touching});
        stats_.touching += touching ? 1U : 0U;
    }

    void leave(const Cluster& piece) {
        if (open_ && open_->b == piece.a) {
            open_->b = piece.b;
            open_->continuous = open_->continuous && piece.continuous;
            open_->cut_short = open_->cut_short || piece.cut_short;
            return;
        }
        close();
        open_ = piece;
    }

    /// Decides a cluster as far as that can be done.
    void close() {
        if (!open_) return;
        Cluster c = *open_;
        open_.reset();
        const Interval interval_a = f_.at(c.a);
        const Interval interval_b = f_.at(c.b);
        Sign at_a = f_.sign(c.a, interval_a);
        Sign at_b = f_.sign(c.b, interval_b);
        // A cluster in which f is monotone hides nothing; poles and gaps are judged below.
        const Dual<Interval> over = f_.over(c.a, c.b);
        bool doubt = c.cut_short || (over.value.continuous && over.slope.has_zero());

        // Where f is defined at one end alone: from there to the edge.
        if (at_a == Sign::undefined && at_b == Sign::undefined) {
            ++stats_.undecided;
            return;
        }
        if (at_a == Sign::undefined) {
            c.a = edge(c.b, c.a);
            at_a = f_.sign(c.a);
            doubt = true;
        } else if (at_b == Sign::undefined) {
            c.b = edge(c.a, c.b);
            at_b = f_.sign(c.b);
            doubt = true;
        }

        if (at_a != at_b) {
            change_of_sign(c, at_b, doubt);
        } else if (c.cut_short || c.a > lo_ || c.b < hi_ || sure(interval_a) || sure(interval_b)) {
            same_sign(c, at_a, doubt);
        } else {
            doubt = false;  // f is 0 all along, as far as doubles can tell
        }
        stats_.undecided += doubt ? 1U : 0U;
    }

    /// The last double with a value, from one that has towards one that has not.
    [[nodiscard]] double edge(double defined, double undefined) const {
        for (;;) {
            const double m = middle(defined, undefined);
            if (m == defined || m == undefined) return defined;
            (f_.sign(m) == Sign::undefined ? undefined : defined) = m;
        }
    }

    void change_of_sign(const Cluster& c, Sign at_b, bool& doubt) {
        const auto [a, b] = follow_signs(f_, c.a, c.b, at_b);
        if (!c.continuous) {
            // A root shrinks |f|; a pole lets it grow, a gap leaves it as it was or has no value.
            const double before = std::min(std::abs(f_.value(c.a)), std::abs(f_.value(c.b)));
            const double after = std::max(std::abs(f_.value(a)), std::abs(f_.value(b)));
            const auto noise = [](const Interval& at) { return at.continuous && at.has_zero(); };
            const bool zero = noise(f_.at(a)) || noise(f_.at(b));
            const Interval across = f_.over(a, b).value;
            if (!across.continuous && !zero && !(after <= 0.25 * before)) {
                ++stats_.poles;
                return;
            }
            doubt = doubt || !across.continuous;
        }
        append(b, false);
    }

    void same_sign(const Cluster& c, Sign sign, bool& doubt) {
        const double t = least_magnitude(f_, c.a, c.b);
        const Interval at_t = f_.at(t);
        if (sure(at_t) && f_.sign(t, at_t) != sign) {
            append(follow_signs(f_, c.a, t, f_.sign(t, at_t)).second, false);
            append(follow_signs(f_, t, c.b, sign).second, false);
        } else if (!sure(at_t) && !at_t.empty()) {
            // At an end of the interval there is no other side to have the same sign.
            if (t > lo_ && t < hi_) append(t, true);
        } else {
            doubt = true;
        }
    }

    const Line& f_;
    double lo_, hi_, least_;
    std::vector<Root>& roots_;
    IsolationStats& stats_;
    std::size_t first_ = roots_.size();
    std::optional<Cluster> open_;
};

}  // namespace

struct RootIsolator::State {
    Expression f;
    std::optional<LinePolynomial> polynomial;
};

RootIsolator::RootIsolator(Expression f) {
    std::optional<LinePolynomial> polynomial = LinePolynomial::from(f.value());
    state_ = std::make_shared<const State>(State{std::move(f), std::move(polynomial)});
}

void RootIsolator::isolate(const Vec3& origin, const Vec3& direction, double lo, double hi,
                           std::vector<Root>& roots, IsolationStats& stats) const {
    if (polynomial()) isolate_polynomial(origin, direction, lo, hi, roots, stats);
    else isolate_by_intervals(origin, direction, lo, hi, roots, stats);
}

int RootIsolator::most_roots() const {
    return polynomial() ? state_->polynomial->degree() : state_->f.degree().value_or(0);
}

bool RootIsolator::polynomial() const { return state_->polynomial.has_value(); }

void RootIsolator::isolate_polynomial(const Vec3& origin, const Vec3& direction, double lo, double hi,
                                      std::vector<Root>& roots, IsolationStats& stats) const {
    assert(polynomial());
    state_->polynomial->isolate(origin, direction, lo, hi, roots, stats);
}

void RootIsolator::isolate_by_intervals(const Vec3& origin, const Vec3& direction, double lo, double hi,
                                        std::vector<Root>& roots, IsolationStats& stats) const {
    if (!(lo < hi)) return;
    static thread_local Scratch scratch;
    const Line line(state_->f.value(), origin, direction, scratch);
    Subdivision(line, lo, hi, roots, stats).run_all(scratch.stack);
}

}  // namespace pellucid
