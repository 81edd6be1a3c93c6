// The one exception that leaves the library, and warnings.
//
// Three kinds of trouble, three means: our own mistakes are asserted; an answer that may not exist
// is a std::optional; bad input, a missing device and a failed run are an `Error`, whose kind is
// also the exit code of every command.
#pragma once

#include <cstddef>
#include <stdexcept>
#include <string>
#include <string_view>

#include <fmt/core.h>

namespace pellucid {

enum class Failure {
    input = 2,   // a file, key or argument is wrong: names it and what was expected
    device = 3,  // the asked device is not there
    run = 4,     // disk, memory, device lost, or our own bug
};

class Error : public std::runtime_error {
public:
    Error(Failure kind, const std::string& message) : std::runtime_error(message), kind_(kind) {}
    [[nodiscard]] Failure kind() const noexcept { return kind_; }
    [[nodiscard]] int exit_code() const noexcept { return static_cast<int>(kind_); }

private:
    Failure kind_;
};

/// Error of kind `input`. A message names thing, value and expectation in one line:
/// `scene.toml:12: surface "ring": opacity = 1.5, expected [0, 1]`.
template <class... Args>
[[nodiscard]] Error input_error(fmt::format_string<Args...> format, Args&&... args) {
    return {Failure::input, fmt::format(format, std::forward<Args>(args)...)};
}

template <class... Args>
[[nodiscard]] Error run_error(fmt::format_string<Args...> format, Args&&... args) {
    return {Failure::run, fmt::format(format, std::forward<Args>(args)...)};
}

/// Foreign text (a value, a name, a library's message) as part of one line: control characters become
/// blanks, several together one and none at the ends; more than `limit` bytes are cut between
/// characters of UTF-8 and end with "…".
[[nodiscard]] std::string one_line(std::string_view text, std::size_t limit = 400);

/// One line on stderr, "warning: …": something was left out or mended, and how often.
void warn(const std::string& message);

template <class... Args>
void warn(fmt::format_string<Args...> format, Args&&... args) {
    warn(fmt::format(format, std::forward<Args>(args)...));
}

}  // namespace pellucid
