// A program over many points at once: SIMD, every step over a chunk of points before the next.
//
// Equal to `run_program<Real>` to the last bit on every instruction set.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "field/program.hpp"

namespace pellucid {

class PointEvaluator {
public:
    explicit PointEvaluator(const Program& program);

    [[nodiscard]] std::size_t output_count() const { return outputs_.size(); }

    /// Arrays that the evaluator reads and writes have room for this many values more than they hold.
    static constexpr std::size_t kRoom = 8;
    /// Output k of point i goes to out[k][i]; out[k] null: not wanted. Safe from several threads.
    void operator()(std::size_t count, const double* x, const double* y, const double* z, double* const* out) const;

    /// One step on registers: arrays of a chunk. For the implementation.
    struct Instruction {
        Op op = Op::constant;
        std::uint8_t constant_operand = 0;  // 0: none, 1: `value` stands for a, 2: for b
        std::int32_t exponent = 0;
        std::uint32_t to = 0, a = 0, b = 0;
        double value = 0;
    };

private:
    std::vector<Instruction> instructions_;
    std::vector<std::uint32_t> outputs_;  // registers
    std::uint32_t registers_ = 0;         // the first three are x, y, z
};

}  // namespace pellucid
