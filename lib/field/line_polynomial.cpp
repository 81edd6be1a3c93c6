#include "field/line_polynomial.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>

#include <boost/multiprecision/cpp_int.hpp>

namespace pellucid {
namespace {

using boost::multiprecision::cpp_int;
using boost::multiprecision::cpp_rational;
using Plan = LinePolynomial::Plan;

constexpr std::size_t kRoom = kMostLineDegree + 1;

// ---- Numbers that a coefficient can be -----------------------------------------------------------------------------

/// A double and the sum of magnitudes that made it: after k roundings the error is below k·2^-53·magnitude, to first
/// order (N. J. Higham, Accuracy and Stability of Numerical Algorithms, lemma 3.1).
struct Bounded {
    double value = 0;
    double magnitude = 0;

    /// More than all that can underflow in one coefficient, and still lost in every usual magnitude.
    static constexpr double kFloor = 0x1p-1000;

    static Bounded constant(double v) { return {v, std::abs(v)}; }
    /// With the roundings of product and sum added back (T. J. Dekker, A floating-point technique for extending the
    /// available precision, Numerische Mathematik 18, 1971): far origins would otherwise blur every coefficient.
    static Bounded on_line(double origin, double direction, double t) {
        const auto high_half = [](double v) {
            const double scaled = 0x1.0000002p27 * v;
            return scaled - (scaled - v);
        };
        const double p = direction * t;
        const double d = high_half(direction), d_low = direction - d;
        const double s = high_half(t), s_low = t - s;
        const double p_low = ((d * s - p) + d * s_low + d_low * s) + d_low * s_low;
        const double sum = origin + p;
        const double p_in_sum = sum - origin;
        const double sum_low = (origin - (sum - p_in_sum)) + (p - p_in_sum);
        const double value = sum + (sum_low + p_low);
        return {value, std::abs(value) + 0x1p-49 * (std::abs(origin) + std::abs(p)) + kFloor};
    }
    friend Bounded operator-(const Bounded& a) { return {-a.value, a.magnitude}; }
    friend Bounded operator+(const Bounded& a, const Bounded& b) {
        return {a.value + b.value, a.magnitude + b.magnitude};
    }
    friend Bounded operator*(const Bounded& a, const Bounded& b) {
        return {a.value * b.value, a.magnitude * b.magnitude};
    }
    friend Bounded divide(const Bounded& a, double by) {
        return {a.value / by, a.magnitude / std::abs(by) + kFloor};
    }
    friend Bounded times(const Bounded& a, int n) { return {a.value * n, a.magnitude * n}; }
    friend void after_product(Bounded& a) { a.magnitude += kFloor; }
};

/// n·2^e.
struct Dyadic {
    cpp_int n = 0;
    int e = 0;

    static Dyadic constant(double v) {
        if (v == 0) return {};
        int exponent = 0;
        const double fraction = std::frexp(v, &exponent);
        return {cpp_int(static_cast<std::int64_t>(std::ldexp(fraction, 53))), exponent - 53};
    }
    static Dyadic on_line(double origin, double direction, double t) {
        return constant(origin) + constant(direction) * constant(t);
    }
    friend Dyadic operator-(const Dyadic& a) { return {-a.n, a.e}; }
    friend Dyadic operator+(const Dyadic& a, const Dyadic& b) {
        if (a.n == 0) return b;
        if (b.n == 0) return a;
        if (a.e < b.e) return b + a;
        cpp_int sum = a.n << static_cast<unsigned>(a.e - b.e);
        sum += b.n;
        return {sum, b.e};
    }
    friend Dyadic operator*(const Dyadic& a, const Dyadic& b) {
        if (a.n == 0 || b.n == 0) return {};
        return {a.n * b.n, a.e + b.e};
    }
    friend Dyadic divide(const Dyadic& a, double power_of_two) {
        const int exponent = std::ilogb(power_of_two);
        return {power_of_two < 0 ? cpp_int(-a.n) : a.n, a.e - exponent};
    }
    friend Dyadic times(const Dyadic& a, int by) { return {a.n * by, a.e}; }
    friend void after_product(Dyadic&) {}
};

/// Where constants divide that are no powers of two.
struct Rational {
    cpp_rational value = 0;

    static Rational constant(double v) { return {cpp_rational(v)}; }
    static Rational on_line(double origin, double direction, double t) {
        return {cpp_rational(origin) + cpp_rational(direction) * cpp_rational(t)};
    }
    friend Rational operator-(const Rational& a) { return {-a.value}; }
    friend Rational operator+(const Rational& a, const Rational& b) { return {a.value + b.value}; }
    friend Rational operator*(const Rational& a, const Rational& b) { return {a.value * b.value}; }
    friend Rational divide(const Rational& a, double by) { return {a.value / cpp_rational(by)}; }
    friend Rational times(const Rational& a, int by) { return {a.value * by}; }
    friend void after_product(Rational&) {}
};

// ---- The formula along a line --------------------------------------------------------------------------------------

[[nodiscard]] constexpr int binomial(int n, int k) {
    int choose = 1;
    for (int i = 1; i <= k; ++i) choose = choose * (n - k + i) / i;
    return choose;
}

/// Coefficients c of Σ c_i u^i v^(d−i), v = 1 − u: Bernstein coefficients times C(d,i). Products of polynomials are
/// convolutions of these, and u + v = 1 raises the degree.
template <class C>
void multiply(const C* a, int a_degree, const C* b, int b_degree, C* out) {
    for (int i = 0; i <= a_degree + b_degree; ++i) {
        const int first = std::max(0, i - b_degree);
        const int last = std::min(i, a_degree);
        C sum = a[first] * b[i - first];
        for (int j = first + 1; j <= last; ++j) sum = sum + a[j] * b[i - j];
        after_product(sum);
        out[i] = sum;
    }
}

template <class C>
void raise(const C* a, int from, int to, C* out) {
    if (from == 0) {
        for (int i = 0; i <= to; ++i) out[i] = times(a[0], binomial(to, i));
        return;
    }
    std::copy(a, a + from + 1, out);
    for (int degree = from; degree < to; ++degree) {
        out[degree + 1] = out[degree];
        for (int i = degree; i > 0; --i) out[i] = out[i - 1] + out[i];
    }
}

/// Coefficients of the program's output; `all` is scratch and holds them.
template <class C>
const C* along_line(const Plan& plan, const Vec3& origin, const Vec3& direction, double lo, double hi,
                    std::vector<C>& all) {
    if (all.size() < plan.size) all.resize(plan.size);
    std::array<C, kRoom> spare;
    const auto linear = [&](double o, double d, C* out) {
        out[0] = C::on_line(o, d, lo);
        out[1] = C::on_line(o, d, hi);
    };
    for (std::size_t i = 0; i < plan.program.steps.size(); ++i) {
        const Step& s = plan.program.steps[i];
        const int degree = plan.degree[i];
        C* const out = all.data() + plan.place[i];
        const C* const a = all.data() + plan.place[s.a];
        const C* b = all.data() + plan.place[s.b];
        const int a_degree = plan.degree[s.a];
        const int b_degree = plan.degree[s.b];
        switch (s.op) {
            case Op::constant: out[0] = C::constant(s.value); break;
            case Op::x: linear(origin.x, direction.x, out); break;
            case Op::y: linear(origin.y, direction.y, out); break;
            case Op::z: linear(origin.z, direction.z, out); break;
            case Op::negate:
                for (int k = 0; k <= degree; ++k) out[k] = -a[k];
                break;
            case Op::square: multiply(a, a_degree, a, a_degree, out); break;
            case Op::power: {
                std::copy(a, a + a_degree + 1, out);
                for (int n = 1; n < s.exponent; ++n) {
                    std::copy(out, out + n * a_degree + 1, spare.data());
                    multiply(spare.data(), n * a_degree, a, a_degree, out);
                }
                break;
            }
            case Op::add:
            case Op::subtract:
                raise(a, a_degree, degree, out);
                if (b_degree < degree) {
                    raise(b, b_degree, degree, spare.data());
                    b = spare.data();
                }
                if (s.op == Op::add)
                    for (int k = 0; k <= degree; ++k) out[k] = out[k] + b[k];
                else
                    for (int k = 0; k <= degree; ++k) out[k] = out[k] + -b[k];
                break;
            case Op::multiply: multiply(a, a_degree, b, b_degree, out); break;
            case Op::divide:
                for (int k = 0; k <= degree; ++k) out[k] = divide(a[k], plan.program.steps[s.b].value);
                break;
            default: break;  // no polynomial: refused by from()
        }
    }
    return all.data() + plan.place[plan.program.outputs[0]];
}

// ---- One simple root in an interval --------------------------------------------------------------------------------

/// Newton squares its error: a step this short, and so much shorter than the one before, is the last.
constexpr double kLastStep = 0x1p-36;
constexpr double kConverging = 0x1p-12;

struct Refined {
    double u;      // in [0, 1]
    double slope;  // dp/du there
};

/// The root of Σ b_i B_i(u), whose coefficients change sign once. Newton, started where the control polygon crosses;
/// halving where a step leaves the bracket or does not shrink.
[[nodiscard]] Refined refine(const double* b, int d) {
    // With s = u/v, p = v^d g(s) for g = Σ C(d,i) b_i s^i, and p/p' = v² g / (g' − d v g); mirrored beyond ½.
    std::array<double, kRoom> c;
    const bool rising = b[0] < 0;
    int change = 0;
    for (int i = 0; i <= d; ++i) c[static_cast<std::size_t>(i)] = b[i] * binomial(d, i);
    for (int i = 0; i < d; ++i)
        if ((b[i] < 0) != (b[i + 1] < 0)) change = i;
    double u = (change + b[change] / (b[change] - b[change + 1])) / d;
    double lo = 0, hi = 1;
    double last_step = 1;
    double slope = 0;
    for (int iteration = 0; iteration < 200; ++iteration) {
        if (!(u > lo && u < hi)) u = lo + 0.5 * (hi - lo);
        const bool mirrored = u > 0.5;
        const double v = mirrored ? u : 1 - u;
        const double s = mirrored ? (1 - u) / u : u / (1 - u);
        double g = c[static_cast<std::size_t>(mirrored ? 0 : d)];
        double dg = 0;
        if (mirrored) {
            for (int i = 1; i <= d; ++i) {
                dg = dg * s + g;
                g = g * s + c[static_cast<std::size_t>(i)];
            }
        } else {
            for (int i = d - 1; i >= 0; --i) {
                dg = dg * s + g;
                g = g * s + c[static_cast<std::size_t>(i)];
            }
        }
        const double tilt = dg - d * v * g;
        slope = mirrored ? -tilt : tilt;
        for (int i = 2; i < d; ++i) slope *= v;
        if (d == 1) slope /= v;
        if (g == 0) break;
        ((g > 0) == rising ? hi : lo) = u;
        const double step = v * v * g / tilt;
        double next = mirrored ? u + step : u - step;
        const bool halve = !(next >= lo && next <= hi) || std::abs(next - u) > 0.5 * last_step;
        if (halve) next = lo + 0.5 * (hi - lo);
        const double moved = std::abs(next - u);
        const bool converges = moved <= kLastStep && moved <= kConverging * last_step;
        last_step = moved;
        u = next;
        if ((converges && !halve) || hi - lo <= 0x1p-60) break;
    }
    return {u, slope};
}

/// Roots worse conditioned than this share of the interval are found with exact coefficients.
constexpr double kMostDoubt = 1e-11;
/// Bisection in doubles ends here, and after so many intervals; then integers decide.
constexpr double kLeastPiece = 0x1p-30;
constexpr int kMostCuts = 400;

// ---- In doubles ----------------------------------------------------------------------------------------------------

struct Piece {
    std::array<double, kRoom> b, error;  // Bernstein coefficients
    double start, width;                 // of [0, 1]
};

/// Number of sign changes of coefficients that may be off by their error; zero counts as positive.
struct Changes {
    int least, most;
    bool ends_sure;
};

[[nodiscard]] Changes sign_changes(const Piece& p, int d) {
    unsigned negative = 0, unsure = 0;
    for (int i = 0; i <= d; ++i) {
        const auto k = static_cast<std::size_t>(i);
        negative |= (p.b[k] < 0 ? 1U : 0U) << k;
        unsure |= (std::abs(p.b[k]) > p.error[k] ? 0U : 1U) << k;
    }
    const unsigned pairs = (1U << static_cast<unsigned>(d)) - 1U;
    if (unsure == 0) {
        const int changes = std::popcount((negative ^ (negative >> 1U)) & pairs);
        return {changes, changes, true};
    }
    // Most changes of a sequence that ends with + or with −; the least leaves out what is unsure.
    int most_plus = 0, most_minus = 0, least = 0, last_sign = 0;
    for (int i = 0; i <= d; ++i) {
        const bool may_minus = ((negative | unsure) >> static_cast<unsigned>(i) & 1U) != 0;
        const bool may_plus = ((~negative | unsure) >> static_cast<unsigned>(i) & 1U) != 0;
        constexpr int kNever = -100;
        const int plus = may_plus ? (i == 0 ? 0 : std::max(most_plus, most_minus + 1)) : kNever;
        const int minus = may_minus ? (i == 0 ? 0 : std::max(most_minus, most_plus + 1)) : kNever;
        most_plus = plus;
        most_minus = minus;
        if (may_plus != may_minus) {
            const int sign = may_plus ? 1 : -1;
            least += last_sign == -sign ? 1 : 0;
            last_sign = sign;
        }
    }
    const bool ends_sure = ((unsure | unsure >> static_cast<unsigned>(d)) & 1U) == 0;
    return {least, std::max(most_plus, most_minus), ends_sure};
}

/// De Casteljau's scheme at `at`, a multiple of 1/16: `p` becomes the right part.
void split(Piece& p, int d, double at, Piece& left) {
    const double rest = 1 - at;
    // At ½ a sum rounds once, elsewhere products round too; a little more for the roundings of the bound itself.
    const double unit = at == 0.5 ? 0x1.02p-53 : 0x1.04p-51;
    left.b[0] = p.b[0];
    left.error[0] = p.error[0];
    for (int round = 1; round <= d; ++round) {
        for (std::size_t i = 0; i <= static_cast<std::size_t>(d - round); ++i) {
            const double size = rest * std::abs(p.b[i]) + at * std::abs(p.b[i + 1]);
            p.b[i] = rest * p.b[i] + at * p.b[i + 1];
            p.error[i] = rest * p.error[i] + at * p.error[i + 1] + (unit * size + 0x1p-1070);
        }
        left.b[static_cast<std::size_t>(round)] = p.b[0];
        left.error[static_cast<std::size_t>(round)] = p.error[0];
    }
    left.start = p.start;
    left.width = p.width * at;
    p.start += left.width;
    p.width *= rest;
}

/// Where pieces are cut: not where a root is, so the sign there must be sure.
constexpr std::array kCuts{8, 7, 9, 5, 11};

/// Appends the roots u in [0, 1], none of them multiple. False where doubles cannot tell, and then nothing is appended.
[[nodiscard]] bool isolate_in_doubles(const Bounded* c, int d, double roundings, std::vector<double>& roots) {
    const std::size_t before = roots.size();
    std::array<Piece, 40> stack;
    std::size_t depth = 0;
    Piece p;
    p.start = 0;
    p.width = 1;
    const double relative = 1.01 * (roundings + 2) * 0x1p-53;
    for (int i = 0; i <= d; ++i) {
        const auto k = static_cast<std::size_t>(i);
        const double over = 1.0 / binomial(d, i);
        p.b[k] = c[k].value * over;
        p.error[k] = c[k].magnitude * over * relative;
        if (!(p.error[k] < std::numeric_limits<double>::infinity())) return false;
    }
    bool sure = sign_changes(p, d).ends_sure;
    for (int pieces = 0; sure; ++pieces) {
        const Changes changes = sign_changes(p, d);
        if (changes.least == 1 && changes.most == 1) {
            const Refined root = refine(p.b.data(), d);
            const double error = *std::max_element(p.error.begin(), p.error.begin() + d + 1);
            sure = error * p.width <= kMostDoubt * std::abs(root.slope);
            roots.push_back(p.start + p.width * root.u);
        }
        if (changes.most <= 1) {
            if (!sure || depth == 0) break;
            p = stack[--depth];
            continue;
        }
        // Two roots or a pair of them that may be none: cut.
        sure = false;
        if (p.width < kLeastPiece || depth == stack.size() || pieces == kMostCuts) break;
        for (const int cut : kCuts) {
            Piece right = p;
            Piece left;
            split(right, d, cut / 16.0, left);
            if (!(std::abs(right.b[0]) > right.error[0])) continue;
            sure = true;
            stack[depth++] = right;
            p = left;
            break;
        }
    }
    if (!sure) roots.resize(before);
    return sure;
}

// ---- In integers ---------------------------------------------------------------------------------------------------

using Integers = std::vector<cpp_int>;

[[nodiscard]] Integers integers(const Dyadic* c, int d) {
    int least = std::numeric_limits<int>::max();
    for (int i = 0; i <= d; ++i)
        if (c[i].n != 0) least = std::min(least, c[i].e);
    Integers out(static_cast<std::size_t>(d) + 1);
    for (int i = 0; i <= d; ++i)
        if (c[i].n != 0) out[static_cast<std::size_t>(i)] = c[i].n << static_cast<unsigned>(c[i].e - least);
    return out;
}

[[nodiscard]] Integers integers(const Rational* c, int d) {
    cpp_int common = 1;
    for (int i = 0; i <= d; ++i) common = lcm(common, denominator(c[i].value));
    Integers out;
    for (int i = 0; i <= d; ++i) out.push_back(numerator(c[i].value) * (common / denominator(c[i].value)));
    return out;
}

void divide_by_content(Integers& p) {
    cpp_int content = 0;
    for (const cpp_int& c : p) content = gcd(content, c);
    if (content > 1)
        for (cpp_int& c : p) c /= content;
}

void drop_leading_zeros(Integers& p) {
    while (!p.empty() && p.back() == 0) p.pop_back();
}

/// Remainder of lead(b)^(deg a − deg b + 1)·a divided by b.
[[nodiscard]] Integers pseudo_remainder(Integers a, const Integers& b) {
    std::size_t rounds = a.size() - b.size() + 1;
    while (a.size() >= b.size()) {
        const cpp_int lead = a.back();
        for (cpp_int& c : a) c *= b.back();
        for (std::size_t i = 0; i < b.size(); ++i) a[a.size() - b.size() + i] -= lead * b[i];
        drop_leading_zeros(a);
        --rounds;
    }
    for (; rounds > 0; --rounds)
        for (cpp_int& c : a) c *= b.back();
    return a;
}

/// Greatest common divisor of polynomials with integer coefficients, without content; deg a >= deg b.
/// Subresultants: H. Cohen, A Course in Computational Algebraic Number Theory, algorithm 3.3.1.
[[nodiscard]] Integers common_divisor(Integers a, Integers b) {
    cpp_int g = 1, h = 1;
    while (b.size() > 1) {
        const auto delta = static_cast<unsigned>(a.size() - b.size());
        Integers r = pseudo_remainder(a, b);
        if (r.empty()) {
            divide_by_content(b);
            return b;
        }
        a = std::move(b);
        const cpp_int divisor = g * pow(h, delta);
        for (cpp_int& c : r) c /= divisor;
        b = std::move(r);
        g = a.back();
        if (delta == 1) h = g;
        else if (delta > 1) h = pow(g, delta) / pow(h, delta - 1);
    }
    return {1};
}

/// a/b, which leaves no remainder.
[[nodiscard]] Integers quotient(Integers a, const Integers& b) {
    Integers q(a.size() - b.size() + 1);
    for (std::size_t k = q.size(); k-- > 0;) {
        q[k] = a[k + b.size() - 1] / b.back();
        for (std::size_t i = 0; i < b.size(); ++i) a[k + i] -= q[k] * b[i];
    }
    return q;
}

/// The same roots, each once. With s = u/v, the coefficients of u^i v^(d−i) are those of the powers of s.
[[nodiscard]] Integers square_free(Integers c) {
    divide_by_content(c);
    Integers derivative;
    for (std::size_t i = 1; i < c.size(); ++i) derivative.push_back(c[i] * i);
    return quotient(c, common_divisor(c, derivative));
}

/// Part [start, start + width]/2^shift of [0, 1], and the Bernstein coefficients there times a positive number.
struct ExactPiece {
    Integers b;
    cpp_int start = 0, width = 1;
    unsigned shift = 0;
};

[[nodiscard]] int sign_changes(const Integers& b) {
    int changes = 0, last = 0;
    for (const cpp_int& c : b) {
        if (c == 0) continue;
        changes += last == -c.sign() ? 1 : 0;
        last = c.sign();
    }
    return changes;
}

/// Two parts, cut at sixteenths where there is no root.
void split(const ExactPiece& p, ExactPiece& left, ExactPiece& right) {
    const std::size_t d = p.b.size() - 1;
    for (const unsigned cut : {8U, 7U, 9U, 6U, 10U, 5U, 11U, 4U, 12U, 3U, 13U, 2U, 14U, 1U, 15U}) {
        // At the half, cut in units of ½: fewer bits.
        const unsigned bits = cut == 8 ? 1 : 4;
        const unsigned at = cut == 8 ? 1 : cut;
        const unsigned rest = (1U << bits) - at;
        Integers b = p.b;
        left.b.assign(d + 1, 0);
        left.b[0] = b[0] << static_cast<unsigned>(bits * d);
        for (std::size_t round = 1; round <= d; ++round) {
            for (std::size_t i = 0; i + round <= d; ++i) {
                if (cut != 8) {
                    b[i] *= rest;
                    b[i] += b[i + 1] * at;
                } else {
                    b[i] += b[i + 1];
                }
            }
            left.b[round] = b[0] << static_cast<unsigned>(bits * (d - round));
        }
        if (b[0] == 0) continue;
        for (std::size_t i = 0; i <= d; ++i) b[i] <<= static_cast<unsigned>(bits * i);
        right.b = std::move(b);
        left.shift = right.shift = p.shift + bits;
        left.start = p.start << bits;
        left.width = p.width * at;
        right.start = left.start + left.width;
        right.width = p.width * rest;
        return;
    }
}

/// Pieces with one root each, ascending. False where two roots are closer than 2^-depth, and then as many as were told
/// apart. Terminates for depth = ∞ only if no root is multiple.
[[nodiscard]] bool isolate_in_integers(const Integers& c, unsigned most_shift, std::vector<ExactPiece>& isolated) {
    const auto d = static_cast<int>(c.size()) - 1;
    cpp_int common = 1;
    for (int i = 0; i <= d; ++i) common = lcm(common, cpp_int(binomial(d, i)));
    std::vector<ExactPiece> stack(1);
    for (int i = 0; i <= d; ++i) stack[0].b.push_back(c[static_cast<std::size_t>(i)] * (common / binomial(d, i)));
    bool apart = true;
    while (!stack.empty()) {
        ExactPiece p = std::move(stack.back());
        stack.pop_back();
        const int changes = sign_changes(p.b);
        if (changes == 0) continue;
        if (changes == 1) {
            isolated.push_back(std::move(p));
        } else if (p.shift >= most_shift) {
            apart = false;
        } else {
            stack.resize(stack.size() + 2);
            split(p, stack.back(), stack[stack.size() - 2]);
        }
    }
    return apart;
}

[[nodiscard]] double ratio(const cpp_int& n, unsigned shift) {
    return std::ldexp(n.convert_to<double>(), -static_cast<int>(shift));
}

/// Where in [0, 1] the one root of a piece is: its coefficients as doubles keep their signs.
[[nodiscard]] double locate(const ExactPiece& p) {
    unsigned bits = 0;
    for (const cpp_int& c : p.b)
        if (c != 0) bits = std::max(bits, static_cast<unsigned>(msb(abs(c))));
    const unsigned excess = bits > 900 ? bits - 900 : 0;
    std::array<double, kRoom> b{};
    for (std::size_t i = 0; i < p.b.size(); ++i) {
        b[i] = cpp_int(abs(p.b[i]) >> excess).convert_to<double>();
        if (p.b[i].sign() < 0) b[i] = -std::max(b[i], 0x1p-60);
    }
    const Refined root = refine(b.data(), static_cast<int>(p.b.size()) - 1);
    return ratio(p.start, p.shift) + ratio(p.width, p.shift) * root.u;
}

/// Sign of Σ c_i u^i v^(d−i) at u = start/2^shift.
[[nodiscard]] int sign_at(const Integers& c, const cpp_int& start, unsigned shift) {
    const cpp_int v = (cpp_int(1) << shift) - start;
    cpp_int sum = c.back();
    cpp_int v_power = 1;
    for (std::size_t i = c.size() - 1; i-- > 0;) {
        v_power *= v;
        sum = sum * start + c[i] * v_power;
    }
    return sum.sign();
}

/// Multiple roots are suspected when a bisection gets here; two different roots may be closer than the second.
constexpr unsigned kSuspicion = 48;
constexpr unsigned kMostShift = 1000;

struct ShareRoot {
    double u;
    bool touching;
};

void isolate_exactly(Integers c, std::vector<ShareRoot>& roots, IsolationStats& stats) {
    // Zeros at the ends: zero counts as positive, so what matters is the sign inside.
    std::size_t at_lo = 0;
    while (at_lo < c.size() && c[at_lo] == 0) ++at_lo;
    if (at_lo == c.size()) return;  // zero all along
    if (at_lo > 0 && c[at_lo] < 0) roots.push_back({0.0, false});
    const std::size_t degree = c.size();
    drop_leading_zeros(c);
    const bool falls_from_hi = c.size() < degree && c.back() < 0;
    c.erase(c.begin(), c.begin() + static_cast<std::ptrdiff_t>(at_lo));

    std::vector<ExactPiece> isolated;
    if (isolate_in_integers(c, kSuspicion, isolated)) {
        for (const ExactPiece& p : isolated) roots.push_back({locate(p), false});
    } else {
        isolated.clear();
        if (!isolate_in_integers(square_free(c), kMostShift, isolated)) ++stats.undecided;
        for (const ExactPiece& p : isolated) {
            const bool touching = sign_at(c, p.start, p.shift) == sign_at(c, p.start + p.width, p.shift);
            stats.touching += touching ? 1U : 0U;
            roots.push_back({locate(p), touching});
        }
    }
    if (falls_from_hi) roots.push_back({1.0, false});
}

template <class C>
[[nodiscard]] Integers exact_coefficients(const Plan& plan, int degree, const Vec3& origin, const Vec3& direction,
                                          double lo, double hi) {
    std::vector<C> all;
    return integers(along_line(plan, origin, direction, lo, hi, all), degree);
}

[[nodiscard]] bool power_of_two(double value) {
    int exponent = 0;
    return std::abs(std::frexp(value, &exponent)) == 0.5;
}

}  // namespace

std::optional<LinePolynomial> LinePolynomial::from(const Program& value) {
    LinePolynomial p;
    Plan& plan = p.plan_;
    plan.program = value;
    std::vector<double> roundings;  // of each step's coefficients
    for (const Step& s : value.steps) {
        int degree = 0;
        double rounded = 0;
        const int a = s.a < plan.degree.size() ? plan.degree[s.a] : 0;
        const int b = s.b < plan.degree.size() ? plan.degree[s.b] : 0;
        const double ra = s.a < roundings.size() ? roundings[s.a] : 0;
        const double rb = s.b < roundings.size() ? roundings[s.b] : 0;
        switch (s.op) {
            case Op::constant:
                if (!std::isfinite(s.value)) return std::nullopt;
                break;
            case Op::x:
            case Op::y:
            case Op::z: degree = 1, rounded = 2; break;
            case Op::negate: degree = a, rounded = ra; break;
            // A product, and then as many sums as the shorter factor allows.
            case Op::square: degree = 2 * a, rounded = 2 * ra + a + 1; break;
            case Op::power:
                if (s.exponent < 1 || s.exponent > kMostLineDegree) return std::nullopt;
                degree = s.exponent * a, rounded = s.exponent * (ra + a + 1);
                break;
            // Each rise of the degree is a sum.
            case Op::add:
            case Op::subtract:
                degree = std::max(a, b);
                rounded = std::max(ra + (degree - a), rb + (degree - b)) + 1;
                break;
            case Op::multiply: degree = a + b, rounded = ra + rb + std::min(a, b) + 1; break;
            case Op::divide:
                if (value.steps[s.b].op != Op::constant || value.steps[s.b].value == 0) return std::nullopt;
                plan.dyadic = plan.dyadic && power_of_two(value.steps[s.b].value);
                degree = a, rounded = ra + 1;
                break;
            default: return std::nullopt;
        }
        if (degree > kMostLineDegree) return std::nullopt;
        plan.degree.push_back(degree);
        roundings.push_back(rounded);
        plan.place.push_back(plan.size);
        plan.size += static_cast<std::size_t>(degree) + 1;
    }
    plan.roundings = roundings[value.outputs[0]];
    // Beyond, products of errors would matter, and nothing would be sure anyway.
    if (plan.roundings > 1e6) return std::nullopt;
    p.degree_ = plan.degree[value.outputs[0]];
    return p;
}

void LinePolynomial::isolate(const Vec3& origin, const Vec3& direction, double lo, double hi, std::vector<Root>& roots,
                             IsolationStats& stats) const {
    if (!(lo < hi) || degree_ == 0) return;
    static thread_local std::vector<Bounded> all;
    static thread_local std::vector<double> simple;
    const double length = hi - lo;
    double least = lo;
    const auto append = [&](double u, bool touching) {
        const double t = std::isfinite(length) ? lo + length * u : lo * (1 - u) + hi * u;
        least = std::clamp(t, least, hi);  // ascending, however close
        roots.push_back({least, touching});
    };

    simple.clear();
    if (isolate_in_doubles(along_line(plan_, origin, direction, lo, hi, all), degree_, plan_.roundings, simple)) {
        for (const double u : simple) append(u, false);
        return;
    }
    ++stats.exact;
    std::vector<ShareRoot> found;
    isolate_exactly(plan_.dyadic ? exact_coefficients<Dyadic>(plan_, degree_, origin, direction, lo, hi)
                                 : exact_coefficients<Rational>(plan_, degree_, origin, direction, lo, hi),
                    found, stats);
    for (const ShareRoot& root : found) append(root.u, root.touching);
}

}  // namespace pellucid
