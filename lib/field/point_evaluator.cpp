#include "field/point_evaluator.hpp"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "field/point_evaluator.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "core/elementary-inl.h"

HWY_BEFORE_NAMESPACE();
namespace pellucid {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::ScalableTag<double>;
using V = hn::Vec<D>;
inline constexpr D d;

HWY_INLINE V integer_power(V a, int exponent) {
    auto n = exponent < 0 ? 0U - static_cast<unsigned>(exponent) : static_cast<unsigned>(exponent);
    V result = hn::Set(d, 1.0);
    for (V square = a; n != 0; n >>= 1U) {
        if ((n & 1U) != 0) result = hn::Mul(result, square);
        if (n > 1) square = hn::Mul(square, square);
    }
    return exponent < 0 ? hn::Div(hn::Set(d, 1.0), result) : result;
}

template <class F>
HWY_INLINE void each(std::size_t count, double* to, const double* a, const F& f) {
    for (std::size_t i = 0; i < count; i += hn::Lanes(d)) hn::StoreU(f(hn::LoadU(d, a + i)), d, to + i);
}
template <class F>
HWY_INLINE void each(std::size_t count, const PointEvaluator::Instruction& s, double* to, const double* a,
                     const double* b, const F& f) {
    const V value = hn::Set(d, s.value);
    if (s.constant_operand == 1) {
        for (std::size_t i = 0; i < count; i += hn::Lanes(d)) hn::StoreU(f(value, hn::LoadU(d, b + i)), d, to + i);
    } else if (s.constant_operand == 2) {
        for (std::size_t i = 0; i < count; i += hn::Lanes(d)) hn::StoreU(f(hn::LoadU(d, a + i), value), d, to + i);
    } else {
        for (std::size_t i = 0; i < count; i += hn::Lanes(d))
            hn::StoreU(f(hn::LoadU(d, a + i), hn::LoadU(d, b + i)), d, to + i);
    }
}

/// Runs the instructions on the arrays of the registers.
void evaluate(const PointEvaluator::Instruction* begin, std::size_t instructions, std::size_t count,
              double* const* registers) {
    namespace el = elementary;
    for (std::size_t k = 0; k < instructions; ++k) {
        const PointEvaluator::Instruction& s = begin[k];
        double* to = registers[s.to];
        const double* a = registers[s.a];
        const double* b = registers[s.b];
        switch (s.op) {
            case Op::constant:
                for (std::size_t i = 0; i < count; i += hn::Lanes(d)) hn::StoreU(hn::Set(d, s.value), d, to + i);
                break;
            case Op::x:
            case Op::y:
            case Op::z: break;
            case Op::negate: each(count, to, a, [](V v) { return hn::Neg(v); }); break;
            case Op::square: each(count, to, a, [](V v) { return hn::Mul(v, v); }); break;
            case Op::abs: each(count, to, a, [](V v) { return hn::Abs(v); }); break;
            case Op::sqrt: each(count, to, a, [](V v) { return hn::Sqrt(v); }); break;
            case Op::exp: each(count, to, a, [](V v) { return el::exp(d, v); }); break;
            case Op::log: each(count, to, a, [](V v) { return el::log(d, v); }); break;
            case Op::sin: each(count, to, a, [](V v) { return el::sin_cos(d, v).sin; }); break;
            case Op::cos: each(count, to, a, [](V v) { return el::sin_cos(d, v).cos; }); break;
            case Op::tan:
                each(count, to, a, [](V v) {
                    const auto both = el::sin_cos(d, v);
                    return hn::Div(both.sin, both.cos);
                });
                break;
            case Op::power: each(count, to, a, [&](V v) { return integer_power(v, s.exponent); }); break;
            case Op::step:
                each(count, to, a,
                     [](V v) { return hn::IfThenElseZero(hn::Ge(v, hn::Zero(d)), hn::Set(d, 1.0)); });
                break;
            case Op::add: each(count, s, to, a, b, [](V u, V v) { return hn::Add(u, v); }); break;
            case Op::subtract: each(count, s, to, a, b, [](V u, V v) { return hn::Sub(u, v); }); break;
            case Op::multiply: each(count, s, to, a, b, [](V u, V v) { return hn::Mul(u, v); }); break;
            case Op::divide: each(count, s, to, a, b, [](V u, V v) { return hn::Div(u, v); }); break;
            case Op::min:
                each(count, s, to, a, b, [](V u, V v) { return hn::IfThenElse(hn::Gt(u, v), v, u); });
                break;
            case Op::max:
                each(count, s, to, a, b, [](V u, V v) { return hn::IfThenElse(hn::Lt(u, v), v, u); });
                break;
        }
    }
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace pellucid
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
#include <algorithm>
#include <array>
#include <map>

namespace pellucid {

HWY_EXPORT(evaluate);

namespace {

/// Points a chunk: the registers of a formula of a few dozen steps then stay in the first-level cache.
constexpr std::size_t kChunk = 128;
constexpr std::uint32_t kNone = ~0U;

[[nodiscard]] bool is_binary(Op op) { return op >= Op::add; }
[[nodiscard]] bool is_leaf(Op op) { return op <= Op::z; }

}  // namespace

PointEvaluator::PointEvaluator(const Program& program) {
    const auto& steps = program.steps;
    const auto count = static_cast<std::uint32_t>(steps.size());
    // Constants stand in the instructions, but where nothing else is there or an output is one.
    const auto constant = [&](std::uint32_t i) { return steps[i].op == Op::constant; };
    std::vector<bool> needed(count, false);  // constants that need a register
    for (const std::uint32_t i : program.outputs) needed[i] = needed[i] || constant(i);
    for (const Step& s : steps) {
        if (is_leaf(s.op)) continue;
        if (!is_binary(s.op) || (constant(s.a) && constant(s.b))) {
            if (constant(s.a)) needed[s.a] = true;
        }
    }
    // The last step that reads each result; outputs are read at the end.
    std::vector<std::uint32_t> last(count, 0);
    for (std::uint32_t i = 0; i < count; ++i) {
        if (is_leaf(steps[i].op)) continue;
        last[steps[i].a] = i;
        if (is_binary(steps[i].op)) last[steps[i].b] = i;
    }
    for (const std::uint32_t i : program.outputs) last[i] = kNone;

    // Registers are handed out again once their value has been read for the last time.
    std::vector<std::uint32_t> place(count, kNone);
    std::vector<std::uint32_t> spare;
    registers_ = 3;
    for (std::uint32_t i = 0; i < count; ++i) {
        const Step& s = steps[i];
        if (s.op == Op::x || s.op == Op::y || s.op == Op::z) {
            place[i] = static_cast<std::uint32_t>(s.op) - static_cast<std::uint32_t>(Op::x);
            continue;
        }
        if (constant(i) && !needed[i]) continue;
        Instruction made{.op = s.op, .exponent = s.exponent, .value = s.value};
        const auto release = [&](std::uint32_t operand) {
            if (last[operand] == i && place[operand] != kNone && place[operand] >= 3)
                spare.push_back(place[operand]);
        };
        if (!is_leaf(s.op)) {
            const bool binary = is_binary(s.op);
            if (binary && place[s.a] == kNone) {
                made.constant_operand = 1;
                made.value = steps[s.a].value;
            } else {
                made.a = place[s.a];
            }
            if (binary && place[s.b] == kNone) {
                made.constant_operand = 2;
                made.value = steps[s.b].value;
            } else if (binary) {
                made.b = place[s.b];
            }
            release(s.a);
            if (binary && s.b != s.a) release(s.b);
        }
        if (spare.empty()) {
            place[i] = registers_++;
        } else {
            place[i] = spare.back();
            spare.pop_back();
        }
        made.to = place[i];
        instructions_.push_back(made);
    }
    for (const std::uint32_t i : program.outputs) outputs_.push_back(place[i]);
}

void PointEvaluator::operator()(std::size_t count, const double* x, const double* y, const double* z,
                                double* const* out) const {
    thread_local std::vector<double> memory;
    thread_local std::vector<double*> registers;
    memory.resize(std::max(memory.size(), registers_ * (kChunk + kRoom)));
    registers.resize(registers_);
    for (std::size_t r = 3; r < registers_; ++r) registers[r] = memory.data() + r * (kChunk + kRoom);
    for (std::size_t first = 0; first < count; first += kChunk) {
        const std::size_t n = std::min(kChunk, count - first);
        // Inputs are only read: instructions never write to the first three registers.
        registers[0] = const_cast<double*>(x + first);
        registers[1] = const_cast<double*>(y + first);
        registers[2] = const_cast<double*>(z + first);
        HWY_DYNAMIC_DISPATCH(evaluate)(instructions_.data(), instructions_.size(), n, registers.data());
        for (std::size_t k = 0; k < outputs_.size(); ++k)
            if (out[k] != nullptr) std::copy_n(registers[outputs_[k]], n, out[k] + first);
    }
}

}  // namespace pellucid
#endif
