// Text of a formula (grammar: field/expression.hpp) to a graph, without recursion.
#pragma once

#include <cstddef>
#include <map>
#include <string>
#include <string_view>

#include "field/formula_graph.hpp"

namespace pellucid {

/// Longer texts are refused unread.
inline constexpr std::size_t kMostFormulaBytes = std::size_t{1} << 20U;

/// Throws Error(input), one line with the column; errors and meaning of `parameters` as in Expression.
///   most_depth  of parentheses and functions inside of each other
[[nodiscard]] FormulaGraph::Node parse_formula(std::string_view text,
                                               const std::map<std::string, double>& parameters,
                                               int most_depth, FormulaGraph& graph);

}  // namespace pellucid
