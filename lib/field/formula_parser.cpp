// Dijkstra's shunting yard: values wait on one stack, operators that still lack their right side on another.
#include "field/formula_parser.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <numbers>
#include <vector>

#include <fmt/format.h>

#include "core/error.hpp"

namespace pellucid {
namespace {

using Node = FormulaGraph::Node;

struct Function {
    std::string_view name;
    Op op;
    bool many;  // two or more arguments, else one
};

constexpr Function kFunctions[] = {
    {"sqrt", Op::sqrt, false}, {"abs", Op::abs, false}, {"exp", Op::exp, false},
    {"log", Op::log, false},   {"sin", Op::sin, false}, {"cos", Op::cos, false},
    {"tan", Op::tan, false},   {"min", Op::min, true},  {"max", Op::max, true},
};

[[nodiscard]] bool is_blank(char c) { return c == ' ' || (c >= '\t' && c <= '\r'); }
[[nodiscard]] bool is_digit(char c) { return c >= '0' && c <= '9'; }
[[nodiscard]] bool begins_name(char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_';
}
[[nodiscard]] bool continues_name(char c) { return begins_name(c) || is_digit(c); }
[[nodiscard]] bool continues_character(char c) { return (static_cast<unsigned char>(c) & 0xC0U) == 0x80U; }

/// Bytes of the character of UTF-8 at the front; 0 where there is none.
[[nodiscard]] std::size_t character_size(std::string_view text) {
    const auto lead = static_cast<unsigned char>(text.front());
    std::size_t size = 4;
    if (lead < 0x80) size = 1;
    else if (lead < 0xE0) size = 2;
    else if (lead < 0xF0) size = 3;
    if ((lead >= 0x80 && lead < 0xC2) || lead > 0xF4) return 0;  // no first byte
    if (size > text.size()) return 0;
    const std::string_view rest = text.substr(1, size - 1);
    return std::all_of(rest.begin(), rest.end(), continues_character) ? size : 0;
}

class Parser {
public:
    Parser(std::string_view text, const std::map<std::string, double>& parameters, int most_depth,
           FormulaGraph& graph)
        : text_(text), parameters_(parameters), most_depth_(most_depth), graph_(graph) {}

    [[nodiscard]] Node read() {
        bool wants_value = true;
        for (skip_blanks(); at_ < text_.size(); skip_blanks())
            wants_value = wants_value ? read_value() : read_operator();
        if (wants_value) throw error(text_.size(), "the text ends, expected {}", kValue);
        finish(lowest);
        if (!pending_.empty()) {
            const Pending& open = pending_.back();
            throw error(open.at, "\"{}\" is never closed, expected \")\"",
                        open.function != nullptr ? fmt::format("{}(", open.function->name) : "(");
        }
        return values_.back();
    }

private:
    static constexpr std::string_view kValue = "a number, a name, \"(\" or a sign";

    /// How tightly an operator binds.
    enum Rank { none, lowest, sum = lowest, product, sign, power };

    /// A parenthesis ('('), a function ('f'), a minus in front ('~'), or an operator with both sides.
    struct Pending {
        char what;
        std::size_t at;
        const Function* function = nullptr;
        std::size_t arguments = 1;
    };

    [[nodiscard]] static Rank rank(char what) {
        switch (what) {
            case '+':
            case '-': return sum;
            case '*':
            case '/': return product;
            case '~': return sign;
            case '^': return power;
            default: return none;
        }
    }

    // Each reads one token and tells whether a value must follow.

    [[nodiscard]] bool read_value() {
        const char c = text_[at_];
        if (c == '+' || c == '-') {
            if (c == '-') pending_.push_back({'~', at_});
            ++at_;
            return true;
        }
        if (c == '(') {
            open({'(', at_});
            ++at_;
            return true;
        }
        if (is_digit(c) || c == '.') return read_number();
        if (begins_name(c)) return read_name();
        throw error(at_, "{}, expected {}", shown(at_), kValue);
    }

    [[nodiscard]] bool read_number() {
        double value = 0;
        const char* begin = text_.data() + at_;
        const auto [end, problem] = std::from_chars(begin, text_.data() + text_.size(), value);
        if (problem == std::errc::invalid_argument) throw error(at_, "{} is no number", shown(at_));
        const std::string_view digits(begin, static_cast<std::size_t>(end - begin));
        if (problem != std::errc())
            throw error(at_, "the number {} is not in the range of a double", one_line(digits, 40));
        values_.push_back(graph_.constant(value));
        at_ += digits.size();
        return false;
    }

    [[nodiscard]] bool read_name() {
        const std::size_t begin = at_;
        const std::string_view name = word(begin);
        at_ += name.size();
        if (name.size() == 1 && name[0] >= 'x' && name[0] <= 'z') {
            values_.push_back(graph_.variable(name[0] - 'x'));
            return false;
        }
        if (name == "pi") {
            values_.push_back(graph_.constant(std::numbers::pi));
            return false;
        }
        const auto is_it = [&](const Function& f) { return f.name == name; };
        const Function* function = std::find_if(std::begin(kFunctions), std::end(kFunctions), is_it);
        if (function != std::end(kFunctions)) {
            skip_blanks();
            if (at_ == text_.size() || text_[at_] != '(')
                throw error(begin, "\"{}\" is a function, expected \"(\" behind it", name);
            open({'f', begin, function});
            ++at_;
            return true;
        }
        const auto parameter = parameters_.find(std::string(name));
        if (parameter == parameters_.end())
            throw error(begin, "\"{}\" is no name here, expected {}", one_line(name, 40), known_names());
        if (!std::isfinite(parameter->second))
            throw error(begin, "the parameter \"{}\" is {}, expected a finite number", one_line(name, 40),
                        parameter->second);
        values_.push_back(graph_.constant(parameter->second));
        return false;
    }

    [[nodiscard]] bool read_operator() {
        const std::size_t begin = at_;
        const char c = text_[at_];
        if (const Rank r = rank(c); r != none && r != sign) {
            // What binds tighter is complete, and what binds as tightly unless it is a power.
            finish(c == '^' ? static_cast<Rank>(power + 1) : r);
            pending_.push_back({c, begin});
            ++at_;
            return true;
        }
        if (c == ',') {
            finish(lowest);
            if (pending_.empty() || pending_.back().function == nullptr)
                throw error(begin, "\",\" stands between the arguments of a function, and here is none");
            ++pending_.back().arguments;
            ++at_;
            return true;
        }
        if (c == ')') {
            finish(lowest);
            if (pending_.empty()) throw error(begin, "\")\" closes nothing, expected an operator or the end");
            const Pending group = pending_.back();
            pending_.pop_back();
            --depth_;
            if (group.function != nullptr) call(group);
            ++at_;
            return false;
        }
        if (c == '(' || c == '.' || continues_name(c))
            throw error(begin, "{} directly behind a value, expected an operator (a product needs *)",
                        shown(begin));
        throw error(begin, "{}, expected an operator, \")\" or the end", shown(begin));
    }

    void skip_blanks() {
        while (at_ < text_.size() && is_blank(text_[at_])) ++at_;
    }

    void open(const Pending& group) {
        if (++depth_ > most_depth_)
            throw error(group.at, "more than {} parentheses or functions inside of each other", most_depth_);
        pending_.push_back(group);
    }

    /// Applies the last operators down to the rank; parentheses stop it.
    void finish(Rank down_to) {
        while (!pending_.empty() && rank(pending_.back().what) >= down_to) {
            const Pending last = pending_.back();
            pending_.pop_back();
            apply(last);
        }
    }

    void apply(const Pending& operation) {
        const Node b = pop();
        if (operation.what == '~') return values_.push_back(graph_.negate(b));
        const Node a = pop();
        const auto ca = graph_.constant_value(a);
        const auto cb = graph_.constant_value(b);
        if (operation.what == '/' && cb == 0)
            throw error(operation.at, "\"/\" by 0, expected another divisor");
        if (operation.what == '^' && ca && *ca <= 0 && !cb)
            throw error(operation.at, "\"^\" of {} to what varies, expected a positive base", *ca);
        const Node result = [&] {
            switch (operation.what) {
                case '+': return graph_.add(a, b);
                case '-': return graph_.subtract(a, b);
                case '*': return graph_.multiply(a, b);
                case '/': return graph_.divide(a, b);
                default: return graph_.power(a, b);
            }
        }();
        if (const auto value = graph_.constant_value(result); value && !std::isfinite(*value))
            throw error(operation.at, "\"{}\" of {} and {} is {}, expected a finite number", operation.what,
                        ca.value_or(0), cb.value_or(0), *value);
        values_.push_back(result);
    }

    void call(const Pending& group) {
        const Function& f = *group.function;
        if (f.many ? group.arguments < 2 : group.arguments != 1)
            throw error(group.at, "\"{}\" has {} argument{}, expected {}", f.name, group.arguments,
                        group.arguments == 1 ? "" : "s", f.many ? "2 or more" : "1");
        if (!f.many) {
            const Node a = pop();
            const Node result = graph_.function(f.op, a);
            if (const auto value = graph_.constant_value(result); value && !std::isfinite(*value))
                throw error(group.at, "\"{}\" of {} is {}, expected a finite number", f.name,
                            graph_.constant_value(a).value_or(0), *value);
            return values_.push_back(result);
        }
        const std::size_t first = values_.size() - group.arguments;
        Node result = values_[first];
        for (std::size_t i = first + 1; i < values_.size(); ++i)
            result = f.op == Op::min ? graph_.min(result, values_[i]) : graph_.max(result, values_[i]);
        values_.resize(first);
        values_.push_back(result);
    }

    [[nodiscard]] Node pop() {
        const Node last = values_.back();
        values_.pop_back();
        return last;
    }

    // Words for errors

    template <class... Args>
    [[nodiscard]] Error error(std::size_t at, fmt::format_string<Args...> format, Args&&... args) const {
        const std::string_view before = text_.substr(0, at);
        const auto lines = std::count(before.begin(), before.end(), '\n');
        const std::string_view line = before.substr(before.rfind('\n') + 1);  // npos + 1 is 0
        const auto later_bytes = std::count_if(line.begin(), line.end(), continues_character);
        const std::size_t column = 1 + line.size() - static_cast<std::size_t>(later_bytes);
        return input_error("expression, {}column {}: {}",
                           lines > 0 ? fmt::format("line {}, ", lines + 1) : "", column,
                           fmt::format(format, std::forward<Args>(args)...));
    }

    [[nodiscard]] std::string_view word(std::size_t begin) const {
        std::size_t end = begin;
        while (end < text_.size() && continues_name(text_[end])) ++end;
        return text_.substr(begin, end - begin);
    }

    /// The word or character there, or the byte where it has no shape.
    [[nodiscard]] std::string shown(std::size_t at) const {
        const char c = text_[at];
        if (continues_name(c)) return fmt::format("\"{}\"", one_line(word(at), 40));
        const std::size_t size = character_size(text_.substr(at));
        if (size > 1 || (size == 1 && c > ' ' && c != 0x7f))
            return fmt::format("\"{}\"", text_.substr(at, size));
        return fmt::format("the byte 0x{:02x}", static_cast<unsigned char>(c));
    }

    [[nodiscard]] std::string known_names() const {
        std::string names = "x, y, z, pi";
        for (const auto& [name, value] : parameters_) names += ", " + name;
        names += " or a function:";
        for (const Function& f : kFunctions) names += fmt::format(" {}", f.name);
        return one_line(names);
    }

    std::string_view text_;
    const std::map<std::string, double>& parameters_;
    int most_depth_;
    FormulaGraph& graph_;
    std::size_t at_ = 0;
    int depth_ = 0;
    std::vector<Node> values_;
    std::vector<Pending> pending_;
};

}  // namespace

FormulaGraph::Node parse_formula(std::string_view text, const std::map<std::string, double>& parameters,
                                 int most_depth, FormulaGraph& graph) {
    if (text.size() > kMostFormulaBytes)
        throw input_error("expression: {} bytes, expected at most {}", text.size(), kMostFormulaBytes);
    if (std::all_of(text.begin(), text.end(), is_blank))
        throw input_error("expression: it is empty, expected a formula of x, y and z");
    return Parser(text, parameters, most_depth, graph).read();
}

}  // namespace pellucid
